"""States that solids rest in: stability, merging, as drawn."""

import math

import numpy as np
import pytest
import shapely
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from palpate.base.errors import InputError
from palpate.cad.parts import Solid
from palpate.cad.stable_states import (
    LEAST_TIPPING_RAD,
    centre_of_mass,
    hull_of,
    solid_angles,
    stable_states,
    state_as_drawn,
    volume_mm3,
)
from palpate.cad.state_merging import merge_states
from support.benches.parts import ELL, prism
from support.campaign.sampling import sample
from support.commands.repository import cad_file

# ----------------------------------------------------------------------------------------------------
# Stable states against trimesh's poses, closed forms and files of others.

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


# ----------------------------------------------------------------------------------------------------
# Symmetric states become one; trimesh cuts the sections.


def slicer(mesh):
    """Sections by trimesh; loops inside of loops are holes."""

    def slices_of(state, heights_mm):
        resting = mesh.copy()
        resting.vertices = mesh.vertices @ state.rotation.T + state.offset_mm
        sections = []
        for height in heights_mm:
            cut = resting.section([0, 0, 1], [0, 0, height])
            region = shapely.Polygon()
            for loop in [] if cut is None else cut.discrete:
                region = region.symmetric_difference(shapely.Polygon(loop[:, :2]))
            sections.append(region.simplify(1e-9))
        return sections

    return slices_of


def run(mesh, within=0.05, **options):
    states, _ = stable_states(solid(mesh))
    found, out = merge_states(solid(mesh), states, slicer(mesh), within, **options)
    total = sum(item.state.probability for item in found) + sum(item.probability for item in out)
    assert total == pytest.approx(1.0)
    assert [item.state.name for item in found] == [f"state-{k}" for k in range(1, len(found) + 1)]
    return found, out


def counts(found):
    return [item.count for item in found]


def test_a_cube_has_one_state():
    found, out = run(trimesh.creation.box((20, 20, 20)))
    assert counts(found) == [6]
    assert found[0].state.probability == pytest.approx(1.0)
    assert found[0].apart_mm < 1e-6
    assert not out


def test_a_box_has_three():
    found, _ = run(trimesh.creation.box((30, 20, 10)))
    assert counts(found) == [2, 2, 2]


def test_triangulation_does_not_matter():
    mesh = trimesh.creation.box((20, 20, 20))
    uneven = mesh.subdivide(face_index=[0, 5, 7])
    uneven = trimesh.Trimesh(*trimesh.remesh.subdivide_to_size(uneven.vertices, uneven.faces, 9.0))
    uneven.merge_vertices()
    assert counts(run(uneven)[0]) == [6]


def test_a_nearly_symmetric_box_merges_within_the_distance_only():
    mesh = trimesh.creation.box((20, 20, 20.06))
    found, _ = run(mesh, within=0.1)
    assert counts(found) == [6]
    assert 0.02 < found[0].apart_mm <= 0.1
    found, _ = run(mesh, within=0.02)
    assert counts(found) == [4, 2]


def test_mirror_images_stay_apart():
    # A slab that is cut obliquely: upside down it is its own mirror image.
    base = np.array([(0, 0), (40, 0), (30, 15), (0, 20)], dtype=float)
    points = np.vstack([np.column_stack([base, np.full(4, z)]) for z in (0.0, 8.0)])
    found, _ = run(trimesh.convex.convex_hull(points))
    flat = [item for item in found if abs(item.state.rotation[2, 2]) > 0.99]
    assert counts(flat) == [1, 1]


def test_a_hole_through_the_middle_changes_nothing_and_a_blind_one_does():
    plate = trimesh.creation.box((30, 30, 10))
    through = trimesh.creation.annulus(5, 15, 10, sections=9)
    assert counts(run(through, within=0.01)[0])[:1] == [2]
    assert counts(run(plate, within=0.01)[0]) == [2, 4]
    # A pyramid on top: the two large faces are no longer the same.
    tip = np.vstack([plate.vertices, [(0.0, 0.0, 9.0)]])
    found, _ = run(trimesh.convex.convex_hull(tip))
    assert max(counts(found)) == 4


