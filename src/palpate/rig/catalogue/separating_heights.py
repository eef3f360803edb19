"""Separating heights: finger heights that distinguish the states of a catalogue.

A height is as good as the number of pairs of states that fingers there could never tell apart, as
`find_twins` counts them. Between two heights at which some section begins or ends all are equally good.

For one pair a range counts only if no motion at all leaves the sections at the fingers' heights and in the
range within what contacts may hide: no turned or shifted alternative is forgotten. What a ball meets changes
with every height, so that only single heights are known to count for one.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from palpate.cad.planar_congruence import PlanarMotion, find_motions, stack_distance_mm
from palpate.rig.catalogue.finger_model import RigFingers
from palpate.rig.catalogue.section_stack import Range, StateSections, join_ranges, level_bounds_mm
from palpate.rig.catalogue.twins import (
    ReachedRegion,
    StatePair,
    find_twins,
    is_certainly_within,
    may_be_within,
)

_MIN_RANGE_MM = 0.5  # no finger is put into less
_MAX_RANGES_TRIED = 24
"""Ranges of height that are looked at; of finely cut catalogues some, evenly chosen."""


@dataclass(frozen=True)
class HeightRange:
    """Heights (mm) that are as good as each other for a finger.

    `alike`: pairs of states that are, or may be, the same there. `unmet`: states of which nothing is there.
    """

    range_mm: Range
    alike: int
    unmet: int

    @property
    def middle_mm(self) -> float:
        """Middle of the range."""
        return sum(self.range_mm) / 2


@dataclass(frozen=True)
class BestHeights:
    """`ranges` in ascending order; `chosen_mm`: where fingers should be, `alike` pairs are left there.

    `alike_now`: with the fingers where they are.
    """

    ranges: tuple[HeightRange, ...]
    chosen_mm: tuple[float, ...]
    alike: int
    alike_now: int


def best_heights(states: Sequence[StateSections], fingers: RigFingers) -> BestHeights:
    """Try heights one by one, then with the best one a second, and so on, for as many as there are fingers.

    Fingers stay where they are unless that leaves more pairs alike.
    """
    now = _count_alike(states, fingers, [item.height_mm for item in fingers.at])
    ranges = tuple(
        _range(states, fingers, item)
        for item in _candidate_ranges(states, fingers.another(0.0).half_length_mm)
    )
    chosen: list[float] = []
    left = None
    count = sum(len(item.fingers) for item in fingers.at)
    while ranges and len(chosen) < count and left != 0:
        # Of equally good ones that at which states are met, and the widest.
        tried = [(_count_alike(states, fingers, [*chosen, item.middle_mm]), item.unmet, _width(item), k)
                 for k, item in enumerate(ranges)]  # fmt: skip
        alike, *_, best = min(tried)
        if left is not None and alike >= left:
            break
        left = alike
        chosen.append(round(ranges[best].middle_mm, 2))
    if left is None or left >= now:
        return BestHeights(ranges, tuple(item.height_mm for item in fingers.at), now, now)
    return BestHeights(ranges, tuple(chosen), left, now)


def _width(item: HeightRange) -> float:
    return item.range_mm[0] - item.range_mm[1]


def _range(states: Sequence[StateSections], fingers: RigFingers, range_mm: Range) -> HeightRange:
    middle = sum(range_mm) / 2
    span = fingers.another(middle).span_mm
    unmet = sum(item.region_within(span).is_empty for item in states)
    return HeightRange(range_mm, _count_alike(states, fingers, [middle]), unmet)


def _count_alike(states: Sequence[StateSections], fingers: RigFingers, heights_mm: Sequence[float]) -> int:
    """Pairs that fingers at these heights cannot, or may not, tell apart."""
    at = tuple(map(fingers.another, sorted(set(heights_mm))))
    return len(find_twins(states, RigFingers(fingers.rig_name, at, fingers.bound_mm)))


def _candidate_ranges(states: Sequence[StateSections], half_mm: float) -> list[Range]:
    """Over which no state changes, where all are known and one is there at least."""

    def known(height_mm: float) -> bool:
        return all(item.state.known_within((height_mm - half_mm, height_mm + half_mm)) for item in states)

    found = [
        (low, high)
        for low, high in pairwise(level_bounds_mm(states, half_mm))
        if high - low >= _MIN_RANGE_MM and known((low + high) / 2)
    ]
    chosen = np.linspace(0, len(found) - 1, min(len(found), _MAX_RANGES_TRIED)).round().astype(int).tolist()
    return [found[k] for k in dict.fromkeys(chosen)]


_MIN_SEPARATION_MM = 0.01  # no finger is put into less: tops that are off by a rounding differ there

MAX_SEPARATING_TRIED = 64
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


def separating_heights(pair: StatePair) -> SeparatingHeights:
    """Look through all ranges of height over which neither state changes."""
    ranges = list(_constant_ranges(pair))
    count = min(len(ranges), MAX_SEPARATING_TRIED)
    chosen = np.linspace(0, len(ranges) - 1, count).round().astype(int).tolist()
    found = [ranges[k] for k in chosen if _distinguishes(pair, _round_height_within(ranges[k]))]
    states = (pair.first.state.state, pair.second.state.state)
    known = all(state.heights_mm is None for state in states)
    upright = pair.first.fingers.any_upright
    wide = [
        item for item in (join_ranges(found) if upright else found) if item[1] - item[0] > _MIN_SEPARATION_MM
    ]
    heights = wide if upright else [(_round_height_within(item), _round_height_within(item)) for item in wide]
    return SeparatingHeights(tuple(heights), len(chosen), len(ranges), known)


def _round_height_within(range_mm: Range) -> float:
    """A height about the middle of a range, in as round a number as lies within."""
    low, high = range_mm
    middle = (low + high) / 2
    return next((found for digits in (0, 1, 2) if low < (found := round(middle, digits)) < high), middle)


def _constant_ranges(pair: StatePair) -> Iterator[Range]:
    """Ranges between steps of either, where both are known and one is there at least."""
    first, second = pair.first.state, pair.second.state
    half = pair.first.fingers.another(0.0).half_length_mm
    for low, high in pairwise(level_bounds_mm((first, second), half)):
        middle = (low + high) / 2
        span = middle - half, middle + half
        if first.state.known_within(span) and second.state.known_within(span):
            yield low, high


def _distinguishes(pair: StatePair, height_mm: float) -> bool:
    """True if one more finger of the rig's kind, at a height, would distinguish the two."""
    another = pair.first.fingers.another(height_mm)
    new, its = (item.reached_by(another) for item in (pair.first, pair.second))
    if new.region.is_empty and its.region.is_empty:
        return False
    if not may_be_within(new.measures, its.measures, np.array(pair.within_mm)):
        return True
    if any(_stays_within(motion, new, its, pair.within_mm) for motion in pair.motions):
        return False
    one, other = pair.touched
    return not find_motions((*one, new.region), (*other, its.region), pair.within_mm)


def _stays_within(motion: PlanarMotion, one: ReachedRegion, other: ReachedRegion, within_mm: float) -> bool:
    """True if the two are still within the distance of each other: cheaply, if that is certain."""
    if is_certainly_within(one, other, motion, within_mm):
        return True
    return stack_distance_mm([one.region], [other.region], motion.turn_rad, motion.shift_mm) <= within_mm
