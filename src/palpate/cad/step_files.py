"""STEP files (ISO 10303-21), cut into triangles (`tessellation`), into checked solids.

Each distinct shape of an assembly is imported once: four screws are one object. A shape that is not sound is
cut again with longer chords; if it stays so, it is refused, and the others are imported.
"""

import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

from palpate.base.errors import InputError
from palpate.base.file_io import CAD_BYTES, read_bytes
from palpate.base.optional_imports import import_extra
from palpate.cad.lost_cones import Cone, close_cones, cones_in
from palpate.cad.mesh_checks import UnsoundSurfaceError, check_solids, merge_vertices
from palpate.cad.mesh_topology import vertex_rounding
from palpate.cad.parts import GIVE_NO_UNITS, UNIT_MM, Solid, SolidFile
from palpate.cad.tessellation import StepShape, tessellate

STEP_SUFFIXES = (".step", ".stp")

_CHORD_TURN_RAD = math.radians(10.0)
"""Most that neighbouring chords of a curve turn by."""

_FINER, _FINE_FACETS = (9.0, 7.0, 5.0, 3.0, 2.0), 90_000
"""Curves are cut so many times as finely as they must be, as far as so many facets in all do: many take long.

Where walls lean, sections are the wider for what a surface is off by. Where faces cross as they are cut, by
chance, they may not with other chords.
"""

_COARSER_FACTOR, _COARSE_TURN_RAD, _COARSER_FACETS = 8.0, math.radians(45.0), 40_000
"""Where no chords close a surface that is closed: half of an import's tolerance, if they are not many."""

_ADVICE = "allow its curves a larger tolerance, or export it as STL"

_SI_MM = {"": 1000.0, "DECI": 100.0, "CENTI": 10.0, "MILLI": 1.0, "MICRO": 0.001}


def read_step(path: Path, units: str | None, curve_mm: float) -> SolidFile:
    """Solids of a STEP file in mm, curves replaced by chords within `curve_mm`; each shape once.

    Chords are nearer, a ninth of that, where few facets do, and further, up to eight times, where others do
    not meet. The file has units, which `units` ("mm", "inch" or "m") may repeat. Raises InputError for what
    cannot be read, for units that are not the file's, and if `mesh_checks` refuses all shapes.
    """
    import_extra("cascadio", "step", "reading STEP files")
    data = read_bytes(path, CAD_BYTES, _ADVICE)
    if not data.lstrip().startswith(b"ISO-10303-21"):
        raise InputError(f"{path}: is no STEP file: it does not start with ISO-10303-21")
    if not data.rstrip().endswith(b"END-ISO-10303-21;"):
        raise InputError(f"{path}: is cut short: END-ISO-10303-21; is missing at its end")
    stated_mm = _check_units(path, data, units)
    shapes = tessellate(path, curve_mm, _CHORD_TURN_RAD)
    found: list[_Found] = [_UNCUT] * len(shapes)
    cuts: list[_Cut] = []
    for cut in _cuts(path, shapes, curve_mm):
        cuts.append(cut)
        found = _again(path, found, [cut], None)
        if not _some_unsound(found):
            break
    if _some_unsound(found):
        cones = [cone for mm in stated_mm for cone in cones_in(data, mm)]
        found = _again(path, found, cuts, cones)
        if _some_unsound(found) and _facet_count(shapes) <= _COARSER_FACETS:
            coarser = _other_cut(path, shapes, _COARSER_FACTOR * curve_mm, _COARSE_TURN_RAD)
            found = _again(path, _again(path, found, coarser, None), coarser, cones)
    solids = tuple(solid for item in found if not isinstance(item, InputError) for solid in item)
    refused = tuple(str(item).removeprefix(f"{path}: ") for item in found if isinstance(item, InputError))
    return SolidFile(solids, refused=refused)


_Cut = tuple[float, Sequence[StepShape]]
"""All shapes, and the deviation (mm) of their chords."""

_Found = tuple[Solid, ...] | InputError
"""The solids of a shape, or what is wrong with it."""

_UNCUT = UnsoundSurfaceError("", "")


def _cuts(path: Path, shapes: Sequence[StepShape], curve_mm: float) -> Iterator[_Cut]:
    """Cuts of the same shapes, from the finest one of few enough facets to the one that there is."""
    left = _FINE_FACETS
    for factor in _FINER:
        # Cylinders take so many times more facets, what is curved both ways takes more.
        if math.sqrt(factor) * _facet_count(shapes) <= left:
            for cut in _other_cut(path, shapes, curve_mm / factor, _CHORD_TURN_RAD):
                left -= _facet_count(cut[1])
                if left >= 0:
                    yield cut
    yield curve_mm, shapes


def _facet_count(shapes: Sequence[StepShape]) -> int:
    return sum(len(shape.faces) for shape in shapes)


def _other_cut(path: Path, shapes: Sequence[StepShape], within_mm: float, turn_rad: float) -> list[_Cut]:
    """The same shapes with other chords; none if some are not there then."""
    other = tessellate(path, within_mm, turn_rad)
    return [(within_mm, other)] if [item.name for item in other] == [item.name for item in shapes] else []


def _some_unsound(found: Sequence[_Found]) -> bool:
    return any(isinstance(item, UnsoundSurfaceError) for item in found)


