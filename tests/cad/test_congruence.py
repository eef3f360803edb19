"""Surfaces moved onto themselves: closed forms, and trimesh's distances from every triangle."""

import math

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from trimesh.transformations import rotation_matrix

from palpate.cad.parts import Solid
from palpate.cad.surface_congruence import solid_congruence_bound_mm

CUBE = trimesh.creation.box((20, 20, 20))


def solid(mesh):
    return Solid("part", np.asarray(mesh.vertices, dtype=float), np.asarray(mesh.faces, dtype=np.int64))


def turn(degrees, axis):
    return rotation_matrix(math.radians(degrees), axis)[:3, :3]


def apart(mesh, rotation, within, shift=(0.0, 0.0, 0.0)):
    return solid_congruence_bound_mm(solid(mesh), rotation, np.array(shift, dtype=float), within)


def sampled_mm(mesh, rotation, shift, seed=0, count=60):
    """Largest distance of some points of the moved surface, held against every triangle."""
    points = trimesh.sample.sample_surface(mesh, count, seed=seed)[0]
    points = np.vstack([points, mesh.vertices]) @ rotation.T + shift
    every = np.repeat(np.asarray(mesh.triangles), len(points), axis=0)
    some = np.tile(points, (len(mesh.faces), 1))
    off = np.linalg.norm(trimesh.triangles.closest_point(every, some) - some, axis=1)
    return off.reshape(len(mesh.faces), -1).min(axis=0).max()


def saddle(h):
    """A slab whose top is a saddle of one quad; a quarter turn takes the other diagonal."""
    base = np.array([(-10, -10), (10, -10), (10, 10), (-10, 10)], dtype=float)
    top = 20.0 + h * np.array([1.0, -1.0, 1.0, -1.0])
    points = np.vstack([np.column_stack([base, np.zeros(4)]), np.column_stack([base, top])])
    walls = [(k, (k + 1) % 4, 4 + (k + 1) % 4) for k in range(4)]
    walls += [(k, 4 + (k + 1) % 4, 4 + k) for k in range(4)]
    faces = [(0, 2, 1), (0, 3, 2), *walls, (4, 5, 6), (4, 6, 7)]
    return trimesh.Trimesh(points, faces, process=False)


@pytest.mark.parametrize("axis", np.eye(3))
def test_a_cube_turns_onto_itself_whatever_its_diagonals(axis):
    assert apart(CUBE, turn(90, axis), 0.05) < 1e-6


@pytest.mark.parametrize("shift", [0.01, 0.04])
def test_a_shift_is_what_it_is(shift):
    found = apart(CUBE, np.eye(3), 0.05, (shift, 0.0, 0.0))
    assert shift <= found <= 0.05
    assert apart(CUBE, np.eye(3), 0.9 * shift, (shift, 0.0, 0.0)) is None


def test_what_only_the_way_back_tells():
    # A thin fin beside a block: shifted into the block's side the fin is near to something, the block is not.
    block = trimesh.creation.box((20, 20, 20))
    fin = trimesh.creation.box((0.02, 20, 20), trimesh.transformations.translation_matrix((10.5, 0, 0)))
    both = trimesh.util.concatenate([block, fin])
    assert apart(both, np.eye(3), 0.04) < 1e-6
    assert apart(both, turn(180, [0, 0, 1]), 0.04) is None
    assert apart(both, turn(180, [1, 0, 0]), 0.04) < 1e-6


def test_a_prism_of_64_sides_turns_by_one_and_a_half_turn_of_a_side_costs_its_sagitta():
    mesh = trimesh.creation.cylinder(10, 30, sections=64)
    assert apart(mesh, turn(360 / 64, [0, 0, 1]), 0.05) < 1e-5
    assert apart(mesh, turn(180, [1, 0, 0]), 0.05) < 1e-5
    sagitta = 10 * (1 - math.cos(math.pi / 64))
    assert sagitta * 0.99 < apart(mesh, turn(180 / 64, [0, 0, 1]), 0.05) <= 0.05
    assert apart(mesh, turn(180 / 64, [0, 0, 1]), 0.9 * sagitta) is None


