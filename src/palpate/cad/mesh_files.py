"""STL, OBJ, PLY and 3MF files, as trimesh reads them, into checked solids.

trimesh takes what it can get: it skips what is cut off and returns open surfaces without a word. What it
passes over is therefore looked for here, in the file itself, and the rest in `mesh_checks`.
"""

import io
import re
import warnings
import zipfile
from pathlib import Path
from typing import Any

import numpy as np

from palpate.base.errors import InputError
from palpate.base.files import read_bytes
from palpate.base.files.limits import CAD_BYTES, MEMBERS
from palpate.base.files.opening import size_in_words
from palpate.base.geometry import Floats, Ints
from palpate.base.optional_imports import needed
from palpate.cad.mesh_checks import check_solids
from palpate.cad.obj_polygons import with_triangles
from palpate.cad.part_size import GIVE_NO_UNITS, UNIT_MM
from palpate.cad.ply_header import ply_problem
from palpate.cad.scenes import distinct_shapes, triangles
from palpate.cad.values import Solid

__all__ = ["MESH_SUFFIXES", "read_mesh_file"]

MESH_SUFFIXES = (".3mf", ".obj", ".ply", ".stl")

_STL_HEADER, _STL_FACE = 84, 50
"""Bytes before the first face of a binary STL file, which end in the number of faces, and of each."""

_ADVICE = "export the part more coarsely"

_3MF_MM = {
    "micron": 0.001,
    "millimeter": 1.0,
    "centimeter": 10.0,
    "inch": 25.4,
    "foot": 304.8,
    "meter": 1000.0,
}
"""Units of the 3MF core specification; a file that names none is in millimetres."""


def read_mesh_file(path: Path, units: str | None) -> tuple[Solid, ...]:
    """Solids of a mesh file in mm.

    STL, OBJ and PLY have no units: `units` ("mm", "inch" or "m") is needed; the bodies of such a file are
    found by what hangs together. A 3MF file has units, which `units` may repeat, and parts, of which each
    shape is read once. Raises InputError for what cannot be read and for what `mesh_checks` refuses.
    """
    kind = path.suffix.lower()[1:]
    if kind == "3mf":
        return _read_3mf(path, units)
    data = read_bytes(path, CAD_BYTES, _ADVICE)
    if problem := {"stl": _stl_problem, "obj": _obj_problem, "ply": ply_problem}[kind](data):
        raise InputError(f"{path}: {problem}")
    if units is None:
        raise InputError(f"{path}: {kind.upper()} files have no units: give their units: mm, inch or m")
    if kind == "obj" or (kind == "stl" and not _is_binary_stl(data)):
        data = _as_utf8(data)
    if kind == "obj":
        data = with_triangles(data)
    vertices, faces = _one_mesh(path, _scene(path, data, kind))
    if kind == "stl" and len(faces) != _stl_faces(data):
        raise InputError(f"{path}: only {len(faces)} of its {_stl_faces(data)} faces can be read")
    return check_solids(str(path), path.stem, vertices * UNIT_MM[units], faces, units=units)


def _read_3mf(path: Path, units: str | None) -> tuple[Solid, ...]:
    needed("networkx", "cad", "reading 3MF files")
    needed("lxml", "cad", "reading 3MF files")
    data = read_bytes(path, CAD_BYTES, _ADVICE)
    if problem := _3mf_problem(data):
        raise InputError(f"{path}: {problem}")
    scene = _scene(path, data, "3mf")
    stated = {
        str(mesh.metadata.get("units", "millimeter")).removesuffix("s") for mesh in scene.geometry.values()
    }
    if not stated:
        raise InputError(f"{path}: has no faces; export the part as a closed solid")
    unit = stated.pop()
    if unit not in _3MF_MM:
        raise InputError(f"{path}: unknown unit '{unit}'; 3MF allows {', '.join(_3MF_MM)}")
    if units is not None and UNIT_MM[units] != _3MF_MM[unit]:
        raise InputError(f"{path}: says that it is in {unit}, not in {units}: {GIVE_NO_UNITS}")
    solids: list[Solid] = []
    for shape in distinct_shapes(str(path), scene, path.stem):
        where = f"{path}: {shape.name}"
        solids += check_solids(where, shape.name, shape.vertices * _3MF_MM[unit], shape.faces)
    return tuple(solids)


