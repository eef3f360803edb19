"""Checks of the contents of an objects file; findings name the place, and redundant points are dropped.

It runs after `objects_tables`, so that values already have the right types, and before `objects_file`.
Points that repeat the previous one, or lie on a straight line between others, as exporters write them, are
redundant. They are dropped, with a notice, since the edges in answers are counted without them.
"""

import unicodedata
from bisect import bisect_right
from collections.abc import Iterable, Iterator, Mapping, Sequence
from operator import itemgetter
from typing import Any

import numpy as np
import shapely

from palpate.base.errors import join_words, quantity
from palpate.base.file_io import MOST_OUTLINES
from palpate.base.geometry import Bools, Floats
from palpate.config.objects_tables import (
    CircleText,
    ObjectsFileText,
    ObjectText,
    Outline,
    SectionText,
    StateText,
    curve_of,
    facets_for,
    flat_curve,
    stray_for_mm,
)
from palpate.config.outline_checks import MIN_EDGE_MM, outline_problem, polygons_problem
from palpate.config.problems import Place

NOUNS: Mapping[str, str] = {
    "objects": "object",
    "states": "state",
    "sections": "section",
    "polygons": "polygon",
    "outline": "outline point",
    "outer": "outer point",
    "holes": "hole",
}
"""What messages call the entries of a file's lists."""

_PROBABILITY_SLACK = 1e-6
_STRAY_MM = stray_for_mm(0.0)

Finding = tuple[Place, str]
"""Where in the file, and what is wrong there."""


def objects_problems(text: ObjectsFileText) -> Iterator[Finding]:
    """Everything that is wrong with what the values say, with its place; nothing for a good file."""
    yield from _repeated_names([entry.name for entry in text.objects], ("objects",), "object")
    for index, entry in enumerate(text.objects):
        yield from _object_problems(entry, ("objects", index))


def _repeated_names(names: list[str], place: Place, noun: str) -> Iterator[Finding]:
    first: dict[str, int] = {}
    for index, name in enumerate(names):
        taken = first.setdefault(unicodedata.normalize("NFC", name), index)
        if taken != index:
            yield (
                (*place, index),
                f"the name is taken by {noun} {taken} already ({noun}s are counted from 0)",
            )


def _object_problems(entry: ObjectText, place: Place) -> Iterator[Finding]:
    if entry.states is None:
        for key, value in (("outline", entry.outline), ("height", entry.height)):
            if value is None:
                yield place, f'the key "{key}" is missing (or give "states")'
        if entry.outline is not None:
            yield from _outline_problems(entry.outline, (*place, "outline"))
        return
    if entry.outline is not None or entry.height is not None:
        yield place, 'has "states" and "outline" or "height"; give either the short form or states'
    yield from _repeated_names([state.name for state in entry.states], (*place, "states"), "state")
    total = sum(state.probability or 0.0 for state in entry.states)
    if total > 1 + _PROBABILITY_SLACK:
        yield place, f"the probabilities of its states add up to {total:.4g}; at most 1 is possible"
    for index, state in enumerate(entry.states):
        yield from _state_problems(state, (*place, "states", index))


def _state_problems(state: StateText, place: Place) -> Iterator[Finding]:
    yield from _heights_problems(state, place)
    for index, section in enumerate(state.sections):
        at = (*place, "sections", index)
        if section.z[0] < 0:
            yield (*at, "z"), f"starts at {section.z[0]:g} mm, below the support plane"
        yield from _section_problems(section, at)
    for index, other in _overlapping(state.sections):
        yield (*place, "sections", index, "z"), f"overlaps the heights of section {other}"


def _overlapping(sections: Sequence[SectionText]) -> Iterator[tuple[int, int]]:
    """Pairs of sections that overlap, at least one pair if any do; the later one in the file first."""
    highest: tuple[float, int] | None = None
    for index in sorted(range(len(sections)), key=lambda k: sections[k].z):
        low, high = sections[index].z
        if highest is not None and low < highest[0]:
            yield max(index, highest[1]), min(index, highest[1])
        highest = max(highest or (high, index), (high, index))


