"""STEP files (ISO 10303-21), tessellated by OpenCASCADE through cascadio, into checked solids.

Each distinct shape of an assembly is imported once: four screws are one object. cascadio gives metres in
single precision, whatever the file's unit; how finely curves are cut is asked for in millimetres.
"""

import math
import re
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from palpate.base.confined_reading import read_confined
from palpate.base.errors import InputError
from palpate.base.file_io import CAD_BYTES, read_bytes
from palpate.base.geometry import Floats, Ints
from palpate.base.optional_imports import import_extra
from palpate.cad.mesh_checks import CLOSE_ADVICE, OpenSurfaceError, check_solids
from palpate.cad.mesh_files import mesh_triangles
from palpate.cad.mesh_topology import vertex_rounding
from palpate.cad.parts import GIVE_NO_UNITS, UNIT_MM, Solid, real_name

STEP_SUFFIXES = (".step", ".stp")

_SAME_TRANSFORM = 1e-6
"""Transforms whose lengths and angles differ by less are the same but for position and heading."""

_MAX_CHORD_TURN_RAD = math.radians(10.0)
"""Most that neighbouring chords of a curve turn by."""
_DEVIATION_SHARE = 0.5
"""OpenCASCADE exceeds the deviation it is asked for, by half on spheres: it is asked for this share."""

_FINER_FACTOR, _FINE_FACETS = 3.0, 12_000
"""Curves are cut so many times as finely as they have to be, if that takes few facets: many take long."""

_COARSER_FACTOR, _MAX_COARSE_TURN_RAD = 8.0, math.radians(30.0)
"""Where chords do not close a surface that is closed: half of an import's tolerance."""

_ADVICE = "allow its curves a larger tolerance, or export it as STL"

_SI_MM = {"": 1000.0, "DECI": 100.0, "CENTI": 10.0, "MILLI": 1.0, "MICRO": 0.001}


@dataclass(frozen=True, eq=False)
class MeshPart:
    """A part of a scene where it first occurs: `vertices` (n, 3) in the scene's frame, `faces` (m, 3)."""

    name: str
    vertices: Floats
    faces: Ints


def _distinct_shapes(where: str, scene: Any, fallback: str) -> list[MeshPart]:
    """Parts of a trimesh scene that differ in more than place and heading, by name or `fallback`."""
    found: list[MeshPart] = []
    seen: dict[str, list[Floats]] = {}
    for node in sorted(scene.graph.nodes_geometry, key=lambda node: _order(scene, node)):
        transform, geometry = scene.graph[node]
        linear = np.asarray(transform, dtype=np.float64)[:3, :3]
        # Equal up to a rotation: the same lengths and angles, and the same handedness.
        kind = np.append((linear.T @ linear).ravel(), np.sign(np.linalg.det(linear)))
        if any(np.abs(kind - other).max() <= _SAME_TRANSFORM for other in seen.setdefault(geometry, [])):
            continue
        seen[geometry].append(kind)
        mesh = scene.geometry[geometry]
        if not hasattr(mesh, "faces"):
            continue
        name = real_name(str(geometry)) or fallback
        vertices, faces = mesh_triangles(f"{where}: {name}", mesh)
        found.append(MeshPart(name, vertices @ linear.T + np.asarray(transform)[:3, 3], faces))
    return found


def _order(scene: Any, node: str) -> tuple[int, str]:
    return list(scene.geometry).index(scene.graph[node][1]), str(node)


