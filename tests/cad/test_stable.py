"""Stable states against trimesh's poses, closed forms and files of others."""

import math

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from shared_files import cad_file

from palpate.base.errors import InputError
from palpate.cad.hull import centre_of_mass, hull_of
from palpate.cad.parts import Solid
from palpate.cad.stable_states import LEAST_TIPPING_RAD, solid_angles, stable_states

MADE = {
    "box": trimesh.creation.box((30, 20, 10)),
    "prism of eight sides": trimesh.creation.cylinder(25, 20, sections=8),
    "cylinder": trimesh.creation.cylinder(25, 60, sections=64),
    "cone": trimesh.creation.cone(20, 30, sections=48),
    "ring": trimesh.creation.annulus(10, 25, 12, sections=24),
    "capsule": trimesh.creation.capsule(30, 10, count=[16, 16]),
}


def solid(mesh):
    return Solid("part", np.asarray(mesh.vertices, dtype=float), np.asarray(mesh.faces, dtype=np.int64))


def check(mesh):
    """The same ways down as trimesh finds, with the same probabilities; states rest as they say."""
    part = solid(mesh)
    states, out = stable_states(part)
    found = [(-state.rotation[2], state.probability) for state in states]
    found += [(item.down, item.probability) for item in out]
    turned, shares = trimesh.poses.compute_stable_poses(mesh, sigma=0, n_samples=1, threshold=0)
    assert len(found) == len(shares)
    for pose, share in zip(turned, shares, strict=True):
        near = [own for down, own in found if -pose[2, :3] @ down > math.cos(0.003)]
        assert near == [pytest.approx(share, abs=1e-6)]
    assert sum(share for _, share in found) == pytest.approx(1.0)
    for state in states:
        points = part.vertices_mm @ state.rotation.T + state.offset_mm
        size = np.ptp(points, axis=0).max()
        assert np.linalg.det(state.rotation) == pytest.approx(1.0)
        assert points[:, 2].min() == pytest.approx(0.0, abs=1e-9 * size)
        centre = state.rotation @ mesh.center_mass + state.offset_mm
        np.testing.assert_allclose(centre[:2], 0.0, atol=1e-6 * size)
        assert state.tipping_angle_rad == pytest.approx(tipping(state.support_mm, centre[2]), abs=1e-6)


def tipping(support, height):
    """Of a counter-clockwise polygon round the origin, written out edge by edge."""
    angles = []
    for (x, y), (p, q) in zip(support, np.roll(support, -1, axis=0), strict=True):
        inside = (x * q - y * p) / math.hypot(p - x, q - y)
        angles.append(math.atan2(inside, height))
    return min(angles)


@pytest.mark.parametrize("name", MADE)
def test_states_of_made_solids_are_those_of_trimesh(name):
    check(MADE[name])


@pytest.mark.parametrize(
    "name", ["20mm-xyz-cube.stl", "7_8ths_cube.stl", "angle_block.STL", "featuretype.STL"]
)
def test_states_of_files_are_those_of_trimesh(name):
    mesh = trimesh.load_mesh(cad_file(name))
    mesh.merge_vertices()
    check(mesh)


@settings(max_examples=15)
@given(st.integers(0, 10_000), st.integers(6, 40))
def test_states_of_random_hulls_are_those_of_trimesh(seed, count):
    points = np.random.default_rng(seed).normal(size=(count, 3)) * [20, 15, 10]
    check(trimesh.convex.convex_hull(points))


def test_a_box_rests_on_its_faces():
    states, out = stable_states(solid(MADE["box"]))
    assert not out
    assert [state.name for state in states] == [f"state-{k}" for k in range(1, 7)]
    # Half the solid angle of a rectangle a × b seen from height h: 2 asin(ab / √((a²+4h²)(b²+4h²))).
    a, b, h = 30.0, 20.0, 5.0
    corner = a * b / math.sqrt((a**2 + 4 * h**2) * (b**2 + 4 * h**2))
    assert states[0].probability == pytest.approx(4 * math.asin(corner) / (4 * math.pi))
    assert states[0].tipping_angle_rad == pytest.approx(math.atan2(10, 5))
    np.testing.assert_allclose(np.abs(states[0].support_mm), np.tile([15.0, 10.0], (4, 1)))
    np.testing.assert_allclose([abs(state.offset_mm[2]) for state in states], [5, 5, 10, 10, 15, 15])


