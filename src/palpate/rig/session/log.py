"""The session log: all events of a run in one append-only file that survives a crash.

JSON Lines in a Zstandard stream, one event a line, written every 0.05 s beside the thread that drives
devices: whatever kills the process, every line but perhaps the last is whole, and no more than the last 0.1
s are missing. Raw bytes of every port stand beside the values that were made of them, on the rig's clock. So
does all else that decides what the host does, call by call: `log_reader` reads it, and `palpate replay` runs
the session again. Errors that come from outside are written so that a replay can raise them again.
`docs/session-log.md` lists the events.
"""

import base64
import contextlib
import dataclasses
import json
import math
import zlib
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from enum import Enum
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
from serial import PortNotOpenError, SerialException, SerialTimeoutException

from palpate.base.errors import DeviceError, InputError, OutputError
from palpate.drivers.transport import (
    PORT_ERRORS,
    Clock,
    ErrorRaised,
    PortBytes,
    PortOpened,
    PortTaken,
    RecordItem,
)
from palpate.recognizer import Approach, Grip, Hypothesis
from palpate.rig.identification.events import (
    Event,
    MoveEvent,
    PlanEvent,
    RecognitionEvent,
    StageEvent,
    TouchEvent,
)
from palpate.rig.session.log_file import LOG_NAME, LogFile
from palpate.rig.session.signals import Interrupted
from palpate.rig.workers import QUEUE_CAPACITY, Background

_APPROACH = [field.name for field in dataclasses.fields(Approach)]


class SessionEvents(ABC):
    """An observer of `identify` for which everything is an event with values."""

    @abstractmethod
    def event(self, kind: str, /, **values: object) -> None:
        """Take one event."""

    def __call__(self, event: Event) -> None:
        """Take an event of the identification."""
        kind, values = _event_values(event)
        self.event(kind, **values)


def _event_values(event: Event) -> tuple[str, dict[str, object]]:
    """The event's name and values in the log."""
    match event:
        case StageEvent():
            return "stage", {"grip": event.grip, "stage": event.stage}
        case TouchEvent():
            return "touches", {"grip": event.grip, "touches": event.touches}
        case RecognitionEvent(grip, recognition, others, divisions):
            return "recognised", {
                "grip": grip,
                "verdict": recognition.verdict,
                "levels": recognition.levels,
                "hypotheses": [_hypothesis(item) for item in recognition.hypotheses]
                + [
                    _hypothesis(item) | {"part": number}
                    for number, other in enumerate(others, start=2)
                    for item in other.hypotheses
                ],
            } | ({} if divisions is None else {"divisions": divisions})
        case PlanEvent(grip, plan):
            return "planned", {
                "grip": grip,
                "decisive": plan.decisive,
                "remaining": plan.remaining,
                "approaches": _approaches(plan),
            }
        case MoveEvent():
            return "moved", {"grip": event.grip}


def _approaches(plan: Grip) -> list[dict[str, object]]:
    return [
        {
            "finger_index": item.finger_index,
            "approach": {name: getattr(item, name) for name in _APPROACH},
            "travel_mm": travel,
            "predictions": plan.predictions.of_approach(row),
        }
        for row, (item, travel) in enumerate(zip(plan.approaches, plan.travels_mm, strict=True))
    ]


def _hypothesis(item: Hypothesis) -> dict[str, object]:
    return {
        "object": item.state.object_name,
        "state": item.state.state.name,
        "configuration": item.configuration,
        "bounds": item.bounds,
        "weight": item.weight,
        "verified": item.verified,
        "symmetry_order": item.state.symmetry_order,
    }