def read_step(path: Path, units: str | None, curve_mm: float) -> tuple[Solid, ...]:
    """Solids of a STEP file in mm, curves replaced by chords within `curve_mm`; each shape once.

    Chords are nearer, a third of that, where few facets do. The file has units, which `units` ("mm", "inch"
    or "m") may repeat. Raises InputError for what cannot be read, for units that are not the file's, and for
    what `mesh_checks` refuses.
    """
    import_extra("cascadio", "step", "reading STEP files")
    data = read_bytes(path, CAD_BYTES, _ADVICE)
    if not data.lstrip().startswith(b"ISO-10303-21"):
        raise InputError(f"{path}: is no STEP file: it does not start with ISO-10303-21")
    if not data.rstrip().endswith(b"END-ISO-10303-21;"):
        raise InputError(f"{path}: is cut short: END-ISO-10303-21; is missing at its end")
    _check_units(path, data, units)
    try:
        return _solids(path, *read_confined(path, _ADVICE, _tessellate, path, curve_mm))
    except OpenSurfaceError as error:
        problem = str(error)
    try:  # chords of other lengths may meet
        return _solids(path, *read_confined(path, _ADVICE, _tessellate_coarsely, path, curve_mm))
    except InputError:
        pass
    raise InputError(
        f"{problem.removesuffix(CLOSE_ADVICE)}, as OpenCASCADE cuts it into triangles; export it as STL "
        "from the program that drew it"
    )


def _solids(path: Path, scene: Any, within_mm: float) -> tuple[Solid, ...]:
    """The solids of a scene in metres, whose chords deviate by so much."""
    solids: list[Solid] = []
    for shape in _distinct_shapes(str(path), scene, path.stem):
        vertices = shape.vertices * 1000.0
        off = math.nextafter(within_mm + vertex_rounding(vertices), math.inf)
        solids += check_solids(f"{path}: {shape.name}", shape.name, vertices, shape.faces, off)
    if not solids:
        raise InputError(f"{path}: holds no solid")
    return tuple(solids)


def _tessellate(path: Path, curve_mm: float) -> tuple[Any, float]:
    """Read a file with OpenCASCADE as a trimesh scene in metres, and the deviation of its chords.

    What it makes of a damaged one may be a crash, a search without end or more memory than there is.
    """
    scene = _scene(path, curve_mm)
    if sum(len(mesh.faces) for mesh in scene.geometry.values() if hasattr(mesh, "faces")) > _FINE_FACETS:
        return scene, curve_mm
    return _scene(path, curve_mm / _FINER_FACTOR), curve_mm / _FINER_FACTOR


def _tessellate_coarsely(path: Path, curve_mm: float) -> tuple[Any, float]:
    """The same with longer chords."""
    within_mm = _COARSER_FACTOR * curve_mm
    return _scene(path, within_mm, _MAX_COARSE_TURN_RAD), within_mm


def _scene(path: Path, curve_mm: float, turn_rad: float = _MAX_CHORD_TURN_RAD) -> Any:
    trimesh = import_extra("trimesh", "step", "reading STEP files")
    cascadio = import_extra("cascadio", "step", "reading STEP files")
    with tempfile.TemporaryDirectory() as folder:
        target = Path(folder) / "tessellated.glb"
        # One thread: the same triangles in the same order, always.
        failed = cascadio.step_to_glb(
            str(path.resolve()),
            str(target),
            tol_linear=curve_mm * _DEVIATION_SHARE,
            tol_angular=turn_rad,
            use_parallel=False,
        )
        if failed or not target.is_file():
            raise InputError(f"{path}: OpenCASCADE cannot read it, or it holds no solid; export it again")
        try:
            return trimesh.load_scene(target, process=False)
        except MemoryError:
            raise
        except Exception:
            raise InputError(f"{path}: holds no solid") from None


def _check_units(path: Path, data: bytes, units: str | None) -> None:
    """Refuse a file without a unit of length, or with another than the one that was said."""
    stated = _units_mm(data.decode("latin-1"))
    if not stated:
        raise InputError(f"{path}: states no unit of length; export it again with one")
    if units is not None and any(abs(mm / UNIT_MM[units] - 1) > 1e-9 for mm in stated):
        said = " and ".join(f"{mm:g} mm" for mm in sorted(stated))
        raise InputError(f"{path}: says that its unit is {said}, not {units}: {GIVE_NO_UNITS}")


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