def _heights_problems(state: StateText, place: Place) -> Iterator[Finding]:
    """Find where a state's height, the heights at which it is known, and its sections disagree."""
    if state.height is None:
        if state.heights is not None:
            yield place, 'has "heights" but no "height": how high the part is must be known then'
        return
    top = state.height
    known = [(0.0, top)] if state.heights is None else state.heights
    for index, (low, high) in enumerate(known):
        at = (*place, "heights", index)
        if low < 0:
            yield at, f"starts at {low:g} mm, below the support plane"
        if high > top:
            yield at, f"ends at {high:g} mm, above the part's height of {top:g} mm"
        if index > 0 and low <= known[index - 1][1]:
            yield at, f"starts at {low:g} mm, where the one before has not ended; give them in order, apart"
    for index, section in enumerate(state.sections):
        low, high = section.z
        around = known[bisect_right(known, low, key=itemgetter(0)) - 1]
        if not (around[0] <= low and high <= around[1]):
            what = f"[{low:g}, {high:g}] mm is not within the heights at which the state is known"
            yield (*place, "sections", index, "z"), f"{what}: {heights_in_words(known)}"
    highest = max(section.z[1] for section in state.sections)
    if state.heights is None and highest < top:
        what = f"ends at {highest:g} mm, below its height of {top:g} mm"
        yield place, f'{what}; say at which "heights" its sections are known'


def heights_in_words(ranges: Iterable[tuple[float, float]]) -> str:
    """Ranges of height as people read them: "4.5–5.5 and 11.5–12.5 mm"."""
    return f"{join_words([f'{low:g}–{high:g}' for low, high in ranges])} mm"


def _section_problems(section: SectionText, place: Place) -> Iterator[Finding]:
    count = sum(1 + len(polygon.holes) for polygon in section.polygons)
    if count > MOST_OUTLINES:
        yield (*place, "polygons"), f"has {count} outlines; at most {MOST_OUTLINES} are read"
        return
    simple = True
    for index, polygon in enumerate(section.polygons):
        at = (*place, "polygons", index)
        outlines = [((*at, "outer"), polygon.outer)]
        outlines += [((*at, "holes", number), hole) for number, hole in enumerate(polygon.holes)]
        for where, outline in outlines:
            for finding in _outline_problems(outline, where):
                simple = False
                yield finding
    if not simple:
        return
    found = polygons_problem(
        [
            (_polygon_ring(polygon.outer), [_polygon_ring(hole) for hole in polygon.holes])
            for polygon in section.polygons
        ]
    )
    if found is not None:
        number, hole_number, what = found
        inner: Place = () if hole_number is None else ("holes", hole_number)
        yield (*place, "polygons", number, *inner), what


def _outline_problems(outline: Outline, place: Place) -> Iterator[Finding]:
    found = outline_problem(_polygon_ring(outline))
    if found is not None:
        point, what = found
        if (
            curve_of(outline) is not None
        ):  # points and edges of the polygon that stands for it are not the file's
            point, what = None, what.partition(": edge ")[0]
        yield (place if point is None else (*place, point)), what


def _polygon_ring(outline: Outline) -> Floats:
    """The polygon that an outline is, or one that stands for its curves finely."""
    return flat_curve(outline, _STRAY_MM, facets_for([outline], _STRAY_MM))[0]


_MAX_BEND_MM = 1e-7
"""From a straight line; less than what makes two points of one."""
_MAX_COORDINATE_MM = 1e9
"""Further out numbers are too coarse to tell; such outlines are refused elsewhere."""


