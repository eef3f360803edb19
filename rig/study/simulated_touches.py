"""Simulated touches: what fingers would feel of a part that lies still, mismeasured within the rig's bounds.

Worked out with shapely alone, so that nothing of it is shared with the recogniser, and without devices: a
thousand identifications in the time of a few on emulated ones.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
import shapely

from palpate.geometry import Floats
from palpate.recognizer import Contact, FingerApproach, NormalRange, Resolution
from palpate.rig.emulated.scene import Placement, shape_of
from palpate.rig.motion.guarded_approach import GripPhase, Touch

__all__ = ["SimulatedTouches"]

_TOUCHES_MM = 1e-9  # the gap at which a tip counts as touching
_PATH_SHARE = 0.55  # of an approach's own bound: what its way is free within


@dataclass(eq=False)
class SimulatedTouches:
    """Carries out grips on a part, as `search` has them carried out.

    A touch declares the rig's `resolution`: its place is off by anything up to that, its normal anywhere in
    a range of that width.
    """

    placement: Placement
    resolution: Resolution
    rng: np.random.Generator
    _shapes: dict[float, shapely.Geometry] = field(default_factory=dict)

    def __call__(
        self, grip: Sequence[FingerApproach], tell: Callable[[GripPhase], None] | None = None
    ) -> list[Touch]:
        """What the fingers of a grip feel."""
        del tell
        return [self._touch(approach) for approach in grip]

    def _touch(self, approach: FingerApproach) -> Touch:
        bound, half = self.resolution.distance_mm / 2, self.resolution.normal_half_rad
        shape, radius = self._shape(approach.finger.height_mm), approach.finger.tip_radius_mm
        bearing, off = self.rng.uniform(0, 2 * math.pi), bound * math.sqrt(self.rng.uniform())
        error = off * np.array([math.cos(bearing), math.sin(bearing)])
        heading = np.array([math.cos(approach.direction_rad), math.sin(approach.direction_rad)])
        start = np.array(approach.start_mm)
        travel = _travel_mm(shape, start + error, heading, radius, approach.travel_mm)
        touched, normal = math.isfinite(travel), None
        end = start + (travel if touched else approach.travel_mm) * heading
        if touched:
            middle = _outward_rad(shape, end + error) + self.rng.uniform(-half, half)
            normal = NormalRange(middle - half, middle + half)
        contact = Contact(
            f"f{approach.finger_index + 1}",
            approach.finger,
            touched,
            approach.start_mm,
            (float(end[0]), float(end[1])),
            bound,
            normal,
            path_bound_mm=max(bound, _PATH_SHARE * approach.position_bound_mm),
        )
        return Touch(approach.finger_index, contact, None, (math.nan, math.nan))

    def _shape(self, height_mm: float) -> shapely.Geometry:
        """The part at a height, in W."""
        if height_mm not in self._shapes:
            sections = self.placement.state.sections_at(height_mm)
            self._shapes[height_mm] = shapely.union_all([shape_of(self.placement, item) for item in sections])
        return self._shapes[height_mm]


def _travel_mm(
    shape: shapely.Geometry, start: Floats, heading: Floats, radius_mm: float, reach_mm: float
) -> float:
    """Travel after which a disc on a straight path first touches the shape; infinite if it passes by."""
    if shape.is_empty:
        return math.inf
    travel = 0.0
    while travel < reach_mm:
        gap = shapely.distance(shape, shapely.Point(start + travel * heading)) - radius_mm
        if gap < _TOUCHES_MM:
            return travel
        travel += gap
    return math.inf


def _outward_rad(shape: shapely.Geometry, centre: Floats) -> float:
    """Direction from the nearest point of the shape to the centre of a tip that touches it from outside."""
    way = shapely.get_coordinates(shapely.shortest_line(shape, shapely.Point(centre)))
    x, y = way[1] - way[0]
    return math.atan2(y, x)
