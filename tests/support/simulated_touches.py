"""A rig without devices: grips carried out with shapely, mismeasured within their declared bounds.

Thousands of searches in the time of one on emulated devices. Shares with the rig only what a rig file says:
which approaches there are, and how well they are carried out.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from shapely_bench import Placed, outward_normal, stop, unit

from palpate.recognizer import Approach, Contact, FingerApproach, NormalRange
from palpate.recognizer.prediction import Prediction
from palpate.rig.motion.guarded_approach import GripPhase
from palpate.rig.motion.touch import Touch
from palpate.rig.reach.approaches import Reach

# Of an approach's bound: what touches on the emulated bench declare.
ORDINARY_SHARE, ORDINARY_PATH = 0.33, 0.55


@dataclass
class SimulatedTouches:
    """What lies on the table, and how it is felt. Called as the loop's `carry`.

    A touch declares `share` of its approach's bound, and is off by as much if `at_bound`, otherwise by any
    part of it. `normal_half_rad`: half of every normal range; the true normal is anywhere in it, or at its
    end.
    """

    reach: Reach
    placed: Placed
    rng: np.random.Generator
    normal_half_rad: float = math.radians(10.0)
    share: float = ORDINARY_SHARE
    at_bound: bool = False

    def __call__(
        self, grip: Sequence[FingerApproach], tell: Callable[[GripPhase], None] | None = None
    ) -> list[Touch]:
        del tell
        return [self._touch(item) for item in grip]

    def _touch(self, approach: FingerApproach) -> Touch:
        bound = approach.position_bound_mm
        contact = felt_along(
            approach,
            f"f{approach.finger_index + 1}",
            self.placed,
            self.rng,
            bound=self.share * bound,
            path_bound=max(self.share, ORDINARY_PATH) * bound,
            half_range=self.normal_half_rad,
            at_bound=self.at_bound,
        )
        return Touch(approach.finger_index, contact, None, (math.nan, math.nan))


def felt_along(
    approach: Approach,
    name: str,
    placed: Placed,
    rng: np.random.Generator,
    *,
    bound: float,
    path_bound: float,
    half_range: float,
    at_bound: bool = False,
) -> Contact:
    """What a finger feels that really travels up to `bound` mm beside the approach, or just as much."""
    finger, direction = approach.finger, approach.direction_rad
    shape = placed.shape_at(finger.height_mm)
    angle = rng.uniform(0, 2 * math.pi)
    error = unit(angle) * bound * (1.0 if at_bound else math.sqrt(rng.uniform()))
    start = np.array(approach.start_mm)
    travel = stop(shape, start + error, direction, finger.tip_radius_mm, approach.travel_mm)
    touched, normal = math.isfinite(travel), None
    end = start + (travel if touched else approach.travel_mm) * unit(direction)
    if touched:
        off = rng.choice([-1.0, 1.0]) if at_bound else rng.uniform(-1, 1)
        middle = outward_normal(shape, end + error) + off * half_range
        normal = NormalRange(middle - half_range, middle + half_range)
    at = (float(end[0]), float(end[1]))
    return Contact(name, finger, touched, approach.start_mm, at, bound, normal, path_bound_mm=path_bound)


def as_predicted(contact: Contact, predicted: Prediction, slack_mm: float = 0.0) -> bool:
    """Whether the finger stopped where it was to, or missed where it might."""
    travel = contact.travel_mm if contact.touched else math.inf
    return predicted.earliest_mm - slack_mm <= travel <= predicted.latest_mm + slack_mm
