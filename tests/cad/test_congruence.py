"""Congruence of states, symmetry of solids."""

import math

import numpy as np
import pytest
import shapely
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from shapely import affinity
from trimesh.transformations import rotation_matrix

from palpate.cad.mesh_topology import overlapping_pairs
from palpate.cad.parts import Solid
from palpate.cad.planar_congruence import PlanarMotion, find_motions, stack_distance_mm
from palpate.cad.solid_symmetries import KnownSymmetries, SolidSymmetry, orbits_of, with_symmetry
from palpate.cad.stable_states import stable_states
from palpate.cad.surface_congruence import SurfaceDistance, solid_congruence_bound_mm
from support.benches.parts import prism
from support.campaign.sampling import sample

# ----------------------------------------------------------------------------------------------------
# Surfaces moved onto themselves: closed forms, and trimesh's distances from every triangle.

CUBE = trimesh.creation.box((20, 20, 20))


def solid(mesh):
    return Solid("part", np.asarray(mesh.vertices, dtype=float), np.asarray(mesh.faces, dtype=np.int64))


def turn(degrees, axis):
    return rotation_matrix(math.radians(degrees), axis)[:3, :3]


def apart(mesh, rotation, within, shift=(0.0, 0.0, 0.0)):
    return solid_congruence_bound_mm(solid(mesh), rotation, np.array(shift, dtype=float), within)


def sampled_mm(mesh, rotation, shift, seed=0):
    """Largest distance of some points of the moved surface, held against every triangle."""
    points = trimesh.sample.sample_surface(mesh, 60, seed=seed)[0]
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


# ----------------------------------------------------------------------------------------------------
# Rigid motions between stacks of sections, against shapely's distances and known copies.

ANGLES = st.floats(-math.pi, math.pi)
SHIFTS = st.tuples(st.floats(-80, 80), st.floats(-80, 80))


def star(seed, corners=20, radius=25.0, spread=8.0):
    rng = np.random.default_rng(seed)
    angle = np.sort(rng.uniform(0, 2 * math.pi, corners))
    radii = radius + rng.uniform(-spread, spread, corners)
    ring = np.column_stack([radii * np.cos(angle), radii * np.sin(angle)])
    return shapely.Polygon(ring)


def regular(corners, radius=20.0):
    angle = np.arange(corners) * 2 * math.pi / corners
    return shapely.Polygon(np.column_stack([radius * np.cos(angle), radius * np.sin(angle)]))


def moved(region, turn, shift):
    c, s = math.cos(turn), math.sin(turn)
    return affinity.affine_transform(region, (c, -s, s, c, shift[0], shift[1]))


def noisy(region, seed, by):
    rng = np.random.default_rng(seed)
    ring = np.asarray(region.exterior.coords)[:-1]
    angle = rng.uniform(0, 2 * math.pi, len(ring))
    return shapely.Polygon(ring + by * np.column_stack([np.cos(angle), np.sin(angle)]))


def check(found, a, b, within):
    """Every motion does what it says, by shapely's densified (from below) distance of boundaries."""
    for motion in found:
        for mine, its in zip(a, b, strict=True):
            there = moved(mine, motion.turn_rad, motion.shift_mm)
            seen = shapely.hausdorff_distance(there.boundary, its.boundary, densify=0.05)
            assert seen <= motion.apart_mm + 1e-9
        assert motion.apart_mm <= within + 1e-6


def turns(found):
    return np.sort([math.remainder(item.turn_rad, 2 * math.pi) for item in found])


@settings(max_examples=12)
@given(st.integers(0, 99), ANGLES, SHIFTS)
def test_a_moved_copy_is_found_with_its_motion(seed, turn, shift):
    a = [star(seed), star(seed + 100, 9)]
    b = [moved(item, turn, shift) for item in a]
    found = find_motions(a, b, 0.05)
    check(found, a, b, 0.05)
    assert found[0].apart_mm < 1e-6
    assert abs(math.remainder(found[0].turn_rad - turn, 2 * math.pi)) < 1e-7
    np.testing.assert_allclose(found[0].shift_mm, shift, atol=1e-5)


@settings(max_examples=12)
@given(st.integers(0, 30), ANGLES, SHIFTS, st.floats(0.001, 0.5))
def test_a_copy_with_displaced_corners_is_found_and_refined(seed, turn, shift, by):
    a = star(seed)
    b = noisy(moved(a, turn, shift), seed, by)
    known = stack_distance_mm([a], [b], turn, np.array(shift))
    found = find_motions([a], [b], known)
    check(found, [a], [b], known)
    assert found[0].apart_mm <= known * (1 + 1e-6) + 1e-6


