"""What is mended of meshes: bodies that overlap, cracks, tiny folds; and what is refused all the same."""

import numpy as np
import pytest
import trimesh
from scipy import ndimage

from palpate.base.errors import InputError
from palpate.cad.mesh_checks import check_solids
from palpate.cad.mesh_mending import smooth_crossings, unite_bodies
from palpate.cad.parts import Solid
from palpate.cad.stable_states import volume_mm3


def check(mesh: trimesh.Trimesh) -> tuple[Solid, ...]:
    return check_solids("part.stl", "part", np.array(mesh.vertices), np.array(mesh.faces))


def farthest_mm(solid: Solid, points: np.ndarray) -> float:
    """Largest distance of points from the planes of a solid's facets that they are nearest to, by hand."""
    corners = solid.vertices_mm[solid.faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(normal, axis=1)
    normal, corners = normal[length > 0] / length[length > 0][:, None], corners[length > 0]
    away = np.abs(np.einsum("pfk,fk->pf", points[:, None] - corners[None, :, 0], normal))
    return float(away.min(axis=1).max())


def test_bodies_of_one_file_that_overlap_are_one_part() -> None:
    base, pin = trimesh.creation.box((40, 30, 10)), trimesh.creation.cylinder(4, 30, sections=24)
    (solid,) = check(trimesh.util.concatenate([base, pin]))
    inside = 10 * pin.volume / 30
    assert volume_mm3(solid) == pytest.approx(base.volume + pin.volume - inside)
    assert solid.off_mm < 1e-6


def test_arrays_may_lie_in_memory_as_they_like() -> None:
    mesh = folded(4e-4)
    vertices, faces = np.asfortranarray(mesh.vertices), np.asfortranarray(mesh.faces)
    assert smooth_crossings((vertices, faces)) is not None
    assert unite_bodies([(vertices, faces)])[0][0].shape[1] == 3


def test_bodies_that_touch_with_their_faces_are_one_part() -> None:
    base, top = trimesh.creation.box((40, 30, 10)), trimesh.creation.box((20, 10, 8))
    top.apply_translation((0, 0, 9))
    (solid,) = check(trimesh.util.concatenate([base, top]))
    assert volume_mm3(solid) == pytest.approx(base.volume + top.volume)


def test_bodies_are_not_united_where_one_may_be_a_void() -> None:
    outer, void = trimesh.creation.box((40, 40, 40)), trimesh.creation.box((10, 10, 60))
    void.invert()
    with pytest.raises(InputError, match="intersects itself"):
        check(trimesh.util.concatenate([outer, void]))


def folded(by_mm: float) -> trimesh.Trimesh:
    """A box whose top has a fold: two rows of vertices that have passed each other."""
    box = trimesh.creation.box((40, 30, 10)).subdivide().subdivide()
    vertices = box.vertices.copy()
    top = (vertices[:, 2] == 5.0) & (np.abs(vertices[:, 1]) < 14)
    one, other = top & (vertices[:, 0] == 0.0), top & (vertices[:, 0] == 10.0)
    vertices[one, 0] += 5.0 + by_mm / 2
    vertices[other, 0] -= 5.0 + by_mm / 2
    return trimesh.Trimesh(vertices, box.faces, process=False)


def test_a_fold_of_less_than_a_micrometre_is_smoothed() -> None:
    mesh = folded(4e-4)
    (solid,) = check(mesh)
    assert 1e-3 <= solid.off_mm < 2e-3
    assert volume_mm3(solid) == pytest.approx(12000.0, abs=1e-3 * 40 * 30)
    assert farthest_mm(solid, mesh.vertices) <= solid.off_mm


def test_a_top_that_is_pushed_through_the_bottom_is_refused() -> None:
    box = trimesh.creation.box((40, 30, 10)).subdivide()
    vertices = box.vertices.copy()
    vertices[np.linalg.norm(vertices - (0, 0, 5), axis=1).argmin(), 2] = -5.1
    with pytest.raises(InputError, match="intersects itself"):
        check(trimesh.Trimesh(vertices, box.faces, process=False))


def cracked(width_mm: float) -> trimesh.Trimesh:
    """A box without a long triangle of its top."""
    corners = np.array([[0, 0, 0], [40, 0, 0], [40, 30, 0], [0, 30, 0]], dtype=float)
    top = np.vstack([corners, [[20.0, width_mm, 0.0]]]) + np.array([0, 0, 10])
    lower = [[0, 2, 1], [0, 3, 2]]
    sides = [[a, b, b + 4] for a, b in ((0, 1), (1, 2), (2, 3), (3, 0))]
    sides += [[a, b + 4, a + 4] for a, b in ((0, 1), (1, 2), (2, 3), (3, 0))]
    upper = [[5, 6, 8], [6, 7, 8], [7, 4, 8]]
    return trimesh.Trimesh(np.vstack([corners, top]), lower + sides + upper, process=False)


def test_a_crack_is_closed_and_counts_as_off() -> None:
    mesh = cracked(0.01)
    assert not mesh.is_watertight
    (solid,) = check(mesh)
    assert volume_mm3(solid) == pytest.approx(12000.0)
    assert 0.01 <= solid.off_mm <= 0.03


def test_a_hole_is_no_crack() -> None:
    with pytest.raises(InputError, match=r"not watertight: the edge from \(.*\) mm belongs to 1 face"):
        check(cracked(2.0))


def blocks(cells: set[tuple[int, int, int]]) -> tuple[np.ndarray, np.ndarray]:
    """Surface of cubes of 10 mm; an edge in which two of them meet, and no more, belongs to four faces."""
    number: dict[tuple[int, ...], int] = {}
    faces = []
    for cell in sorted(cells):
        for axis in range(3):
            for side in (0, 1):
                beside, corner = list(cell), list(cell)
                beside[axis] += 2 * side - 1
                corner[axis] += side
                if tuple(beside) in cells:
                    continue
                square = []
                for step in ((0, 0), (1, 0), (1, 1), (0, 1)):
                    point = list(corner)
                    point[(axis + 1) % 3] += step[0]
                    point[(axis + 2) % 3] += step[1]
                    square.append(number.setdefault(tuple(point), len(number)))
                a, b, c, d = square if side else square[::-1]
                faces += [(a, b, c), (a, c, d)]
    return 10.0 * np.array(list(number), dtype=float), np.array(faces)


def test_edges_in_which_a_part_touches_itself_are_parted() -> None:
    plate = {(x, y, 0) for x in range(2) for y in range(2)}
    (solid,) = check_solids("part.stl", "part", *blocks(plate | {(0, 0, 1), (1, 1, 1)}))
    mesh = trimesh.Trimesh(solid.vertices_mm, solid.faces, process=False)
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    assert mesh.volume == pytest.approx(6000, rel=1e-3)
    assert 0 < solid.off_mm < 0.01
    assert any("parted" in line for line in solid.mended)


def test_random_blocks_are_parted_or_hang_together_by_an_edge_alone() -> None:
    rng, parted = np.random.default_rng(2), 0
    for _ in range(80):
        cells = set(map(tuple, np.argwhere(rng.random((3, 3, 3)) < 0.7).tolist()))
        grid = np.zeros((3, 3, 3), dtype=int)
        grid[tuple(np.array(sorted(cells)).T)] = 1
        by_faces = ndimage.label(grid)[1]
        by_corners = ndimage.label(grid, np.ones((3, 3, 3)))[1]
        if by_faces > by_corners:  # bodies that only an edge or a corner joins
            continue
        found = check_solids("part.stl", "part", *blocks(cells))
        parted += any("parted" in line for solid in found for line in solid.mended)
        assert sum(volume_mm3(solid) for solid in found) == pytest.approx(1000 * len(cells), rel=3e-3)
    assert parted >= 10
