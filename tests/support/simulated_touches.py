"""A rig without devices: grips carried out with shapely, mismeasured within their declared bounds.

Thousands of searches in the time of one on emulated devices. Shares with the rig only what a rig file says:
which approaches there are, and how well they are carried out.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import shapely
from shapely import ops
from shapely_bench import Placed, stop

from palpate.recognizer import Contact, NormalRange
from palpate.rig.closing import Stage, Touch
from palpate.rig.reach import Reach

ORDINARY_SHARE, ORDINARY_PATH = (
    0.33,
    0.55,
)  # of an approach's bound: what touches on the emulated bench declare


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
        self, grip: Sequence[tuple[int, float]], tell: Callable[[Stage], None] | None = None
    ) -> list[Touch]:
        del tell
        return [self._touch(index, travel) for index, travel in grip]

    def _touch(self, index: int, travel_mm: float) -> Touch:
        candidate = self.reach.candidates[index]
        approach, name = candidate.approach, f"f{candidate.finger_index + 1}"
        shape = self.placed.shape_at(approach.finger.height_mm)
        bound = self.share * approach.position_bound_mm
        angle = self.rng.uniform(0, 2 * math.pi)
        size = bound * (1.0 if self.at_bound else math.sqrt(self.rng.uniform()))
        error = size * np.array([math.cos(angle), math.sin(angle)])
        start = np.array(approach.start_mm)
        heading = np.array([math.cos(approach.direction_rad), math.sin(approach.direction_rad)])
        at = stop(shape, start + error, approach.direction_rad, approach.finger.tip_radius_mm, travel_mm)
        missed = not math.isfinite(at)
        end = start + (travel_mm if missed else at) * heading
        contact = Contact(
            name,
            approach.finger,
            not missed,
            approach.start_mm,
            (float(end[0]), float(end[1])),
            bound,
            None if missed else self._normal(shape, end + error),
            path_bound_mm=max(self.share, ORDINARY_PATH) * approach.position_bound_mm,
        )
        return Touch(candidate.finger_index, contact, None)

    def _normal(self, shape: shapely.Geometry, centre: np.ndarray) -> NormalRange:
        nearest = ops.nearest_points(shape, shapely.Point(centre))[0]
        true = math.atan2(centre[1] - nearest.y, centre[0] - nearest.x)
        off = self.rng.choice([-1.0, 1.0]) if self.at_bound else self.rng.uniform(-1, 1)
        middle = true + off * self.normal_half_rad
        return NormalRange(middle - self.normal_half_rad, middle + self.normal_half_rad)
