"""Simulated touches of parts that do not move: straight paths against their outlines, with errors.

Without devices: a thousand identifications in the time of a few on emulated ones. Where a tip on a straight
path meets the first part is worked out with shapely alone, so that nothing of it is shared with the
recogniser.

Contacts are off within the rig's bounds, as devices are. A position's bound is the sum of its causes'
bounds, and causes seldom conspire; most of them a finger keeps for a whole run. On the emulated bench
contacts are off by 0.20 of their bound along the normal, root mean square, and normals by 0.31 of their
half range; here by 0.20 and 0.33. Larger errors, drawn anew for each touch, would narrow an answer sooner
than real ones do: what all contacts allow would be cut from all sides.
"""

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import shapely

from palpate.base.geometry import Floats
from palpate.drivers.emulators import IN_PLACE, Displacement
from palpate.recognizer import Contact, FingerApproach, NormalRange, Resolution
from palpate.rig.emulated.scene import Placement
from palpate.rig.motion.guarded_approach import GripPhase
from palpate.rig.motion.touch import Touch

_CONTACT_GAP_MM = 1e-9  # the gap at which a tip counts as touching
_PATH_SHARE = 0.42  # of an approach's own bound: what its way is free within
_SHARPEST_SHARE, _BLUNTEST_SHARE = (
    0.69,
    1.15,
)  # of the resolution's normal range: as touches of the emulated bench are
_BLUNTNESS_POWER = 4  # power of what is drawn evenly: 0.70 in the median there, 0.78 in the mean
_POSITION_CAUSES = 6  # of a position bound: base, heading, zero, travel, and the plays of aim and slide
_CAUSES_OF_FINGER = 4  # of these: the finger's own for a whole run
_NORMAL_CAUSES = 3  # gains, noise, and where the edge lies between taxels


LyingShape = tuple[shapely.Geometry, Displacement]
"""A part in W as it was put, and where it has been pushed from there."""


@dataclass(frozen=True, eq=False)
class Mismeasurement:
    """Error of one finger in one grip: it is `offset_mm` (2,) from where it is said to be.

    `bound_mm`: what is declared of that; `turn_rad`: how far the middle of the normal's range is off, half of
    which is `half_rad`; `unnoticed_mm`: how deep the part may be pressed into the tip without being noticed.
    """

    offset_mm: Floats
    turn_rad: float
    bound_mm: float
    half_rad: float
    unnoticed_mm: float = 0.0

    def contact(self, approach: FingerApproach, parts: Iterable[LyingShape], far_mm: float) -> Contact | None:
        """Contact with the part that is met first; None if the way is free up to `far_mm`."""
        start = np.array(approach.start_mm)
        heading = np.array([math.cos(approach.direction_rad), math.sin(approach.direction_rad)])
        radius = approach.finger.tip_radius_mm
        travel, normal = math.inf, 0.0
        for shape, displacement in parts:
            begin = displacement.back(start + self.offset_mm)
            along = displacement.back(start + self.offset_mm + heading) - begin
            stop = _travel_mm(shape, begin, along, radius, far_mm)
            if stop < travel:
                travel = stop
                normal = _outward_rad(shape, begin + travel * along) + displacement.turn_rad + self.turn_rad
        if not math.isfinite(travel):
            return None
        end = start + travel * heading
        return self._contact(approach, end, NormalRange(normal - self.half_rad, normal + self.half_rad))

    def miss(self, approach: FingerApproach, far_mm: float) -> Contact:
        """The way was free up to `far_mm`."""
        heading = np.array([math.cos(approach.direction_rad), math.sin(approach.direction_rad)])
        return self._contact(approach, np.array(approach.start_mm) + far_mm * heading, None)

    def _contact(self, approach: FingerApproach, end: Floats, normal: NormalRange | None) -> Contact:
        return Contact(
            f"f{approach.finger_index + 1}",
            approach.finger,
            normal is not None,
            approach.start_mm,
            (float(end[0]), float(end[1])),
            self.bound_mm,
            normal,
            path_bound_mm=max(self.bound_mm + self.unnoticed_mm, _PATH_SHARE * approach.position_bound_mm),
        )