def _scene(path: Path, data: bytes, kind: str) -> Any:
    """What trimesh makes of a file, nothing merged or left out."""
    trimesh = needed("trimesh", "cad", f"reading {kind.upper()} files")
    skip = {} if kind in ("stl", "3mf") else {"skip_materials": True}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        # numpy only warns where a number is none.
        warnings.filterwarnings("error", message="string or file could not be read")
        try:
            return trimesh.load_scene(io.BytesIO(data), file_type=kind, process=False, **skip)
        except MemoryError:
            raise
        except Exception as error:
            reason = " ".join(str(error).split())
            said = f": {reason}" if reason.count(" ") > 1 else "; is it whole?"
            raise InputError(f"{path}: cannot be read as {kind.upper()}{said}") from None


def _one_mesh(path: Path, scene: Any) -> tuple[Floats, Ints]:
    """All triangles of a scene whose parts are only pieces of the file, by material or by name."""
    meshes = [triangles(str(path), mesh) for mesh in scene.geometry.values() if hasattr(mesh, "faces")]
    if not meshes:
        return np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int64)
    starts = np.cumsum([0, *(len(vertices) for vertices, _ in meshes)])
    faces = [faces + start for (_, faces), start in zip(meshes, starts, strict=False)]
    return np.vstack([vertices for vertices, _ in meshes]), np.vstack(faces)


def _is_binary_stl(data: bytes) -> bool:
    return len(data) >= _STL_HEADER and len(data) == _STL_HEADER + _STL_FACE * _announced(data)


def _as_utf8(data: bytes) -> bytes:
    """Text of an older program, whose names may be in Latin-1, in the only encoding that trimesh takes."""
    try:
        data.decode("utf-8")
    except UnicodeDecodeError:
        return data.decode("latin-1").encode("utf-8")
    return data


def _announced(data: bytes) -> int:
    return int.from_bytes(data[_STL_HEADER - 4 : _STL_HEADER], "little")


def _stl_faces(data: bytes) -> int:
    return _announced(data) if _is_binary_stl(data) else data.lower().count(b"endfacet")


def _stl_problem(data: bytes) -> str:
    """What keeps an STL file from being read whole, or nothing."""
    if _is_binary_stl(data):
        return ""
    if not data:
        return "the file is empty"
    if re.match(rb"\s*solid\b", data, re.IGNORECASE) and b"\0" not in data[:_STL_HEADER]:
        opened, closed = (
            len(re.findall(word, data)) for word in (rb"(?im)^[ \t]*solid\b", rb"(?im)^[ \t]*endsolid\b")
        )
        return "" if opened == closed else "is cut short: there is no endsolid for a solid"
    if len(data) < _STL_HEADER:
        return f"is no STL file: it has {len(data)} bytes"
    count = _announced(data)
    return (
        f"is cut short or no STL file: it announces {count} faces, "
        f"which take {_STL_HEADER + _STL_FACE * count} bytes, and has {len(data)}"
    )


def _3mf_problem(data: bytes) -> str:
    """What in the directory of a 3MF file, a ZIP archive, keeps it from being unpacked, or nothing."""
    try:
        members = zipfile.ZipFile(io.BytesIO(data)).infolist()
    except (zipfile.BadZipFile, ValueError, NotImplementedError, UnicodeDecodeError, EOFError) as error:
        return f"cannot be read as 3MF: {error}"
    # No member gives more than its directory says: zipfile stops there.
    unpacked = sum(member.file_size for member in members)
    if unpacked > CAD_BYTES:
        most = size_in_words(CAD_BYTES)
        return f"is {size_in_words(unpacked)} when unpacked; at most {most} are read: {_ADVICE}"
    if len(members) > MEMBERS:
        return f"holds {len(members)} files; at most {MEMBERS} are read: leave out what is no part"
    return ""


def _obj_problem(data: bytes) -> str:
    """What trimesh would read wrongly in an OBJ file, or nothing."""
    if not data.strip():
        return "the file is empty"
    faces = re.search(rb"(?m)^f\b", data)
    if faces and re.search(rb"(?m)^f\b.*\s-\d", data) and re.search(rb"(?m)^v\s", data[faces.start() :]):
        return "its faces count vertices backwards (negative numbers); export it with positive ones"
    return ""
