"""A solid that stays as its file has it."""

import math

import numpy as np
import pytest
import trimesh
from solids import ELL, prism

from palpate.cad.parts import Solid
from palpate.cad.stable_states import state_as_drawn, volume_mm3


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
