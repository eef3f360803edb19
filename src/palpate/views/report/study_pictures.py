"""Pictures of a study: touches, confusion, pairs that are hard to tell apart, heights, what errors cost."""

import math
from collections.abc import Mapping, Sequence

import numpy as np
import shapely
from shapely import affinity

from palpate.base.geometry import ObjectModel, State
from palpate.config.study_result import (
    ConfusionOut,
    HeightOut,
    NoiseCostOut,
    PairStudiedOut,
    StateStudiedOut,
)
from palpate.views.report.study_text import SOURCE_WORDS, may_be_chance
from palpate.views.svg import element, number, path_data, shorten_middle, text, text_width

_WIDTH, _TEXT_SIZE, _ROW_HEIGHT = 760.0, 11.0, 18.0
_ONE, _OTHER, _FAINT, _GREY, _LINE = "#0072b2", "#d55e00", "#eaeef2", "#5b6b78", "#c3ccd3"
_CHANCE_COLOUR = "#a9b8c2"
_NAME_WIDTH = 250.0
_MAX_STATES, _MAX_PAIRS, _COLUMNS, _MAX_HEIGHTS = 24, 6, 3, 24
_CELL_SIZE, _MAX_LABEL_WIDTH = 30.0, 180.0
_ALIGNMENT_TURNS = 72
MATRIX_STATES = 16
"""So many of the states that are confused most have room in the matrix."""


def states_picture(states: Sequence[StateStudiedOut]) -> str:
    """A bar for every state that was not always identified, those that were so least often first."""
    room = _WIDTH - _NAME_WIDTH - 60
    parts = []
    for k, item in enumerate(states[:_MAX_STATES]):
        y, share = k * _ROW_HEIGHT, item.identified / item.runs
        parts.append(_label(f"{item.object}, {item.state}", y))
        parts.append(element("rect", x=_NAME_WIDTH, y=y + 3, width=room, height=_ROW_HEIGHT - 6, fill=_FAINT))
        parts.append(
            element("rect", x=_NAME_WIDTH, y=y + 3, width=room * share, height=_ROW_HEIGHT - 6, fill=_ONE)
        )
        parts.append(text(f"{100 * share:.0f} %", _NAME_WIDTH + room + 6, y + 13, size=_TEXT_SIZE))
    return _svg(parts, min(len(states), _MAX_STATES) * _ROW_HEIGHT + 4)


def touches_picture(touches_of: Mapping[int, int]) -> str:
    """Histogram: runs by how many touches they took."""
    low, high = min(touches_of), max(touches_of)
    total, most = sum(touches_of.values()), max(touches_of.values())
    pitch = min((_WIDTH - 60) / (high - low + 1), 48.0)
    height, parts = 150.0, []
    for k, count in enumerate(range(low, high + 1)):
        runs = touches_of.get(count, 0)
        tall = height * runs / most
        x = 30 + k * pitch
        parts.append(element("rect", x=x + 1, y=20 + height - tall, width=pitch - 2, height=tall, fill=_ONE))
        if runs and pitch > 24:
            share = f"{100 * runs / total:.0f} %" if runs / total >= 0.01 else "< 1 %"
            parts.append(text(share, x + pitch / 2, 15 + height - tall, size=10, anchor="middle", fill=_GREY))
        if pitch > 16 or count % 5 == 0:
            parts.append(text(str(count), x + pitch / 2, 34 + height, size=_TEXT_SIZE, anchor="middle"))
    end = 30 + (high - low + 1) * pitch
    parts.append(element("line", x1=30, x2=end, y1=20 + height, y2=20 + height, stroke=_LINE))
    parts.append(text("touches", 30, 50 + height, size=_TEXT_SIZE, fill=_GREY))
    return _svg(parts, 58 + height)


