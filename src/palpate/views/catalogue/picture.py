"""The picture of a file's objects: a card for every state, in rows of one SVG document."""

from collections.abc import Mapping, Sequence

import numpy as np
import shapely

from palpate.base.errors import quantity
from palpate.rig.catalogue.finger_model import RigFingers, finger_heights_text
from palpate.rig.catalogue.section_stack import Level, Range, StateSections
from palpate.views import svg
from palpate.views.catalogue.card import (
    CONCAVE,
    GAP,
    HEIGHT,
    ROOM,
    UNREACHED,
    UNREACHED_LINE,
    WIDTH,
    Card,
    CardFacts,
    draw_card,
    shade,
)

_PAGE_MARGIN = 28.0
_COLUMNS = 4
_MAX_CARDS_PER_PAGE = 60
_MAX_NAMES_LEFT_OUT = 6

MAX_CARDS = 960
"""Of all pages."""
MAX_CONTOURS = 12
"""Sections drawn over each other in one card."""
_ALIKE_SHARE = 0.015
"""Share of a section's size: sections that are as near are drawn as one."""


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


def draw_objects(
    title: str, states: Sequence[StateSections], facts: Mapping[StateSections, CardFacts], fingers: RigFingers
) -> tuple[tuple[str, ...], tuple[StateSections, ...]]:
    """The picture as SVG documents, a page each, and the states that it has no room for.

    `title`: the file's name.
    """
    cards, left_out = cards_of(states, fingers)
    scales = _scales(cards)
    count = max(-(-len(cards) // _MAX_CARDS_PER_PAGE), 1)
    pages = []
    for page in range(count):
        some = cards[page * _MAX_CARDS_PER_PAGE : (page + 1) * _MAX_CARDS_PER_PAGE]
        heading = title if count == 1 else f"{title}, page {page + 1} of {count}"
        end = left_out if page == count - 1 else ()
        pages.append(_page(heading, states, some, facts, fingers, scales, end))
    return tuple(pages), left_out


def _page(
    title: str,
    states: Sequence[StateSections],
    cards: Sequence[Card],
    facts: Mapping[StateSections, CardFacts],
    fingers: RigFingers,
    scales: Mapping[str, float],
    left_out: Sequence[StateSections],
) -> str:
    """One page: the heading, the cards, and at the end which states are left out."""
    columns = min(_COLUMNS, max(len(cards), 2))
    width = 2 * _PAGE_MARGIN + columns * WIDTH + (columns - 1) * GAP
    head, y = _head(title, states, cards, fingers, width - 2 * _PAGE_MARGIN)
    drawn = []
    for index, card in enumerate(cards):
        row, column = divmod(index, columns)
        corner = (_PAGE_MARGIN + column * (WIDTH + GAP), y + row * (HEIGHT + GAP))
        drawn.append(draw_card(card, facts[card.state], fingers, corner, scales[card.state.object_name]))
    y += -(-len(cards) // columns) * (HEIGHT + GAP)
    for line in _left_out_lines(left_out, width - 2 * _PAGE_MARGIN):
        y += 20
        drawn.append(svg.text(line, _PAGE_MARGIN, y, size=13, fill=svg.INK))
    height = y + _PAGE_MARGIN
    words = _description([card.state for card in cards], facts)
    return svg.document((width, height), *head, *drawn, title=title, description=words, is_sized=True)


def _head(
    title: str, states: Sequence[StateSections], cards: Sequence[Card], fingers: RigFingers, room: float
) -> tuple[list[str], float]:
    """Title, what it is of, and the meaning of the colours; where they end."""
    objects = len({state.object_name for state in states})
    where = (
        f"{quantity(len(states), 'state', 'states')} of {quantity(objects, 'object', 'objects')}; "
        f"fingers of rig {fingers.rig_name} at {finger_heights_text(fingers.at)}"
    )
    y = _PAGE_MARGIN - 8
    head = []
    for line in svg.wrap(title, 22, room, most_lines=2, bold=True):
        y += 28
        head.append(svg.text(line, _PAGE_MARGIN, y, size=22, fill=svg.INK, weight="bold"))
    for line in svg.wrap(where, 13.5, room, most_lines=2):
        y += 21
        head.append(svg.text(line, _PAGE_MARGIN, y, size=13.5, fill=svg.MUTED))
    stacks = any(card.is_stack for card in cards)
    legend, y = _legend(fingers, y + 26, _PAGE_MARGIN + room, stacks=stacks)
    return [*head, *legend], y + 22


def _kind(fingers: RigFingers) -> str:
    """Word for what tips are taken for."""
    if not fingers.any_upright:
        return fingers.at[0].tip.noun
    return "disc" if any(item.tip.has_face for item in fingers.at) else "tip"


def _legend(fingers: RigFingers, y: float, right: float, *, stacks: bool) -> tuple[list[str], float]:
    """Legend of colours and marks, in as many lines as it takes, and y of the last.

    `stacks`: sections are drawn over each other.
    """
    swatch = {"width": 20.0, "height": 12.0, "y": -10.0}
    centre = svg.circle((2.0, -4.0), 2.4, fill=svg.INK)
    ray = svg.element("path", d="M2,-4H22", stroke=svg.INK, stroke_width=0.9, stroke_dasharray="5 3")
    entries = [
        (svg.element("rect", **swatch, fill=CONCAVE), "pocket: reached from some directions only"),
        (
            svg.element("rect", **swatch, fill=UNREACHED, stroke=UNREACHED_LINE, stroke_dasharray="3 2"),
            f"no {_kind(fingers)} of radius {fingers.slimmest_mm:g} mm gets there",
        ),
        (centre + ray, "turns after which it looks the same"),
        (svg.element("path", d="M8,-4L15,-8V0Z", fill=svg.TIP), "heights of fingers, mm"),
    ]
    if stacks:
        lines = [
            svg.element("path", d=f"M0,{y}H20", stroke=stroke, stroke_width=1.6)
            for y, stroke in ((-9, shade(0.0, 1.0)), (-4, shade(0.5, 1.0)), (1, shade(1.0, 1.0)))
        ]
        entries.append(("".join(lines), "sections, the higher the darker"))
        line = svg.element("path", d="M0,-4H20", stroke=svg.TIP, stroke_width=2.0)
        entries.append((line, "sections at heights of fingers"))
    x = _PAGE_MARGIN
    drawn = []
    for mark, words in entries:
        wide = 30 + svg.text_width(words, 12) + 12
        if x > _PAGE_MARGIN and x + wide > right:
            x, y = _PAGE_MARGIN, y + 21
        drawn.append(svg.element("g", mark, transform=f"translate({svg.number(x)} {svg.number(y)})"))
        drawn.append(svg.text(words, x + 28, y, size=12, fill=svg.INK))
        x += wide
    return drawn, y


def _scales(cards: Sequence[Card]) -> dict[str, float]:
    """SVG units per mm of each object: all of its cards have one scale, and its largest section fits."""
    largest: dict[str, float] = {}
    for card in cards:
        x1, y1, x2, y2 = shapely.union_all([level.region for level in card.shown]).bounds
        name = card.state.object_name
        largest[name] = max(largest.get(name, 0.0), x2 - x1, y2 - y1)
    return {name: (ROOM - 8) / size for name, size in largest.items()}


def _left_out_lines(left_out: Sequence[StateSections], room: float) -> list[str]:
    if not left_out:
        return []
    names = "; ".join(state.name for state in left_out[:_MAX_NAMES_LEFT_OUT])
    more = f"; and {len(left_out) - _MAX_NAMES_LEFT_OUT} more" if len(left_out) > _MAX_NAMES_LEFT_OUT else ""
    return svg.wrap(
        f"Not drawn, for want of room: {quantity(len(left_out), 'state', 'states')}: {names}{more}.",
        13,
        room,
        most_lines=4,
    )


def _description(states: Sequence[StateSections], facts: Mapping[StateSections, CardFacts]) -> str:
    """The picture in words, for those who do not see it."""
    words = []
    for state in states:
        twins = facts[state].twins
        like = "".join(f"; {item.words} {', '.join(item.names)}" for item in twins)
        words.append(
            f"{state.name}: {quantity(len(state.levels), 'section', 'sections')} up to "
            f"{state.state.top_mm:.4g} mm{like}."
        )
    return " ".join(words)
