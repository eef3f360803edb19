"""Crossing surfaces: boxes and tetrahedra with known answers, and every edge against every face."""

import numpy as np
import pytest
import trimesh
from scipy.optimize import linprog
from scipy.spatial.transform import Rotation

from palpate.cad.mesh_topology import triangle_surface_of, vertex_rounding
from palpate.cad.self_crossing import find_crossings, height_fields

TETRAHEDRON = np.array([[0, 1, 2], [0, 3, 1], [1, 3, 2], [2, 3, 0]])


def grid_box(lo, hi, cells, rng):
    """A box whose sides are cut into cells, each halved along a diagonal at random."""
    numbers: dict[tuple[int, ...], int] = {}
    faces = []
    for axis in range(3):
        u, w = (axis + 1) % 3, (axis + 2) % 3
        for end in (0, 1):
            for i in range(cells[u]):
                for j in range(cells[w]):
                    ring = []
                    for a, b in ((0, 0), (1, 0), (1, 1), (0, 1)):
                        point = [0, 0, 0]
                        point[axis], point[u], point[w] = end * cells[axis], i + a, j + b
                        ring.append(numbers.setdefault(tuple(point), len(numbers)))
                    ring = ring if end else ring[::-1]
                    turn = int(rng.integers(2))
                    a, b, c, d = ring[turn:] + ring[:turn]
                    faces += [[a, b, c], [a, c, d]]
    return lo + (hi - lo) * np.array(list(numbers), dtype=float) / cells, np.array(faces)


def crossed(vertices, faces):
    return len(find_crossings(triangle_surface_of(vertices, faces, vertex_rounding(vertices))).pairs)


def test_boxes_on_a_grid():
    """Edges, corners and diagonals fall onto each other in every way; touching along them is allowed."""
    rng = np.random.default_rng(1)
    seen = {True: 0, False: 0}
    for trial in range(160):
        lo = rng.integers(0, 4, (2, 3)).astype(float)
        hi = lo + rng.integers(1, 4, (2, 3))
        cells = rng.integers(1, 4, (2, 3))
        (v0, f0), (v1, f1) = (grid_box(lo[k], hi[k], cells[k], rng) for k in (0, 1))
        vertices, faces = np.vstack([v0, v1]), np.vstack([f0, f1 + len(v0)])
        if trial % 2:
            vertices = Rotation.random(rng=rng).apply(vertices) * rng.uniform(1, 100) + rng.uniform(
                -10, 10, 3
            )
        if trial % 4 == 3:
            vertices = vertices.astype(np.float32).astype(float)
        common = np.minimum(hi[0], hi[1]) - np.maximum(lo[0], lo[1])
        nested = any((lo[a] < lo[b]).all() and (hi[a] > hi[b]).all() for a, b in ((0, 1), (1, 0)))
        # Faces that lie on each other overlap too.
        expected = bool(
            ((common > 0).all() and not nested) or ((common >= 0).all() and (common == 0).sum() == 1)
        )
        assert (crossed(vertices, faces) > 0) == expected, (trial, lo, hi, cells)
        seen[expected] += 1
    assert min(seen.values()) > 30


def test_tetrahedra_cross_unless_a_plane_separates_them_or_one_holds_the_other():
    rng = np.random.default_rng(2)
    seen = {True: 0, False: 0}
    for trial in range(150):
        a, b = rng.normal(size=(2, 4, 3))
        b = (b + rng.normal(size=3) * rng.uniform(0, 1.5)) * rng.uniform(0.2, 1)
        rows = np.vstack(
            [np.column_stack([-a, np.ones((4, 2))]), np.column_stack([b, -np.ones(4), np.ones(4)])]
        )
        margin = -linprog([0, 0, 0, 0, -1], rows, np.zeros(8), bounds=[(-1, 1)] * 3 + [(None, None)] * 2).fun
        held = any(
            (np.linalg.solve(np.vstack([outer.T, np.ones(4)]), np.vstack([inner.T, np.ones(4)])) > 0).all()
            for outer, inner in ((a, b), (b, a))
        )
        faces = [TETRAHEDRON if np.linalg.det(t[1:] - t[0]) < 0 else TETRAHEDRON[:, ::-1] for t in (a, b)]
        expected = margin < 1e-9 and not held
        assert (crossed(np.vstack([a, b]), np.vstack([faces[0], faces[1] + 4])) > 0) == expected, trial
        seen[expected] += 1
    assert min(seen.values()) > 30


def pierced_pairs(vertices, faces):
    """Pairs of faces of which an edge of one goes through the other: all edges against all faces."""
    found = set()
    a, b, c = vertices[faces].transpose(1, 0, 2)
    normal = np.cross(b - a, c - a)
    for index, face in enumerate(faces):
        for start, end in zip(face, np.roll(face, -1), strict=True):
            p, q = vertices[start], vertices[end]
            at_p, at_q = ((p - a) * normal).sum(axis=1), ((q - a) * normal).sum(axis=1)
            through = (at_p * at_q < 0) & ~np.isin(faces, [start, end]).any(axis=1)
            x = p + np.where(through, at_p / np.where(through, at_p - at_q, 1), 0)[:, None] * (q - p)
            for s, e in ((a, b), (b, c), (c, a)):
                through &= (np.cross(e - s, x - s) * normal).sum(axis=1) > 0
            found |= {tuple(sorted((index, int(other)))) for other in np.flatnonzero(through)}
    return found


@pytest.mark.parametrize("seed", range(4))
def test_a_crumpled_sphere_crosses_itself_where_edges_pierce_faces(seed):
    rng = np.random.default_rng(seed)
    sphere = trimesh.creation.icosphere(subdivisions=2)
    vertices = np.asarray(sphere.vertices) + rng.normal(scale=0.12, size=(len(sphere.vertices), 3))
    faces = np.asarray(sphere.faces)
    surface = triangle_surface_of(vertices, faces, vertex_rounding(vertices))
    found = {tuple(sorted(pair)) for pair in find_crossings(surface).pairs.tolist()}
    assert found
    assert found == pierced_pairs(vertices, faces)


@pytest.mark.parametrize(
    "shape",
    [
        trimesh.creation.icosphere(subdivisions=4),
        trimesh.creation.torus(20, 5, 40, 30),
        trimesh.creation.cylinder(10, 50, sections=400),
        trimesh.creation.cone(10, 50, sections=200),
    ],
)
def test_good_surfaces_do_not_cross_themselves_in_any_position(shape):
    shape.merge_vertices()
    faces = np.asarray(shape.faces)
    turn = Rotation.random(rng=np.random.default_rng(3))
    for vertices in (np.asarray(shape.vertices), turn.apply(shape.vertices).astype(np.float32).astype(float)):
        assert crossed(vertices, faces) == 0
        assert (
            height_fields(triangle_surface_of(vertices, faces, vertex_rounding(vertices))) >= 0
        ).mean() > 0.9


def test_a_face_folded_onto_its_neighbour_overlaps_it():
    """A flat box whose lid is not there: its walls have no height."""
    vertices = np.array([[0, 0, 0], [10, 0, 0], [0, 10, 0], [3, 3, 0.0]])
    assert crossed(vertices, TETRAHEDRON) >= 3