def test_a_cylinder_of_many_facets_stands_or_lies():
    found, out = run(trimesh.creation.cylinder(10, 30, sections=12))
    assert sorted(counts(found)) == [2, 12]
    assert not out
    lying = max(found, key=lambda item: item.count)
    assert lying.state.tipping_angle_rad == pytest.approx(math.pi / 12)


def test_a_ball_has_one_state_that_says_how_far_it_is_off():
    mesh = trimesh.creation.icosphere(3, 20)
    assert len(stable_states(solid(mesh))[0]) == 1280
    found, out = run(mesh, within=0.2)
    assert counts(found) == [1280]
    assert 0.01 < found[0].apart_mm <= 0.2
    assert not out


def test_the_number_of_states_is_bounded_and_the_rest_is_said():
    points = np.random.default_rng(1).normal(size=(30, 3)) * [20, 15, 10]
    mesh = trimesh.convex.convex_hull(points)
    every, _ = run(mesh)
    found, out = run(mesh, most=3)
    assert len(found) == 3
    assert len(every) > 4
    assert [item.reason.split(":")[0] for item in out] == [
        f"{len(every) - 3} states beyond the 3 most probable"
    ]
    assert out[0].probability == pytest.approx(sum(item.state.probability for item in every[3:]))


def test_what_is_improbable_is_judged_after_merging():
    mesh = trimesh.creation.cylinder(10, 30, sections=12)
    found, out = run(mesh, least_probability=0.05)
    assert sorted(counts(found)) == [2, 12]
    found, out = run(trimesh.creation.box((30, 20, 10)), least_probability=0.2)
    assert counts(found) == [2, 2]
    assert [item.reason for item in out] == ["improbable: 11 %"]


def _blocks(cuts, solid_cells):
    """The surface of those cells of a grid, the same in x, y and z, that are solid."""
    n = len(cuts) - 1
    cells = np.zeros((n + 2,) * 3, dtype=bool)
    cells[1:-1, 1:-1, 1:-1] = solid_cells
    quads = []
    for axis in range(3):
        behind = np.roll(cells, 1, axis=axis)
        for index in np.argwhere(cells != behind):
            u, v = np.eye(3, dtype=int)[[(axis + 1) % 3, (axis + 2) % 3]]
            ring = [index, index + u, index + u + v, index + v]
            quads.append(ring[::-1] if cells[tuple(index)] else ring)
    corners = np.array(quads) - 1
    triangles = corners[:, [[0, 1, 2], [0, 2, 3]]].reshape(-1, 3, 3)
    points, faces = np.unique(triangles.reshape(-1, 3), axis=0, return_inverse=True)
    return trimesh.Trimesh(cuts[points], faces.reshape(-1, 3), process=False)


def test_an_engraving_between_the_sections_keeps_states_apart():
    cuts = np.r_[0.0, 0.2, np.linspace(1.1, 18.9, 16), 19.8, 20.0] - 10.0
    plain = np.ones((19, 19, 19), dtype=bool)
    engraved = plain.copy()
    engraved[6, 0, 11] = False  # 0.2 mm deep
    whole, mesh = _blocks(cuts, plain), _blocks(cuts, engraved)
    assert whole.is_watertight
    assert mesh.is_watertight
    assert counts(run(whole)[0]) == [6]
    states, _ = stable_states(solid(mesh))
    seen = {}

    def slices_of(state, heights_mm):
        seen[state.name] = slicer(mesh)(state, heights_mm)
        return seen[state.name]

    found, _ = merge_states(solid(mesh), states, slices_of, 0.05)
    full = [name for name, sections in seen.items() if all(abs(item.area - 400) < 1e-6 for item in sections)]
    assert len(full) == 4, "seen by their sections alone, four states are those of a plain cube"
    assert counts(found) == [1] * 6


