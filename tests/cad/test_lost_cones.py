"""Cones that a tessellation has lost: covered again, and how far off; judged by formula and by trimesh."""

import math
from pathlib import Path

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from palpate.cad.lost_cones import Cone, close_cones, cones_in

STEP = Path(__file__).parent / "step"


def ring(radius, z, count, start, end=math.tau):
    """Points on a circle from an angle on; all of it, or an arc with both its ends."""
    turn = start + (end - 0.0) * np.arange(count) / (count if end == math.tau else count - 1)
    return np.column_stack([radius * np.cos(turn), radius * np.sin(turn), np.full(count, z)])


def fan(indices, centre):
    return [(centre, a, b) for a, b in zip(indices, [*indices[1:], indices[0]], strict=True)]


def frustum(half_angle, low, high, counts, starts):
    """Cap below and above of a frustum of a cone with its apex at 0; with `low` 0 there is none below."""
    tangent = math.tan(half_angle)
    top = ring(high * tangent, high, counts[1], starts[1])
    above = list(range(len(top)))
    points, faces = [top, [[0, 0, high]]], fan(above, len(top))
    if low > 0:
        bottom = ring(low * tangent, low, counts[0], starts[0])
        first = len(top) + 1
        points += [bottom, [[0, 0, low]]]
        faces += fan(list(range(first, first + len(bottom)))[::-1], first + len(bottom))
    return np.vstack(points), np.array(faces)


def off_cone(points, half_angle):
    radius = np.hypot(points[:, 0], points[:, 1])
    return np.abs(radius * math.cos(half_angle) - np.abs(points[:, 2]) * math.sin(half_angle))


def inner_points(corners):
    share = np.array([(i, j, 6 - i - j) for i in range(7) for j in range(7 - i)]) / 6
    return np.einsum("sc,mcx->msx", share, corners).reshape(-1, 3)


angles = st.floats(0, math.tau)


@settings(deadline=None, max_examples=60)
@given(
    half_angle=st.floats(0.15, 1.3),
    low=st.one_of(st.just(0.0), st.floats(1.0, 8.0)),
    height=st.floats(0.5, 10.0),
    counts=st.tuples(st.integers(8, 90), st.integers(8, 90)),
    starts=st.tuples(angles, angles),
    seed=st.integers(0, 10_000),
)
def test_bands_and_tips_are_closed_and_as_far_off_as_is_said(half_angle, low, height, counts, starts, seed):
    vertices, faces = frustum(half_angle, low, low + height, counts, starts)
    rng = np.random.default_rng(seed)
    turned, moved = Rotation.random(rng=rng).as_matrix(), rng.uniform(-50, 50, 3)
    cone = Cone(moved, turned @ [0, 0, 1], half_angle)
    (points, closed), off = close_cones((vertices @ turned.T + moved, faces), [cone])
    mesh = trimesh.Trimesh(points, closed, process=False)
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    assert mesh.volume > 0
    new = ((points - moved) @ turned)[closed[len(faces) :]]
    assert off_cone(inner_points(new), half_angle).max() <= off


@pytest.mark.parametrize("arc", [0.4, 2.0])
def test_part_of_a_cone_is_unrolled(arc):
    half_angle, tangent = 0.6, math.tan(0.6)
    lower, upper = ring(5 * tangent, 5.0, 9, 0.3, arc), ring(9 * tangent, 9.0, 12, 0.3, arc)
    edge = np.vstack([lower, upper[::-1]])
    apex = np.array([[0.0, 0.0, -20.0]])  # of a pyramid over the hole: closed with it
    faces = np.array(fan(list(range(len(edge)))[::-1], len(edge)))
    cone = Cone(np.zeros(3), np.array([0.0, 0.0, 1.0]), half_angle)
    (points, closed), off = close_cones((np.vstack([edge, apex]), faces), [cone])
    mesh = trimesh.Trimesh(points, closed, process=False)
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    assert off_cone(inner_points(points[closed[len(faces) :]]), half_angle).max() <= off < 0.2


def test_holes_that_are_on_no_cone_stay_open():
    vertices, faces = frustum(0.6, 3.0, 8.0, (20, 30), (0.0, 0.1))
    other = Cone(np.array([0.0, 0.0, 0.5]), np.array([0.0, 0.0, 1.0]), 0.6)
    (_, closed), off = close_cones((vertices, faces), [other])
    assert len(closed) == len(faces)
    assert off == 0


def test_a_cone_is_read_from_its_file():
    text = (STEP / "cone.step").read_bytes()
    some = cones_in(text, 1.0)
    (cone,) = [item for item in some if item.half_angle_rad > 0.1]  # radians; the other one would be degrees
    assert cone.apex_mm == pytest.approx([0, 0, 45])
    assert np.abs(cone.axis) == pytest.approx([0, 0, 1])
    assert cone.half_angle_rad == pytest.approx(math.atan(1 / 3))
