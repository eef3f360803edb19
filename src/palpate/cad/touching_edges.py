"""Edges in which a solid touches itself: parted, so that each belongs to two faces.

Programs write solids that meet themselves along an edge: it belongs to four faces then, and whether the
material hangs together there is left open. Here it does not: the faces that bound one wedge of material stay
together, and the edges of wedges are drawn back into their material.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from palpate.base.geometry import Floats, Ints
from palpate.cad.mesh_mending import Mesh
from palpate.cad.mesh_topology import component_of

_APART_MM = 2e-3
"""How far the edge of a wedge is drawn back."""


def part_touching_edges(mesh: Mesh, tolerance_mm: float) -> tuple[Mesh, float] | None:
    """The surface without edges of four or more faces, and how far (mm) it was moved.

    None if faces do not bound wedges of material there, or if the edge is all that holds bodies together, as
    they may be one part or two. `tolerance_mm`: vertices closer together are one.
    """
    vertices, faces = _with_middles(*mesh)
    edges = _edges_of(faces)
    pairs = _pair_faces(vertices, faces, edges)
    if pairs is None:
        return None
    corners = _link_corners(faces, pairs)
    crowded = edges.crowded_ends
    # Other vertices stay one: surfaces that touch in a vertex belong together.
    label = np.where(np.isin(faces.ravel(), crowded), len(vertices) + corners, faces.ravel())
    _, first, parted = np.unique(label, return_index=True, return_inverse=True)
    parted = parted.reshape(-1, 3)
    points = vertices[faces.ravel()[first]]
    if _bodies(points, parted) > _bodies(vertices, faces):
        return None
    apart_mm = max(_APART_MM, 4 * tolerance_mm)
    moved = points - apart_mm * _normals(points, parted)
    copies = np.bincount(np.unique(np.column_stack([faces.ravel(), parted.ravel()]), axis=0)[:, 0])
    is_split = copies[faces.ravel()[first]] > 1
    return (np.where(is_split[:, None], moved, points), parted.reshape(-1, 3)), apart_mm


def _with_middles(vertices: Floats, faces: Ints) -> Mesh:
    """The same surface with a vertex in the middle of each crowded edge, whose ends may not come apart."""
    edges = _edges_of(faces)
    ends = edges.crowded_ends
    middle = {(a, b): len(vertices) + number for number, (a, b) in enumerate(ends.tolist())}
    is_cut = (edges.count[edges.number] > 2).any(axis=1)
    cut: list[tuple[int, int, int]] = []
    for face in faces[is_cut].tolist():
        ring: list[int] = []
        for a, b in zip(face, [*face[1:], face[0]], strict=True):
            ring += [a, middle[min(a, b), max(a, b)]] if (min(a, b), max(a, b)) in middle else [a]
        begin = next(k for k, vertex in enumerate(ring) if vertex >= len(vertices))
        hub, *others = [*ring[begin:], *ring[:begin]]
        cut += [(hub, one, other) for one, other in pairwise(others)]
    more = np.array(cut, dtype=np.int64).reshape(-1, 3)
    return np.vstack([vertices, vertices[ends].mean(axis=1)]), np.vstack([faces[~is_cut], more])


def _bodies(vertices: Floats, faces: Ints) -> int:
    """How many bodies there are that share no vertex; a shell that faces inwards bounds a void of one."""
    ends = np.roll(faces, -1, axis=1)
    body = component_of(faces.ravel(), ends.ravel(), len(vertices))[faces[:, 0]]
    a, b, c = (vertices[faces] - vertices.mean(axis=0)).transpose(1, 0, 2)
    volume = np.bincount(body, (a * np.cross(b, c)).sum(axis=1))
    return int(np.count_nonzero(volume > 0))


@dataclass(frozen=True, eq=False)
class _Edges:
    """Edges of faces: the `number` (m, 3) of the edge that begins at each corner, in the order of the file.

    `ends` (e, 2): lower and higher vertex; `count` (e,): of faces.
    """

    number: Ints
    ends: Ints
    count: Ints

    @property
    def crowded_ends(self) -> Ints:
        """Ends (k, 2) of the edges of more than two faces."""
        result: Ints = self.ends[self.count > 2]
        return result


def _edges_of(faces: Ints) -> _Edges:
    following = np.roll(faces, -1, axis=1)
    size = int(faces.max()) + 1
    keys = (np.minimum(faces, following) * size + np.maximum(faces, following)).ravel()
    _, first, number, count = np.unique(keys, return_index=True, return_inverse=True, return_counts=True)
    order = np.argsort(first)
    place = np.argsort(order)
    ends = np.column_stack(np.divmod(keys[first[order]], size))
    return _Edges(place[number].reshape(-1, 3), ends, count[order])


def _pair_faces(vertices: Floats, faces: Ints, edges: _Edges) -> Ints | None:
    """Pairs (p, 4) of faces that meet in an edge and bound one wedge: face, corner, face, corner."""
    order = np.argsort(edges.number, axis=None, kind="stable")
    face_corner = np.column_stack(np.divmod(order, 3))
    pairs = [face_corner[(edges.count == 2)[edges.number.ravel()[order]]].reshape(-1, 4)]
    first = np.cumsum(edges.count) - edges.count
    for number in np.flatnonzero(edges.count != 2).tolist():
        a, b = edges.ends[number].tolist()
        some = face_corner[first[number] : first[number] + edges.count[number]].tolist()
        axis = vertices[b] - vertices[a]
        if not axis.any():
            return None
        across = np.array([vertices[faces[face][(corner + 2) % 3]] - vertices[a] for face, corner in some])
        turn = _angles(across, axis / np.linalg.norm(axis))
        around = np.argsort(turn, kind="stable").tolist()
        # Seen along the edge, material is to the left of faces that run against it, up to the next one.
        against = [faces[some[k][0]][some[k][1]] == b for k in around]
        if len(some) % 2 or any(one == other for one, other in pairwise(against)):
            return None
        begin = against.index(True)
        around = [*around[begin:], *around[:begin]]
        pairs.append(np.array(some)[around].reshape(-1, 4))
    return np.vstack(pairs)


def _angles(across: Floats, axis: Floats) -> Floats:
    """Angle of vectors (k, 3) about an axis."""
    first = np.cross(np.eye(3)[int(np.abs(axis).argmin())], axis)
    return np.arctan2(across @ np.cross(axis, first), across @ first)


def _link_corners(faces: Ints, pairs: Ints) -> Ints:
    """A number (3 m,) for each corner of a face, the same for those that hang together round a vertex."""
    one, at, other, to = pairs.T
    # The edge runs the other way in the other face.
    rows = np.concatenate([3 * one + at, 3 * one + (at + 1) % 3])
    columns = np.concatenate([3 * other + (to + 1) % 3, 3 * other + to])
    return component_of(rows, columns, 3 * len(faces))


def _normals(points: Floats, faces: Ints) -> Floats:
    """Unit normal (n, 3) of each vertex: the mean of the unit normals of its faces, outwards."""
    a, b, c = points[faces].transpose(1, 0, 2)
    normal = np.cross(b - a, c - a)
    normal /= np.maximum(np.linalg.norm(normal, axis=1), 1e-300)[:, None]
    total = np.zeros_like(points)
    for corner in range(3):
        np.add.at(total, faces[:, corner], normal)
    unit: Floats = total / np.maximum(np.linalg.norm(total, axis=1), 1e-300)[:, None]
    return unit
