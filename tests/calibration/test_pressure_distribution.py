"""Columns' shares of a press, against the emulated skin and what must hold of any."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from simulated_presses import COLS, DESCRIPTION, PITCH, by_column, disc, face

from palpate.calibration.press_model import PressureDistribution, dent_and_bearing, distribute_pressure
from palpate.drivers.emulators.tip import tip_load

COLUMNS = np.array(DESCRIPTION.columns)
RADIUS = 5.0
FEW = settings(max_examples=25)
angles = st.floats(-1.2, 1.2)
dents = st.floats(0.01, 0.4)
curvatures = st.floats(0.0, 1.0)


def one(towards: float, dent: float, curvature: float) -> PressureDistribution:
    return distribute_pressure(COLUMNS, PITCH, *(np.array([value]) for value in (towards, dent, curvature)))


@FEW
@given(angles, dents, curvatures)
def test_shares_of_a_patch_on_the_array_sum_to_one(towards: float, dent: float, curvature: float) -> None:
    found = one(towards, dent, curvature)
    assert found.share.sum() == pytest.approx(1.0, abs=1e-5)
    assert (found.share >= 0).all()
    assert 0 < found.lean[0] <= 1


@FEW
@given(angles, dents, curvatures)
def test_mirrored_contacts_have_mirrored_shares(towards: float, dent: float, curvature: float) -> None:
    left, right = one(towards, dent, curvature), one(-towards, dent, curvature)
    assert left.share[0] == pytest.approx(right.share[0, ::-1], abs=1e-12)


@FEW
@given(angles, dents, curvatures)
def test_a_turn_by_a_column_moves_shares_by_one(towards: float, dent: float, curvature: float) -> None:
    here, there = one(towards, dent, curvature), one(towards + PITCH, dent, curvature)
    assert here.share[0, :-1] == pytest.approx(there.share[0, 1:], abs=1e-9)


def test_what_is_beside_the_array_is_missing() -> None:
    edge = float(COLUMNS[-1]) + PITCH / 2
    assert one(edge, 0.2, 0.0).share.sum() == pytest.approx(0.5, abs=1e-6)
    assert one(math.pi, 0.1, 0.0).share.sum() == 0.0


@FEW
@given(angles, st.floats(0.05, 0.3), st.sampled_from([None, 8.0, 25.0, 60.0]))
def test_agrees_with_the_emulated_skin(towards: float, dent: float, disc_mm: float | None) -> None:
    away = RADIUS * (1 - dent)
    if disc_mm is None:
        outline, aim, centre = face(), 0.0, np.array([-away, 0.0])
    else:
        outline, aim = disc(disc_mm), towards
        centre = -(disc_mm + away) * np.array([math.cos(aim), math.sin(aim)])
    touch = tip_load(outline, centre, RADIUS, 3.0)
    assert touch is not None
    found = one(towards, dent, 0.0 if disc_mm is None else RADIUS / disc_mm)
    total = float(touch.by_ray_n.sum())
    felt = by_column(touch.angle, touch.by_ray_n, aim - towards) / total
    # Rays a quarter of a degree apart: a column's edge is off by half of that at most, in 13.5 degrees.
    assert found.share[0] == pytest.approx(felt, abs=0.01)
    push = float(np.hypot(*touch.force_n))
    assert push == pytest.approx(total * found.lean[0], rel=0.002)
    # The force on the axis is as on a flat wall: on a small disc, less of what taxels see cancels out.
    assert total == pytest.approx(3.0 * dent * RADIUS, rel=0.01 + dent / 16)
    assert felt.shape == (COLS,)


@FEW
@given(st.floats(0.0, 1.5), angles, st.sampled_from([0.0, 0.02, 0.04, 0.2]))
def test_approach_is_the_triangle_of_both_centres(travel: float, bearing: float, curvature: float) -> None:
    dent, turned = dent_and_bearing(np.array([travel]), np.array([bearing]), RADIUS, np.array([curvature]))
    reference = 1 / max(curvature, 1e-7)  # a face is a huge disc
    towards = (RADIUS + reference) * complex(math.cos(bearing), math.sin(bearing)) - travel
    assert dent[0] == pytest.approx(RADIUS + reference - abs(towards), abs=1e-4)
    assert turned[0] == pytest.approx(math.atan2(towards.imag, towards.real), abs=1e-6)
