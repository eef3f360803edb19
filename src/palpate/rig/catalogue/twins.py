"""Twins: states that a rig's fingers can never distinguish, or perhaps not.

Two states are twins if one rigid motion in the plane brings what tips can reach of the one onto that of the
other, at every height that fingers are at. How far off it leaves them is a Hausdorff distance, and the least
over all such motions decides. Fingers are taken to be able to touch everywhere at their height, so a pair
that is called the same stays the same for a rig that reaches less. A tip comes from outside and keeps its
height, so it stays out of holes, and of pockets whose mouths are narrower than it is.

Most pairs are distinguished by measures of regions that bound their distance. Where A lies within L of B,
A's area is at most what B's becomes when B is grown by L: area + L · perimeter + n π L² for n parts
(Steiner's formula, an upper bound where B is not convex). The same holds for the convex hulls, whose
perimeters grow by 2 π L, and for the smallest discs that hold them, whose radii grow by L. None of them
depends on place and turn.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from enum import StrEnum
from functools import cached_property

import numpy as np
import shapely
from shapely import affinity

from palpate.base.geometry import Bools, Floats
from palpate.base.tips import Tip
from palpate.cad.planar_congruence import PlanarMotion, find_motions, stack_distance_mm
from palpate.rig.catalogue.finger_model import AtHeight, RigFingers
from palpate.rig.catalogue.section_stack import StateSections

_ROUNDING_SHARE = 1e-9


def measure_regions(regions: Sequence[shapely.Geometry]) -> Floats:
    """Area, perimeter, parts, the hull's area and perimeter, smallest disc: (n, 6), mm; 0 for nothing."""
    shapes = np.array(regions, dtype=object)
    hulls = shapely.convex_hull(shapes)
    columns = [
        shapely.area(shapes),
        shapely.length(shapes),
        shapely.get_num_geometries(shapes).astype(float),
        shapely.area(hulls),
        shapely.length(hulls),
        shapely.minimum_bounding_radius(shapes),
    ]
    empty = shapely.is_empty(shapes)
    result: Floats = np.where(empty[:, None], 0.0, np.column_stack(columns))
    return result


def may_be_within(first: Floats, second: Floats, within_mm: Floats) -> Bools:
    """True if some motion may bring two regions within a distance of each other; False is certain.

    `first` and `second` (..., 6) of `measures`, `within_mm` (...). Nothing and something never are.
    """
    fits = _holds(first, second, within_mm) & _holds(second, first, within_mm)
    both: Bools = fits & ((first[..., 2] == 0) == (second[..., 2] == 0))
    return both


def _holds(inner: Floats, outer: Floats, within_mm: Floats) -> Bools:
    """True if the measures leave room for `inner` inside of `outer` grown by a distance."""
    area, perimeter, parts, hull_area, hull_perimeter, radius = np.moveaxis(outer, -1, 0)
    disc = np.pi * within_mm**2
    most = np.stack(
        [
            area + within_mm * perimeter + parts * disc,
            hull_area + within_mm * hull_perimeter + disc,
            hull_perimeter + 2 * np.pi * within_mm,
            radius + within_mm,
        ],
        axis=-1,
    )
    result: Bools = np.all(
        inner[..., [0, 3, 4, 5]] <= most * (1 + _ROUNDING_SHARE) + _ROUNDING_SHARE, axis=-1
    )
    return result


_CERTAIN_SHARE = (
    0.98  # of a buffer's distance: GEOS evens out hollows of the outline by up to a hundredth of it
)


class ReachedRegion:
    """A region (mm) that tips can touch all around; its numbers and its surroundings are found once."""

    def __init__(self, region: shapely.Geometry) -> None:
        self.region = region
        self._near: dict[float, shapely.Geometry] = {}

    @cached_property
    def measures(self) -> Floats:
        """Measures of the region, (6,), as in `objects_measures`."""
        found: Floats = measure_regions([self.region])[0]
        return found

    @cached_property
    def outline(self) -> shapely.Geometry:
        """All rings of the region as lines."""
        return shapely.boundary(self.region)

    def near(self, within_mm: float) -> shapely.Geometry:
        """Places within a distance of the outline for certain: nearly all there are."""
        if within_mm not in self._near:
            self._near[within_mm] = self.outline.buffer(_CERTAIN_SHARE * within_mm, quad_segs=8)
            shapely.prepare(self._near[within_mm])
        return self._near[within_mm]


def is_certainly_within(
    one: ReachedRegion, other: ReachedRegion, motion: PlanarMotion, within_mm: float
) -> bool:
    """True if the motion brings the outline of one within a distance of the other's, and the other way round.

    True is certain, for arcs of buffers are chords. False is not: `apart_mm` decides then.
    """
    c, s = math.cos(motion.turn_rad), math.sin(motion.turn_rad)
    x, y = motion.shift_mm.tolist()
    back_x, back_y = (-np.array([[c, s], [-s, c]]) @ motion.shift_mm).tolist()
    there = affinity.affine_transform(one.outline, (c, -s, s, c, x, y))
    back = affinity.affine_transform(other.outline, (c, s, -s, c, back_x, back_y))
    return bool(shapely.covers(other.near(within_mm), there) and shapely.covers(one.near(within_mm), back))


