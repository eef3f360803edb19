"""Approaches of the next grip in the drawing: arrows with the stops that each hypothesis predicts."""

import math
from collections.abc import Sequence

import numpy as np

from palpate.base.geometry import Floats
from palpate.views import svg
from palpate.views.table_picture.frame import (
    LabelPlacer,
    View,
    arrow_head,
    end_cross,
    last_visible_point,
    leader,
)
from palpate.views.table_picture.values import ApproachArrow, Picture

_BAR, _LANE = 4.5, 6.0
_NARROW_BAR, _NARROW_LANE = 3.0, 4.0
_ARROW_HEAD_LENGTH = 14.0  # for an arrow's head
_LETTER_WIDTH = 10.5  # width of a letter in a label
_MAX_CLEAR_STOPS = 4  # more are drawn narrower, their circles fainter
_STOP_GAP = 3.0  # between two stops in one lane

_CIRCLE = np.column_stack([np.cos(np.arange(0, 6.28, 0.4)), np.sin(np.arange(0, 6.28, 0.4))])

Stop = tuple[int, float, float]
"""Index of a hypothesis, and the interval of travels (mm) in which it predicts the stop."""


def draw_approach(picture: Picture, item: ApproachArrow, view: View, placer: LabelPlacer) -> str:
    """The way from its start, the stops on it, and its end if nothing may stop it."""
    start, end = view.at(item.start_mm), view.at(item.at(item.travel_mm))
    along = _travel_direction(item)
    stops = _stops(item)
    radius = item.tip_radius_mm * view.scale
    first = min((lo for _, lo, _ in stops), default=item.travel_mm)
    until = view.at(item.at(first))
    placer.add_line(np.array([start, end]), 1.0)
    before = until - along * (radius + 3)
    # A stop that may come at once leaves no room for the head before it.
    is_room = bool(stops) and float((before - start) @ along) > _ARROW_HEAD_LENGTH
    shown = [
        _line(start, until),
        _line(until, end, "2 4"),
        arrow_head(before if is_room else end, along),
        svg.circle(start, 2.2, fill=svg.INK),
    ]
    if any(outcome.may_miss for outcome in item.predictions):
        shown.append(end_cross(end))
        placer.add_disc(end, 5.0, 2.0)
    crowd = len(stops) > _MAX_CLEAR_STOPS
    for (index, lo, hi), lane in zip(stops, lanes(stops, _STOP_GAP / view.scale), strict=True):
        aside = (_NARROW_LANE if crowd else _LANE) * lane * np.array([along[1], -along[0]])
        tips = np.array([view.at(item.at(lo)), view.at(item.at(hi))])
        shown.append(_stop(picture.colour(index), tips, aside, radius, faint=crowd))
        placer.add_line(tips + aside, 4.0)
        for tip in tips:
            placer.add_ring(tip + radius * _CIRCLE, 0.7)
    return "".join(shown)


def approach_labels(picture: Picture, item: ApproachArrow, view: View, placer: LabelPlacer) -> str:
    """The finger's name, the letters of the stops, and of the misses."""
    along = _travel_direction(item)
    square = math.atan2(along[0], along[1])
    stops = _stops(item)
    radius = item.tip_radius_mm * view.scale
    shown = []
    for group in _groups(stops):
        middle = view.at(item.at((min(lo for _, lo, _ in group) + max(hi for _, _, hi in group)) / 2))
        letters = sorted(index for index, _, _ in group)
        shown.append(_letters(picture, letters, "", middle, radius + 4, square, placer))
    start, end = view.at(item.start_mm), view.at(item.at(item.travel_mm))
    seen = last_visible_point(start, end, view)
    for letters, verb in _misses(item):
        if seen is not None:
            shown.append(_letters(picture, letters, verb, seen, 8.0, square, placer))
    first = min((lo for _, lo, _ in stops), default=item.travel_mm)
    before = last_visible_point(start, view.at(item.at(first)) - along * (radius + 16), view)
    if before is not None:
        shown.append(_name(item.finger, before, square + math.pi, placer))
    return "".join(shown)


def _misses(item: ApproachArrow) -> list[tuple[list[int], str]]:
    """Find which hypotheses say that it misses, and which that it may, with the words for it."""
    outcomes = list(enumerate(item.predictions[: svg.MAX_OTHERS]))
    certain = [index for index, outcome in outcomes if outcome.stop_mm is None]
    possible = [index for index, outcome in outcomes if outcome.may_miss and outcome.stop_mm is not None]
    verbs = ((certain, "misses" if len(certain) == 1 else "miss"), (possible, "may miss"))
    return [(letters, verb) for letters, verb in verbs if letters]


