"""Separating heights: where one more finger would distinguish two states that the rig's fingers do not.

A range counts only if no motion at all leaves the sections at the fingers' heights and in the range within
what contacts may hide: no turned or shifted alternative is forgotten. What a ball meets changes with every
height, so that only single heights are known to count for one.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from palpate.cad.congruence_search import Motion, apart_mm, motions
from palpate.rig.catalogue.reached_regions import ReachedRegion, certainly_within
from palpate.rig.catalogue.region_measures import within_reach
from palpate.rig.catalogue.section_stack import Range, joined_ranges, steps_mm
from palpate.rig.catalogue.twins import Pair

__all__ = ["MOST_TRIED", "SeparatingHeights", "separating_heights"]

_THINNEST_MM = 0.01  # no finger is put into less: tops that are off by a rounding differ there

MOST_TRIED = 64
"""Ranges of height that are tried for a pair; of finely cut parts some, evenly chosen."""


@dataclass(frozen=True)
class SeparatingHeights:
    """Ranges of height (mm) at which a finger would distinguish the two; those wider than 0.01 mm.

    Of a rig whose tips are all balls single heights instead, each as a range from it to itself. `tried` of
    `ranges` were looked at; `known`: whether both states are known at every height.
    """

    heights_mm: tuple[Range, ...]
    tried: int
    ranges: int
    known: bool


def separating_heights(pair: Pair) -> SeparatingHeights:
    """Look through all ranges of height over which neither state changes."""
    ranges = list(_ranges(pair))
    count = min(len(ranges), MOST_TRIED)
    chosen = np.linspace(0, len(ranges) - 1, count).round().astype(int).tolist()
    found = [ranges[k] for k in chosen if _distinguishes(pair, _inside(ranges[k]))]
    states = (pair.first.state.state, pair.second.state.state)
    known = all(state.heights_mm is None for state in states)
    balls = pair.first.fingers.all_balls
    wide = [item for item in (found if balls else joined_ranges(found)) if item[1] - item[0] > _THINNEST_MM]
    heights = [(_inside(item), _inside(item)) for item in wide] if balls else wide
    return SeparatingHeights(tuple(heights), len(chosen), len(ranges), known)


def _inside(range_mm: Range) -> float:
    """A height about the middle of a range, in as round a number as lies within."""
    low, high = range_mm
    middle = (low + high) / 2
    return next((found for digits in (0, 1, 2) if low < (found := round(middle, digits)) < high), middle)


def _ranges(pair: Pair) -> Iterator[Range]:
    """Ranges between steps of either, where both are known and one is there at least."""
    first, second = pair.first.state, pair.second.state
    half = pair.first.fingers.another(0.0).half_length_mm
    for low, high in pairwise(steps_mm((first, second), half)):
        middle = (low + high) / 2
        span = middle - half, middle + half
        if first.state.known_within(span) and second.state.known_within(span):
            yield low, high


def _distinguishes(pair: Pair, height_mm: float) -> bool:
    """Whether one more finger of the rig's kind, at a height, would distinguish the two."""
    another = pair.first.fingers.another(height_mm)
    new, its = (item.reached_by(another) for item in (pair.first, pair.second))
    if new.region.is_empty and its.region.is_empty:
        return False
    if not within_reach(new.measures, its.measures, np.array(pair.within_mm)):
        return True
    if any(_keeps(motion, new, its, pair.within_mm) for motion in pair.motions):
        return False
    one, other = pair.touched
    return not motions((*one, new.region), (*other, its.region), pair.within_mm)


def _keeps(motion: Motion, one: ReachedRegion, other: ReachedRegion, within_mm: float) -> bool:
    """Whether the two are still within the distance of each other: cheaply, if that is certain."""
    if certainly_within(one, other, motion, within_mm):
        return True
    return apart_mm([one.region], [other.region], motion.turn_rad, motion.shift_mm) <= within_mm
