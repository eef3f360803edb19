"""Rigid motions between stacks of sections, against shapely's distances and known copies."""

import math

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from shapely import affinity

from palpate.cad.planar_congruence import PlanarMotion, find_motions, stack_distance_mm

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
def test_mirror_images_are_not_the_same(seed):
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
