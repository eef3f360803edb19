"""Priors of slides: by their stops against closed forms and many trials, and by what the rig file says."""

import math

import numpy as np
import pytest
from touched_references import SPECS

from palpate.calibration.actuator_estimators import Backlash, StopStalls
from palpate.calibration.finger_model import slide_in_contact, slide_model, zero_in_file_mm

STOPS_MM = (43.0, 255.0)
TICK_RAD = 2 * math.pi / 4096
SPEC = SPECS[0]


def stalled_rad(zero_mm: float, per_rad: float, half_mm: float) -> tuple[float, float]:
    """Servo angles where a drive stands that presses its carriage against each stop.

    `zero_mm`: where the drive is at angle 0. Pushing back it is a half play behind the carriage, pushing on
    a half play before it.
    """
    return (STOPS_MM[0] - half_mm - zero_mm) / per_rad, (STOPS_MM[1] + half_mm - zero_mm) / per_rad


def test_stops_give_the_line_on_which_touches_lie() -> None:
    for per_rad in (15.9, -15.9):
        back, front = stalled_rad(90.3, per_rad, 0.12)
        slide = slide_in_contact(
            SPEC, Backlash(0.12, 0.0), StopStalls(STOPS_MM, np.array([back]), np.array([front]))
        )
        # In a touch the tip is a half play behind the drive.
        assert slide.zero_mm == pytest.approx(90.3 - 0.12)
        assert slide.mm_per_rad == pytest.approx(per_rad)


def test_one_play_too_little_tilts_that_line() -> None:
    back, front = stalled_rad(90.3, 15.9, 0.12)
    slide = slide_in_contact(
        SPEC, Backlash(0.0, 0.0), StopStalls(STOPS_MM, np.array([back]), np.array([front]))
    )
    assert slide.mm_per_rad == pytest.approx(15.9 * 212 / 212.24)
    assert slide.zero_mm + slide.mm_per_rad * front == pytest.approx(STOPS_MM[1])


@pytest.mark.parametrize("per_rad", [15.9, -15.9])
def test_deviations_hold_in_many_trials(per_rad: float) -> None:
    """Encoder steps, scatter of the stalls and of the play put values off as much as is stated."""
    rng = np.random.default_rng(11)
    half, sigma_half, sigma_rad, off = 0.12, 0.02, 0.006, []
    for _ in range(400):
        given = half + rng.normal(0, sigma_half)
        zero = 90.0 + rng.uniform(-1, 1)
        angles = np.array(stalled_rad(zero, per_rad, half))[:, None] + rng.normal(0, sigma_rad, (2, 40))
        stalls = StopStalls(STOPS_MM, *np.round(angles / TICK_RAD) * TICK_RAD)
        slide = slide_in_contact(SPEC, Backlash(given, sigma_half), stalls)
        error = np.array([slide.zero_mm - (zero - half), slide.mm_per_rad / per_rad - 1])
        off.append(error @ np.linalg.solve(slide.covariance, error))
        assert np.linalg.eigvalsh(slide.covariance).min() > 0
    assert np.mean(off) == pytest.approx(2.0, rel=0.25)


def test_without_stops_the_rig_file_has_the_say() -> None:
    slide = slide_in_contact(SPEC)
    assert slide.mm_per_rad == pytest.approx(100 / (2 * math.pi))
    # Half a turn from the file's zero, and half of the largest play behind the drive.
    assert slide.zero_mm == pytest.approx(40.0 + 50.0 - 0.1)
    assert math.sqrt(slide.covariance[0, 0]) >= 0.5 / math.sqrt(3)
    assert math.sqrt(slide.covariance[1, 1]) == pytest.approx(0.003 / math.sqrt(3))


def test_a_measured_play_counts_before_the_described_one() -> None:
    assert slide_in_contact(SPEC, Backlash(0.06, 0.004)).zero_mm == pytest.approx(90.0 - 0.06)


def test_a_model_says_what_the_rig_file_says() -> None:
    slide = slide_in_contact(SPEC, Backlash(0.06, 0.004))
    model = slide_model(SPEC, slide)
    x, y, heading, radius, zero, play, scale = model.prior
    assert (x, y) == SPEC.base_mm
    assert heading == pytest.approx(math.radians(270.0))
    assert (radius, zero, scale) == (5.0, slide.zero_mm, 0.0)
    assert play == pytest.approx(math.radians(0.01))
    assert (model.gear_ratio, model.mm_per_rad) == (5.0, slide.mm_per_rad)
    assert model.aim_zero_rad == pytest.approx(0.0)
    sigma = np.sqrt(np.diag(model.covariance))
    assert sigma[:2] == pytest.approx(3.0 / 2)  # a disc of 3 mm: half of it in each direction
    assert sigma[2] == pytest.approx(math.radians(3.0) / math.sqrt(3))
    assert sigma[3] == pytest.approx(0.3 / math.sqrt(3))
    assert (np.linalg.eigvalsh(model.covariance) > 0).all()


def test_zeros_hold_half_a_turn_apart() -> None:
    assert zero_in_file_mm(90.0, SPEC.slide.mm_per_rad) == pytest.approx(40.0)
