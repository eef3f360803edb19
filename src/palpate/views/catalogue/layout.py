"""Layout of the picture of objects: sizes, colours, which sections a card shows, words that fit."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import shapely

from palpate.base.errors import quantity
from palpate.rig.catalogue.finger_model import RigFingers
from palpate.rig.catalogue.section_stack import Level, Range, StateSections
from palpate.views.numerals import ceil_to, floor_to

MAX_CARDS = 960
"""Of all pages."""
MAX_CONTOURS = 12
"""Sections drawn over each other in one card."""
_ALIKE_SHARE = 0.015
"""Share of a section's size: sections that are as near are drawn as one."""


@dataclass(frozen=True, eq=False)
class Card:
    """A drawing of a state: its only section, at some ranges of height, or several from the bottom up."""

    state: StateSections
    shown: tuple[Level, ...]
    ranges_mm: tuple[Range, ...] = ()

    @property
    def is_stack(self) -> bool:
        """True if different sections are drawn over each other."""
        return not self.ranges_mm


def cards_of(
    states: Sequence[StateSections], fingers: RigFingers
) -> tuple[tuple[Card, ...], tuple[StateSections, ...]]:
    """The cards in the states' order, and the states for which there is no room."""
    return tuple(_card(state, fingers) for state in states[:MAX_CARDS]), tuple(states[MAX_CARDS:])


def _card(state: StateSections, fingers: RigFingers) -> Card:
    lowest, *others = state.levels
    if all(_are_drawn_alike(lowest.region, level.region) for level in others):
        return Card(state, (lowest,), _unite_ranges([level.z_mm for level in state.levels]))
    return Card(state, _choose_levels(state.levels, fingers))


def _unite_ranges(ranges_mm: Sequence[Range]) -> tuple[Range, ...]:
    """Ranges of height with those that touch as one, ascending."""
    joined: list[Range] = []
    for low, high in sorted(ranges_mm):
        if joined and low <= joined[-1][1]:
            joined[-1] = joined[-1][0], max(high, joined[-1][1])
        else:
            joined.append((low, high))
    return tuple(joined)


def _are_drawn_alike(one: shapely.Geometry, other: shapely.Geometry) -> bool:
    """True if two sections would be drawn alike."""
    west, south, east, north = one.bounds
    within_mm = _ALIKE_SHARE * max(east - west, north - south)
    if np.abs(np.subtract(one.bounds, other.bounds)).max() > within_mm:
        return False
    return bool(shapely.hausdorff_distance(one.boundary, other.boundary) <= within_mm)


def _choose_levels(levels: Sequence[Level], fingers: RigFingers) -> tuple[Level, ...]:
    """The lowest, the highest, those that fingers meet, and some evenly between."""
    spans = [at.span_mm for at in fingers.at]
    met = [k for k, level in enumerate(levels) if any(level.is_within(span) for span in spans)]
    met = met[: MAX_CONTOURS - 2]
    even = np.linspace(0, len(levels) - 1, min(len(levels), MAX_CONTOURS - len(met))).round().astype(int)
    return tuple(levels[k] for k in sorted({*even.tolist(), *met}))


MARGIN, GAP = 14.0, 14.0
ROOM = 190.0
"""Side of the square in which a section is drawn."""
BAR_WIDTH = 78.0
"""Width of the ladder of heights with its numbers."""
SIDE = 76.0
"""Height of the side view, beneath the ladder."""
WIDTH = 2 * MARGIN + ROOM + 12 + BAR_WIDTH
LINES, BOTTOM = 102.0, 102.0
HEIGHT = LINES + ROOM + BOTTOM

CONCAVE = "#f6ecd4"
UNREACHED, UNREACHED_LINE = "#e6cfdd", "#8f5a7e"
SHADES = ((0x9C, 0xC9, 0xE8), (0x08, 0x2F, 0x5C))
"""Colours of the lowest and of the highest section."""


def known_words(known_mm: Sequence[Range], top_mm: float, most: int) -> str:
    """Say "known at 4.5–5.5 mm only", or "not known at 17.33–17.36 mm" where little is unknown.

    `known_mm`: ascending ranges, both ends included; `top_mm`: how high the part is. Ends are rounded to
    0.01 mm so that no more is called known than is. `most`: how many ranges are listed.
    """
    ends = [0.0, *(z for found in known_mm for z in found), top_mm]
    gaps = [(low, high) for low, high in zip(ends[::2], ends[1::2], strict=True) if low < high]
    if gaps and sum(high - low for low, high in gaps) < top_mm / 2:
        return f"not known at {_ranges([_outside(*gap) for gap in gaps], most)}"
    return f"known at {_ranges([_inside(*found) for found in known_mm], most)} only"


def _outside(low: float, high: float) -> Range:
    return floor_to(low), ceil_to(high)


def _inside(low: float, high: float) -> Range:
    """Rounded inward; as it is where nothing would be left."""
    first, last = ceil_to(low), floor_to(high)
    return (first, last) if first < last else (low, high)


def _ranges(ranges_mm: Sequence[Range], most: int) -> str:
    words = [f"{low:.6g}–{high:.6g}" for low, high in ranges_mm[:most]]
    more = len(ranges_mm) - len(words)
    if not words:
        return quantity(more, "range of height", "ranges of height")
    if more:
        return f"{', '.join(words)} mm and {quantity(more, 'more range', 'more ranges')}"
    *before, last = words
    return f"{', '.join(before)} and {last} mm" if before else f"{last} mm"
