"""Rotational symmetry: found about the right axis, of the right order, and never claimed of what has none."""

import math

import numpy as np
import pytest
import shapely
import trimesh
from solids import prism

from palpate.cad.parts import Solid
from palpate.cad.solid_symmetries import orbits_of, with_symmetry
from palpate.cad.stable_states import stable_states

WITHIN_MM = 0.003


def solid(mesh, turn=None):
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


@pytest.mark.parametrize("teeth", [5, 12, 20])
def test_a_gear_has_the_order_of_its_teeth_however_its_hole_is_cut(teeth):
    turn = trimesh.transformations.random_rotation_matrix(np.array([0.1, 0.8, 0.4]))
    found = with_symmetry(solid(gear(teeth, 252), turn), WITHIN_MM).symmetry
    assert found.order == teeth
    assert abs(found.axis @ turn[:3, 2]) == pytest.approx(1.0, abs=1e-6)
    assert found.apart_mm <= WITHIN_MM


def test_a_bent_tooth_is_no_gear():
    assert with_symmetry(solid(gear(12, 48, bent_mm=0.05)), WITHIN_MM).symmetry is None


def test_a_box_and_a_wedge():
    assert with_symmetry(solid(trimesh.creation.box((20, 20, 30))), WITHIN_MM).symmetry.order == 4
    wedge = prism(shapely.Polygon([(0, 0), (40, 0), (40, 21)]), 20)
    assert with_symmetry(solid(wedge), WITHIN_MM).symmetry is None


def test_orbits_are_the_states_that_turns_make_of_each_other():
    part = with_symmetry(solid(gear(12, 48)), WITHIN_MM)
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
    part = with_symmetry(solid(gear(12, 52)), 0.05)
    assert part.symmetry.apart_mm > 0.005
    states, _ = stable_states(part)
    assert all(len(orbit.members) == 1 for orbit in orbits_of(part, states, 0.02))
