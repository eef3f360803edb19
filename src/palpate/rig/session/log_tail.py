"""Tail of a session log: its entries as another process writes them, or all of one that ended."""

from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import BinaryIO

import zstandard

from palpate.base.errors import InputError
from palpate.drivers.transport.recording import Entry
from palpate.rig.session.log_file import is_locked, log_path
from palpate.rig.session.log_reader import entry_in

__all__ = ["LogTail"]

_CHUNK = 1 << 18


class LogTail:
    """Reads a log from its beginning on; each `read` goes on where the one before ended."""

    def __init__(self, folder: Path) -> None:
        """`folder`: the session's; its log may not be there yet."""
        self._folder = folder
        self._file: BinaryIO | None = None
        self._stream = zstandard.ZstdDecompressor().decompressobj()
        self._line = 0
        self._rest = b""

    @property
    def path(self) -> Path:
        """The log."""
        return log_path(self._folder)

    @property
    def is_written(self) -> bool:
        """Whether a process has the log open now."""
        file = self._opened()
        return file is not None and is_locked(file)

    def read(self) -> Iterator[Entry]:
        """The entries written since; none while there is no log. Raises InputError as `read_session` does."""
        try:
            file = self._opened()
            while file is not None and (data := file.read(_CHUNK)):
                yield from self._entries(self._unpacked(data))
        except OSError as error:
            raise InputError(f"{self.path} cannot be read: {error.strerror}") from error

    def _opened(self) -> BinaryIO | None:
        """The log, kept open: a view's own log is removed when its command ends, and read to its end."""
        if self._file is None:
            with suppress(FileNotFoundError):
                self._file = self.path.open("rb")
        return self._file

    def _unpacked(self, data: bytes) -> bytes:
        if self.path.suffix != ".zst":
            return data
        try:
            return b"" if self._stream.eof else self._stream.decompress(data)
        except zstandard.ZstdError as error:
            raise InputError(f"{self.path}: is no Zstandard stream, or was changed ({error})") from None

    def _entries(self, text: bytes) -> Iterator[Entry]:
        *lines, self._rest = (self._rest + text).split(b"\n")
        for line in lines:
            self._line += 1
            yield entry_in(self.path, self._line, line)
