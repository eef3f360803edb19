"""Does what an objects file says make sense? Every finding with its place in the file.

Stands behind `objects_text`, where the values have the right kinds already, and before `objects_file`. What
an outline must be is in `outlines`.
"""

from bisect import bisect_right
from collections.abc import Iterable, Iterator, Mapping, Sequence
from operator import itemgetter

from palpate.base.files.limits import OUTLINES
from palpate.base.geometry import Floats
from palpate.config.model_places import Place
from palpate.config.objects_rings import Outline, curve_of, facets_for, flat_curve, stray_for_mm
from palpate.config.objects_tables import ObjectsFileText, ObjectText, SectionText, StateText
from palpate.config.outlines import outline_problem, polygons_problem

__all__ = ["NOUNS", "Finding", "heights_in_words", "objects_problems"]

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
        taken = first.setdefault(name, index)
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
    """Whether a state's height, the heights at which it is known, and its sections go together."""
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
    *others, last = [f"{low:g}–{high:g}" for low, high in ranges]
    return f"{', '.join(others)} and {last} mm" if others else f"{last} mm"


def _section_problems(section: SectionText, place: Place) -> Iterator[Finding]:
    count = sum(1 + len(polygon.holes) for polygon in section.polygons)
    if count > OUTLINES:
        yield (*place, "polygons"), f"has {count} outlines; at most {OUTLINES} are read"
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
        [(_ring(polygon.outer), [_ring(hole) for hole in polygon.holes]) for polygon in section.polygons]
    )
    if found is not None:
        number, hole_number, what = found
        inner: Place = () if hole_number is None else ("holes", hole_number)
        yield (*place, "polygons", number, *inner), what


def _outline_problems(outline: Outline, place: Place) -> Iterator[Finding]:
    found = outline_problem(_ring(outline))
    if found is not None:
        point, what = found
        if (
            curve_of(outline) is not None
        ):  # points and edges of the polygon that stands for it are not the file's
            point, what = None, what.partition(": edge ")[0]
        yield (place if point is None else (*place, point)), what


def _ring(outline: Outline) -> Floats:
    """The polygon that an outline is, or one that stands for its curves finely."""
    return flat_curve(outline, _STRAY_MM, facets_for([outline], _STRAY_MM)).ring
