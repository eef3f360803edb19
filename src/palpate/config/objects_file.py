"""Object models, format `palpate/objects@1`: JSON in, checked object models out.

The catalogue of everything that may lie on the table; what was read of a large file is kept as arrays. Each
object has stable states, each state has cross sections at ranges of height, each section polygons. The short
form (one outline, one height) becomes one state called "flat" with one section from the table up.

Outlines keep the order of the file, whichever way round they run: edge k goes from point k to point k + 1,
the last edge back to point 0. Edges of a section are counted polygon by polygon, outer before holes.
"""

import hashlib
import json
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import Any, Self, TypeGuard

import numpy as np
import pydantic
from numpy.typing import NDArray

from palpate.base.array_cache import code_digest, user_cache
from palpate.base.confined_reading import read_confined
from palpate.base.file_io import UNCONFINED_BYTES
from palpate.base.geometry import Circle, Curve, Floats, ObjectModel, Polygon, Section, State
from palpate.config.loading import Source, check_values, load_json, read_json, source_name
from palpate.config.objects_checks import NOUNS, drop_redundant_points, objects_problems
from palpate.config.objects_tables import (
    ObjectsFileText,
    ObjectText,
    PolygonText,
    SectionText,
    StateText,
    check_objects_there,
    curve_of,
    facets_for,
    flat_curve,
    stray_for_mm,
)
from palpate.config.problems import Problem, place_in_words, refuse


def arrays_of_objects(objects: tuple[ObjectModel, ...], notices: tuple[str, ...]) -> dict[str, NDArray[Any]]:
    """Object models and what there was to say of their file."""
    rings = list(_rings(objects))
    text = json.dumps([list(notices), [_object_record(item) for item in objects]])
    points = np.concatenate([np.empty((0, 2)), *rings])
    points.setflags(write=False)
    return {
        "text": np.frombuffer(text.encode(), np.uint8),
        "sizes": np.array([len(ring) for ring in rings], np.int64),
        "points": points,
    }


def objects_of_arrays(arrays: Mapping[str, NDArray[Any]]) -> tuple[tuple[ObjectModel, ...], tuple[str, ...]]:
    """Object models and notices. Raises ValueError for arrays that hold none."""
    try:
        text, sizes, points = arrays["text"], arrays["sizes"], arrays["points"]
        if sizes.dtype != np.int64 or sizes.ndim != 1 or bool(np.any(sizes < 0)):
            raise ValueError("no sizes of rings")
        if points.dtype != np.float64 or points.shape != (int(sizes.sum()), 2):
            raise ValueError("no points of rings")
        notices, items = json.loads(text.tobytes())
        # Views of one array, which is mapped from its file.
        rings = iter([points[end - size : end] for size, end in zip(sizes, np.cumsum(sizes), strict=True)])
        objects = tuple(_read_object(item, rings) for item in items)
        if next(rings, None) is not None:
            raise ValueError("more rings than objects have")
        return objects, tuple(notices)
    except (KeyError, TypeError, AttributeError, RuntimeError) as error:
        raise ValueError("no objects") from error


def _rings(objects: tuple[ObjectModel, ...]) -> Iterator[Floats]:
    for item in objects:
        for state in item.states:
            for section in state.sections:
                yield from section.rings
            yield from state.side_mm


def _object_record(item: ObjectModel) -> list[object]:
    states = [_state_record(state) for state in item.states]
    numbers = [item.tolerance_mm, item.holds_n, item.support_mm, item.normal_bound_rad]
    return [item.name, states, *numbers, item.least_tip_radius_mm]


def _state_record(state: State) -> list[object]:
    sections = [
        [section.z_mm, [_polygon_record(item) for item in section.polygons]] for section in state.sections
    ]
    return [
        state.name,
        sections,
        state.probability,
        state.tipping_angle_rad,
        state.height_mm,
        state.heights_mm,
        state.normal_bound_rad,
        state.curves_off_mm,
        state.curves_turn_rad,
        len(state.side_mm),
    ]


def _polygon_record(polygon: Polygon) -> list[object]:
    return [len(polygon.holes), [_curve_record(curve) for curve in polygon.curves]]


def _curve_record(curve: Curve | None) -> object:
    if isinstance(curve, Circle):
        return {"circle": [*curve.centre_mm, curve.radius_mm]}
    return None if curve is None else curve.tolist()


def _read_object(item: list[Any], rings: Iterator[Floats]) -> ObjectModel:
    name, states, *numbers = item
    return ObjectModel(name, tuple(_read_state(state, rings) for state in states), *numbers)


def _read_state(item: list[Any], rings: Iterator[Floats]) -> State:
    name, sections, probability, tipping, height, heights, bound, off, turn, sides = item
    found = tuple(
        Section(tuple(z), tuple(_read_polygon(polygon, rings) for polygon in polygons))
        for z, polygons in sections
    )
    known = None if heights is None else tuple((low, high) for low, high in heights)
    side = tuple(next(rings) for _ in range(sides))
    return State(name, found, probability, tipping, height, known, bound, off, turn, side)


