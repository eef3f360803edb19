"""KnownSymmetries made of others hold on the surface itself; turns of a prism are the oracle."""

import math

import numpy as np
import pytest
import trimesh

from palpate.cad.parts import Solid
from palpate.cad.solid_symmetries import KnownSymmetries, SolidSymmetry
from palpate.cad.surface_congruence import SurfaceDistance, solid_congruence_bound_mm

CORNERS = 16
CENTRE = np.array([5.0, -3.0, 2.0])


def turn(steps, off_rad=0.0):
    angle = 2 * math.pi * steps / CORNERS + off_rad
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


@pytest.fixture(scope="module")
def prism():
    mesh = trimesh.creation.cylinder(radius=20, height=30, sections=CORNERS)
    moved = np.asarray(mesh.vertices) + CENTRE
    return Solid("prism", moved, np.asarray(mesh.faces, dtype=np.int64))


def about_the_axis(rotation, apart_mm):
    return rotation, CENTRE - rotation @ CENTRE, apart_mm


def test_two_in_a_row_are_bounded_by_both_together(prism):
    first, second = (SolidSymmetry(*about_the_axis(turn(k, off), 0.02)) for k, off in ((3, 8e-4), (4, 9e-4)))
    both = first.then(second)
    assert both.apart_mm == pytest.approx(0.04)
    really = solid_congruence_bound_mm(prism, both.rotation, both.shift_mm, 0.1)
    assert 0.005 < really <= both.apart_mm
    undone = first.then(first.back())
    assert undone.rotation == pytest.approx(np.eye(3))
    assert undone.shift_mm == pytest.approx(np.zeros(3))


def test_what_is_asked_for_is_made_of_two(prism):
    known = KnownSymmetries(SurfaceDistance(prism))
    x = np.array([1.0, 0.0, 0.0])
    assert known.taking(x, turn(3) @ x, 1e-3) is None
    known.proven(*about_the_axis(turn(3), 1e-9))
    known.proven(*about_the_axis(turn(5), 1e-9))
    for steps in (3, 5, -3, -5, 8, 2, 6, 10):
        found = known.taking(x, turn(steps) @ x, 1e-3)
        assert found.rotation == pytest.approx(turn(steps))
        assert solid_congruence_bound_mm(prism, found.rotation, found.shift_mm, 0.01) <= 1e-6
    assert known.taking(x, turn(1) @ x, 1e-3) is None


def test_a_rough_one_is_made_exact(prism):
    known = KnownSymmetries(SurfaceDistance(prism))
    rough = about_the_axis(turn(3, 2e-4), 0.005)
    assert solid_congruence_bound_mm(prism, *rough[:2], 0.01) > 5e-4
    known.proven(*rough)
    x = np.array([1.0, 0.0, 0.0])
    found = known.taking(x, turn(3) @ x, 1e-3)
    assert found.apart_mm < 1e-6
    assert found.rotation == pytest.approx(turn(3), abs=1e-9)
