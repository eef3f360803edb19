"""Layout of the picture of objects: which sections share a card, and what is left out of a large file.

A state with a few different sections gets a card for each, one with many gets one card with some of them over
each other; so do all in a file that would need too many. Sections that differ by less than is drawn are one.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import shapely

from palpate.rig.catalogue.finger_model import RigFingers
from palpate.rig.catalogue.section_stack import Level, Range, StateSections

__all__ = ["MOST_CARDS", "MOST_CONTOURS", "Card", "cards_of"]

MOST_CARDS = 960
"""Of all pages."""
MOST_CONTOURS = 12
"""Sections drawn over each other in one card."""
_FEW = 3
"""Different sections of a state that get cards of their own."""
_ALIKE = 0.015
"""Share of a section's size: sections that are as near are one card."""


@dataclass(frozen=True, eq=False)
class Card:
    """A drawing: one section, at one or several ranges of height, or several sections from the bottom up.

    `number` of `different`: which of the state's different sections it is, from 1.
    """

    state: StateSections
    shown: tuple[Level, ...]
    different: int
    number: int = 1
    ranges_mm: tuple[Range, ...] = ()

    @property
    def is_stack(self) -> bool:
        """Whether different sections are drawn over each other."""
        return not self.ranges_mm


def cards_of(
    states: Sequence[StateSections], fingers: RigFingers
) -> tuple[tuple[Card, ...], tuple[StateSections, ...]]:
    """The cards in the states' order, and the states for which there is no room."""
    sections = [_different(state) for state in states]
    single = sum(len(found) if len(found) <= _FEW else 1 for found in sections) > MOST_CARDS
    cards: list[Card] = []
    for state, found in zip(states[:MOST_CARDS], sections[:MOST_CARDS], strict=True):
        if len(found) == 1 or (len(found) <= _FEW and not single):
            cards += [
                Card(state, levels[:1], len(found), number, _joined([level.z_mm for level in levels]))
                for number, levels in enumerate(found, 1)
            ]
        else:
            cards.append(Card(state, _chosen(state.levels, fingers), len(found)))
    return tuple(cards), tuple(states[MOST_CARDS:])


def _joined(ranges_mm: Sequence[Range]) -> tuple[Range, ...]:
    """Ranges of height with those that touch as one, ascending."""
    joined: list[Range] = []
    for low, high in sorted(ranges_mm):
        if joined and low <= joined[-1][1]:
            joined[-1] = joined[-1][0], max(high, joined[-1][1])
        else:
            joined.append((low, high))
    return tuple(joined)


def _different(state: StateSections) -> list[tuple[Level, ...]]:
    """The state's different sections from the bottom up, each with all levels at which it is found.

    No more are told apart than matters to the layout: the last one then has the rest.
    """
    found: list[list[Level]] = []
    for level in state.levels:
        same = next((levels for levels in found if _alike(levels[0].region, level.region)), None)
        if same is not None:
            same.append(level)
        elif len(found) <= _FEW:
            found.append([level])
        else:
            found[-1].append(level)
    return [tuple(levels) for levels in found]


def _alike(one: shapely.Geometry, other: shapely.Geometry) -> bool:
    """Whether two sections would be drawn alike."""
    west, south, east, north = one.bounds
    within_mm = _ALIKE * max(east - west, north - south)
    if np.abs(np.subtract(one.bounds, other.bounds)).max() > within_mm:
        return False
    return bool(shapely.hausdorff_distance(one.boundary, other.boundary) <= within_mm)


def _chosen(levels: Sequence[Level], fingers: RigFingers) -> tuple[Level, ...]:
    """The lowest, the highest, those that fingers meet, and some evenly between."""
    spans = [at.span_mm for at in fingers.at]
    met = [k for k, level in enumerate(levels) if any(level.is_within(span) for span in spans)]
    met = met[: MOST_CONTOURS - 2]
    even = np.linspace(0, len(levels) - 1, min(len(levels), MOST_CONTOURS - len(met))).round().astype(int)
    return tuple(levels[k] for k in sorted({*even.tolist(), *met}))
