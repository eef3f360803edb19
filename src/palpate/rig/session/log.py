"""The session log: everything that happened, in one append-only file that survives a crash.

JSON Lines in a Zstandard stream, one event a line, written every 0.05 s beside the thread that drives
devices: whatever kills the process, every line but perhaps the last is whole, and no more than the last 0.1 s
are missing. Raw bytes of every port stand beside the values that were made of them, on the rig's clock. So
does all else that decides what the host does, call by call: `log_reader` reads it, and `palpate replay` runs
the session again.
`docs/session-log.md` lists the events.
"""

import base64
import json
import zlib
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Self

from palpate.base.errors import InputError, OutputError
from palpate.drivers.transport.clock import Clock
from palpate.drivers.transport.record import Noted
from palpate.drivers.transport.recording import ErrorRaised, PortBytes, PortOpened
from palpate.rig.background import CAPACITY, Background
from palpate.rig.session.error_values import values_of
from palpate.rig.session.events import SessionEvents, plain
from palpate.rig.session.log_file import LOG_NAME, LogFile

__all__ = ["SessionLog", "check_sum", "session_folder"]

_STALLED_S = 5.0
_ENDED = "the run was ended, torque off"


def session_folder(root: Path, name: str) -> Path:
    """Make the folder for a session; InputError if it cannot be made.

    A folder of that name is used again: emulated sessions are named after everything that decides them, so
    it holds the same session.
    """
    folder = root / name
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(
            f"session folder {folder} cannot be made: {error.strerror}; choose another folder for sessions"
        ) from error
    return folder


def check_sum(line: str, before: int) -> int:
    """CRC-32 of a line without its check sum, going on from the sum of the line before (0 at first)."""
    return zlib.crc32(line.encode(), before)


class SessionLog(SessionEvents):
    """Writes one session's events: an observer of `identify`, and where a `Recorder` records to.

    Use as a context manager. Lines are made and written beside the thread that drives devices: once the file
    exists, nothing here waits or raises, but `check` and the end of the block.
    """

    def __init__(
        self,
        folder: Path,
        clock: Clock,
        header: Mapping[str, object],
        *,
        stalled_s: float = _STALLED_S,
        capacity: int = CAPACITY,
        needed: bool = True,
    ) -> None:
        """Start the log of a session in `folder` with a header line.

        A disk that takes nothing for `stalled_s`, in real time, or lets more than `capacity` lines wait,
        counts as gone. `needed`: whether a run should end if it cannot be logged. Raises InputError if the
        log cannot be written, or another process is writing it now.
        """
        self.path = folder / LOG_NAME
        self._clock = clock
        self._calls: list[str] = []
        self._sum = 0
        self._said = not needed
        self.has_traffic = False
        """Whether any byte went through a port."""
        self._stalled_s, self._capacity = stalled_s, capacity
        try:
            self._file = LogFile(self.path)
        except BlockingIOError as error:
            raise InputError(
                f"{self.path} is being written by another palpate; choose another folder for sessions"
            ) from error
        except OSError as error:
            raise InputError(
                f"{self.path} cannot be written: {error.strerror}; choose another folder for sessions"
            ) from error
        self._lines: Background[_Line] = Background(self._write, capacity, self._file.close)
        self.event("session", format="palpate/session@1", **header)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        how = "done" if error is None else type(error).__name__
        self.event("end", how=how, message=None if error is None else str(error))
        whole = self._lines.close(self._stalled_s)
        if whole or self._said:
            return
        if error is None:
            raise self._error("the run was complete")
        error.add_note(str(self._error(_ENDED)))

    def check(self) -> None:
        """Raise OutputError, once, if the log cannot be written any more: the run should end in order."""
        stalled = self._lines.busy_s > self._stalled_s
        if (self._lines.failure is not None or self._lines.dropped or stalled) and not self._said:
            self._said = True
            raise self._error(_ENDED)

    def event(self, kind: str, /, **values: object) -> None:
        """Append one event at the rig's present time."""
        t_s = self._clock.now()
        self._put(lambda: _event(t_s, kind, values))

    def note(self, what: Noted) -> None:
        """Log what a `Recorder` notes; a call of the host waits for the next line, as it is not worth one."""
        match what:
            case str():
                self._calls.append(what)
            case PortOpened():
                self.event("opened", port=what.port, number=what.number, url=what.url)
            case PortBytes():
                self.has_traffic = True
                instant = self._clock.now()
                self._put(lambda: _bytes(instant, what))
            case ErrorRaised():
                self.event("raised", during=what.during, **values_of(what.error))

    def _put(self, line: Callable[[], str]) -> None:
        """Have a line written, with the calls before it."""
        if not self._lines.dropped:  # what is written is a whole beginning
            self._lines.put((line, "".join(self._calls)))
        self._calls.clear()

    def _write(self, lines: Sequence["_Line"]) -> None:
        """Write lines with their calls and check sums, and hand them to the system. On the log's thread."""
        text = []
        for make, calls in lines:
            line = make()
            if calls:
                line = f'{line[:-1]},"calls":"{calls}"}}'
            self._sum = check_sum(line, self._sum)
            text.append(f'{line[:-1]},"sum":"{self._sum:08x}"}}\n')
        self._file.write("".join(text))

    def _error(self, run: str) -> OutputError:
        """What is wrong with the log; `run`: what became of the run."""
        failure = self._lines.failure
        if failure is not None:
            reason = failure.strerror if isinstance(failure, OSError) and failure.strerror else repr(failure)
        elif self._lines.dropped:
            reason = f"its queue of {self._capacity} lines was full: they came faster than they were written"
        else:
            reason = f"the disk has not taken it for {self._stalled_s:g} s"
        return OutputError(
            f"session log {self.path} cannot be written: {reason}; {run}; "
            "make room, or choose a sessions folder on another disk"
        )


_Line = tuple[Callable[[], str], str]
"""What makes a line, and the calls before it."""


def _event(t_s: float, kind: str, values: Mapping[str, object]) -> str:
    line = {"t_s": round(t_s, 9), "event": kind} | {key: plain(value) for key, value in values.items()}
    return json.dumps(line, separators=(",", ":"), allow_nan=False)


def _bytes(instant: float, what: PortBytes) -> str:
    text = base64.b64encode(what.data).decode()
    return (
        f'{{"t_s":{instant:.9f},"event":"bytes","port":{json.dumps(what.port)},'
        f'"direction":"{what.direction.value}","base64":"{text}"}}'
    )
