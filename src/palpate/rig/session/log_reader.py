"""Reading of a session log: from lines of text to the entries that a replay processes.

Every line is checked before anything is replayed. A mistake is one `InputError` line that names the file,
the line, and what is allowed. A log that was cut off by a kill is read up to its last whole line; one that
another process is writing is read as it grows (`LogTail`).
"""

import base64
import binascii
import json
import math
import re
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO, NoReturn

import zstandard

from palpate.base.errors import InputError
from palpate.base.file_access import is_locked
from palpate.base.file_io import MOST_LOG_LINES, MOST_LOG_VALUES
from palpate.base.short_repr import ShortRepr
from palpate.config.problems import excerpt
from palpate.drivers.transport import (
    CALLS,
    Direction,
    ErrorRaised,
    PortBytes,
    PortOpened,
    RecordedEvent,
    RecordEntry,
    SessionEvent,
)
from palpate.rig.session.log import INTERRUPTS, KINDS, error_of, line_checksum
from palpate.rig.session.log_file import check_line_length, check_session, log_lines, log_path

_FORMAT = "palpate/session@1"
_ADVICE = "record shorter runs"
_SUM = re.compile(r',"sum":"([0-9a-f]{8})"\}$')
_VALUE_MARKS = (b",", b"[", b"{")  # each goes with a value
_COMMON = ("t_s", "event", "calls", "sum")


@dataclass(frozen=True, repr=False)
class SessionFile(ShortRepr):
    """A session log: `header` is its first line, `entries` the lines after it, up to `end`.

    `end` is the last line's values, None if the log was cut off. `changed_line` is the first line that is not
    as it was written, by its check sum.
    """

    path: Path
    header: Mapping[str, Any]
    entries: tuple[RecordEntry, ...]
    end: Mapping[str, Any] | None
    changed_line: int | None

    def events(self) -> Iterator[tuple[float, str, Mapping[str, Any]]]:
        """Time, kind and values of all events but bytes, opened ports and errors, in order."""
        for entry in self.entries:
            if isinstance(entry.what, SessionEvent):
                yield entry.t_s, entry.what.kind, entry.what.values

    def told(self, kind: str) -> list[Mapping[str, Any]]:
        """Values of all events of a kind, in order."""
        kinds = (entry.what for entry in self.entries)
        return [what.values for what in kinds if isinstance(what, SessionEvent) and what.kind == kind]


def read_session(folder: Path) -> SessionFile:
    """Read the log in a session's folder; InputError if there is none, or a line of it cannot be read."""
    path = log_path(folder)
    check_session(folder)
    entries = []
    checked, changed, values = 0, None, 0
    for number, line in enumerate(log_lines(folder), start=1):
        text = _Line(path, number, {}).decoded(line)
        match = _SUM.search(text)
        bare = text if match is None else text[: match.start()] + "}"
        checked = line_checksum(bare, checked)
        if changed is None and (match is None or int(match[1], 16) != checked):
            changed = number
        entries.append(_Line.of(path, number, text).entry())
        if isinstance(entries[-1].what, SessionEvent):
            values += sum(map(line.count, _VALUE_MARKS))
        _check_counts(path, number, values)
    if not entries:
        raise InputError(f'{path}: has no whole line; the first must say format "{_FORMAT}"')
    header = _header(path, entries[0])
    ends = [
        k
        for k, entry in enumerate(entries)
        if isinstance(entry.what, SessionEvent) and entry.what.kind == "end"
    ]
    if ends and ends[0] != len(entries) - 1:
        raise InputError(f'{path}: line {ends[0] + 2}: comes after "end"; nothing is allowed there')
    last = entries[-1].what
    end = last.values if isinstance(last, SessionEvent) and last.kind == "end" else None
    return SessionFile(path, header, tuple(entries[1:]), end, changed)


def _parse_entry(path: Path, number: int, line: bytes) -> RecordEntry:
    """Return what one line of a log says; InputError, with its number, for what is wrong with it."""
    check_line_length(path, number, line)
    return _Line.of(path, number, _Line(path, number, {}).decoded(line)).entry()


def _check_counts(path: Path, lines: int, values: int) -> None:
    for count, most, what in ((lines, MOST_LOG_LINES, "lines"), (values, MOST_LOG_VALUES, "values")):
        if count > most:
            raise InputError(f"{path}: holds more than {most} {what}: {_ADVICE}")


def _header(path: Path, entry: RecordEntry) -> Mapping[str, Any]:
    what = entry.what
    values = what.values if isinstance(what, SessionEvent) and what.kind == "session" else {}
    if values.get("format") != _FORMAT:
        raise InputError(f'{path}: line 1: must be the event "session" with format "{_FORMAT}"')
    return values


