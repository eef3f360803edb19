"""Object models, format `palpate/objects@1`: JSON in, checked object models out.

The catalogue of everything that may lie on the table. Each object has stable states, each state has cross
sections at ranges of height, each section polygons. The short form (one outline, one height) becomes one
state called "flat" with one section from the table up.

Outlines keep the order of the file, whichever way round they run: edge k goes from point k to point k + 1,
the last edge back to point 0. Edges of a section are counted polygon by polygon, outer before holes.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from palpate.config.fields import Bounded, FileModel, Fraction, Length, Name, Point, Positive
from palpate.config.loading import Source, load_json, source_name
from palpate.config.outlines import outline_problem, polygons_problem
from palpate.config.problems import Place, Problem, place_in_words, refuse

__all__ = [
    "FLAT",
    "ObjectModel",
    "ObjectsFile",
    "ObjectsFileText",
    "Polygon",
    "Section",
    "State",
    "load_objects",
]

FLAT = "flat"
"""Name of the only state of an object given in the short form."""

_NOUNS = {
    "objects": "object",
    "states": "state",
    "sections": "section",
    "polygons": "polygon",
    "outline": "outline point",
    "outer": "outer point",
    "holes": "hole",
}
_PROBABILITY_SLACK = 1e-6

Outline = Annotated[list[Point], Field(description="Corner points [x, y], mm, either way round, not closed.")]


class PolygonText(FileModel):
    """A polygon as it stands in the file."""

    outer: Outline
    holes: list[Outline] = Field(default=[], description="Outlines of holes, inside `outer`.")


class SectionText(FileModel):
    """A cross section as it stands in the file."""

    z: Bounded = Field(description="[from, to], mm above the support plane.")
    polygons: list[PolygonText] = Field(min_length=1)


class StateText(FileModel):
    """A stable state as it stands in the file."""

    name: Name
    probability: Fraction | None = Field(default=None, description="How often the object comes to rest so.")
    tipping_angle: Annotated[float, Field(strict=True, ge=0, le=np.pi)] | None = Field(
        default=None, description="Smallest tilt that tips the object over, rad."
    )
    sections: list[SectionText] = Field(min_length=1)


class ObjectText(FileModel):
    """An object as it stands in the file: `outline` and `height`, or `states`."""

    name: Name
    tolerance: Length = Field(
        default=0.0, description="The part's true outline is within this distance of the model's, mm."
    )
    outline: Outline | None = Field(default=None, description="Short form: the only cross section.")
    height: Positive | None = Field(default=None, description="Short form: height of the part, mm.")
    states: list[StateText] | None = Field(default=None, min_length=1)


class ObjectsFileText(FileModel):
    """The file as it stands; source of the exported JSON Schema."""

    format: Literal["palpate/objects@1"]
    units: Literal["mm"] = Field(description="mm is the only unit; convert other drawings on import.")
    objects: list[ObjectText] = Field(min_length=1)


@dataclass(frozen=True, slots=True, eq=False)
class Polygon:
    """Outer outline and holes: arrays of shape (n, 2), mm, object frame, read-only, in the file's order."""

    outer: NDArray[np.float64]
    holes: tuple[NDArray[np.float64], ...] = ()


@dataclass(frozen=True, slots=True)
class Section:
    """What a finger at a height in `z_mm` = (from, to), mm above the support plane, can touch."""

    z_mm: tuple[float, float]
    polygons: tuple[Polygon, ...]


@dataclass(frozen=True, slots=True)
class State:
    """A way to rest on the support plane; `probability` and `tipping_angle_rad` where known."""

    name: str
    sections: tuple[Section, ...]
    probability: float | None = None
    tipping_angle_rad: float | None = None


@dataclass(frozen=True, slots=True)
class ObjectModel:
    """A known object; its true outline is within `tolerance_mm` of the model's."""

    name: str
    states: tuple[State, ...]
    tolerance_mm: float = 0.0


@dataclass(frozen=True, slots=True)
class ObjectsFile:
    """A catalogue of objects with different names, in the file's order."""

    objects: tuple[ObjectModel, ...]


def load_objects(source: Source) -> ObjectsFile:
    """Read and check the object models in `source`.

    Raises:
        InputError: unreadable, wrong keys or values, a name given twice, an outline that is no simple
            closed polygon, a hole outside its outline, overlapping polygons or heights; one line that names
            the object and the place.

    """
    text = load_json(source, ObjectsFileText, _NOUNS)
    problems = list(_problems(text))
    if problems:
        data = text.model_dump()
        raise refuse(
            source_name(source), [Problem(place_in_words(at, data, _NOUNS), what) for at, what in problems]
        )
    return ObjectsFile(tuple(_object(entry) for entry in text.objects))


Finding = tuple[Place, str]


def _problems(text: ObjectsFileText) -> Iterator[Finding]:
    yield from _repeated_names([entry.name for entry in text.objects], ("objects",), "object")
    for index, entry in enumerate(text.objects):
        yield from _object_problems(entry, ("objects", index))


def _repeated_names(names: list[str], place: Place, noun: str) -> Iterator[Finding]:
    for index, name in enumerate(names):
        if name in names[:index]:
            yield (
                (*place, index),
                f"the name is taken by {noun} {names.index(name)} already ({noun}s are counted from 0)",
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
    for index, section in enumerate(state.sections):
        at = (*place, "sections", index)
        if section.z[0] < 0:
            yield (*at, "z"), f"starts at {section.z[0]:g} mm, below the support plane"
        for other, earlier in enumerate(state.sections[:index]):
            if section.z[0] < earlier.z[1] and earlier.z[0] < section.z[1]:
                yield (*at, "z"), f"overlaps the heights of section {other}"
        yield from _section_problems(section, at)


def _section_problems(section: SectionText, place: Place) -> Iterator[Finding]:
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
        [(_array(polygon.outer), [_array(hole) for hole in polygon.holes]) for polygon in section.polygons]
    )
    if found is not None:
        number, hole_number, what = found
        inner: Place = () if hole_number is None else ("holes", hole_number)
        yield (*place, "polygons", number, *inner), what


def _outline_problems(outline: list[Point], place: Place) -> Iterator[Finding]:
    found = outline_problem(_array(outline))
    if found is not None:
        point, what = found
        yield (place if point is None else (*place, point)), what


def _object(entry: ObjectText) -> ObjectModel:
    if entry.states is not None:
        return ObjectModel(entry.name, tuple(_state(state) for state in entry.states), entry.tolerance)
    assert entry.outline is not None, "checked by _object_problems"
    assert entry.height is not None, "checked by _object_problems"
    section = Section((0.0, entry.height), (Polygon(_array(entry.outline)),))
    return ObjectModel(entry.name, (State(FLAT, (section,)),), entry.tolerance)


def _state(state: StateText) -> State:
    sections = tuple(
        Section(
            section.z,
            tuple(
                Polygon(_array(p.outer), tuple(_array(hole) for hole in p.holes)) for p in section.polygons
            ),
        )
        for section in state.sections
    )
    return State(state.name, sections, state.probability, state.tipping_angle)


def _array(outline: list[Point]) -> NDArray[np.float64]:
    array = np.array(outline, dtype=np.float64).reshape(-1, 2)
    array.setflags(write=False)
    return array
