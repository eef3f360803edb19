"""At which heights another finger would tell two states apart that the rig's own fingers do not.

From a `Pair` to ranges of height. A range counts only if no motion at all leaves the sections at the fingers'
heights and in the range within what contacts may hide: no turned or shifted alternative is forgotten.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from palpate.cad.sameness import apart_mm
from palpate.rig.objects_measures import measures, within_reach
from palpate.rig.objects_reach import filled
from palpate.rig.objects_stack import Range, joined_ranges
from palpate.rig.objects_twins import FindMotions, Pair

__all__ = ["MOST_TRIED", "Separating", "separating"]

MOST_TRIED = 64
"""Ranges of height that are tried for a pair; of finely cut parts some, evenly chosen."""


@dataclass(frozen=True)
class Separating:
    """Ranges of height (mm) at which a finger would tell the two apart.

    `tried` of `ranges` were looked at; `known`: whether both states are known at every height.
    """

    heights_mm: tuple[Range, ...]
    tried: int
    ranges: int
    known: bool


def separating(pair: Pair, find: FindMotions) -> Separating:
    """Look through all ranges of height over which neither state changes."""
    ranges = list(_ranges(pair))
    if len(ranges) > MOST_TRIED:
        chosen = np.unique(np.linspace(0, len(ranges) - 1, MOST_TRIED).round().astype(int)).tolist()
    else:
        chosen = list(range(len(ranges)))
    telling = [ranges[k] for k in chosen if _tells(pair, sum(ranges[k]) / 2, find)]
    states = (pair.first.state.state, pair.second.state.state)
    known = all(state.heights_mm is None for state in states)
    return Separating(joined_ranges(telling), len(chosen), len(ranges), known)


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
    slimmest = pair.first.fingers.slimmest_mm
    new = [filled(item.state.region_at(height_mm), slimmest) for item in (pair.first, pair.second)]
    if all(region.is_empty for region in new):
        return False
    within = np.array(pair.within_mm)
    sizes = measures(new)
    if not within_reach(sizes[0], sizes[1], within):
        return True
    one, other = pair.touched
    kept = (apart_mm(new[:1], new[1:], motion.turn_rad, motion.shift_mm) for motion in pair.motions)
    if any(off <= pair.within_mm for off in kept):
        return False
    return not find((*one, new[0]), (*other, new[1]), pair.within_mm)