@pytest.mark.parametrize("edge", [6.0, 3.0])
def test_any_triangulation_of_flat_faces_is_the_same(edge):
    uneven = CUBE.subdivide(face_index=[0, 5, 7])
    uneven = trimesh.Trimesh(*trimesh.remesh.subdivide_to_size(uneven.vertices, uneven.faces, edge))
    uneven.merge_vertices()
    found = apart(uneven, turn(90, [1, 0, 0]), 0.05)
    assert found < 1e-5 * 20


def test_facets_of_no_match_are_cut_until_they_fit():
    # The slanted cut has other triangles on either side of its axis.
    fine, coarse = CUBE.copy(), CUBE.subdivide().subdivide()
    top = coarse.triangles_center[:, 2] > 9.99
    rest = fine.triangles_center[:, 2] < 9.99
    mixed = trimesh.util.concatenate(
        [trimesh.Trimesh(m.vertices, m.faces[rows]) for m, rows in ((coarse, top), (fine, rest))]
    )
    assert apart(mixed, turn(180, [1, 0, 0]), 0.05) < 1e-5 * 20


def test_a_saddle_cut_along_the_other_diagonal_is_off_by_its_depth():
    mesh = saddle(0.02)
    half, flip = turn(180, [0, 0, 1]), turn(90, [0, 0, 1])
    assert apart(mesh, half, 0.1) < 1e-6
    # A quarter turn makes ridges of its dips: corners are off by 0.04.
    assert 0.0399 < apart(mesh, flip, 0.1) <= 0.1
    assert apart(mesh, flip, 0.035) is None


def test_saddles_of_different_diagonals_are_as_far_apart_as_their_middles():
    one = saddle(0.02)
    pair = one.copy()
    pair.apply_translation((30, 0, 0))
    pair.faces[-2:] = [(4, 5, 7), (5, 6, 7)]
    one.apply_translation((-30, 0, 0))
    both = trimesh.util.concatenate([one, pair])
    found = apart(both, turn(180, [0, 0, 1]), 0.1)
    assert 0.0399 < found <= 0.1
    assert apart(both, turn(180, [0, 0, 1]), 0.039) is None


def test_mirror_images_are_not_the_same():
    base = np.array([(0, 0), (40, 0), (30, 15), (0, 20)], dtype=float)
    points = np.vstack([np.column_stack([base, np.full(4, z)]) for z in (-4.0, 4.0)])
    slab = trimesh.convex.convex_hull(points)
    centre = slab.center_mass
    for degrees in range(0, 360, 15):
        rotation = turn(degrees, [0, 0, 1]) @ turn(180, [1, 0, 0])
        assert apart(slab, rotation, 0.5, centre - rotation @ centre) is None


@settings(max_examples=12)
@given(st.integers(0, 999), st.floats(0.0, 0.4), st.floats(-0.1, 0.1))
def test_no_sample_is_further_than_the_bound(seed, degrees, shift):
    rng = np.random.default_rng(seed)
    mesh = trimesh.convex.convex_hull(rng.normal(size=(25, 3)) * [20, 15, 10])
    axis = rng.normal(size=3)
    rotation, by = turn(degrees, axis), np.array([shift, -shift, shift / 2])
    found = apart(mesh, rotation, 0.2, by)
    seen = max(sampled_mm(mesh, rotation, by, seed), sampled_mm(mesh, rotation.T, -rotation.T @ by, seed))
    if found is None:
        # Convex surfaces turned by so little are proven whenever they are near enough.
        reach = np.linalg.norm(mesh.vertices, axis=1).max()
        assert math.radians(degrees) * reach + np.linalg.norm(by) > 0.2
    else:
        assert seen <= found <= 0.2


def test_needles_and_doubled_points_are_no_trouble():
    # A corner of the cube's lid twice, 1e-9 mm apart: two facets without a normal.
    points = np.vstack([CUBE.vertices, CUBE.vertices[0] + [0.0, 0.0, 1e-9]])
    faces = np.vstack([CUBE.faces, [(0, 1, 8), (0, 8, 1)]])
    found = solid_congruence_bound_mm(Solid("part", points, faces), turn(180, [0, 0, 1]), np.zeros(3), 0.05)
    assert found < 1e-4