def test_the_centre_of_mass_is_of_the_solid_and_not_of_its_hull():
    mesh = _bracket()
    centre = centre_of_mass(solid(mesh))
    np.testing.assert_allclose(centre, mesh.center_mass, atol=1e-9)
    assert np.linalg.norm(centre - mesh.convex_hull.center_mass) > 1.0
    check(mesh)


def _bracket():
    outline = [(0, 0), (60, 0), (60, 8), (8, 8), (8, 40), (0, 40)]
    triangles = [(0, 1, 2), (0, 2, 3), (0, 3, 4), (0, 4, 5)]
    return trimesh.creation.extrude_triangulation(np.array(outline, float), np.array(triangles), 25.0)


@pytest.mark.parametrize("steps", [1, 2])
def test_the_frame_does_not_depend_on_the_triangulation(steps):
    mesh = _bracket()
    finer = mesh
    for _ in range(steps):
        finer = finer.subdivide()
    rng = np.random.default_rng(3)
    noisy = finer.vertices + rng.uniform(-2e-6, 2e-6, finer.vertices.shape)
    one, _ = stable_states(solid(mesh))
    other, _ = stable_states(Solid("part", noisy, np.asarray(finer.faces)))
    assert len(one) == len(other)
    for a, b in zip(one, other, strict=True):
        np.testing.assert_allclose(a.rotation, b.rotation, atol=1e-5)
        np.testing.assert_allclose(a.offset_mm, b.offset_mm, atol=1e-4)


def test_states_that_tip_at_a_touch_are_left_out_and_say_so():
    # A leaning prism whose centre of mass is 0.2 mm inside of its lower edge, 20 mm up: 0.57°.
    lean = 2 * (10 - 0.2)
    bottom = np.array([(-10, -10), (10, -10), (10, 10), (-10, 10)], dtype=float)
    top = bottom + np.array([lean, 0.0])
    points = np.vstack([np.column_stack([bottom, np.zeros(4)]), np.column_stack([top, np.full(4, 40.0)])])
    states, out = stable_states(solid(trimesh.convex.convex_hull(points)))
    down = [item for item in out if item.down[2] < -0.99]
    assert math.radians(0.57) < LEAST_TIPPING_RAD
    assert [item.reason for item in down] == ["unstable: a tilt of 0.57° tips it over"]
    assert all(state.tipping_angle_rad > LEAST_TIPPING_RAD for state in states)


def test_a_finely_cut_cylinder_still_lies_on_its_side():
    states, out = stable_states(solid(trimesh.creation.cylinder(25, 60, sections=720)))
    lying = [state for state in states if abs(state.rotation[2, 2]) < 0.01]
    assert not out
    assert len(lying) > 300
    assert max(state.tipping_angle_rad for state in lying) < LEAST_TIPPING_RAD


def test_improbable_states_are_left_out_and_say_so():
    states, out = stable_states(solid(MADE["box"]), 0.1)
    assert len(states) == 4
    assert [item.reason for item in out] == ["improbable: 5.6 %"] * 2


def test_solid_angles_fill_the_sphere():
    for mesh in MADE.values():
        assert solid_angles(hull_of(solid(mesh))).sum() == pytest.approx(4 * math.pi)


def test_a_flat_part_is_refused():
    points = np.array([(0, 0, 0), (10, 0, 0), (0, 10, 0.0)])
    with pytest.raises(InputError, match="part: the part encloses no volume"):
        stable_states(Solid("part", points, np.array([(0, 1, 2), (0, 2, 1)])))
