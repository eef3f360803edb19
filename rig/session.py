"""The session log: everything that happened, in one append-only file that survives a crash.

JSON Lines, one event a line, flushed line by line: whatever kills the process, every line but perhaps the
last is whole. Raw bytes of every port stand beside the values that were made of them, on the rig's clock, so
that a session can be replayed from any arrow of the data's way. `docs/session-log.md` lists the events.
"""

import base64
import dataclasses
import fcntl
import json
import math
from collections.abc import Mapping, Sequence
from enum import Enum
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np

from palpate.drivers.transport.clock import Clock
from palpate.drivers.transport.tap import BytesObserver, Direction
from palpate.errors import InputError
from palpate.recognizer import Grip, Hypothesis, Recognition
from palpate.rig.closing import Stage, Touch

__all__ = ["SessionLog", "session_folder"]

_LOG_NAME = "session.jsonl"


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
            f"session folder {folder} cannot be made: {error.strerror}; choose --sessions"
        ) from error
    return folder


class SessionLog:
    """Writes one session's events; an observer of `identify`. Use as a context manager."""

    def __init__(self, folder: Path, clock: Clock, header: Mapping[str, object]) -> None:
        """Start the log of a session in `folder` with a header line.

        Raises InputError if it cannot be written, or if another process is writing it now.
        """
        self.path = folder / _LOG_NAME
        self._clock = clock
        try:
            self._file = self.path.open("a", encoding="utf-8", buffering=1)
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            self._file.truncate(0)
        except BlockingIOError as error:
            raise InputError(f"{self.path} is being written by another palpate; choose --sessions") from error
        except OSError as error:
            raise InputError(f"{self.path} cannot be written: {error.strerror}; choose --sessions") from error
        self.event("session", format="palpate/session@1", **header)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        how = "done" if error is None else type(error).__name__
        self.event("end", how=how, message=None if error is None else str(error))
        self._file.close()

    def event(self, kind: str, **values: object) -> None:
        """Append one event at the rig's present time."""
        line = {"t_s": round(self._clock.now(), 9), "event": kind} | {k: _plain(v) for k, v in values.items()}
        self._file.write(json.dumps(line, separators=(",", ":"), allow_nan=False) + "\n")

    def tap(self, port: str) -> BytesObserver:
        """An observer that logs a port's bytes."""

        def on_bytes(direction: Direction, instant: float, data: bytes) -> None:
            text = base64.b64encode(data).decode()
            self._file.write(
                f'{{"t_s":{instant:.9f},"event":"bytes","port":{json.dumps(port)},'
                f'"direction":"{direction.value}","base64":"{text}"}}\n'
            )

        return on_bytes

    def stage(self, grip: int, stage: Stage) -> None:
        """Log that fingers began something."""
        self.event("stage", grip=grip, stage=stage)

    def touches(self, grip: int, touches: Sequence[Touch]) -> None:
        """Log what a grip felt."""
        self.event("touches", grip=grip, touches=touches)

    def recognised(self, grip: int, recognition: Recognition) -> None:
        """Log what all contacts so far allow."""
        self.event(
            "recognised",
            grip=grip,
            verdict=recognition.verdict,
            levels=recognition.levels,
            hypotheses=[_hypothesis(item) for item in recognition.hypotheses],
        )

    def planned(self, grip: int, plan: Grip) -> None:
        """Log the next grip and what it is expected to feel."""
        approaches = [
            {
                "finger_index": item.finger_index,
                "approach": item.approach,
                "travel_mm": travel,
                "predictions": plan.predictions.of_approach(row),
            }
            for row, (item, travel) in enumerate(zip(plan.candidates, plan.travels_mm, strict=True))
        ]
        self.event(
            "planned", grip=grip, decisive=plan.decisive, remaining=plan.remaining, approaches=approaches
        )

    def moved(self, grip: int) -> None:
        """Log that what was felt before this grip counts no more."""
        self.event("moved", grip=grip)


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


def _plain(value: Any) -> Any:  # noqa: PLR0911  # one kind of value, one return
    """The value as JSON has it: dataclasses as objects, arrays as lists, infinities as null."""
    match value:
        case None | bool() | str() | int():
            return value
        case float() | np.floating():
            return float(value) if math.isfinite(value) else None
        case np.integer():
            return int(value)
        case Enum():
            return value.value
        case Path():
            return str(value)
        case np.ndarray():
            return _plain(value.tolist())
        case Mapping():
            return {str(k): _plain(v) for k, v in value.items()}
        case frozenset() | set():
            return sorted(_plain(v) for v in value)
        case list() | tuple():
            return [_plain(v) for v in value]
        case _ if dataclasses.is_dataclass(value) and not isinstance(value, type):
            return {f.name: _plain(getattr(value, f.name)) for f in dataclasses.fields(value)}
    raise TypeError(f"cannot log a {type(value).__name__}")