def json_value(value: Any) -> Any:  # noqa: PLR0911  # one kind of value, one return
    """The value as JSON has it: dataclasses as objects, arrays as lists, infinities as null."""
    match value:
        case Enum():  # before str: an enum of strings is both
            return value.value
        case None | bool() | str() | int():
            return value
        case float():
            return float(value) if math.isfinite(value) else None
        case np.generic():
            return json_value(value.item())
        case Path():
            return str(value)
        case np.ndarray():
            listed = value.tolist()
            return listed if value.dtype.kind in "iufb" and np.isfinite(value).all() else json_value(listed)
        case Mapping():
            return {str(k): json_value(v) for k, v in value.items()}
        case list() | tuple() | set() | frozenset():
            listed = [json_value(v) for v in value]
            return listed if isinstance(value, list | tuple) else sorted(listed)
        case _ if dataclasses.is_dataclass(value) and not isinstance(value, type):
            return {f.name: json_value(getattr(value, f.name)) for f in dataclasses.fields(value)}
    raise TypeError(f"cannot log a {type(value).__name__}")


INTERRUPTS = ("Interrupted", "KeyboardInterrupt")


def _port_not_open(*_: object) -> PortNotOpenError:
    return PortNotOpenError()


_MAKERS: Mapping[str, tuple[type[BaseException], Callable[..., BaseException]]] = {
    "DeviceError": (DeviceError, DeviceError),
    "Interrupted": (Interrupted, Interrupted.of),
    "KeyboardInterrupt": (KeyboardInterrupt, KeyboardInterrupt),
    "PortTaken": (PortTaken, PortTaken),
    "PortNotOpenError": (PortNotOpenError, _port_not_open),
    "SerialException": (SerialException, SerialException),
    "SerialTimeoutException": (SerialTimeoutException, SerialTimeoutException),
    "OSError": (OSError, OSError),
    "TerminalError": (PORT_ERRORS[-1], PORT_ERRORS[-1]),
    "TypeError": (TypeError, TypeError),
    "ValueError": (ValueError, ValueError),
}

KINDS = tuple(_MAKERS)
"""Names of the kinds of errors that can be raised again."""


def values_of(error: BaseException) -> dict[str, Any]:
    """The error's nearest kind that can be raised again, else its own name, and what it is made from."""
    names = {kind: name for name, (kind, _) in _MAKERS.items()}
    kind = next((names[base] for base in type(error).__mro__ if base in names), type(error).__name__)
    simple = all(isinstance(item, str | int) for item in error.args)
    return {
        "kind": kind,
        "args": list(error.args) if simple else [str(error)],
        "message": str(error),
    }


def error_of(kind: str, args: Sequence[str | int]) -> BaseException | None:
    """The error to raise again; None if there is no such kind, or it cannot be made from that."""
    _, maker = _MAKERS.get(kind, (None, None))
    if maker is not None:
        with contextlib.suppress(TypeError, KeyError, ValueError):
            return maker(*args)
    return None


_MAX_STALL_S = 5.0
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


def line_checksum(line: str, before: int) -> int:
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
        stalled_s: float = _MAX_STALL_S,
        capacity: int = QUEUE_CAPACITY,
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
        """True if any byte went through a port."""
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
        self._put(lambda: _event_line(t_s, kind, values))

    def note(self, what: RecordItem) -> None:
        """Log what a `Recorder` notes; a call of the host waits for the next line, as it is not worth one."""
        match what:
            case str():
                self._calls.append(what)
            case PortOpened():
                self.event("opened", port=what.port, number=what.number, url=what.url)
            case PortBytes():
                self.has_traffic = True
                instant = self._clock.now()
                self._put(lambda: _bytes_line(instant, what))
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
            self._sum = line_checksum(line, self._sum)
            text.append(f'{line[:-1]},"sum":"{self._sum:08x}"}}\n')
        self._file.write("".join(text))

    def _error(self, run: str) -> OutputError:
        """Return what is wrong with the log; `run`: what became of the run."""
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


def _event_line(t_s: float, kind: str, values: Mapping[str, object]) -> str:
    line = {"t_s": round(t_s, 9), "event": kind} | {key: json_value(value) for key, value in values.items()}
    return json.dumps(line, separators=(",", ":"), allow_nan=False)


def _bytes_line(instant: float, what: PortBytes) -> str:
    text = base64.b64encode(what.data).decode()
    return (
        f'{{"t_s":{instant:.9f},"event":"bytes","port":{json.dumps(what.port)},'
        f'"direction":"{what.direction.value}","base64":"{text}"}}'
    )