def _name(finger: str, at: Floats, towards: float, placer: LabelPlacer) -> str:
    content = svg.shorten(f"next: {finger}", svg.LABEL_SIZE, 120, bold=True)
    box = placer.place(
        at, svg.text_width(content, svg.LABEL_SIZE, bold=True) + 4, 15.0, clear=7.0, towards=towards
    )
    return leader(at, box, 5.0, svg.INK) + svg.text(
        content, box.x, box.y + 4, size=svg.LABEL_SIZE, fill=svg.INK, anchor="middle", weight="bold"
    )


def lanes(stops: Sequence[Stop], gap_mm: float) -> list[int]:
    """A lane for each stop, so that no two of one lane overlap: 0 in the middle, then 1, −1, 2, −2, …"""
    ends: list[float] = []
    taken: dict[int, int] = {}
    for index, lo, hi in sorted(stops, key=lambda stop: stop[1:]):
        free = next((k for k, end in enumerate(ends) if end + gap_mm < lo), len(ends))
        ends[free : free + 1] = [hi]
        taken[index] = (free + 1) // 2 * (1 if free % 2 else -1)
    return [taken[index] for index, _, _ in stops]


def _travel_direction(item: ApproachArrow) -> Floats:
    """Unit vector of the travel on the page."""
    return np.array([math.cos(item.direction_rad), -math.sin(item.direction_rad)])


def _stops(item: ApproachArrow) -> list[Stop]:
    return [
        (index, *outcome.stop_mm)
        for index, outcome in enumerate(item.predictions[: svg.MAX_OTHERS])
        if outcome.stop_mm is not None
    ]


def _groups(stops: Sequence[Stop]) -> list[list[Stop]]:
    """Stops that overlap, directly or through others, together; along the way."""
    groups: list[list[Stop]] = []
    reach = -math.inf
    for stop in sorted(stops, key=lambda stop: stop[1:]):
        if stop[1] > reach:
            groups.append([])
        groups[-1].append(stop)
        reach = max(reach, stop[2])
    return groups


def _line(start: Floats, end: Floats, dash: str | None = None) -> str:
    return svg.segment(start, end, stroke=svg.INK, stroke_width=svg.LINE, stroke_dasharray=dash)


def _stop(colour: str, tips: Floats, aside: Floats, radius: float, *, faint: bool) -> str:
    """A bar in its lane, with the tip at both ends, `tips` (2, 2), where it really is."""
    shown = [
        svg.circle(
            (x, y),
            radius,
            fill="none" if faint else colour,
            fill_opacity=None if faint else 0.06,
            stroke=colour,
            stroke_width=svg.THIN,
            stroke_opacity=0.4 if faint else 0.7,
        )
        for x, y in tips.tolist()
    ]
    (x1, y1), (x2, y2) = (tips + aside).tolist()
    shown.append(svg.segment((x1, y1), (x2, y2), stroke=colour, stroke_width=_NARROW_BAR if faint else _BAR))
    return "".join(shown)


def _letters(
    picture: Picture,
    indices: Sequence[int],
    after: str,
    anchor: Floats,
    clear: float,
    towards: float,
    placer: LabelPlacer,
) -> str:
    """Letters of hypotheses in their colours, and a few words, beside what they name."""
    words = svg.text_width(after, svg.LABEL_SIZE, bold=True) + 4 if after else 0.0
    box = placer.place(anchor, _LETTER_WIDTH * len(indices) + words + 4, 15.0, clear=clear, towards=towards)
    y = box.y + 4
    shown = [leader(anchor, box, clear, svg.INK)]
    for k, index in enumerate(indices):
        x = box.left + 2 + _LETTER_WIDTH * (k + 0.5)
        name = chr(ord("a") + index)
        colour = picture.colour(index)
        shown.append(svg.text(name, x, y, size=svg.LABEL_SIZE, fill=colour, anchor="middle", weight="bold"))
    if after:
        x = box.left + 6 + _LETTER_WIDTH * len(indices)
        shown.append(svg.text(after, x, y, size=svg.LABEL_SIZE, fill=svg.INK, weight="bold"))
    return "".join(shown)
