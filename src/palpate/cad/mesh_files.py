"""STL, OBJ and PLY files, as trimesh reads them, into checked solids.

trimesh is lenient: it ignores truncation, cuts concave polygons of OBJ files into wrong fans, and returns
open surfaces without a warning. What it ignores is therefore checked here, in the file itself, and the rest
in `mesh_checks`. Sources: G. Turk, The PLY Polygon File Format, 1994; Wavefront, The OBJ format,
appendix B1, which allows any planar polygon in a face statement.
"""

import io
import re
import warnings
from collections.abc import Sequence
from itertools import takewhile
from pathlib import Path
from typing import Any

import numpy as np
import shapely

from palpate.base.errors import InputError
from palpate.base.file_io import CAD_BYTES, MOST_FACETS, read_bytes
from palpate.base.geometry import Bools, Floats, Ints
from palpate.base.optional_imports import import_extra
from palpate.cad.mesh_checks import check_solids
from palpate.cad.parts import UNIT_MM, Solid

_FLAT_SHARE = 1e-9
"""Turns to the right that are this small beside the polygon's area are rounding of its coordinates."""

_AREA_SHARE = 1e-6
"""Relative difference in area up to which triangles cover their polygon."""


def triangulate_concave(data: bytes) -> bytes:
    """The text of an OBJ file with every concave polygon as triangles; else as it was.

    A polygon that cannot be cut (self-intersecting, a corner that is not in the file) stays as it is, for
    the checks of the mesh to name.
    """
    text = data.replace(b"\r\n", b"\n").replace(b"\\\n", b" ")
    lines = text.split(b"\n")
    polygons = _polygons(lines)
    if not polygons:
        return data
    vertices = _vertices(lines)
    is_changed = False
    for rows in polygons.values():
        corners = np.array([[_index(token) for token in lines[row].split()[1:]] for row in rows])
        known = np.flatnonzero(((corners >= 0) & (corners < len(vertices))).all(axis=1))
        for at in known[_are_concave(vertices[corners[known]])]:
            if triangles := _triangles(vertices[corners[at]]):
                tokens = lines[rows[at]].split()[1:]
                lines[rows[at]] = b"\n".join(b"f " + b" ".join(tokens[c] for c in t) for t in triangles)
                is_changed = True
    return b"\n".join(lines) if is_changed else data


def _polygons(lines: Sequence[bytes]) -> dict[int, list[int]]:
    """Rows of the faces with more than three corners, by their number of corners."""
    rows: dict[int, list[int]] = {}
    for row, line in enumerate(lines):
        if line.lstrip()[:2] in (b"f ", b"f\t") and (corners := len(line.split()) - 1) > 3:
            rows.setdefault(corners, []).append(row)
    return rows


def _vertices(lines: Sequence[bytes]) -> Floats:
    """Vertices (n, 3) of the file; NaN where a number is none, which no comparison takes for concave."""
    rows = [line.split()[1:4] for line in lines if line.lstrip()[:2] in (b"v ", b"v\t")]
    try:
        return np.array(rows, dtype=float).reshape(-1, 3)
    except ValueError:
        return np.full((len(rows), 3), np.nan)


def _index(token: bytes) -> int:
    """A corner's vertex, from 0; −1 for what is no positive number."""
    number = re.match(rb"\d+", token)
    return int(number[0][:12]) - 1 if number else -1


def _are_concave(corners: Floats) -> Bools:
    """Mark polygons (n, k, 3) that turn to the right somewhere, seen along their area vector."""
    steps = np.roll(corners, -1, axis=1) - corners
    normals = _area_vectors(corners)
    turns = np.cross(steps, np.roll(steps, -1, axis=1))
    areas2 = np.einsum("ni,ni->n", normals, normals)
    along: Floats = np.einsum("nki,ni->nk", turns, normals)
    concave: Bools = (along < -_FLAT_SHARE * areas2[:, None]).any(axis=1)
    return concave


def _area_vectors(corners: Floats) -> Floats:
    """Twice the area vectors (n, 3) of polygons (n, k, 3), by Newell's method."""
    from_first = corners - corners[:, :1]
    areas: Floats = np.cross(from_first, np.roll(from_first, -1, axis=1)).sum(axis=1)
    return areas


