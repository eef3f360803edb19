"""Carrier of one's own: anything that moves a tip, known by the approaches that it can make."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from numbers import Real

import numpy as np

from palpate.base.errors import InputError
from palpate.base.geometry import Bools, Floats, Ints
from palpate.base.vocabulary import DEFAULT_BUDGET
from palpate.config import SearchConfig
from palpate.recognizer import Finger, FingerApproach, Goals, Resolution

_DEFAULT_GOALS = Goals(0.1, math.radians(0.1))
_APPROACH_NUMBERS = 5  # start, direction, travel and bound
_NO_NORMAL_RAD = math.pi  # half of the range of a touch that measures none


def _is_finite(value: object) -> bool:
    return isinstance(value, Real) and math.isfinite(value)


@dataclass(frozen=True, eq=False)
class Carrier:
    """Carrier of a tip, such as a machine tool or a robot arm: `approaches` that it can make, one at a time.

    Touches measure where they stop, each within its approach's bound, and no normals; the part is held still.
    `travel_mm_s`: speed in free space; `search_mm_s`: where the part may be. `false_match_probability`: as in
    a rig file's `[search]`. Raises InputError if there are no approaches, or they cannot be made.
    """

    approaches: Sequence[FingerApproach]
    goals: Goals = _DEFAULT_GOALS
    travel_mm_s: float = 10.0
    search_mm_s: float = 1.0
    false_match_probability: float = 0.001
    name: str = "carrier"
    search: SearchConfig = field(init=False, repr=False)

    def __post_init__(self) -> None:
        if not self.approaches or not all(isinstance(item, FingerApproach) for item in self.approaches):
            raise InputError("a carrier has one approach or more, each a palpate.FingerApproach")
        if not isinstance(self.goals, Goals):
            raise InputError(f"a carrier's goals must be palpate.Goals(mm, rad), not {self.goals!r}")
        if not all(isinstance(item.finger, Finger) for item in self.approaches):
            raise InputError("the finger of a carrier's approach must be a palpate.Finger")
        if any(item.finger.tip.has_face for item in self.approaches):
            raise InputError("the tip of a carrier's approach must be round: where a pad is met is not known")
        for item in self.approaches:
            values = *item.start_mm, item.direction_rad, item.travel_mm, item.position_bound_mm
            finite = len(values) == _APPROACH_NUMBERS and all(map(_is_finite, values))
            if not (finite and item.travel_mm > 0 <= item.position_bound_mm):
                raise InputError(
                    "an approach must be finite, start at x and y, go more than 0 and have a bound from 0: "
                    f"{item}"
                )
        if not all(_is_finite(speed) and speed > 0 for speed in (self.travel_mm_s, self.search_mm_s)):
            raise InputError("a carrier's speeds must be more than 0")
        if not (_is_finite(self.false_match_probability) and 0 < self.false_match_probability <= 1):
            raise InputError("a carrier's false_match_probability must be over 0, and 1 at most")
        search = SearchConfig(
            max_grips=1000,
            goal_position_mm=self.goals.position_mm,
            goal_orientation_deg=math.degrees(self.goals.orientation_rad),
            false_match_probability=self.false_match_probability,
            budget=DEFAULT_BUDGET,
        )
        object.__setattr__(self, "search", search)

    @property
    def resolution(self) -> Resolution:
        """Resolution of touches: by how much the stops of two of them may differ."""
        return Resolution(2 * max(item.position_bound_mm for item in self.approaches), _NO_NORMAL_RAD)

    def together(self, one: int, travel_mm: float, others: Ints, travels_mm: Floats) -> Bools:  # noqa: ARG002
        """Return that nothing goes together with approach `one`."""
        return np.zeros(len(others), dtype=bool)

    def seconds(self, travels_mm: Floats) -> Floats:
        """Duration of each approach (n,), there and back, going this far (n,)."""
        result: Floats = 2 * np.asarray(travels_mm) / self.travel_mm_s
        return result

    # What touches do to the part, as `palpate.recognizer.PushLimits` has it: nothing.

    def safe_heights_mm(self, states: Ints) -> Floats:
        """Heights (n, 1) up to which a push does not tip states (n,): any."""
        return np.full((len(states), 1), np.inf)

    def slide_shares(self, states: Ints) -> Floats:
        """Share (n, 2) of what holds states (n,) that a touch takes of it: none."""
        return np.zeros((len(states), 2))

    def touch_mm_s(self, states: Ints) -> float:  # noqa: ARG002
        """Speed at which any state is met."""
        return self.search_mm_s
