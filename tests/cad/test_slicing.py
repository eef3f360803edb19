"""Slices of closed surfaces against trimesh, and at the heights where slicing is delicate."""

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from palpate.base.errors import InputError
from palpate.base.geometry import Floats
from palpate.cad.parts import Region, Solid, StableState
from palpate.cad.resting_surface import (
    RestingSurface,
    regions_of,
    resting_surface_of,
    signed_area,
    slice_surface,
)

SQUARE = np.array([[0.0, 0.0], [4.0, 0.0], [4.0, 4.0], [0.0, 4.0]])


def surface_from(mesh: trimesh.Trimesh, rotation: Floats) -> RestingSurface:
    solid = Solid("part", np.array(mesh.vertices, dtype=float), np.array(mesh.faces, dtype=np.int64))
    lowest = (solid.vertices_mm @ rotation.T)[:, 2].min()
    state = StableState("a", rotation, np.array([0.0, 0.0, -lowest]), 1.0, 0.5, np.zeros((3, 2)))
    return resting_surface_of(solid, state)


def area(regions: tuple[Region, ...]) -> float:
    return sum(signed_area(r.outer) + sum(signed_area(h) for h in r.holes) for r in regions)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize(
    "mesh",
    [
        trimesh.creation.annulus(4, 9, 12, sections=30),
        trimesh.creation.icosphere(2, radius=7),
        trimesh.creation.torus(12, 4, 30, 20),
    ],
    ids=["tube", "ball", "torus"],
)
def test_areas_are_those_of_trimesh(mesh: trimesh.Trimesh, seed: int) -> None:
    rotation = Rotation.random(random_state=seed).as_matrix()
    surface = surface_from(mesh, rotation)
    moved = trimesh.Trimesh(surface.vertices_mm, surface.faces, process=False)
    for height in np.random.default_rng(seed).uniform(0.01, 0.99, 6) * surface.top_mm:
        regions = regions_of([ring.points for ring in slice_surface(surface, height)])
        lines = trimesh.intersections.mesh_plane(moved, [0, 0, 1], [0, 0, height], return_faces=True)
        (start, end), normal = lines[0][:, :, :2].swapaxes(0, 1), moved.face_normals[lines[1]]
        # Gauss: the area is half the flux of the position through the edges.
        outward = normal[:, :2] / np.hypot(*normal[:, :2].T)[:, None]
        flux = np.sum((start + end) / 2 * outward, axis=1) @ np.hypot(*(end - start).T) / 2
        assert area(regions) == pytest.approx(flux, rel=1e-9)
        assert all(signed_area(r.outer) > 0 and all(signed_area(h) < 0 for h in r.holes) for r in regions)


def test_a_plane_through_vertices_is_no_special_case() -> None:
    surface = surface_from(trimesh.creation.icosphere(2, radius=7), np.eye(3))
    for height in np.unique(surface.vertices_mm[:, 2])[1:-1]:
        (region,) = regions_of(
            [r.points for r in slice_surface(surface, height) if abs(signed_area(r.points)) > 1e-9]
        )
        (above,) = regions_of([r.points for r in slice_surface(surface, height + 1e-9)])
        assert signed_area(region.outer) == pytest.approx(signed_area(above.outer), abs=1e-6)


def test_every_edge_lies_on_its_facet() -> None:
    surface = surface_from(trimesh.creation.box((3, 4, 5)), Rotation.random(random_state=2).as_matrix())
    (ring,) = slice_surface(surface, surface.top_mm / 2)
    leg = np.roll(ring.points, -1, axis=0) - ring.points
    outward = np.column_stack([leg[:, 1], -leg[:, 0]]) / np.hypot(*leg.T)[:, None]
    np.testing.assert_allclose(outward, surface.normal[ring.facet], atol=1e-9)


def test_holes_belong_to_the_smallest_polygon_around_them() -> None:
    island = SQUARE / 8 + 1.75
    regions = regions_of([SQUARE, (SQUARE / 2 + 1)[::-1], island, (island / 2 + 1)[::-1] + 0.0, SQUARE + 9])
    assert [len(region.holes) for region in regions] == [1, 1, 0]
    assert area(regions) == pytest.approx(16 - 4 + 0.25 - 0.0625 + 16)


def test_a_hole_outside_of_the_material_is_refused() -> None:
    with pytest.raises(InputError, match=r"a hole at \(11, 11\) lies outside"):
        regions_of([SQUARE, (SQUARE + 9)[::-1]])


def test_an_open_surface_is_refused() -> None:
    mesh = trimesh.creation.box((3, 4, 5))
    mesh.faces = mesh.faces[1:]
    with pytest.raises(InputError, match="not closed"):
        surface_from(mesh, np.eye(3))


def test_faces_that_are_level_but_for_rounding_are_made_level() -> None:
    mesh = trimesh.creation.box((30, 40, 50))
    surface = surface_from(mesh, Rotation.from_rotvec([1e-8, 2e-8, 0]).as_matrix())
    assert surface.level.sum() == 4
    assert surface.top_mm == pytest.approx(50, abs=1e-3)
