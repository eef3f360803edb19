"""The log's file: lines as a Zstandard stream (RFC 8878), readable up to the last complete block.

A block ends with every flush, so that the log of a killed process can be read: at most the lines since the
last flush are missing. Logs of older versions, and those that were unpacked by `zstd -d`, are plain text.
"""

import io
import threading
from collections.abc import Iterator
from pathlib import Path

import zstandard

from palpate.base.errors import InputError
from palpate.base.file_access import is_locked, lock_file
from palpate.base.file_io import LOG_BYTES, LOG_LINE_BYTES, read_bytes, size_in_words
from palpate.base.vocabulary import SESSIONS_FOLDER

LOG_NAME = "session.jsonl.zst"
_PLAIN_NAME = "session.jsonl"
_COMPRESSION_LEVEL = 1
"""A thousandth of the time in which a run fills the log; level 9 takes seven times that, for a tenth less."""

_CHUNK = 1 << 20
_LOCK_TRIES, _LOCK_PAUSE_S = 5, 0.01
_ADVICE = "record shorter runs"


class LogFile:
    """A log that is written: locked, so that no other process writes it."""

    def __init__(self, path: Path) -> None:
        """Begin the file anew. Raises OSError, BlockingIOError where another process writes it."""
        self._file = path.open("ab")
        self._lock()
        self._file.truncate(0)
        self._stream = zstandard.ZstdCompressor(level=_COMPRESSION_LEVEL).compressobj()

    def _lock(self) -> None:
        """Lock the file; a look at whether it is locked (`is_written_now`) is no reason to give up."""
        for left in reversed(range(_LOCK_TRIES)):
            try:
                lock_file(self._file)
                return
            except BlockingIOError:
                if not left:
                    self._file.close()
                    raise
                threading.Event().wait(_LOCK_PAUSE_S)

    def write(self, text: str) -> None:
        """Write text and hand it to the system."""
        self._file.write(self._stream.compress(text.encode()))
        self._file.write(self._stream.flush(zstandard.COMPRESSOBJ_FLUSH_BLOCK))
        self._file.flush()

    def fileno(self) -> int:
        """The file's descriptor."""
        return self._file.fileno()

    def close(self) -> None:
        """End the stream and close the file."""
        try:
            self._file.write(self._stream.flush())
        finally:
            self._file.close()


def session_of(path: Path) -> Path:
    """The session's folder, which a user may also name by its log. Raises InputError if there is no log."""
    if path.name in (LOG_NAME, _PLAIN_NAME) and path.is_file():
        return path.parent
    check_session(path)
    return path


def check_session(folder: Path) -> None:
    """Raise InputError if a folder has no log."""
    if folder.is_file():
        raise InputError(f"{folder} is not a session: it is a file, and none of the name {LOG_NAME}")
    if not folder.is_dir():
        raise InputError(f"{folder} is not a session: there is no such folder{_instead(folder)}")
    if not log_path(folder).is_file():
        raise InputError(f"{folder} is not a session: there is no {LOG_NAME} in it{_within(folder)}")


def _instead(folder: Path) -> str:
    """Say where a session of this name is, if it is with all others."""
    usual = Path(SESSIONS_FOLDER, folder.name)
    return f"; {usual} is one" if log_path(usual).is_file() else ""


def _within(folder: Path) -> str:
    """Say what to do with a folder of sessions."""
    holds_some = any(log_path(item).is_file() for item in folder.iterdir() if item.is_dir())
    return f"; `palpate sessions --sessions {folder}` lists those below it" if holds_some else ""


def log_path(folder: Path) -> Path:
    """Path of the log of a session."""
    plain = folder / _PLAIN_NAME
    return plain if plain.is_file() and not (folder / LOG_NAME).is_file() else folder / LOG_NAME


def log_lines(folder: Path) -> Iterator[bytes]:
    """The whole lines of a session's log, without their ends, as far as they can be read after a kill.

    Raises InputError if there is none, if it or a line of it is too large, or if it was changed.
    """
    path = log_path(folder)
    data = read_bytes(path, LOG_BYTES, _ADVICE)
    rest, number = b"", 0
    for piece in _pieces(data) if path.name == _PLAIN_NAME else _decompress(path, data):
        *lines, rest = (rest + piece).split(b"\n")
        for line in lines:
            number += 1
            check_line_length(path, number, line)
            yield line
        check_line_length(path, number + 1, rest)


def check_line_length(path: Path, number: int, line: bytes) -> None:
    """Raise InputError for a line, or the beginning of one, that is too long."""
    if len(line) > LOG_LINE_BYTES:
        most = size_in_words(LOG_LINE_BYTES)
        raise InputError(f"{path}: line {number}: has more than {most}; at most that is read")


def _pieces(data: bytes) -> Iterator[bytes]:
    return (data[begin : begin + _CHUNK] for begin in range(0, len(data), _CHUNK))


def _decompress(path: Path, data: bytes) -> Iterator[bytes]:
    size = 0
    try:
        with zstandard.ZstdDecompressor().stream_reader(io.BytesIO(data)) as stream:
            while piece := stream.read(_CHUNK):
                size += len(piece)
                if size > LOG_BYTES:
                    raise InputError(f"{path}: holds more than {size_in_words(LOG_BYTES)}: {_ADVICE}")
                yield piece
    except zstandard.ZstdError as error:
        raise InputError(f"{path}: is no Zstandard stream, or was changed ({error})") from None


def is_written_now(path: Path) -> bool:
    """True if a process has the log open for writing."""
    try:
        with path.open("rb") as file:
            return is_locked(file)
    except OSError:
        return False