def confusion_picture(confusion: Sequence[ConfusionOut]) -> str:
    """Matrix: a row for what lay there, a column for what was still possible at the end."""
    names = list(dict.fromkeys(name for item in confusion for name in (item.a, item.b)))[:MATRIX_STATES]
    share = {(item.a, item.b): item.share for item in confusion}
    titles, parts = [shorten_middle(name, _TEXT_SIZE, _MAX_LABEL_WIDTH) for name in names], []
    top = max(text_width(words, _TEXT_SIZE) for words in titles) * math.sin(math.pi / 4) + 20
    for k, (name, words) in enumerate(zip(names, titles, strict=True)):
        y, x = top + k * _CELL_SIZE, _NAME_WIDTH + k * _CELL_SIZE
        parts.append(_label(name, y + 6))
        turned = element(
            "g",
            text(words, 0, 0, size=_TEXT_SIZE),
            transform=f"translate({number(x + 18)},{number(top - 6)}) rotate(-45)",
        )
        parts.append(turned)
        for column, other in enumerate(names):
            found = share.get((name, other), 0.0)
            at = {
                "x": _NAME_WIDTH + column * _CELL_SIZE + 1,
                "y": y + 1,
                "width": _CELL_SIZE - 2,
                "height": _CELL_SIZE - 2,
            }
            if name == other:
                parts.append(element("rect", **at, fill="#fff", stroke=_FAINT))
                continue
            parts.append(element("rect", **at, fill=_FAINT))
            parts.append(element("rect", **at, fill=_OTHER, fill_opacity=math.sqrt(found)))
            if found:
                parts.append(
                    text(f"{100 * found:.0f}", at["x"] + _CELL_SIZE / 2 - 1, y + 19, size=10, anchor="middle")
                )
    return _svg(parts, top + len(names) * _CELL_SIZE + 4)


def pair_pictures(pairs: Sequence[PairStudiedOut], objects: Sequence[ObjectModel], height_mm: float) -> str:
    """Outlines of the hardest pairs at a height, laid on each other as well as they will go."""
    states = {(item.name, state.name): state for item in objects for state in item.states}
    drawn: dict[frozenset[tuple[str, str]], tuple[State, State]] = {}
    for pair in pairs:
        names = (pair.object, pair.state), (pair.other_object, pair.other_state)
        if len(set(names)) == 2 and all(name in states for name in names):
            drawn.setdefault(frozenset(names), (states[names[0]], states[names[1]]))
            order = tuple(drawn)
            if len(order) == _MAX_PAIRS:
                break
    parts, side = [], _WIDTH / _COLUMNS
    named = {id(state): f"{name[0]}, {name[1]}" for name, state in states.items()}
    for k, (one, other) in enumerate(drawn.values()):
        row, column = divmod(k, _COLUMNS)
        parts.append(_overlay(one, other, height_mm, column * side, row * (side + 30), side))
        for line, (state, colour) in enumerate(((one, _ONE), (other, _OTHER))):
            words = shorten_middle(named[id(state)], _TEXT_SIZE, side - 24)
            y = row * (side + 30) + side - 4 + 15 * line
            parts.append(text(words, column * side + 12, y, size=_TEXT_SIZE, fill=colour))
    return _svg(parts, math.ceil(len(drawn) / _COLUMNS) * (side + 30))


def heights_picture(heights: Sequence[HeightOut], now_mm: Sequence[float], best_mm: Sequence[float]) -> str:
    """A bar for every range of height: pairs that fingers there do not tell apart."""
    shown = heights[:_MAX_HEIGHTS][::-1]
    most = max(1, *(item.alike for item in shown))
    room, parts = _WIDTH - _NAME_WIDTH - 190, []
    for k, item in enumerate(shown):
        y, (low, high) = k * _ROW_HEIGHT, item.range
        parts.append(_label(f"{low:.1f} to {high:.1f} mm", y))
        width = max(room * item.alike / most, 1.0)
        parts.append(element("rect", x=_NAME_WIDTH, y=y + 3, width=width, height=_ROW_HEIGHT - 6, fill=_ONE))
        words = f"{item.alike} not distinguished" + (f", {item.unmet} not met" if item.unmet else "")
        parts.append(text(words, _NAME_WIDTH + width + 6, y + 13, size=_TEXT_SIZE))
        marks = [
            (words, colour)
            for words, colour, places in (("now", _GREY, now_mm), ("best", _OTHER, best_mm))
            if any(low <= place < high for place in places)
        ]
        for number_, (words, colour) in enumerate(marks):
            parts.append(text(words, 6 + 40 * number_, y + 13, size=_TEXT_SIZE, fill=colour, weight="bold"))
    return _svg(parts, len(shown) * _ROW_HEIGHT + 4)