def _triangles(corners: Floats) -> list[Ints]:
    """Triangles of a polygon (k, 3) as indices of its corners, turning as it does; none if it has none."""
    normal = _area_vectors(corners[None])[0]
    axis = int(np.argmax(np.abs(normal)))
    # Without its longest component the polygon keeps its shape up to a shear, and its coordinates exactly.
    flat = np.delete(corners, axis, axis=1)
    turns_left = (normal[axis] > 0) == (axis != 1)
    outline = shapely.make_valid(shapely.Polygon(flat), method="structure", keep_collapsed=False)
    pieces = shapely.get_parts(shapely.constrained_delaunay_triangles(outline))
    index_of = {tuple(corner): at for at, corner in reversed(list(enumerate(flat.tolist())))}
    rings = [shapely.get_coordinates(piece)[:3].tolist() for piece in pieces]
    if any(tuple(corner) not in index_of for ring in rings for corner in ring):
        return []
    found = [np.array([index_of[tuple(corner)] for corner in ring]) for ring in rings]
    area2 = 0.0
    for at, triangle in enumerate(found):
        a, b, c = flat[triangle]
        turn = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
        area2 += abs(turn)
        if (turn > 0) != turns_left:
            found[at] = triangle[::-1]
    return found if abs(area2 - abs(normal[axis])) <= _AREA_SHARE * abs(normal[axis]) else []


_HEADER_BYTES = 100_000
_TYPE_BYTES = {
    **dict.fromkeys(("char", "uchar", "int8", "uint8"), 1),
    **dict.fromkeys(("short", "ushort", "int16", "uint16"), 2),
    **dict.fromkeys(("int", "uint", "int32", "uint32", "float", "float32"), 4),
    **dict.fromkeys(("double", "float64"), 8),
}
"""Bytes of each type; a list takes its count's, at least."""


def _ply_problem(data: bytes) -> str:
    """Return what keeps a PLY file from being read whole, or nothing."""
    head, end, _ = data[:_HEADER_BYTES].partition(b"end_header")
    lines = [line.split() for line in head.decode("latin-1").splitlines()]
    if not end or lines[0] != ["ply"]:
        return "is no PLY file: it does not begin with a header from ply to end_header"
    as_text = ["format", "ascii"] in [line[:2] for line in lines]
    held, needed = len(data) - len(head) - len(end), 0
    for number, line in enumerate(lines):
        if line[:1] != ["element"]:
            continue
        if len(line) != 3 or not re.fullmatch(r"[0-9]{1,12}", line[2]):
            return f"announces no number of elements in '{' '.join(line):.40}'"
        needed += int(line[2]) * _row_bytes(lines[number + 1 :], as_text=as_text)
        if needed > held + 1:  # nothing need follow the last value of a text
            return f"is cut short: it announces {line[2]} of '{line[1]:.40}', and has {held} bytes of data"
    return ""


def _row_bytes(following: list[list[str]], *, as_text: bool) -> int:
    """Least length of an element's row, by the lines of the header behind the element's."""
    own = takewhile(lambda line: line[:1] != ["element"], following)
    kinds = [(line + [""] * 3)[2 if line[1:2] == ["list"] else 1] for line in own if line[:1] == ["property"]]
    # As text, a value takes a character and what separates it from the next.
    return sum(2 if as_text else _TYPE_BYTES.get(kind, 1) for kind in kinds)


def mesh_triangles(where: str, mesh: Any) -> tuple[Floats, Ints]:
    """Vertices (n, 3) and faces (m, 3) of a trimesh geometry; InputError where a face names none of them."""
    vertices, faces = np.asarray(mesh.vertices, dtype=np.float64), np.asarray(mesh.faces, dtype=np.int64)
    if vertices.ndim != 2 or vertices.shape[1] != 3:
        raise InputError(f"{where}: its vertices do not have 3 coordinates each")
    if not faces.size:
        return vertices, np.zeros((0, 3), dtype=np.int64)
    if faces.ndim != 2 or faces.shape[1] != 3:
        raise InputError(f"{where}: its faces do not have 3 corners each")
    if len(faces) > MOST_FACETS:
        raise InputError(
            f"{where}: has {len(faces)} facets; at most {MOST_FACETS} are read: export it more coarsely"
        )
    if faces.min() < 0 or faces.max() >= len(vertices):
        worst = int(faces.max() if faces.max() >= len(vertices) else faces.min())
        raise InputError(f"{where}: a face has vertex {worst}, counted from 0; there are {len(vertices)}")
    return vertices, faces


MESH_SUFFIXES = (".obj", ".ply", ".stl")

_STL_HEADER, _STL_FACE = 84, 50
"""Bytes before the first face of a binary STL file, which end in the number of faces, and of each."""

_STL_END = re.compile(rb"(?im)^[ \t]*end[ \t]*solid\b")
"""Some programs write it as two words, which trimesh does not know."""

_ADVICE = "export the part more coarsely"