def _read_polygon(item: list[Any], rings: Iterator[Floats]) -> Polygon:
    holes, curves = item
    outer = next(rings)
    return Polygon(outer, tuple(next(rings) for _ in range(holes)), tuple(map(_read_curve, curves)))


def _read_curve(item: Any) -> Curve | None:
    if item is None:
        return None
    if isinstance(item, dict):
        x, y, radius = item["circle"]
        return Circle((x, y), radius)
    curve = np.array(item, np.float64).reshape(-1, 3)
    curve.setflags(write=False)
    return curve


FLAT = "flat"
"""Name of the only state of an object given in the short form."""

_LIBRARY = pydantic.VERSION.replace(".", "-")
_MAX_NAMES_IN_REPR = 8  # names in a repr


@dataclass(frozen=True, slots=True)
class ObjectsFile:
    """A catalogue of objects with different names, in the file's order.

    `notices`: what was left out of the file that it was read from, in words.
    """

    objects: tuple[ObjectModel, ...]
    notices: tuple[str, ...] = field(default=(), compare=False)

    def select(self, names: Sequence[str], file: str) -> Self:
        """Keep some objects only. Raises InputError for a name that no object of `file` has."""
        check_objects_there([model.name for model in self.objects], names, file)
        return replace(self, objects=tuple(model for model in self.objects if model.name in names))

    def __repr__(self) -> str:
        names = ", ".join(model.name for model in self.objects[:_MAX_NAMES_IN_REPR])
        more = (
            f" and {len(self.objects) - _MAX_NAMES_IN_REPR} more"
            if len(self.objects) > _MAX_NAMES_IN_REPR
            else ""
        )
        return f"<ObjectsFile {names}{more}>"


def load_objects(source: Source) -> ObjectsFile:
    """Read and check the object models in `source`.

    Points of outlines that repeat others or lie on straight lines are left out (`idle_points`).

    Raises:
        InputError: unreadable, wrong keys or values, a name given twice, an outline that is no simple
            closed polygon, a hole outside its outline, overlapping polygons or heights; one line that names
            the object and the place.

    """
    found = _read_large(source) if _is_large(source) else _read_objects(source)
    return _name_notices(found, source_name(source))


def objects_of_values(values: Mapping[str, object], name: str) -> ObjectsFile:
    """Check object models that are given as values, as a file holds them; InputError calls them `name`."""
    return _name_notices(_check_objects(check_values(name, values, ObjectsFileText, NOUNS), name), name)


def _name_notices(found: ObjectsFile, name: str) -> ObjectsFile:
    return replace(found, notices=tuple(f"{name}: {line}" for line in found.notices))


def _read_objects(source: Source) -> ObjectsFile:
    return _check_objects(load_objects_text(source), source_name(source))


def _check_objects(text: ObjectsFileText, name: str) -> ObjectsFile:
    text, notices = drop_redundant_points(text)
    return replace(objects_from_text(text, name), notices=notices)


def _read_large(source: str | os.PathLike[str]) -> ObjectsFile:
    """Read what was kept of a file of the same content, or let a process with limits read it."""
    content, cache = read_json(source), user_cache()
    kind = f"objects-{code_digest('palpate.config', 'palpate.base.geometry')}-{_LIBRARY}"
    key = hashlib.sha256(content.data).hexdigest()
    kept = cache.fetch(kind, key)
    if kept is not None:
        with suppress(ValueError):
            return ObjectsFile(*objects_of_arrays(kept))
    found = read_confined(content.name, "divide it", _read_objects, content)
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


def objects_from_text(text: ObjectsFileText, name: str) -> ObjectsFile:
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
        entry.least_tip_radius,
    )


def _state(state: StateText, stray_mm: float) -> State:
    outlines = [
        outline
        for section in state.sections
        for polygon in section.polygons
        for outline in (polygon.outer, *polygon.holes)
    ]
    facets = facets_for(outlines, stray_mm)
    found, off_mm, turn_rad = zip(
        *(flat_curve(outline, stray_mm, facets) for outline in outlines), strict=True
    )
    rings = iter(found)
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
        max(off_mm),
        max(turn_rad),
        tuple(np.array(ring, dtype=np.float64) for ring in state.side or () if len(ring) > 2),
    )


def _polygon(polygon: PolygonText, rings: Iterator[Floats]) -> Polygon:
    """A polygon with the next of the rings, which stand for its outlines."""
    curves = tuple(map(curve_of, (polygon.outer, *polygon.holes)))
    outer, *holes = (next(rings) for _ in curves)
    return Polygon(outer, tuple(holes), curves if any(curve is not None for curve in curves) else ())
