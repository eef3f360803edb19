"""What a session says of itself, event by event: what `identify` tells its observers, as JSON values.

Written by the session log and compared by a replay. `docs/session-log.md` lists the events.
"""

import dataclasses
import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from enum import Enum
from pathlib import Path
from typing import Any

import numpy as np

from palpate.recognizer import Grip, Hypothesis, Recognition
from palpate.rig.motion.guarded_approach import Stage, Touch

__all__ = ["SessionEvents", "plain"]


class SessionEvents(ABC):
    """An observer of `identify` for which everything is an event with values."""

    @abstractmethod
    def event(self, kind: str, /, **values: object) -> None:
        """Take one event."""

    def stage(self, grip: int, stage: Stage) -> None:
        """Fingers began something."""
        self.event("stage", grip=grip, stage=stage)

    def touches(self, grip: int, touches: Sequence[Touch]) -> None:
        """What a grip felt."""
        self.event("touches", grip=grip, touches=touches)

    def recognised(self, grip: int, recognition: Recognition) -> None:
        """What all contacts so far allow."""
        self.event(
            "recognised",
            grip=grip,
            verdict=recognition.verdict,
            levels=recognition.levels,
            hypotheses=[_hypothesis(item) for item in recognition.hypotheses],
        )

    def planned(self, grip: int, plan: Grip) -> None:
        """The next grip and what it is expected to feel."""
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
        """What was felt before this grip counts no more."""
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


def plain(value: Any) -> Any:  # noqa: PLR0911  # one kind of value, one return
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
            return plain(value.tolist())
        case Mapping():
            return {str(k): plain(v) for k, v in value.items()}
        case frozenset() | set():
            return sorted(plain(v) for v in value)
        case list() | tuple():
            return [plain(v) for v in value]
        case _ if dataclasses.is_dataclass(value) and not isinstance(value, type):
            return {f.name: plain(getattr(value, f.name)) for f in dataclasses.fields(value)}
    raise TypeError(f"cannot log a {type(value).__name__}")
