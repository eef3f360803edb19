"""Separating heights: where one more finger would distinguish two states that the rig's fingers do not.

A range counts only if no motion at all leaves the sections at the fingers' heights and in the range within
what contacts may hide: no turned or shifted alternative is forgotten.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from palpate.cad.congruence_search import Motion, apart_mm
from palpate.rig.catalogue.reached_regions import ReachedRegion, surely_within
from palpate.rig.catalogue.region_measures import within_reach
from palpate.rig.catalogue.section_stack import Range, joined_ranges
from palpate.rig.catalogue.twins import FindMotions, Pair

__all__ = ["MOST_TRIED", "SeparatingHeights", "separating"]

_THINNEST_MM = 0.01  # no finger is put into less: tops that are off by a rounding differ there

MOST_TRIED = 64
"""Ranges of height that are tried for a pair; of finely cut parts some, evenly chosen."""


@dataclass(frozen=True)
class SeparatingHeights:
    """Ranges of height (mm) at which a finger would tell the two apart; those wider than 0.01 mm.

    `tried` of `ranges` were looked at; `known`: whether both states are known at every height.
    """

    heights_mm: tuple[Range, ...]
    tried: int
    ranges: int
    known: bool


def separating(pair: Pair, find: FindMotions) -> SeparatingHeights:
    """Look through all ranges of height over which neither state changes."""
    ranges = list(_ranges(pair))
    if len(ranges) > MOST_TRIED:
        chosen = np.unique(np.linspace(0, len(ranges) - 1, MOST_TRIED).round().astype(int)).tolist()
    else:
        chosen = list(range(len(ranges)))
    telling = [ranges[k] for k in chosen if _tells(pair, sum(ranges[k]) / 2, find)]
    states = (pair.first.state.state, pair.second.state.state)
    known = all(state.heights_mm is None for state in states)
    wide = [found for found in joined_ranges(telling) if found[1] - found[0] > _THINNEST_MM]
    return SeparatingHeights(tuple(wide), len(chosen), len(ranges), known)


def _ranges(pair: Pair) -> Iterator[Range]:
    """Ranges between steps of either, where both are known and one is there at least."""
    first, second = pair.first.state, pair.second.state
    steps = sorted({*first.steps_mm, *second.steps_mm})
    for low, high in pairwise(steps):
        middle = (low + high) / 2
        if first.state.known_at(middle) and second.state.known_at(middle):
            yield low, high


def _tells(pair: Pair, height_mm: float, find: FindMotions) -> bool:
    """Whether a finger of the rig's slimmest kind at a height would tell the two apart."""
    new, its = (item.reached_at(height_mm) for item in (pair.first, pair.second))
    if new.region.is_empty and its.region.is_empty:
        return False
    if not within_reach(new.measures, its.measures, np.array(pair.within_mm)):
        return True
    if any(_keeps(motion, new, its, pair.within_mm) for motion in pair.motions):
        return False
    one, other = pair.touched
    return not find((*one, new.region), (*other, its.region), pair.within_mm)


def _keeps(motion: Motion, one: ReachedRegion, other: ReachedRegion, within_mm: float) -> bool:
    """Whether the two are still within the distance of each other: cheaply, if that is certain."""
    if surely_within(one, other, motion, within_mm):
        return True
    return apart_mm([one.region], [other.region], motion.turn_rad, motion.shift_mm) <= within_mm
