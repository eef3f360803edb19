"""Edges in which a solid touches itself: parted, so that each belongs to two faces.

Programs write solids that meet themselves along an edge: it belongs to four faces then, and whether the
material hangs together there is left open. Here it does not: the faces that bound one wedge of material stay
together, and the edges of wedges are drawn back into their material.
"""

from collections import defaultdict
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
    pairs = _pair_faces(vertices, faces)
    if pairs is None:
        return None
    corners = _link_corners(faces, pairs)
    crowded = np.unique(
        faces.ravel()[[3 * face + corner for face, corner in _corners_of_crowded_edges(faces)]]
    )
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
    middle = {
        edge: len(vertices) + number
        for number, edge in enumerate(edge for edge, some in _edges_of(faces).items() if len(some) > 2)
    }
    ends = np.array([*middle], dtype=np.int64)
    kept, cut = [], []
    for face in faces.tolist():
        ring: list[int] = []
        for a, b in zip(face, [*face[1:], face[0]], strict=True):
            ring += [a, middle[min(a, b), max(a, b)]] if (min(a, b), max(a, b)) in middle else [a]
        if len(ring) == 3:
            kept.append(face)
            continue
        begin = next(k for k, vertex in enumerate(ring) if vertex >= len(vertices))
        hub, *others = [*ring[begin:], *ring[:begin]]
        cut += [(hub, one, other) for one, other in pairwise(others)]
    return np.vstack([vertices, vertices[ends].mean(axis=1)]), np.array([*kept, *cut], dtype=np.int64)


def _bodies(vertices: Floats, faces: Ints) -> int:
    """How many bodies there are that share no vertex; a shell that faces inwards bounds a void of one."""
    ends = np.roll(faces, -1, axis=1)
    body = component_of(faces.ravel(), ends.ravel(), len(vertices))[faces[:, 0]]
    a, b, c = (vertices[faces] - vertices.mean(axis=0)).transpose(1, 0, 2)
    volume = np.bincount(body, (a * np.cross(b, c)).sum(axis=1))
    return int(np.count_nonzero(volume > 0))


def _edges_of(faces: Ints) -> dict[tuple[int, int], list[tuple[int, int]]]:
    """Faces of each edge (lower, higher vertex), each with the corner at which the edge begins."""
    found: dict[tuple[int, int], list[tuple[int, int]]] = defaultdict(list)
    for number, face in enumerate(faces.tolist()):
        for corner in range(3):
            a, b = face[corner], face[(corner + 1) % 3]
            found[min(a, b), max(a, b)].append((number, corner))
    return found


def _corners_of_crowded_edges(faces: Ints) -> list[tuple[int, int]]:
    """Both ends of all edges of more than two faces, as faces and corners."""
    crowded = [item for some in _edges_of(faces).values() if len(some) > 2 for item in some]
    return [*crowded, *((face, (corner + 1) % 3) for face, corner in crowded)]


def _pair_faces(vertices: Floats, faces: Ints) -> list[tuple[int, int, int, int]] | None:
    """Pairs of faces that meet in an edge and bound one wedge of material: face, corner, face, corner."""
    pairs = []
    for (a, b), some in _edges_of(faces).items():
        if len(some) == 2:
            pairs.append((*some[0], *some[1]))
            continue
        axis = vertices[b] - vertices[a]
        if not axis.any():
            return None
        across = np.array([vertices[faces[face][(corner + 2) % 3]] - vertices[a] for face, corner in some])
        turn = _angles(across, axis / np.linalg.norm(axis))
        order = np.argsort(turn, kind="stable").tolist()
        # Seen along the edge, material is to the left of faces that run against it, up to the next one.
        against = [faces[some[k][0]][some[k][1]] == b for k in order]
        if len(some) % 2 or any(one == other for one, other in pairwise(against)):
            return None
        begin = against.index(True)
        around = [some[k] for k in (*order[begin:], *order[:begin])]
        pairs += [(*one, *other) for one, other in zip(around[::2], around[1::2], strict=True)]
    return pairs


def _angles(across: Floats, axis: Floats) -> Floats:
    """Angle of vectors (k, 3) about an axis."""
    first = np.cross(np.eye(3)[int(np.abs(axis).argmin())], axis)
    return np.arctan2(across @ np.cross(axis, first), across @ first)


def _link_corners(faces: Ints, pairs: list[tuple[int, int, int, int]]) -> Ints:
    """A number (3 m,) for each corner of a face, the same for those that hang together round a vertex."""
    rows, columns = [], []
    for one, at, other, to in pairs:
        ends = [(at, (to + 1) % 3), ((at + 1) % 3, to)]  # the edge runs the other way in the other face
        rows += [3 * one + mine for mine, _ in ends]
        columns += [3 * other + theirs for _, theirs in ends]
    return component_of(np.array(rows), np.array(columns), 3 * len(faces))


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
