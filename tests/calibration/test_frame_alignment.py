"""From a fit to the hand frame: what cannot be known leaves the covariance, and parts add up to bounds."""

import math
from dataclasses import replace

import numpy as np
import pytest
from touched_references import (
    COLUMNS,
    HEADING,
    RADIUS,
    SCALE,
    SPECS,
    ZERO,
    Floats,
    drawn,
    models,
    nearly,
    placings,
    some_places,
    touches,
)

from palpate.calibration.finger_fit import FingerFit, TouchArrays, fit_fingers
from palpate.calibration.frame_alignment import (
    AlignedFit,
    align_fit,
    calibrate_place,
    estimate_array_headings,
    summarise_residuals,
)
from palpate.calibration.measurements import TouchMeasurement

SIZE = 3 * COLUMNS


@pytest.fixture(scope="module")
def fitted() -> tuple[TouchArrays, FingerFit]:
    rng = np.random.default_rng(12)
    values, where = drawn(rng), some_places(rng)[:3]
    given = touches(values, where, rng)
    return given, fit_fingers(models(), placings()[:3], given, nearly(where))


def motions(values: Floats) -> Floats:
    """What shifts along x and y and a turn about the origin do to all values, (3, 21)."""
    rows = np.zeros((3, *values.shape))
    rows[0, :, 0] = rows[1, :, 1] = 1.0
    rows[2, :, 0], rows[2, :, 1], rows[2, :, HEADING] = -values[:, 1], values[:, 0], 1.0
    return rows.reshape(3, -1)


def test_moving_all_places_rigidly_has_no_variance(fitted: tuple[TouchArrays, FingerFit]) -> None:
    _, fit = fitted
    rigid = motions(fit.values)
    only = np.zeros_like(fit.covariance)
    only[:SIZE, :SIZE] = rigid.T @ np.diag([4.0, 4.0, 1e-2]) @ rigid
    assert align_fit(SPECS, replace(fit, covariance=only)).covariance == pytest.approx(0.0, abs=1e-6)
    hand = align_fit(SPECS, fit)
    more = align_fit(SPECS, replace(fit, covariance=fit.covariance + only))
    assert more.covariance == pytest.approx(hand.covariance, abs=1e-6)


def test_the_middle_of_the_bases_is_certain_and_where_the_rig_file_says(
    fitted: tuple[TouchArrays, FingerFit],
) -> None:
    hand = align_fit(SPECS, fitted[1])
    for axis in (0, 1):
        at = np.arange(3) * COLUMNS + axis
        assert hand.covariance[np.ix_(at, at)].sum() == pytest.approx(0.0, abs=1e-9)
        assert hand.values[:, axis].mean() == pytest.approx(np.mean([spec.base_mm[axis] for spec in SPECS]))
    assert np.linalg.eigvalsh(hand.covariance).min() > -1e-9


def test_a_fit_in_another_frame_is_the_same_hand(fitted: tuple[TouchArrays, FingerFit]) -> None:
    """Turned and shifted with its covariance, a fit says the same of the hand."""
    _, fit = fitted
    angle, shift = 0.3, np.array([12.0, -5.0])
    turn = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
    values = fit.values.copy()
    values[:, :2] = fit.values[:, :2] @ turn.T + shift
    values[:, HEADING] += angle
    slopes = np.eye(len(fit.covariance))
    for k in range(3):
        at = slice(k * COLUMNS, k * COLUMNS + 2)
        slopes[at, at] = turn
    moved = replace(fit, values=values, covariance=slopes @ fit.covariance @ slopes.T)
    here, there = align_fit(SPECS, fit), align_fit(SPECS, moved)
    assert there.values == pytest.approx(here.values, abs=1e-9)
    assert there.covariance == pytest.approx(here.covariance, abs=1e-7)
    assert there.frame.angle_rad == pytest.approx(here.frame.angle_rad - angle)