def _again(
    path: Path, found: Sequence[_Found], cuts: Sequence[_Cut], cones: Sequence[Cone] | None
) -> list[_Found]:
    """What is found with other cuts, or with cones, of shapes that are not sound."""
    return [
        _first_sound(path, number, cuts, cones, item) if isinstance(item, UnsoundSurfaceError) else item
        for number, item in enumerate(found)
    ]


def _first_sound(
    path: Path,
    number: int,
    cuts: Sequence[_Cut],
    cones: Sequence[Cone] | None,
    problem: InputError,
) -> _Found:
    """The solids of a shape, of the first of its cuts that is sound; if none is, the first `problem`.

    With `cones`, only what these close is looked at: the rest is known to be unsound.
    """
    for within_mm, shapes in cuts:
        closed = (
            (shapes[number], within_mm) if cones is None else _with_lost(shapes[number], within_mm, cones)
        )
        if closed is None:
            continue
        try:
            return _solids(path, *closed)
        except InputError as error:
            problem = _by_opencascade(error) if problem is _UNCUT else problem
            if not isinstance(error, UnsoundSurfaceError):
                break
    return problem


def _by_opencascade(error: InputError) -> InputError:
    """The same fault, with advice for who has no triangles to mend."""
    if not isinstance(error, UnsoundSurfaceError):
        return error
    return UnsoundSurfaceError(
        f"{error.problem}, as OpenCASCADE cuts it into triangles",
        "export it as STL from the program that drew it",
    )


def _with_lost(shape: StepShape, within_mm: float, cones: Sequence[Cone]) -> tuple[StepShape, float] | None:
    """A shape with the `cones` of its file that close its holes, and how far (mm) it is off, if any do."""
    lost = [cone for cone in cones if not any(cone.is_like(there) for there in shape.cones)]
    laid = [cone.move(shape.place) for cone in lost]
    if not laid:
        return None
    rounding = vertex_rounding(shape.vertices_mm)
    vertices, faces, moved = merge_vertices(shape.vertices_mm, shape.faces, rounding)
    (vertices, faces), off = close_cones((vertices, faces), laid)
    return (replace(shape, vertices_mm=vertices, faces=faces), max(within_mm, off) + moved) if off else None


def _solids(path: Path, shape: StepShape, off_mm: float) -> tuple[Solid, ...]:
    """The solids of a shape whose chords deviate by so much. Raises InputError."""
    off = math.nextafter(off_mm + vertex_rounding(shape.vertices_mm), math.inf)
    return check_solids(f"{path}: {shape.name}", shape.name, shape.vertices_mm, shape.faces, off)


def _check_units(path: Path, data: bytes, units: str | None) -> set[float]:
    """Units of length in mm; refuse a file without one, or with another than the one that was said."""
    stated = _units_mm(data.decode("latin-1"))
    if not stated:
        raise InputError(f"{path}: states no unit of length; export it again with one")
    if units is not None and any(abs(mm / UNIT_MM[units] - 1) > 1e-9 for mm in stated):
        said = " and ".join(f"{mm:g} mm" for mm in sorted(stated))
        raise InputError(f"{path}: says that its unit is {said}, not {units}: {GIVE_NO_UNITS}")
    return stated


def _units_mm(text: str) -> set[float]:
    """Units of length, in mm, of all contexts of a STEP file.

    A context lists its units; a unit of length is metres with a prefix, or a number of another unit (ISO
    10303-41, conversion_based_unit).
    """
    entity = {
        number: body
        for number, body in re.findall(r"#(\d+)\s*=\s*((?:'[^']*'|[^';])*);", text)
        if "LENGTH" in body or "GLOBAL_UNIT_ASSIGNED_CONTEXT" in body
    }
    found: set[float] = set()
    for body in entity.values():
        for listed in re.findall(r"GLOBAL_UNIT_ASSIGNED_CONTEXT\s*\(\s*\(([^)]*)\)", body):
            found |= {mm for number in re.findall(r"#(\d+)", listed) if (mm := _length_mm(entity, number))}
    return found


_MOST_CONVERSIONS = 8  # of units by other units: more are a circle


def _length_mm(entity: dict[str, str], number: str, left: int = _MOST_CONVERSIONS) -> float:
    """Length in mm of a unit, 0 if it is none of length."""
    body = entity.get(number, "")
    if "LENGTH_UNIT" not in body or not left:
        return 0.0
    if metres := re.search(r"SI_UNIT\s*\(\s*(?:\$|\.(\w+)\.)\s*,\s*\.METRE\.", body):
        return _SI_MM.get(metres[1] or "", 0.0)
    conversion = re.search(r"CONVERSION_BASED_UNIT\s*\(\s*'[^']*'\s*,\s*#(\d+)", body)
    measure = entity.get(conversion[1], "") if conversion else ""
    # Open CASCADE writes the number without its type.
    size = re.search(
        r"MEASURE_WITH_UNIT\s*\(\s*(?:LENGTH_MEASURE\s*\(\s*)?([-+.\dEe]+)\s*\)?\s*,\s*#(\d+)", measure
    )
    return float(size[1]) * _length_mm(entity, size[2], left - 1) if size else 0.0
