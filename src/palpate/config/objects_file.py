"""Object models, format `palpate/objects@1`: JSON in, checked object models out.

The catalogue of everything that may lie on the table. Each object has stable states, each state has cross
sections at ranges of height, each section polygons. The short form (one outline, one height) becomes one
state called "flat" with one section from the table up.

Outlines keep the order of the file, whichever way round they run: edge k goes from point k to point k + 1,
the last edge back to point 0. Edges of a section are counted polygon by polygon, outer before holes.
"""

import hashlib
import os
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import TypeGuard

import numpy as np
import pydantic

from palpate.base.files import confined
from palpate.base.files.cache import user_cache
from palpate.base.files.code_digest import code_digest
from palpate.base.files.limits import UNCONFINED_BYTES
from palpate.base.geometry import Floats, ObjectModel, Polygon, Section, State
from palpate.config.idle_points import without_idle_points
from palpate.config.loading import Source, load_json, read_json, source_name
from palpate.config.objects_arrays import arrays_of_objects, objects_of_arrays
from palpate.config.objects_checks import NOUNS, objects_problems
from palpate.config.objects_rings import curve_of, facets_for, flat_curve, stray_for_mm
from palpate.config.objects_tables import ObjectsFileText, ObjectText, PolygonText, SectionText, StateText
from palpate.config.problems import Problem, place_in_words, refuse

__all__ = [
    "FLAT",
    "ObjectsFile",
    "checked_objects",
    "load_objects",
    "load_objects_text",
]

FLAT = "flat"
"""Name of the only state of an object given in the short form."""

_LIBRARY = pydantic.VERSION.replace(".", "-")
_SHOWN = 8  # names in a repr


@dataclass(frozen=True, slots=True)
class ObjectsFile:
    """A catalogue of objects with different names, in the file's order.

    `notices`: what was left out of the file that it was read from, in words.
    """

    objects: tuple[ObjectModel, ...]
    notices: tuple[str, ...] = field(default=(), compare=False)

    def __repr__(self) -> str:
        names = ", ".join(model.name for model in self.objects[:_SHOWN])
        more = f" and {len(self.objects) - _SHOWN} more" if len(self.objects) > _SHOWN else ""
        return f"<ObjectsFile {names}{more}>"


def load_objects(source: Source) -> ObjectsFile:
    """Read and check the object models in `source`.

    Points of outlines that repeat others or lie on straight lines are left out (`idle_points`).

    Raises:
        InputError: unreadable, wrong keys or values, a name given twice, an outline that is no simple
            closed polygon, a hole outside its outline, overlapping polygons or heights; one line that names
            the object and the place.

    """
    found = _loaded_large(source) if _is_large(source) else _loaded(source)
    name = source_name(source)
    return replace(found, notices=tuple(f"{name}: {line}" for line in found.notices))


def _loaded(source: Source) -> ObjectsFile:
    text, notices = without_idle_points(load_objects_text(source))
    return replace(checked_objects(text, source_name(source)), notices=notices)


def _loaded_large(source: str | os.PathLike[str]) -> ObjectsFile:
    """What was kept of a file of the same content, or else what a process with limits reads of it."""
    content, cache = read_json(source), user_cache()
    kind = f"objects-{code_digest('palpate.config', 'palpate.base.geometry')}-{_LIBRARY}"
    key = hashlib.sha256(content.data).hexdigest()
    kept = cache.fetch(kind, key)
    if kept is not None:
        with suppress(ValueError):
            return ObjectsFile(*objects_of_arrays(kept))
    found = confined(content.name, "divide it", _loaded, content)
    arrays = arrays_of_objects(found.objects, found.notices)
    cache.keep(kind, key, arrays)
    return ObjectsFile(*objects_of_arrays(arrays))


def _is_large(source: Source) -> TypeGuard[str | os.PathLike[str]]:
    """Can checking outlines against each other, by the square of their number, take long?"""
    try:
        return isinstance(source, str | os.PathLike) and os.stat(source).st_size > UNCONFINED_BYTES
    except (OSError, ValueError):
        return False  # reading it says what is wrong


def load_objects_text(source: Source) -> ObjectsFileText:
    """Read `source` as it stands, for a file that is to be written anew; InputError for its form only."""
    return load_json(source, ObjectsFileText, NOUNS)


def checked_objects(text: ObjectsFileText, name: str) -> ObjectsFile:
    """Check what the values of a text mean; InputError as `load_objects`, which calls the file `name`."""
    problems = list(objects_problems(text))
    if problems:
        data = text.model_dump()
        raise refuse(name, [Problem(place_in_words(at, data, NOUNS), what) for at, what in problems])
    return ObjectsFile(tuple(_object(entry) for entry in text.objects))


def _object(entry: ObjectText) -> ObjectModel:
    states = entry.states
    if states is None:
        assert entry.outline is not None, "checked by _object_problems"
        assert entry.height is not None, "checked by _object_problems"
        section = SectionText(z=(0.0, entry.height), polygons=[PolygonText(outer=entry.outline)])
        states = [StateText(name=FLAT, sections=[section])]
    return ObjectModel(
        entry.name,
        tuple(_state(state, stray_for_mm(entry.tolerance)) for state in states),
        entry.tolerance,
        entry.part_holds_n,
        entry.part_support_mm,
        entry.normal_bound,
    )


def _state(state: StateText, stray_mm: float) -> State:
    outlines = [
        outline
        for section in state.sections
        for polygon in section.polygons
        for outline in (polygon.outer, *polygon.holes)
    ]
    facets = facets_for(outlines, stray_mm)
    flat = [flat_curve(outline, stray_mm, facets) for outline in outlines]
    rings = iter(item.ring for item in flat)
    sections = tuple(
        Section(section.z, tuple(_polygon(polygon, rings) for polygon in section.polygons))
        for section in state.sections
    )
    heights = None if state.heights is None else tuple(state.heights)
    return State(
        state.name,
        sections,
        state.probability,
        state.tipping_angle,
        state.height,
        heights,
        state.normal_bound,
        max(item.off_mm for item in flat),
        max(item.turn_rad for item in flat),
        tuple(np.array(ring, dtype=np.float64) for ring in state.side or () if len(ring) > 2),
    )


def _polygon(polygon: PolygonText, rings: Iterator[Floats]) -> Polygon:
    """A polygon with the next of the rings, which stand for its outlines."""
    curves = tuple(map(curve_of, (polygon.outer, *polygon.holes)))
    outer, *holes = (next(rings) for _ in curves)
    return Polygon(outer, tuple(holes), curves if any(curve is not None for curve in curves) else ())
