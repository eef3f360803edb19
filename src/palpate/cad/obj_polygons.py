"""Concave polygons of OBJ files, cut into triangles before trimesh reads them.

trimesh cuts a polygon into a fan from its first corner, which is right for a convex polygon only: the fan of
a concave one covers what lies outside of it. Shapely's constrained Delaunay triangulation cuts those, and
keyhole polygons (a hole joined to the outline by a slit) as well. The OBJ format (Wavefront, appendix B1)
allows any planar polygon in a face statement.
"""

import re
from collections.abc import Sequence

import numpy as np
import shapely

from palpate.base.geometry import Bools, Floats, Ints

__all__ = ["with_triangles"]

_FLAT_SHARE = 1e-9
"""Turns to the right that are this small beside the polygon's area are rounding of its coordinates."""

_AREA_SHARE = 1e-6
"""Relative difference in area up to which triangles cover their polygon."""


def with_triangles(data: bytes) -> bytes:
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
    """Whether polygons (n, k, 3) turn to the right somewhere, seen along their area vector."""
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