_SHALLOW_MM = 0.02  # what is nowhere deeper than this is left alone: arcs are chords here
_QUARTER_CHORDS = 16
_STEP_MM = 0.5  # between the points of a piece whose depth is asked


def unreached_region(region: shapely.Geometry, tip_radius_mm: float) -> shapely.Geometry:
    """The part of the plane outside of a region that no disc of the radius from far away can cover.

    Empty for a convex region. Pieces that are nowhere deeper than 0.02 mm behind what tips can cover are left
    out; slits count however narrow they are.
    """
    if region.is_empty or shapely.equals(region, shapely.convex_hull(region)):
        return shapely.Polygon()
    grown = region.buffer(tip_radius_mm, quad_segs=_QUARTER_CHORDS)
    whole = shapely.union_all([shapely.Polygon(part.exterior) for part in shapely.get_parts(grown)])
    closed = whole.buffer(-tip_radius_mm, quad_segs=_QUARTER_CHORDS)
    pieces = [part for part in shapely.get_parts(closed.difference(region)) if _is_deep(part, closed)]
    return shapely.union_all(pieces)


def fill_unreached(region: shapely.Geometry, tip_radius_mm: float) -> shapely.Geometry:
    """The region with what no tip reaches added: two that agree in this feel the same all round."""
    more = unreached_region(region, tip_radius_mm)
    return region if more.is_empty else shapely.union_all([region, more])


def _reached_region(
    levels: Sequence[tuple[tuple[float, float], shapely.Geometry]],
    tip: Tip,
    height_mm: float,
    radius_mm: float,
) -> shapely.Geometry:
    """Region that a tip, as a ball, meets of those from some heights to others, filled.

    They are grown by what the tip's circle beside them has more than the least that may touch: two that
    agree in this feel the same to it.
    """
    least, grown = tip.least_share * radius_mm, []
    for (low, high), region in levels:
        circle = tip.radius_at_mm(radius_mm, max(low - height_mm, height_mm - high, 0.0))
        if circle > 0:
            grown.append(region.buffer(circle - least, quad_segs=_QUARTER_CHORDS))
    return fill_unreached(shapely.union_all(grown), least)


def _is_deep(part: shapely.Geometry, closed: shapely.Geometry) -> bool:
    along = shapely.points(shapely.get_coordinates(shapely.segmentize(part, _STEP_MM)))
    depth = shapely.distance(along, shapely.boundary(closed)).max(initial=0.0)
    return part.geom_type == "Polygon" and bool(depth > _SHALLOW_MM)


_ROUNDING_MM = 1e-6
_MAX_TURNS_TRIED = 8


class Likeness(StrEnum):
    """Likeness of two states by touch; those that are distinguished are not listed.

    The same within their tolerances; within what contacts may hide as well; or not known, because one of them
    is not at the height of some finger, and the others do not distinguish them.
    """

    SAME = "same"
    DOUBTFUL = "doubtful"
    UNKNOWN = "unknown"


@dataclass(frozen=True, eq=False)
class ReachableState:
    """Parts of a state that a rig's fingers reach, at those of the rig's heights at which it is known."""

    state: StateSections
    fingers: RigFingers

    @cached_property
    def known(self) -> tuple[AtHeight, ...]:
        """Fingers at heights at which the state is known."""
        return tuple(at for at in self.fingers.at if self.state.state.known_within(at.span_mm))

    @cached_property
    def region(self) -> dict[AtHeight, shapely.Geometry]:
        """Regions that fingers reach of the state at each of those heights."""
        return {at: self._region(at) for at in self.known}

    def _region(self, at: AtHeight) -> shapely.Geometry:
        if at.tip.is_upright:
            return fill_unreached(self.state.region_within(at.span_mm), at.tip_radius_mm)
        levels = [(level.z_mm, level.region) for level in self.state.levels if level.is_within(at.span_mm)]
        return _reached_region(levels, at.tip, at.height_mm, at.tip_radius_mm)

    def reached_by(self, at: AtHeight) -> ReachedRegion:
        """Region that another finger, one of `RigFingers.another`, would reach."""
        levels = tuple(k for k, level in enumerate(self.state.levels) if level.is_within(at.span_mm))
        key = levels if at.tip.is_upright else (*levels, at.height_mm)
        if key not in self._reached:
            self._reached[key] = ReachedRegion(self._region(at))
        return self._reached[key]

    @cached_property
    def _reached(self) -> dict[tuple[float, ...], ReachedRegion]:
        """Regions by the levels found at a height: so often are they computed, not once for every pair.

        What a ball reaches of the same levels changes with its height.
        """
        return {}