def test_a_cube_with_letters_has_six_states():
    mesh = trimesh.load_mesh(cad_file("20mm-xyz-cube.stl"))
    mesh.merge_vertices()
    assert counts(run(mesh)[0]) == [1] * 6


@pytest.mark.parametrize("sides", sample([16, 64], [16]))
def test_a_prism_of_many_sides_stands_or_lies(sides):
    found, out = run(trimesh.creation.cylinder(10, 30, sections=sides), within=0.01)
    assert sorted(counts(found)) == [2, sides]
    assert max(item.apart_mm for item in found) < 1e-4
    assert not out


@pytest.mark.parametrize(
    "again",
    [
        (6, 18, 7),
        pytest.param((12, 0, 7), marks=pytest.mark.campaign),
        pytest.param((12, 18, 11), marks=pytest.mark.campaign),
    ],
)
def test_sections_that_allow_four_motions_are_tried_with_all(again):
    # Sections are squares; dents between them, alike by half a turn, tell which turn is right.
    cuts = np.r_[0.0, 0.2, np.linspace(1.1, 18.9, 16), 19.8, 20.0] - 10.0
    cells = np.ones((19, 19, 19), dtype=bool)
    cells[6, 0, 11] = cells[again] = False
    found, _ = run(_blocks(cuts, cells))
    assert sorted(counts(found)) == [1, 1, 2, 2]


def test_a_limit_of_proofs_is_said():
    found, out = run(trimesh.creation.box((30, 20, 10)), effort=0)
    assert counts(found) == [1] * 6
    reason = "not compared, it would take too long: 3 states may be as others are"
    assert [(item.reason, item.probability) for item in out] == [(reason, 0.0)]


# ----------------------------------------------------------------------------------------------------
# A solid that stays as its file has it.


def solid_of(mesh: trimesh.Trimesh) -> Solid:
    return Solid("part", np.asarray(mesh.vertices), np.asarray(mesh.faces))


@pytest.mark.parametrize(
    "mesh", [prism(ELL, 20), trimesh.creation.icosphere(2, 12.0), trimesh.creation.cone(5, 30)]
)
def test_volume(mesh: trimesh.Trimesh) -> None:
    moved = mesh.copy()
    moved.apply_translation([1000, -50, 7])
    assert volume_mm3(solid_of(moved)) == pytest.approx(mesh.volume, rel=1e-9)


def test_it_lies_with_its_axes_on_its_lowest_point() -> None:
    mesh = prism(ELL, 20)
    mesh.apply_translation([100, 200, -35])
    state = state_as_drawn(solid_of(mesh))
    placed = mesh.vertices @ state.rotation.T + state.offset_mm
    assert placed[:, 2].min() == pytest.approx(0)
    np.testing.assert_array_equal(state.rotation, np.eye(3))
    np.testing.assert_allclose((mesh.center_mass + state.offset_mm)[:2], 0, atol=1e-9)
    away = min(np.hypot(*(corner - np.array(ELL.centroid.coords[0]))) for corner in [(8, 8)])
    assert state.tipping_angle_rad <= math.atan2(away + 20, 10)


def test_the_tipping_angle_of_a_box() -> None:
    state = state_as_drawn(solid_of(trimesh.creation.box((20, 60, 40))))
    assert state.tipping_angle_rad == pytest.approx(math.atan2(10, 20))
    assert len(state.support_mm) == 4


def test_what_would_topple_has_no_tipping_angle() -> None:
    leaning = trimesh.creation.box((10, 10, 40))
    shear = np.eye(4)
    shear[0, 2] = 1.0
    leaning.apply_transform(shear)
    assert state_as_drawn(solid_of(leaning)).tipping_angle_rad == 0.0
    tip = trimesh.creation.cone(5, 30)
    tip.apply_transform(trimesh.transformations.rotation_matrix(math.pi, [1, 0, 0]))
    assert state_as_drawn(solid_of(tip)).tipping_angle_rad == 0.0
