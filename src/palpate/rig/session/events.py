"""Events of a session as JSON values: those of an identification, and those of its run.

Written by the session log and compared by a replay. `docs/session-log.md` lists the events.
"""

import dataclasses
import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from enum import Enum
from pathlib import Path
from typing import Any

import numpy as np

from palpate.recognizer import Approach, Grip, Hypothesis
from palpate.rig.identification.observers import (
    Event,
    MoveEvent,
    PlanEvent,
    RecognitionEvent,
    StageEvent,
    TouchEvent,
)

__all__ = ["SessionEvents", "plain"]


_APPROACH = [field.name for field in dataclasses.fields(Approach)]


class SessionEvents(ABC):
    """An observer of `identify` for which everything is an event with values."""

    @abstractmethod
    def event(self, kind: str, /, **values: object) -> None:
        """Take one event."""

    def __call__(self, event: Event) -> None:
        """Take an event of the identification."""
        kind, values = _values(event)
        self.event(kind, **values)


def _values(event: Event) -> tuple[str, dict[str, object]]:
    """The event's name and values in the log."""
    match event:
        case StageEvent():
            return "stage", {"grip": event.grip, "stage": event.stage}
        case TouchEvent():
            return "touches", {"grip": event.grip, "touches": event.touches}
        case RecognitionEvent(grip, recognition):
            return "recognised", {
                "grip": grip,
                "verdict": recognition.verdict,
                "levels": recognition.levels,
                "hypotheses": [_hypothesis(item) for item in recognition.hypotheses],
            }
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


def plain(value: Any) -> Any:  # noqa: PLR0911  # one kind of value, one return
    """The value as JSON has it: dataclasses as objects, arrays as lists, infinities as null."""
    match value:
        case Enum():  # before str: an enum of strings is both
            return value.value
        case None | bool() | str() | int():
            return value
        case float() | np.floating():
            return float(value) if math.isfinite(value) else None
        case np.integer():
            return int(value)
        case Path():
            return str(value)
        case np.ndarray():
            listed = value.tolist()
            return listed if value.dtype.kind in "iufb" and np.isfinite(value).all() else plain(listed)
        case Mapping():
            return {str(k): plain(v) for k, v in value.items()}
        case frozenset() | set():
            return sorted(plain(v) for v in value)
        case list() | tuple():
            return [plain(v) for v in value]
        case _ if dataclasses.is_dataclass(value) and not isinstance(value, type):
            return {f.name: plain(getattr(value, f.name)) for f in dataclasses.fields(value)}
    raise TypeError(f"cannot log a {type(value).__name__}")