def budget_picture(costs: Sequence[NoiseCostOut]) -> str:
    """A bar for every change: touches that it saves, with their confidence interval; grey: may be chance.

    Of those with an interval; the empty string without any.
    """
    drawn = [
        (SOURCE_WORDS[item.source], item.fewer_touches, item.fewer_interval, may_be_chance(item, "touches"))
        for item in costs
        if item.fewer_touches is not None and item.fewer_interval is not None
    ]
    if not drawn:
        return ""
    most = max(0.5, *(abs(end) for _, _, interval, _ in drawn for end in interval))
    room = (_WIDTH - _NAME_WIDTH - 90) / 2
    middle, parts = _NAME_WIDTH + room, []
    for k, (words, fewer, (low, high), is_chance) in enumerate(drawn):
        y, at = k * 26.0, middle + room * fewer / most
        parts.append(_label(words, y + 4))
        colour = _CHANCE_COLOUR if is_chance else _ONE if fewer >= 0 else _OTHER
        parts.append(
            element("rect", x=min(middle, at), y=y + 6, width=abs(at - middle), height=12, fill=colour)
        )
        ends = [middle + room * end / most for end in (low, high)]
        parts.append(element("line", x1=ends[0], x2=ends[1], y1=y + 12, y2=y + 12, stroke="#1f2933"))
        shown = f"{fewer:+.1f}".replace("-", "−") + " ?" * is_chance
        parts.append(text(shown, max(middle, *ends) + 8, y + 16, size=_TEXT_SIZE))
    height = len(drawn) * 26.0
    parts.append(element("line", x1=middle, x2=middle, y1=0, y2=height, stroke=_LINE))
    parts.append(text("touches fewer", middle + 6, height + 14, size=_TEXT_SIZE, fill=_GREY))
    parts.append(text("touches more", middle - 6, height + 14, size=_TEXT_SIZE, fill=_GREY, anchor="end"))
    return _svg(parts, height + 22)


def _label(words: str, y: float) -> str:
    return text(
        shorten_middle(words, _TEXT_SIZE, _NAME_WIDTH - 16),
        _NAME_WIDTH - 8,
        y + 13,
        size=_TEXT_SIZE,
        anchor="end",
    )


def _overlay(one: State, other: State, height_mm: float, x: float, y: float, side: float) -> str:
    """Both outlines, fitted into a square."""
    first, second = (_region(state, height_mm) for state in (one, other))
    second = _align(first, second)
    low, high = np.array(shapely.bounds(shapely.union(first, second))).reshape(2, 2)
    scale = (side - 60) / max(*(high - low).tolist(), 1.0)
    middle = (low + high) / 2
    at = np.array([x + side / 2, y + side / 2 - 12])

    def rings(shape: shapely.Geometry) -> list[np.ndarray[tuple[int, ...], np.dtype[np.float64]]]:
        drawn = [
            np.asarray(ring.coords)[:-1]
            for part in shapely.get_parts(shape)
            for ring in (part.exterior, *part.interiors)
        ]
        return [at + (ring - middle) * scale * np.array([1, -1]) for ring in drawn]

    return "".join(
        element(
            "path",
            d=path_data(rings(shape)),
            fill=colour,
            fill_opacity=0.14,
            fill_rule="evenodd",
            stroke=colour,
            stroke_width=1.4,
        )
        for shape, colour in ((first, _ONE), (second, _OTHER))
        if not shape.is_empty
    )


def _region(state: State, height_mm: float) -> shapely.Geometry:
    """At a height, or the lowest section where nothing is at that height."""
    sections = state.sections_at(height_mm) or state.sections[:1]
    return shapely.union_all(
        [shapely.Polygon(p.outer, p.holes) for section in sections for p in section.polygons]
    )


def _align(first: shapely.Geometry, second: shapely.Geometry) -> shapely.Geometry:
    """The second with its centroid on that of the first, turned so that they share most."""
    to = first.centroid
    second = affinity.translate(second, to.x - second.centroid.x, to.y - second.centroid.y)
    turned = [
        affinity.rotate(second, 360 * k / _ALIGNMENT_TURNS, origin=(to.x, to.y))
        for k in range(_ALIGNMENT_TURNS)
    ]
    return turned[int(np.argmax(shapely.area(shapely.intersection(first, turned))))]


def _svg(parts: Sequence[str], height: float) -> str:
    box = f"0 0 {number(_WIDTH)} {number(height)}"
    return element("svg", *parts, xmlns="http://www.w3.org/2000/svg", viewBox=box, font_family="sans-serif")