@settings(max_examples=12)
@given(st.integers(3, 24), ANGLES, SHIFTS)
def test_a_regular_polygon_has_all_its_turns(corners, turn, shift):
    a = regular(corners)
    found = find_motions([a], [moved(a, turn, shift)], 1e-3)
    steps = np.diff(turns(found))
    assert len(found) == corners
    np.testing.assert_allclose(steps, 2 * math.pi / corners, atol=1e-6)


@pytest.mark.parametrize("within", [0.0, 0.05, 1.0, 4.0])
def test_symmetric_turns_survive_any_tolerance(within):
    rectangle = shapely.box(-20, -10, 20, 10)
    found = find_motions([rectangle], [moved(rectangle, 0.4, (3, 5))], within)
    np.testing.assert_allclose(turns(found), [0.4 - math.pi, 0.4], atol=1e-6)


def test_the_stack_is_turned_as_one():
    square, bar = regular(4), shapely.box(-15, -2, 15, 2)
    assert len(find_motions([square], [square], 0.05)) == 4
    assert len(find_motions([square, bar], [square, bar], 0.05)) == 2
    off = affinity.translate(bar, 1.0, 3.0)
    assert len(find_motions([square, off], [square, off], 0.05)) == 1
    assert find_motions([square, bar], [square, affinity.rotate(bar, 45)], 0.05) == []
    assert find_motions([square, bar], [square, affinity.translate(bar, 0.3, 0)], 0.05) == []


@pytest.mark.parametrize("seed", range(5))
def test_mirror_images_of_drawn_parts_are_not_the_same(seed):
    a = star(seed, 7)
    assert find_motions([a], [affinity.scale(a, -1, 1)], 0.5) == []


@pytest.mark.parametrize("seed", range(4))
def test_no_motion_is_missed_that_a_scan_finds(seed):
    """Oracle: shapely's distance over a grid of turns, centroids together, for nearly symmetric figures."""
    a = noisy(regular(5 + seed, 20.0), seed, 0.8)
    b = noisy(regular(5 + seed, 20.0), seed + 50, 0.8)
    a, b = (affinity.translate(x, -x.centroid.x, -x.centroid.y) for x in (a, b))
    within = 1.6
    near = [
        turn
        for turn in np.linspace(-math.pi, math.pi, 360, endpoint=False)
        if shapely.hausdorff_distance(moved(a, turn, (0, 0)).boundary, b.boundary, densify=0.1) < within
    ]
    found = find_motions([a], [b], within)
    check(found, [a], [b], within)
    assert near
    for turn in near:
        assert min(abs(math.remainder(turn - item.turn_rad, 2 * math.pi)) for item in found) < 0.2


def test_round_sections_match_at_any_turn_and_say_so():
    tube = regular(64, 25).difference(regular(64, 12))
    found = find_motions(
        [tube, regular(64, 8)], [moved(tube, 0.05, (7, 1)), moved(regular(64, 8), 1, (7, 1))], 0.05
    )
    assert [item.any_turn for item in found] == [True]
    check(found, [tube], [moved(tube, 0.05, (7, 1))], 0.05)
    eccentric = regular(64, 25).difference(affinity.translate(regular(64, 5), 10, 0))
    found = find_motions([eccentric], [eccentric], 0.05)
    assert [(item.any_turn, round(item.turn_rad, 6)) for item in found] == [(False, 0.0)]


def test_round_sections_that_are_not_within_reach_are_told_apart():
    assert find_motions([regular(64, 25)], [regular(64, 25.2)], 0.05) == []
    assert find_motions([regular(128, 25)], [regular(128, 25.03)], 0.05)[0].any_turn


def test_holes_count():
    plate = shapely.box(-20, -20, 20, 20)
    a = plate.difference(affinity.translate(regular(6, 4), 8, 8))
    assert len(find_motions([a], [a], 0.05)) == 1
    assert find_motions([a], [plate], 0.05) == []
    assert find_motions([a], [plate.difference(affinity.translate(regular(6, 4), 8, 7))], 0.05) == []


def test_a_disc_is_not_a_thin_ring_though_their_outlines_are_close():
    disc = regular(256, 20)
    ring = disc.difference(regular(256, 19.99))
    assert find_motions([disc], [ring], 0.1) == []


def test_several_regions_are_one_section():
    two = shapely.union_all([shapely.box(-20, -5, -10, 5), shapely.box(10, -5, 20, 5)])
    assert len(find_motions([two], [moved(two, 1.0, (2, 3))], 0.05)) == 2
    other = shapely.union_all([shapely.box(-20, -5, -10, 5), shapely.box(10.5, -5, 20.5, 5)])
    assert find_motions([two], [other], 0.05) == []


