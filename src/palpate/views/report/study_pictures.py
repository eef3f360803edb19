"""Pictures of a study: how many touches runs took, and outlines of pairs that are hard to tell apart."""

import math
from collections.abc import Mapping, Sequence

import numpy as np
import shapely
from shapely import affinity

from palpate.base.geometry import ObjectModel, State
from palpate.base.geometry.outlines import region_of, rings_of
from palpate.config.study_result import PairStudiedOut
from palpate.views import svg

_WIDTH, _TEXT_SIZE = 760.0, 11.0
_ONE, _OTHER, _GREY, _LINE = "#0072b2", "#d55e00", "#5b6b78", "#c3ccd3"
_MAX_PAIRS, _COLUMNS = 6, 3
_ALIGNMENT_TURNS = 72


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
        parts.append(svg.rectangle((x + 1, 20 + height - tall), (pitch - 2, tall), fill=_ONE))
        if runs and pitch > 24:
            share = f"{100 * runs / total:.0f} %" if runs / total >= 0.01 else "< 1 %"
            parts.append(
                svg.text(share, x + pitch / 2, 15 + height - tall, size=10, anchor="middle", fill=_GREY)
            )
        if pitch > 16 or count % 5 == 0:
            parts.append(svg.text(str(count), x + pitch / 2, 34 + height, size=_TEXT_SIZE, anchor="middle"))
    end = 30 + (high - low + 1) * pitch
    parts.append(svg.segment((30, 20 + height), (end, 20 + height), stroke=_LINE))
    parts.append(svg.text("touches", 30, 50 + height, size=_TEXT_SIZE, fill=_GREY))
    return svg.document((_WIDTH, 58 + height), *parts, title="touches that runs took")


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
            words = svg.shorten_middle(named[id(state)], _TEXT_SIZE, side - 24)
            y = row * (side + 30) + side - 4 + 15 * line
            parts.append(svg.text(words, column * side + 12, y, size=_TEXT_SIZE, fill=colour))
    height = math.ceil(len(drawn) / _COLUMNS) * (side + 30)
    return svg.document((_WIDTH, height), *parts, title="outlines of the hardest pairs")


def _overlay(one: State, other: State, height_mm: float, x: float, y: float, side: float) -> str:
    """Both outlines, fitted into a square."""
    first, second = (_region(state, height_mm) for state in (one, other))
    second = _align(first, second)
    low, high = np.array(shapely.bounds(shapely.union(first, second))).reshape(2, 2)
    scale = (side - 60) / max(*(high - low).tolist(), 1.0)
    middle = (low + high) / 2
    at = np.array([x + side / 2, y + side / 2 - 12])

    def rings(shape: shapely.Geometry) -> list[np.ndarray[tuple[int, ...], np.dtype[np.float64]]]:
        return [at + (ring - middle) * scale * np.array([1, -1]) for ring in rings_of(shape)]

    return "".join(
        svg.closed_path(
            rings(shape), fill=colour, fill_opacity=0.14, fill_rule="evenodd", stroke=colour, stroke_width=1.4
        )
        for shape, colour in ((first, _ONE), (second, _OTHER))
        if not shape.is_empty
    )


def _region(state: State, height_mm: float) -> shapely.Geometry:
    """Region at a height, or the lowest section where nothing is at that height."""
    sections = state.sections_at(height_mm) or state.sections[:1]
    return region_of(polygon for section in sections for polygon in section.polygons)


def _align(first: shapely.Geometry, second: shapely.Geometry) -> shapely.Geometry:
    """The second with its centroid on that of the first, turned so that they share most."""
    to = first.centroid
    second = affinity.translate(second, to.x - second.centroid.x, to.y - second.centroid.y)
    turned = [
        affinity.rotate(second, 360 * k / _ALIGNMENT_TURNS, origin=(to.x, to.y))
        for k in range(_ALIGNMENT_TURNS)
    ]
    return turned[int(np.argmax(shapely.area(shapely.intersection(first, turned))))]
