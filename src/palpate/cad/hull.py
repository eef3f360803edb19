"""Convex hull of a solid, seen from its centre of mass: its flat faces and the edges between them.

A solid on a plane rests on a face of its hull. Qhull makes triangles; here those in one plane become one face
again. A face grows from its largest triangle and takes in neighbours whose corners are within 1e-5 of the
solid's size from that triangle's plane: more than single precision loses in files, less than any gap that
lets a part rock noticeably.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import ConvexHull

from palpate.base.errors import InputError
from palpate.base.geometry import Floats, Ints
from palpate.cad.parts import Solid

_COPLANAR_SHARE = 1e-5


@dataclass(frozen=True, eq=False)
class Hull:
    """Faces of a convex hull, in the solid's frame moved so that its centre of mass is at the origin, mm.

    `points_mm` (n, 3); `triangles` (t, 3) of them, counter-clockwise from outside; `face` (t,): which face
    a triangle belongs to. Of faces: `normal` (f, 3) outwards, `height_mm` (f,) of the origin when the solid
    lies on the face, `middle_mm` (f, 3), the centre of its area. Of edges as seen from one of their two
    faces: `edge_face` (e,), `edge_next` (e,) the face beyond, `edge_mm` (e, 2, 3) its ends, counter-clockwise
    about the face. `size_mm`: the largest extent along the file's axes.
    """

    points_mm: Floats
    triangles: Ints
    face: Ints
    normal: Floats
    height_mm: Floats
    middle_mm: Floats
    edge_face: Ints
    edge_next: Ints
    edge_mm: Floats
    size_mm: float


def centre_of_mass(solid: Solid) -> Floats:
    """Centre (3,) of the volume inside a closed surface, in the solid's frame, mm.

    Raises InputError if there is none.
    """
    start = solid.vertices_mm[solid.faces[0, 0]]
    a, b, c = (solid.vertices_mm[solid.faces[:, k]] - start for k in range(3))
    volume = np.einsum("ij,ij->i", a, np.cross(b, c))
    if volume.sum() <= 0:
        raise InputError(f"{solid.name}: the part encloses no volume")
    centre: Floats = start + volume @ (a + b + c) / (4 * volume.sum())
    return centre


def hull_of(solid: Solid) -> Hull:
    """The hull with its faces. Raises InputError for a flat solid, or one whose surface is not closed."""
    points = solid.vertices_mm - centre_of_mass(solid)
    # Joggled by some 1e-11: exact coplanarity, thousands of points on a circle, takes Qhull minutes.
    found = ConvexHull(points, qhull_options="QJ")
    if (found.equations[:, 3] >= 0).any():
        raise InputError(f"{solid.name}: its centre of mass is outside of it: the surface is not closed")
    triangles, neighbours = _orient_outward(points, found)
    corners = points[triangles]
    legs = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(legs, axis=1)
    size_mm = float(np.ptp(points, axis=0).max())
    face = _faces(corners, neighbours, found.equations, area, _COPLANAR_SHARE * size_mm)
    normal = _sums(legs, face)
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    middle = _sums(area[:, None] * corners.mean(axis=1), face) / _sums(area, face)[:, None]
    # The lowest corner is on the table; rounding may bend a face so that it is one just beyond its edge.
    height = np.full(len(normal), -np.inf)
    for other in (np.arange(len(face)), *neighbours.T):
        np.maximum.at(height, face, np.einsum("ijk,ik->ij", corners[other], normal[face]).max(axis=1))
    inner, following = np.repeat(face, 3), face[neighbours.ravel()]
    border = inner != following
    edges = corners[:, [[1, 2], [2, 0], [0, 1]]].reshape(-1, 2, 3)[border]
    # A sliver's own sense of rotation may be lost in rounding, the face's is not.
    arms = edges - middle[inner[border], None]
    reverse = (np.cross(arms[:, 0], arms[:, 1]) * normal[inner[border]]).sum(axis=1) < 0
    edges[reverse] = edges[reverse, ::-1]
    return Hull(
        points, triangles, face, normal, height, middle, inner[border], following[border], edges, size_mm
    )


def _orient_outward(points: Floats, found: ConvexHull) -> tuple[Ints, Ints]:
    """Triangles (t, 3) counter-clockwise from outside; their neighbours (t, 3) across from each corner."""
    triangles, neighbours = found.simplices.astype(np.int64), found.neighbors.astype(np.int64)
    a, b, c = (points[triangles[:, k]] for k in range(3))
    inward = np.einsum("ij,ij->i", np.cross(b - a, c - a), found.equations[:, :3]) < 0
    triangles[inward] = triangles[inward][:, [0, 2, 1]]
    neighbours[inward] = neighbours[inward][:, [0, 2, 1]]
    return triangles, neighbours


def _faces(corners: Floats, neighbours: Ints, planes: Floats, area: Floats, flat_mm: float) -> Ints:
    """Number (t,) of the face of each triangle."""
    off = np.einsum("tkcj,tj->tkc", corners[neighbours], planes[:, :3]) + planes[:, 3, None, None]
    seeds = np.flatnonzero((np.abs(off) <= flat_mm).all(axis=2).any(axis=1))
    # Triangle by triangle plain numbers are ten times as fast as small arrays.
    places, beside = corners.tolist(), neighbours.tolist()
    face = [-1] * len(corners)
    count = 0
    for seed in seeds[np.lexsort((seeds, -area[seeds]))].tolist():
        if face[seed] >= 0:
            continue
        nx, ny, nz, shift = planes[seed].tolist()
        face[seed] = count
        ahead = list(beside[seed])
        while ahead:
            triangle = ahead.pop()
            if face[triangle] < 0 and all(
                abs(nx * x + ny * y + nz * z + shift) <= flat_mm for x, y, z in places[triangle]
            ):
                face[triangle] = count
                ahead += beside[triangle]
        count += 1
    numbers = np.array(face)
    alone = np.flatnonzero(numbers < 0)
    numbers[alone] = count + np.arange(len(alone))
    return numbers


def _sums(values: Floats, face: Ints) -> Floats:
    """Sums of the triangles' values (t, …) over each face."""
    total = np.zeros((int(face.max()) + 1, *values.shape[1:]))
    np.add.at(total, face, values)
    return total