class FingerErrors:
    """Errors of a rig's fingers in one run."""

    def __init__(self, resolution: Resolution, rng: np.random.Generator) -> None:
        self._resolution, self._rng = resolution, rng
        self._own: dict[int, Floats] = {}

    def draw(self, approach: FingerApproach, unnoticed_mm: float = 0.0) -> Mismeasurement:
        """One touch's: what is the finger's own, along and across its way, and what is this touch's."""
        rng = self._rng
        if approach.finger_index not in self._own:
            self._own[approach.finger_index] = self._causes(_CAUSES_OF_FINGER)
        bound = self._resolution.distance_mm / 2
        half = self._resolution.normal_half_rad * (
            _SHARPEST_SHARE + (_BLUNTEST_SHARE - _SHARPEST_SHARE) * rng.uniform() ** _BLUNTNESS_POWER
        )
        along, across = (
            bound
            / _POSITION_CAUSES
            * (self._own[approach.finger_index] + self._causes(_POSITION_CAUSES - _CAUSES_OF_FINGER))
        )
        c, s = math.cos(approach.direction_rad), math.sin(approach.direction_rad)
        offset = np.array([c * along - s * across, s * along + c * across])
        turn = half * float(rng.uniform(-1, 1, _NORMAL_CAUSES).mean())
        return Mismeasurement(offset, turn, bound, half, unnoticed_mm)

    def _causes(self, count: int) -> Floats:
        """Sum (2,) of so many, each anywhere in a unit disc."""
        bearing, off = self._rng.uniform(0, 2 * math.pi, count), np.sqrt(self._rng.uniform(size=count))
        return np.array([(off * np.cos(bearing)).sum(), (off * np.sin(bearing)).sum()])


def _travel_mm(
    shape: shapely.Geometry, start: Floats, heading: Floats, radius_mm: float, reach_mm: float
) -> float:
    """Travel after which a disc on a straight path first touches the shape; infinite if it passes by."""
    if shape.is_empty:
        return math.inf
    travel = 0.0
    while travel < reach_mm:
        gap = shapely.distance(shape, shapely.Point(start + travel * heading)) - radius_mm
        if gap < _CONTACT_GAP_MM:
            return travel
        travel += gap
    return math.inf


def _outward_rad(shape: shapely.Geometry, centre: Floats) -> float:
    """Direction from the nearest point of the shape to the centre of a tip that touches it from outside."""
    way = shapely.get_coordinates(shapely.shortest_line(shape, shapely.Point(centre)))
    x, y = way[1] - way[0]
    return math.atan2(y, x)


class SimulatedTouches:
    """Carries out grips on parts, as `search` has them carried out.

    A touch declares the rig's `resolution`; its place and its normal are off by less than that.
    """

    def __init__(
        self, placements: Sequence[Placement], resolution: Resolution, rng: np.random.Generator
    ) -> None:
        self.placements = tuple(placements)
        self.seconds: float | None = None  # no time passes
        self._errors = FingerErrors(resolution, rng)

    def __call__(
        self, grip: Sequence[FingerApproach], tell: Callable[[GripPhase], None] | None = None
    ) -> list[Touch]:
        """Touches of a grip's fingers."""
        del tell
        return [self._touch(approach) for approach in grip]

    def _touch(self, approach: FingerApproach) -> Touch:
        error = self._errors.draw(approach)
        span, far = approach.finger.span_mm, approach.travel_mm
        parts = [(placement.region_within(span), IN_PLACE) for placement in self.placements]
        contact = error.contact(approach, parts, far) or error.miss(approach, far)
        return Touch(approach.finger_index, contact, None, (math.nan, math.nan))