@dataclass(frozen=True, eq=False)
class StatePair:
    """Two states that are not certain to be distinguished.

    `apart_mm`: how far the sections that fingers meet are apart in the best fit; None if no finger meets
    either, or nothing is known. `tolerance_mm`: of both together; `within_mm`: that and what contacts may
    hide. `compared`: at which heights; `motions`: all fits, or some that show that there is one.
    """

    first: ReachableState
    second: ReachableState
    likeness: Likeness
    apart_mm: float | None
    tolerance_mm: float
    within_mm: float
    compared: tuple[AtHeight, ...]
    motions: tuple[PlanarMotion, ...]

    @property
    def touched(self) -> tuple[tuple[shapely.Geometry, ...], tuple[shapely.Geometry, ...]]:
        """Regions that fingers reach of both, height by height, where they meet anything."""
        return _stacks(self.first, self.second, self.compared)


def find_twins(states: Sequence[StateSections], fingers: RigFingers) -> tuple[StatePair, ...]:
    """Every pair of states that the rig's fingers cannot, or may not, tell apart, in the states' order."""
    reachable = [ReachableState(state, fingers) for state in states]
    pairs = (_pair(reachable[i], reachable[k]) for i, k in _candidates(reachable, fingers))
    return tuple(pair for pair in pairs if pair is not None)


def _candidates(reachable: Sequence[ReachableState], fingers: RigFingers) -> Iterator[tuple[int, int]]:
    """Pairs that measures do not tell apart."""
    tolerance = np.array([item.state.tolerance_mm for item in reachable])
    within = tolerance[:, None] + tolerance + 2 * fingers.bound_mm + _ROUNDING_MM
    possible = np.triu(np.ones(within.shape, dtype=bool), 1)
    for at in fingers.at:
        known = np.array([at in item.region for item in reachable])
        found: Floats = measure_regions([item.region.get(at, shapely.Polygon()) for item in reachable])
        possible &= may_be_within(found[:, None], found[None], within) | ~(known[:, None] & known)
    yield from map(tuple, np.argwhere(possible).tolist())


def _pair(first: ReachableState, second: ReachableState) -> StatePair | None:
    """The two compared; None if they are distinguished."""
    tolerance = first.state.tolerance_mm + second.state.tolerance_mm
    within = tolerance + 2 * first.fingers.bound_mm
    compared = tuple(at for at in first.known if at in second.region)
    one, other = _stacks(first, second, compared)

    # Nothing is empty on one side alone: its measures would have distinguished that.
    def pair(likeness: Likeness, apart_mm: float | None, fits: Sequence[PlanarMotion] = ()) -> StatePair:
        return StatePair(first, second, likeness, apart_mm, tolerance, within, compared, tuple(fits))

    all_known = Likeness.SAME if compared == first.fingers.at else Likeness.UNKNOWN
    if not one:
        return pair(all_known, None)
    found = find_motions(one, other, within)
    if not found:
        return None
    apart = min(motion.apart_mm for motion in found)
    if found[0].any_turn:  # it stands for all turns, of which it need not be the best
        apart = min(apart, _round_apart_mm(one, other))
    if apart > tolerance + _ROUNDING_MM:
        return pair(Likeness.DOUBTFUL, apart, found)
    return pair(all_known, apart, found)


def _round_apart_mm(one: Sequence[shapely.Geometry], other: Sequence[shapely.Geometry]) -> float:
    """Distance of round figures at the best of some turns that bring a corner onto a corner.

    Chords fall on chords at one of them if the figures are copies of each other.
    """
    first, second = one[0], other[0]
    centres = [np.array(shapely.get_coordinates(shapely.centroid(item))[0]) for item in (first, second)]
    corners = [shapely.get_coordinates(item) - at for item, at in zip((first, second), centres, strict=True)]
    radius = [np.hypot(*points.T) for points in corners]
    furthest = corners[0][int(radius[0].argmax())]
    nearest = np.argsort(np.abs(radius[1] - radius[0].max()), kind="stable")[:_MAX_TURNS_TRIED]
    turns = np.arctan2(*corners[1][nearest].T[::-1]) - math.atan2(furthest[1], furthest[0])
    return min(_apart_about(one, other, turn, centres) for turn in turns.tolist())


def _apart_about(
    one: Sequence[shapely.Geometry],
    other: Sequence[shapely.Geometry],
    turn_rad: float,
    centres_mm: Sequence[Floats],
) -> float:
    """Distance at which the turn leaves the two with one's centre on the other's."""
    c, s = math.cos(turn_rad), math.sin(turn_rad)
    return stack_distance_mm(
        one, other, turn_rad, centres_mm[1] - np.array([[c, -s], [s, c]]) @ centres_mm[0]
    )


def _stacks(
    first: ReachableState, second: ReachableState, compared: Sequence[AtHeight]
) -> tuple[tuple[shapely.Geometry, ...], tuple[shapely.Geometry, ...]]:
    """Regions that fingers reach of both at the same heights, but where there is nothing of either."""
    met = [at for at in compared if not (first.region[at].is_empty and second.region[at].is_empty)]
    return tuple(first.region[at] for at in met), tuple(second.region[at] for at in met)