def test_empty_sections_match_only_empty_ones():
    nothing, square = shapely.Polygon(), regular(4)
    assert len(find_motions([square, nothing], [square, nothing], 0.05)) == 4
    assert find_motions([square, nothing], [square, square], 0.05) == []
    assert find_motions([nothing], [nothing], 0.05)[0].any_turn
    assert stack_distance_mm([nothing], [square], 0.0, np.zeros(2)) == math.inf
    with pytest.raises(ValueError, match="same heights"):
        find_motions([square], [square, square], 0.05)


def test_the_furthest_point_may_be_between_corners():
    """A notch's mouth is bridged by a straight edge: its middle, no corner, is furthest from the notch."""
    plate = shapely.box(0, 0, 40, 20)
    notched = plate.difference(shapely.box(10, 10, 30, 20))
    assert shapely.hausdorff_distance(plate.boundary, notched.boundary) == pytest.approx(10.0)
    deep = plate.difference(shapely.Polygon([(10, 20), (30, 20), (20, 2)]))
    seen = shapely.hausdorff_distance(plate.boundary, deep.boundary, densify=0.001)
    found = stack_distance_mm([plate], [deep], 0.0, np.zeros(2))
    assert seen <= found <= seen + 0.02
    assert shapely.hausdorff_distance(plate.boundary, deep.boundary) < found - 1.0


@given(st.integers(0, 60), ANGLES, SHIFTS)
def test_distances_are_those_of_dense_points_from_above(seed, turn, shift):
    a, b = star(seed), star(seed + 1, 11)
    shift = np.array(shift) / 8
    seen = shapely.hausdorff_distance(moved(a, turn, shift).boundary, b.boundary, densify=0.01)
    found = stack_distance_mm([a], [b], turn, shift)
    assert seen <= found + 1e-9
    assert found <= seen + 0.01 * 34


def test_a_search_can_end_early():
    found = find_motions([regular(8)], [regular(8)], 0.01, most=1)
    assert len(found) == 1
    assert isinstance(found[0], PlanarMotion)


# ----------------------------------------------------------------------------------------------------
# KnownSymmetries made of others hold on the surface itself; turns of a prism are the oracle.

CORNERS = 16
CENTRE = np.array([5.0, -3.0, 2.0])


def turn_of_prism(steps, off_rad=0.0):
    angle = 2 * math.pi * steps / CORNERS + off_rad
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


@pytest.fixture(scope="module")
def cut_prism():
    mesh = trimesh.creation.cylinder(radius=20, height=30, sections=CORNERS)
    moved = np.asarray(mesh.vertices) + CENTRE
    return Solid("prism", moved, np.asarray(mesh.faces, dtype=np.int64))


def about_the_axis(rotation, apart_mm):
    return rotation, CENTRE - rotation @ CENTRE, apart_mm


def test_two_in_a_row_are_bounded_by_both_together(cut_prism):
    first, second = (
        SolidSymmetry(*about_the_axis(turn_of_prism(k, off), 0.02)) for k, off in ((3, 8e-4), (4, 9e-4))
    )
    both = first.then(second)
    assert both.apart_mm == pytest.approx(0.04)
    really = solid_congruence_bound_mm(cut_prism, both.rotation, both.shift_mm, 0.1)
    assert 0.005 < really <= both.apart_mm
    undone = first.then(first.back())
    assert undone.rotation == pytest.approx(np.eye(3))
    assert undone.shift_mm == pytest.approx(np.zeros(3))


def test_what_is_asked_for_is_made_of_two(cut_prism):
    known = KnownSymmetries(SurfaceDistance(cut_prism))
    x = np.array([1.0, 0.0, 0.0])
    assert known.taking(x, turn_of_prism(3) @ x, 1e-3) is None
    known.proven(*about_the_axis(turn_of_prism(3), 1e-9))
    known.proven(*about_the_axis(turn_of_prism(5), 1e-9))
    for steps in (3, 5, -3, -5, 8, 2, 6, 10):
        found = known.taking(x, turn_of_prism(steps) @ x, 1e-3)
        assert found.rotation == pytest.approx(turn_of_prism(steps))
        assert solid_congruence_bound_mm(cut_prism, found.rotation, found.shift_mm, 0.01) <= 1e-6
    assert known.taking(x, turn_of_prism(1) @ x, 1e-3) is None