def read_mesh_file(path: Path, units: str | None) -> tuple[Solid, ...]:
    """Solids of a mesh file in mm.

    STL, OBJ and PLY have no units: `units` ("mm", "inch" or "m") is needed; the bodies of a file are found by
    what hangs together. Raises InputError for what cannot be read and for what `mesh_checks` refuses.
    """
    kind = path.suffix.lower()[1:]
    data = read_bytes(path, CAD_BYTES, _ADVICE)
    if problem := {"stl": _stl_problem, "obj": _obj_problem, "ply": _ply_problem}[kind](data):
        raise InputError(f"{path}: {problem}")
    if units is None:
        raise InputError(f"{path}: {kind.upper()} files have no units: give their units: mm, inch or m")
    if kind == "obj" or (kind == "stl" and not _is_binary_stl(data)):
        data = _as_utf8(data)
    if kind == "stl" and not _is_binary_stl(data):
        data = _STL_END.sub(b"endsolid", data)
    if kind == "obj":
        data = triangulate_concave(_count_forwards(re.sub(rb"#.*", b"", data)))
    vertices, faces = _one_mesh(path, _load_scene(path, data, kind))
    if kind == "stl" and len(faces) != _stl_faces(data):
        raise InputError(f"{path}: only {len(faces)} of its {_stl_faces(data)} faces can be read")
    return check_solids(str(path), path.stem, vertices * UNIT_MM[units], faces, units=units)


def _load_scene(path: Path, data: bytes, kind: str) -> Any:
    """Read a file with trimesh, nothing merged or left out."""
    trimesh = import_extra("trimesh", "cad", f"reading {kind.upper()} files")
    skip = {} if kind == "stl" else {"skip_materials": True}
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
    meshes = [mesh_triangles(str(path), mesh) for mesh in scene.geometry.values() if hasattr(mesh, "faces")]
    if not meshes:
        return np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int64)
    starts = np.cumsum([0, *(len(vertices) for vertices, _ in meshes)])
    faces = [faces + start for (_, faces), start in zip(meshes, starts, strict=False)]
    return np.vstack([vertices for vertices, _ in meshes]), np.vstack(faces)


def _is_binary_stl(data: bytes) -> bool:
    return len(data) >= _STL_HEADER and len(data) == _STL_HEADER + _STL_FACE * _announced_faces(data)


def _as_utf8(data: bytes) -> bytes:
    """Text of an older program, whose names may be in Latin-1, in the only encoding that trimesh takes."""
    try:
        data.decode("utf-8")
    except UnicodeDecodeError:
        return data.decode("latin-1").encode("utf-8")
    return data


def _announced_faces(data: bytes) -> int:
    return int.from_bytes(data[_STL_HEADER - 4 : _STL_HEADER], "little")


def _stl_faces(data: bytes) -> int:
    return _announced_faces(data) if _is_binary_stl(data) else data.lower().count(b"endfacet")


def _stl_problem(data: bytes) -> str:
    """Return what keeps an STL file from being read whole, or nothing."""
    if _is_binary_stl(data):
        return ""
    if not data:
        return "the file is empty"
    if re.match(rb"\s*solid\b", data, re.IGNORECASE) and b"\0" not in data[:_STL_HEADER]:
        opened, closed = (len(re.findall(word, data)) for word in (rb"(?im)^[ \t]*solid\b", _STL_END.pattern))
        return "" if opened == closed else "is cut short: there is no endsolid for a solid"
    if len(data) < _STL_HEADER:
        return f"is no STL file: it has {len(data)} bytes"
    count = _announced_faces(data)
    return (
        f"is cut short or no STL file: it announces {count} faces, "
        f"which take {_STL_HEADER + _STL_FACE * count} bytes, and has {len(data)}"
    )


def _obj_problem(data: bytes) -> str:
    """Return what trimesh would read wrongly in an OBJ file, or nothing."""
    if not data.strip():
        return "the file is empty"
    if re.search(rb"(?m)^[ \t]*f\b[^#\n]*[ \t]0+(?![.\d])", data):
        return "a face has vertex 0; OBJ counts vertices from 1: export it again"
    return ""


_OBJ_COUNTED = {b"v": 0, b"vt": 1, b"vn": 2}
"""Statements that faces count, by their place in a corner such as 1/2/3."""


def _count_forwards(data: bytes) -> bytes:
    """The text of an OBJ file whose faces count all that they name from the file's beginning.

    Negative numbers count backwards from where the face stands, which trimesh takes for the file's end.
    """
    if not re.search(rb"(?m)^[ \t]*f\b.*[ \t/]-\d", data):
        return data
    so_far = [0, 0, 0]

    def forwards(corner: bytes) -> bytes:
        numbers = corner.split(b"/")
        return b"/".join(
            b"%d" % (int(number) + 1 + so_far[place])
            if number[:1] == b"-" and number[1:].isdigit()
            else number
            for place, number in enumerate(numbers[: len(so_far)])
        )

    lines = []
    for line in data.replace(b"\r\n", b"\n").replace(b"\\\n", b" ").split(b"\n"):
        words = line.split()
        if words[:1] == [b"f"]:
            lines.append(b" ".join([b"f", *map(forwards, words[1:])]))
            continue
        if words and words[0] in _OBJ_COUNTED:
            so_far[_OBJ_COUNTED[words[0]]] += 1
        lines.append(line)
    return b"\n".join(lines)