@dataclass(frozen=True)
class _Line:
    """One line and where it stands; its methods raise InputError for what is wrong with it."""

    path: Path
    number: int
    values: Mapping[str, Any]

    @classmethod
    def of(cls, path: Path, number: int, text: str) -> "_Line":
        try:
            values = json.loads(text, parse_constant=_no_constant)
        except RecursionError:
            cls(path, number, {}).refuse("brackets are nested too deeply")
        except ValueError:
            cls(path, number, {}).refuse("is not JSON; every line must be one object")
        if not isinstance(values, dict):
            cls(path, number, {}).refuse(f"holds {excerpt(values)}; every line must be one object")
        return cls(path, number, values)

    def refuse(self, problem: str) -> NoReturn:
        raise InputError(f"{self.path}: line {self.number}: {problem}")

    def decoded(self, raw: bytes) -> str:
        try:
            return raw.decode("utf-8")
        except UnicodeDecodeError as error:
            self.refuse(f"holds byte 0x{raw[error.start]:02x}, which is not UTF-8")

    def entry(self) -> RecordEntry:
        instant = self.values.get("t_s")
        if not isinstance(instant, int | float) or isinstance(instant, bool) or not _finite(instant):
            self.refuse(f'"t_s" is {excerpt(instant)}; it must be a time in s')
        calls = self.values.get("calls", "")
        if not isinstance(calls, str) or CALLS.fullmatch(calls) is None:
            self.refuse('"calls" is not a row of calls; docs/session-log.md says how they are written')
        return RecordEntry(self.number, float(instant), calls, self._what(self.text("event")))

    def _what(self, kind: str) -> RecordedEvent:
        match kind:
            case "bytes":
                return PortBytes(self._direction(), self.text("port"), self._data())
            case "opened":
                url = None if self.values.get("url") is None else self.text("url")
                return PortOpened(self._number(), self.text("port"), url)
            case "raised":
                during = None if self.values.get("during") is None else self.text("during")
                return ErrorRaised(during, self._error())
            case "end":
                return SessionEvent(kind, self._rest(), self._interrupt())
        return SessionEvent(kind, self._rest())

    def _rest(self) -> dict[str, Any]:
        return {key: value for key, value in self.values.items() if key not in _COMMON}

    def text(self, key: str) -> str:
        value = self.values.get(key)
        if not isinstance(value, str):
            self.refuse(f'"{key}" is {excerpt(value)}; it must be a text')
        return value

    def _number(self) -> int:
        value = self.values.get("number")
        if not isinstance(value, int) or isinstance(value, bool) or value < 0:
            self.refuse(f'"number" is {excerpt(value)}; it must be a whole number from 0')
        return value

    def _direction(self) -> Direction:
        text = self.text("direction")
        if text not in {item.value for item in Direction}:
            self.refuse(f'"direction" is {excerpt(text)}; allowed: "sent", "received"')
        return Direction(text)

    def _data(self) -> bytes:
        try:
            data = base64.b64decode(self.text("base64"), validate=True)
        except (binascii.Error, ValueError):
            self.refuse('"base64" is not base64')
        if not data:
            self.refuse('"base64" is empty; a line of bytes must hold some')
        return data

    def _error(self) -> BaseException:
        kind, args = self.text("kind"), self.values.get("args")
        if not isinstance(args, list) or not all(isinstance(item, str | int) for item in args):
            self.refuse(f'"args" is {excerpt(args)}; it must be a list of texts and whole numbers')
        error = error_of(kind, args)
        if error is None:
            self.refuse(f"the error {excerpt(kind)} cannot be raised again; allowed: {', '.join(KINDS)}")
        return error

    def _interrupt(self) -> BaseException | None:
        """Return what interrupted the run, if its end says that something did."""
        how = self.text("how")
        message = self.values.get("message")
        if message is not None:
            self.text("message")
        return error_of(how, [message] if message else []) if how in INTERRUPTS else None


def _finite(value: float) -> bool:
    try:
        return math.isfinite(value)
    except OverflowError:  # a whole number beyond all doubles
        return False


def _no_constant(name: str) -> NoReturn:
    raise ValueError(name)


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
        """True if a process has the log open now."""
        file = self._opened()
        return file is not None and is_locked(file)

    def read(self) -> Iterator[RecordEntry]:
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

    def _entries(self, text: bytes) -> Iterator[RecordEntry]:
        *lines, self._rest = (self._rest + text).split(b"\n")
        for line in lines:
            self._line += 1
            yield _parse_entry(self.path, self._line, line)
