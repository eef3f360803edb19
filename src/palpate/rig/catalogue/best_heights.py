"""Best heights: where a rig's fingers should be, so that they can tell most states of a catalogue apart.

A height is as good as the number of pairs of states that fingers there could never tell apart, as
`find_twins` counts them. Between two heights at which some section begins or ends all are equally good.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from palpate.rig.catalogue.finger_model import RigFingers
from palpate.rig.catalogue.section_stack import Range, StateSections, steps_mm
from palpate.rig.catalogue.twins import find_twins

__all__ = ["BestHeights", "HeightRange", "best_heights"]

_THINNEST_MM = 0.5  # no finger is put into less
_MOST_TRIED = 24
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
        """In between."""
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
    now = _alike(states, fingers, [item.height_mm for item in fingers.at])
    ranges = tuple(
        _range(states, fingers, item) for item in _ranges(states, fingers.another(0.0).half_length_mm)
    )
    chosen: list[float] = []
    left = None
    count = sum(len(item.fingers) for item in fingers.at)
    while ranges and len(chosen) < count and left != 0:
        # Of equally good ones that at which states are met, and the widest.
        tried = [(_alike(states, fingers, [*chosen, item.middle_mm]), item.unmet, _width(item), k)
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
    return HeightRange(range_mm, _alike(states, fingers, [middle]), unmet)


def _alike(states: Sequence[StateSections], fingers: RigFingers, heights_mm: Sequence[float]) -> int:
    """Pairs that fingers at these heights cannot, or may not, tell apart."""
    at = tuple(map(fingers.another, sorted(set(heights_mm))))
    return len(find_twins(states, RigFingers(fingers.rig_name, at, fingers.bound_mm)))


def _ranges(states: Sequence[StateSections], half_mm: float) -> list[Range]:
    """Over which no state changes, where all are known and one is there at least."""

    def known(height_mm: float) -> bool:
        return all(item.state.known_within((height_mm - half_mm, height_mm + half_mm)) for item in states)

    found = [
        (low, high)
        for low, high in pairwise(steps_mm(states, half_mm))
        if high - low >= _THINNEST_MM and known((low + high) / 2)
    ]
    chosen = np.linspace(0, len(found) - 1, min(len(found), _MOST_TRIED)).round().astype(int).tolist()
    return [found[k] for k in dict.fromkeys(chosen)]
