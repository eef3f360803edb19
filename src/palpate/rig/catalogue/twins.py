"""Twins: states that a rig's fingers can never distinguish, or perhaps not.

Two states are twins if one rigid motion in the plane brings what tips can reach of the one onto that of the
other, at every height that fingers are at. How far off it leaves them is a Hausdorff distance, and the least
over all such motions decides. Fingers are taken to be able to touch everywhere at their height, so a pair
that is called the same stays the same for a rig that reaches less.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from enum import StrEnum
from functools import cached_property

import numpy as np
import shapely

from palpate.base.geometry import Floats
from palpate.cad.congruence_search import Motion, apart_mm, motions
from palpate.rig.catalogue.finger_model import AtHeight, RigFingers
from palpate.rig.catalogue.reached_regions import ReachedRegion
from palpate.rig.catalogue.region_measures import measures, within_reach
from palpate.rig.catalogue.section_stack import StateSections
from palpate.rig.catalogue.tip_reach import beside_ball, filled

__all__ = ["Likeness", "Pair", "ReachableState", "find_twins"]

_ROUNDING_MM = 1e-6
_TURNS_TRIED = 8


class Likeness(StrEnum):
    """How alike two states feel; those that are distinguished are not listed.

    The same within their tolerances; within what contacts may hide as well; or not known, because one of them
    is not at the height of some finger, and the others do not distinguish them.
    """

    SAME = "same"
    DOUBTFUL = "doubtful"
    UNKNOWN = "unknown"


@dataclass(frozen=True, eq=False)
class ReachableState:
    """What a rig's fingers reach of a state, at those of the rig's heights at which it is known."""

    state: StateSections
    fingers: RigFingers

    @cached_property
    def known(self) -> tuple[AtHeight, ...]:
        """Fingers at heights at which the state is known."""
        return tuple(at for at in self.fingers.at if self.state.state.known_within(at.span_mm))

    @cached_property
    def region(self) -> dict[AtHeight, shapely.Geometry]:
        """What the fingers reach of the state at each of those heights."""
        return {at: self._region(at) for at in self.known}

    def _region(self, at: AtHeight) -> shapely.Geometry:
        if not at.is_ball:
            return filled(self.state.region_within(at.span_mm), at.tip_radius_mm)
        levels = [(level.z_mm, level.region) for level in self.state.levels if level.is_within(at.span_mm)]
        return beside_ball(levels, at.height_mm, at.tip_radius_mm)

    def reached_by(self, at: AtHeight) -> ReachedRegion:
        """What another finger, one of `RigFingers.another`, would reach."""
        levels = tuple(k for k, level in enumerate(self.state.levels) if level.is_within(at.span_mm))
        key = (*levels, at.height_mm) if at.is_ball else levels
        if key not in self._reached:
            self._reached[key] = ReachedRegion(self._region(at))
        return self._reached[key]

    @cached_property
    def _reached(self) -> dict[tuple[float, ...], ReachedRegion]:
        """By the levels that are found at a height: so often is it computed, not once for every pair.

        What a ball reaches of the same levels changes with its height.
        """
        return {}


@dataclass(frozen=True, eq=False)
class Pair:
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
    motions: tuple[Motion, ...]

    @property
    def touched(self) -> tuple[tuple[shapely.Geometry, ...], tuple[shapely.Geometry, ...]]:
        """What fingers reach of both, height by height, where they meet anything."""
        return _stacks(self.first, self.second, self.compared)


def find_twins(states: Sequence[StateSections], fingers: RigFingers) -> tuple[Pair, ...]:
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
        found: Floats = measures([item.region.get(at, shapely.Polygon()) for item in reachable])
        possible &= within_reach(found[:, None], found[None], within) | ~(known[:, None] & known)
    yield from map(tuple, np.argwhere(possible).tolist())


def _pair(first: ReachableState, second: ReachableState) -> Pair | None:
    """The two compared; None if they are distinguished."""
    tolerance = first.state.tolerance_mm + second.state.tolerance_mm
    within = tolerance + 2 * first.fingers.bound_mm
    compared = tuple(at for at in first.known if at in second.region)
    one, other = _stacks(first, second, compared)

    # Nothing is empty on one side alone: its measures would have distinguished that.
    def pair(likeness: Likeness, apart_mm: float | None, fits: Sequence[Motion] = ()) -> Pair:
        return Pair(first, second, likeness, apart_mm, tolerance, within, compared, tuple(fits))

    all_known = Likeness.SAME if compared == first.fingers.at else Likeness.UNKNOWN
    if not one:
        return pair(all_known, None)
    found = motions(one, other, within)
    if not found:
        return None
    apart = min(motion.apart_mm for motion in found)
    if found[0].any_turn:  # it stands for all turns, of which it need not be the best
        apart = min(apart, _round_apart_mm(one, other))
    if apart > tolerance + _ROUNDING_MM:
        return pair(Likeness.DOUBTFUL, apart, found)
    return pair(all_known, apart, found)


def _round_apart_mm(one: Sequence[shapely.Geometry], other: Sequence[shapely.Geometry]) -> float:
    """How far off round figures are at the best of some turns that bring a corner onto a corner.

    Chords fall on chords at one of them if the figures are copies of each other.
    """
    first, second = one[0], other[0]
    centres = [np.array(shapely.get_coordinates(shapely.centroid(item))[0]) for item in (first, second)]
    corners = [shapely.get_coordinates(item) - at for item, at in zip((first, second), centres, strict=True)]
    radius = [np.hypot(*points.T) for points in corners]
    furthest = corners[0][int(radius[0].argmax())]
    nearest = np.argsort(np.abs(radius[1] - radius[0].max()), kind="stable")[:_TURNS_TRIED]
    turns = np.arctan2(*corners[1][nearest].T[::-1]) - math.atan2(furthest[1], furthest[0])
    return min(_apart_about(one, other, turn, centres) for turn in turns.tolist())


def _apart_about(
    one: Sequence[shapely.Geometry],
    other: Sequence[shapely.Geometry],
    turn_rad: float,
    centres_mm: Sequence[Floats],
) -> float:
    """How far off the turn leaves the two with one's centre on the other's."""
    c, s = math.cos(turn_rad), math.sin(turn_rad)
    return apart_mm(one, other, turn_rad, centres_mm[1] - np.array([[c, -s], [s, c]]) @ centres_mm[0])


def _stacks(
    first: ReachableState, second: ReachableState, compared: Sequence[AtHeight]
) -> tuple[tuple[shapely.Geometry, ...], tuple[shapely.Geometry, ...]]:
    """What fingers reach of both at the same heights; without those at which there is nothing of either."""
    met = [at for at in compared if not (first.region[at].is_empty and second.region[at].is_empty)]
    return tuple(first.region[at] for at in met), tuple(second.region[at] for at in met)