def drop_redundant_points(text: ObjectsFileText) -> tuple[ObjectsFileText, tuple[str, ...]]:
    """The file's text without such points, and a line that says so."""
    objects, lines, dropped = [], [], 0
    for item in text.objects:
        made, repeated, straight = _reduce_object(item)
        objects.append(made)
        dropped += repeated + straight
        words = [
            *(
                [f"{quantity(repeated, 'point that repeats', 'points that repeat')} the one before"]
                if repeated
                else []
            ),
            *([f"{quantity(straight, 'point', 'points')} on a straight line"] if straight else []),
        ]
        if words:
            lines.append(f'object "{item.name}": left out {" and ".join(words)}; edges are counted without')
    if len(lines) > 1:  # one by one they would bury everything else
        what = "points that repeat others or lie on straight lines"
        lines = [f"{len(lines)} objects: left out {dropped} {what}; edges are counted without"]
    return (text.model_copy(update={"objects": objects}) if lines else text), tuple(lines)


def _reduce_object(item: ObjectText) -> tuple[ObjectText, int, int]:
    """An object without idle points, and how many were repeated and on straight lines."""
    counts = np.zeros(2, dtype=np.int64)

    def kept(outline: Outline) -> Outline:
        found, *dropped = _reduce_outline(outline)
        counts[:] += dropped
        return found

    if item.states is None:
        outline = None if item.outline is None else kept(item.outline)
        made = item.model_copy(update={"outline": outline})
    else:
        states = []
        for state in item.states:
            sections = []
            for section in state.sections:
                polygons = [
                    polygon.model_copy(
                        update={"outer": kept(polygon.outer), "holes": [kept(hole) for hole in polygon.holes]}
                    )
                    for polygon in section.polygons
                ]
                sections.append(section.model_copy(update={"polygons": polygons}))
            states.append(state.model_copy(update={"sections": sections}))
        made = item.model_copy(update={"states": states})
    repeated, straight = counts.tolist()
    return (made if repeated or straight else item), repeated, straight


def _reduce_outline(outline: Outline) -> tuple[Outline, int, int]:
    """An outline without idle points, but at least three; how many were repeated and on straight lines."""
    if isinstance(outline, CircleText) or len(outline) < 3:
        return outline, 0, 0
    points = np.array([point[:2] for point in outline], dtype=np.float64)
    bent = np.array([len(point) == 3 and point[2] != 0 for point in outline])
    if (np.abs(points) > _MAX_COORDINATE_MM).any():
        return outline, 0, 0
    differs = np.hypot(*(np.roll(points, -1, axis=0) - points).T) >= MIN_EDGE_MM
    some = np.flatnonzero(differs)
    idle = _collinear(points[some], bent[some]) if len(some) > 2 else np.zeros(len(some), dtype=bool)
    left = some[~idle]
    if len(left) == len(points) or len(left) < 3:
        return outline, 0, 0
    chosen: Sequence[Any] = outline
    return [chosen[k] for k in left.tolist()], int((~differs).sum()), int(idle.sum())


def _collinear(points: Floats, bent: Bools) -> Bools:
    """Mark points (n, 2) that lie between their neighbours; `bent` (n,): an arc runs to the next point."""
    before, after = points - np.roll(points, 1, axis=0), np.roll(points, -1, axis=0) - points
    across = before + after
    aside = np.abs(across[:, 0] * before[:, 1] - across[:, 1] * before[:, 0])
    idle: Bools = (
        (aside <= _MAX_BEND_MM * np.hypot(*across.T))
        & ((before * after).sum(axis=1) > 0)
        & ~bent
        & ~np.roll(bent, 1)
    )
    kept = points[~idle]
    if len(kept) < 3 or not idle.any():
        return np.zeros(len(points), dtype=bool)
    # Fine curves bend by as little at each point: then all of them count.
    off = shapely.distance(shapely.points(points[idle]), shapely.LinearRing(kept))
    return idle if float(off.max()) <= _MAX_BEND_MM else np.zeros(len(points), dtype=bool)