def test_a_rough_one_is_made_exact(cut_prism):
    known = KnownSymmetries(SurfaceDistance(cut_prism))
    rough = about_the_axis(turn_of_prism(3, 2e-4), 0.005)
    assert solid_congruence_bound_mm(cut_prism, *rough[:2], 0.01) > 5e-4
    known.proven(*rough)
    x = np.array([1.0, 0.0, 0.0])
    found = known.taking(x, turn_of_prism(3) @ x, 1e-3)
    assert found.apart_mm < 1e-6
    assert found.rotation == pytest.approx(turn_of_prism(3), abs=1e-9)


# ----------------------------------------------------------------------------------------------------
# Rotational symmetry: found about the right axis, of the right order, and never claimed of what has none.

WITHIN_MM = 0.003


def turned_solid(mesh, turn=None):
    if turn is not None:
        mesh.apply_transform(turn)
    return Solid("part", np.asarray(mesh.vertices, dtype=float), np.asarray(mesh.faces, dtype=np.int64))


def gear(teeth, hole_facets, bent_mm=0.0):
    """A gear whose hole has other facets than it has teeth; one tooth may be bent outwards."""
    ring = []
    for k in range(teeth):
        for part, radius in ((-0.25, 17.0), (-0.15, 20.0), (0.15, 20.0), (0.25, 17.0)):
            angle = 2 * math.pi * (k + part) / teeth
            ring.append((radius * math.cos(angle), radius * math.sin(angle)))
    ring[1] = (ring[1][0] + bent_mm, ring[1][1])
    hole = shapely.Point(0, 0).buffer(4, quad_segs=hole_facets // 4)
    return prism(shapely.Polygon(ring) - hole, 8)


@pytest.mark.parametrize("teeth", sample([5, 12, 20], [5, 12]))
def test_a_gear_has_the_order_of_its_teeth_however_its_hole_is_cut(teeth):
    turn = trimesh.transformations.random_rotation_matrix(np.array([0.1, 0.8, 0.4]))
    found = with_symmetry(turned_solid(gear(teeth, 252), turn), WITHIN_MM).symmetry
    assert found.order == teeth
    assert abs(found.axis @ turn[:3, 2]) == pytest.approx(1.0, abs=1e-6)
    assert found.apart_mm <= WITHIN_MM


def test_a_bent_tooth_is_no_gear():
    assert with_symmetry(turned_solid(gear(12, 48, bent_mm=0.05)), WITHIN_MM).symmetry is None


def test_a_box_and_a_wedge():
    assert with_symmetry(turned_solid(trimesh.creation.box((20, 20, 30))), WITHIN_MM).symmetry.order == 4
    wedge = prism(shapely.Polygon([(0, 0), (40, 0), (40, 21)]), 20)
    assert with_symmetry(turned_solid(wedge), WITHIN_MM).symmetry is None


def test_orbits_are_the_states_that_turns_make_of_each_other():
    part = with_symmetry(turned_solid(gear(12, 48)), WITHIN_MM)
    states, _ = stable_states(part)
    orbits = orbits_of(part, states, 0.1)
    assert sum(len(orbit.members) for orbit in orbits) == len(states)
    assert sorted({len(orbit.members) for orbit in orbits}) == [1, 12]
    for orbit in orbits:
        heights = {round(float(state.offset_mm[2]), 4) for state in orbit.members}
        assert len(heights) == 1
        assert len({round(state.probability, 4) for state in orbit.members}) == 1
        assert orbit.first is orbit.members[0]


def test_a_symmetry_that_is_too_rough_makes_no_orbits():
    part = with_symmetry(turned_solid(gear(12, 52)), 0.05)
    assert part.symmetry.apart_mm > 0.005
    states, _ = stable_states(part)
    assert all(len(orbit.members) == 1 for orbit in orbits_of(part, states, 0.02))


# ----------------------------------------------------------------------------------------------------
# All overlapping boxes are found, each pair once; the oracle looks at every pair.


@pytest.mark.parametrize("count", [0, 1, 3, 5, 17, 100, 600])
def test_pairs_are_those_that_overlap_and_are_of_different_groups(count):
    rng = np.random.default_rng(count)
    lo = rng.uniform(0, 10, (count, 3))
    hi = lo + rng.uniform(0, 4, (count, 3))
    group = rng.integers(-1, 3, count)
    found = [tuple(sorted(pair)) for pairs in overlapping_pairs(lo, hi, group) for pair in pairs.tolist()]
    expected = {
        (j, i)
        for i in range(count)
        for j in range(i)
        if (lo[i] <= hi[j]).all() and (lo[j] <= hi[i]).all() and not group[i] == group[j] >= 0
    }
    assert len(found) == len(set(found))
    assert set(found) == expected