def test_a_place_says_its_deviations_in_the_file_s_units(fitted: tuple[TouchArrays, FingerFit]) -> None:
    hand = align_fit(SPECS, fitted[1])
    for index, model in enumerate(models()):
        place = calibrate_place(model, hand, index, (math.radians(2.0), math.radians(0.1)))
        own, sigma = hand.values[index], np.sqrt(np.diag(hand.of(index)))
        assert place.base_mm == pytest.approx(own[:2])
        assert place.base_sigma_mm == pytest.approx(sigma[:2], rel=1e-3)
        assert math.radians(place.heading_sigma_deg) == pytest.approx(sigma[HEADING], rel=1e-3)
        assert math.remainder(math.radians(place.heading_deg) - own[HEADING], 2 * math.pi) == pytest.approx(
            0, abs=1e-6
        )
        assert (place.array_heading_deg, place.array_heading_sigma_deg) == pytest.approx((2.0, 0.1))
        assert place.tip_radius_mm == pytest.approx(own[RADIUS])
        # A file's zero is that at Goal Position 0, half a turn of the servo before 2048.
        turn = 2 * math.pi * model.mm_per_rad * (1 + own[SCALE])
        assert place.mm_per_turn == pytest.approx(turn)
        assert place.zero_mm == pytest.approx(own[ZERO] - turn / 2)
        assert np.array(place.covariance)[4, 4] == pytest.approx(sigma[ZERO] ** 2, rel=1e-3)


def test_arrays_look_where_touches_were_felt(fitted: tuple[TouchArrays, FingerFit]) -> None:
    """Angles felt from arrays that are turned by known angles, with a gross one among them."""
    given, fit = fitted
    turned, rng = np.radians([2.0, -1.0, 0.5]), np.random.default_rng(5)
    touched = []
    for k, finger in enumerate(given.finger):
        model = models()[finger]
        travel = fit.values[finger, HEADING] - given.ways[k, 0] * fit.values[finger, 5]
        travel += (given.servos_rad[k, 0] - model.aim_zero_rad) / model.gear_ratio
        into = math.atan2(-fit.normal[k, 1], -fit.normal[k, 0])
        felt = into - travel - turned[finger] + rng.normal(0, 0.01)
        felt = math.remainder(felt + (0.5 if k == 4 else 0.0), 2 * math.pi)
        touched.append(TouchMeasurement(model.name, 0, (0.0, 0.0), 1, felt, 0.1, 0.5, 0.1))
    for (middle, sigma), truth in zip(
        estimate_array_headings(touched, given, models(), SPECS, fit), turned, strict=True
    ):
        assert abs(middle - truth) < 4 * sigma
        assert 5e-4 < sigma < 1e-2


def test_residuals_are_counted_once_and_shown_in_the_hand_frame(
    fitted: tuple[TouchArrays, FingerFit],
) -> None:
    given, fit = fitted
    hand: AlignedFit = align_fit(SPECS, fit)
    out = np.arange(len(given.finger)) % 6 == 5
    without = replace(fit, residual_mm=fit.residual_mm + 0.1)
    found = summarise_residuals(given, fit, without, out, [spec.name for spec in SPECS], hand.frame)
    assert found.touches == len(given.finger)
    assert found.held_out == out.sum()
    assert found.rms_mm == pytest.approx(float(np.sqrt((fit.residual_mm**2).mean())), rel=1e-6)
    assert found.held_out_largest_mm == pytest.approx(float(np.abs(fit.residual_mm[out] + 0.1).max()))
    for k, seen in enumerate(found.touches_seen):
        assert seen.finger == SPECS[given.finger[k]].name
        base, centre = hand.values[given.finger[k], :2], (seen.x_mm, seen.y_mm)
        # Places within the hand are as they were in the fit's frame, up to seven digits.
        before = math.dist(fit.values[given.finger[k], :2], fit.centre_mm[k])
        assert math.dist(base, centre) == pytest.approx(before, abs=1e-4)
        assert seen.held_out == out[k]
