"""The fit of slides: model, alignment of the frame, freedom of the gauge."""

import math
from dataclasses import dataclass, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize
from scipy.stats import chi2

from palpate.calibration.actuator_estimators import Backlash, StopStalls
from palpate.calibration.finger_fit import FingerFit, TouchArrays, fit_fingers, predict_residuals
from palpate.calibration.frame_alignment import (
    HEADING_ARM_MM,
    AlignedFit,
    BasePose,
    RigidMotion,
    align_fit,
    align_to_nominal,
    calibrate_place,
    estimate_array_headings,
    summarise_residuals,
)
from palpate.calibration.measurements import TouchMeasurement
from palpate.calibration.slide_model import SlideModel, slide_in_contact, zero_in_file_mm
from support.benches.touched_references import (
    COLUMNS,
    HEADING,
    PRIOR_SIGMA,
    RADIUS,
    SCALE,
    SIGMA_MM,
    SPECS,
    ZERO,
    Floats,
    drawn,
    models,
    nearly,
    placings,
    some_places,
    spoilt,
    touches,
)

# ----------------------------------------------------------------------------------------------------
# The fit of simulated fingers with hidden truth: values, deviations, derivatives, outliers.

GAUGE = 3  # a shift and a turn of everything: what touches cannot show


@dataclass(frozen=True, eq=False)
class Simulated:
    """Touches, the values behind them, and what a fit of them begins with."""

    values: Floats
    touches: TouchArrays
    start: tuple[Floats, Floats]
    encoder_sigma_rad: float = PRIOR_SIGMA[-1]

    def fit(self, given: TouchArrays | None = None) -> FingerFit:
        return fit_fingers(models(self.encoder_sigma_rad), placings(), given or self.touches, self.start)


def simulated(seed: int, sigma_mm: float = SIGMA_MM, encoder_sigma_rad: float = PRIOR_SIGMA[-1]) -> Simulated:
    rng = np.random.default_rng(seed)
    values, where = drawn(rng, encoder_sigma_rad), some_places(rng)
    return Simulated(values, touches(values, where, rng, sigma_mm=sigma_mm), nearly(where), encoder_sigma_rad)


def seen_from_the_hand(values: Floats) -> Floats:
    """True values in the frame in which bases and headings are nearest to the rig file's."""
    nominal = [BasePose(spec.base_mm, np.radians(spec.heading_deg)) for spec in SPECS]
    places = [BasePose((float(v[0]), float(v[1])), float(v[HEADING])) for v in values]
    frame = align_to_nominal(nominal, places)
    moved = values.copy()
    for row, place in zip(moved, [frame.place(place) for place in places], strict=True):
        row[:2], row[HEADING] = place.base_mm, place.heading_rad
    return moved


def test_touches_without_noise_show_the_truth() -> None:
    rig = simulated(1, sigma_mm=1e-6)
    fit = rig.fit()
    assert not fit.outlier.any()
    assert np.abs(fit.residual_mm).max() < 1e-5
    off = align_fit(SPECS, fit).values - seen_from_the_hand(rig.values)
    # Zeros, scales and plays are known beforehand only so well, and radii and bases follow.
    assert np.abs(off[:, :2]).max() < 0.1
    assert np.abs(off[:, HEADING]).max() < 2e-3
    assert np.abs(off[:, RADIUS]).max() < 0.1


@pytest.mark.parametrize(("encoder_deg", "problems"), [(0.0, 16), (1.5, 8)])
def test_errors_are_as_large_as_the_fit_says(encoder_deg: float, problems: int) -> None:
    """Errors in the hand frame over many rigs, weighed by the stated covariance: chi-square."""
    squares, touched, freedom = 0.0, 0.0, 0
    encoder_sigma_rad = max(math.radians(encoder_deg) / math.sqrt(6), PRIOR_SIGMA[-1])
    for seed in range(problems):
        rig = simulated(seed, encoder_sigma_rad=encoder_sigma_rad)
        fit = rig.fit()
        hand = align_fit(SPECS, fit)
        off = (hand.values - seen_from_the_hand(rig.values)).ravel()
        # Each value in its own deviation: mm, rad and shares have no common size to tell the rank by.
        sigma = np.sqrt(np.diag(hand.covariance))
        shares, axes = np.linalg.eigh(hand.covariance / np.outer(sigma, sigma))
        assert (shares > 1e-6).sum() == len(off) - GAUGE
        own = (axes.T @ (off / sigma))[GAUGE:]
        squares += float((own**2 / shares[GAUGE:]).sum())
        touched, freedom = touched + fit.chi_square, freedom + fit.freedom
        assert np.abs(off / sigma).max() < 4.5
    low, high = chi2.ppf([0.005, 0.995], problems * (len(off) - GAUGE))
    assert low < squares < high
    # Degrees of freedom are counted in whole ones, rounded down.
    low, high = chi2.ppf([0.005, 0.995], freedom)
    assert low < touched < high + problems


def test_a_plate_is_found_however_it_lies() -> None:
    rng = np.random.default_rng(2)
    values, where = drawn(rng), some_places(rng)[2:3]
    given = touches(values, where, rng, offsets_mm=(-10.0, 0.0, 10.0))
    fit = fit_fingers(models(), placings()[2:3], given)
    assert not fit.outlier.any()
    assert fit.chi_square < chi2.ppf(0.999, fit.freedom)
    # A square looks the same four times in a turn; the rig itself may have been turned by a degree or so.
    assert abs(math.remainder(fit.poses[0, 2] - where[0].theta_rad, math.pi / 2)) < math.radians(3.0)


def test_derivatives_are_those_of_the_residuals() -> None:
    rig = simulated(3)
    poses = rig.start[1]
    _, _, _, rows = predict_residuals(models(), placings(), rig.touches, rig.values, poses)
    unknowns = np.concatenate([rig.values.ravel(), poses.ravel()])
    step = 1e-6

    def residuals(x: Floats) -> Floats:
        own, there = x[: rig.values.size].reshape(-1, COLUMNS), x[rig.values.size :].reshape(-1, 3)
        return predict_residuals(models(), placings(), rig.touches, own, there)[0]

    for column in range(len(unknowns)):
        to = step * (np.arange(len(unknowns)) == column)
        slope = (residuals(unknowns + to) - residuals(unknowns - to)) / (2 * step)
        assert rows[:, column] == pytest.approx(slope, abs=1e-4), column


def test_a_gross_outlier_is_marked_and_spoils_nothing() -> None:
    rig, number = simulated(4), 11
    fit = rig.fit(spoilt(rig.touches, number, 1.5))
    assert np.flatnonzero(fit.outlier).tolist() == [number]
    assert abs(fit.residual_mm[number]) > 0.5
    without = rig.fit(rig.touches.with_used(np.arange(len(rig.touches.finger)) != number))
    assert not without.outlier.any()
    assert fit.values == pytest.approx(without.values, abs=1e-3)
    assert fit.freedom == without.freedom


def test_what_is_held_out_has_a_residual_and_no_say() -> None:
    rig = simulated(5)
    kept = np.arange(len(rig.touches.finger)) % 4 != 0
    fit = rig.fit(rig.touches.with_used(kept))
    again = rig.fit(spoilt(rig.touches, 0, 1.5).with_used(kept))
    assert again.values == pytest.approx(fit.values, abs=1e-9)
    assert abs(again.residual_mm[0] - fit.residual_mm[0]) > 0.5
    held = fit.residual_mm[~kept]
    assert 0.5 < np.sqrt((held**2).mean()) / SIGMA_MM < 2.0


# ----------------------------------------------------------------------------------------------------
# Priors of slides: by their stops against closed forms and many trials, and by what the rig file says.

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
    model = SlideModel.with_slide(SPEC, slide)
    x, y, heading, radius, zero, play, scale = model.prior[:7]
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


# ----------------------------------------------------------------------------------------------------
# From a fit to the hand frame: what cannot be known leaves the covariance, and parts add up to bounds.

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


# ----------------------------------------------------------------------------------------------------
# The hand frame: any rigid motion is undone, and what is left is the least there can be.

ANGLES = st.floats(-math.pi, math.pi)
NEAR = st.floats(-200.0, 200.0)


def places(seed: int, count: int) -> list[BasePose]:
    rng = np.random.default_rng(seed)
    return [
        BasePose((float(rng.uniform(-200, 200)), float(rng.uniform(-200, 200))), float(rng.uniform(-3, 3)))
        for _ in range(count)
    ]


def moved(place: BasePose, angle: float, shift: complex) -> BasePose:
    """Turned about the origin, then shifted: with complex numbers, so that no matrix has to be right."""
    base = complex(*place.base_mm) * complex(math.cos(angle), math.sin(angle)) + shift
    return BasePose((base.real, base.imag), place.heading_rad + angle)


def disagreement(nominal: list[BasePose], found: list[BasePose], angle: float, shift: complex) -> float:
    """Sum of squares of bases, and of points as far away as headings count."""
    total = 0.0
    for one, other in zip(nominal, (moved(place, angle, shift) for place in found), strict=True):
        total += abs(complex(*one.base_mm) - complex(*other.base_mm)) ** 2
        arms = [complex(math.cos(p.heading_rad), math.sin(p.heading_rad)) for p in (one, other)]
        total += HEADING_ARM_MM**2 * abs(arms[0] - arms[1]) ** 2
    return total


@settings(max_examples=60)
@given(st.integers(0, 1000), st.integers(1, 5), ANGLES, NEAR, NEAR)
def test_any_motion_is_undone(seed: int, count: int, angle: float, x: float, y: float) -> None:
    nominal = places(seed, count)
    found = [moved(place, angle, complex(x, y)) for place in nominal]
    frame = align_to_nominal(nominal, found)
    for wanted, place in zip(nominal, found, strict=True):
        back = frame.place(place)
        assert back.base_mm == pytest.approx(wanted.base_mm, abs=1e-7)
        assert math.remainder(back.heading_rad - wanted.heading_rad, 2 * math.pi) == pytest.approx(
            0, abs=1e-9
        )


@pytest.mark.parametrize("seed", range(6))
def test_nothing_brings_places_nearer(seed: int) -> None:
    rng = np.random.default_rng(seed)
    nominal = places(seed, 1 + seed % 4)
    off = [
        BasePose(
            (place.base_mm[0] + float(rng.normal(0, 5)), place.base_mm[1] + float(rng.normal(0, 5))),
            place.heading_rad + float(rng.normal(0, 0.1)),
        )
        for place in nominal
    ]
    found = [moved(place, 0.7, 12 - 9j) for place in off]
    frame = align_to_nominal(nominal, found)
    own = disagreement(nominal, found, frame.angle_rad, complex(*frame.shift_mm))
    best = minimize(
        lambda x: disagreement(nominal, found, float(x[0]), complex(x[1], x[2])),
        [-0.7, 0.0, 0.0],
        method="BFGS",
        options={"gtol": 1e-9},
    )
    assert own <= best.fun + 1e-6
    assert (frame.angle_rad, *frame.shift_mm) == pytest.approx(best.x, abs=1e-3)


def test_one_finger_is_put_where_it_is_described() -> None:
    """Its base and its heading say all; three unknowns are used up."""
    nominal, found = [BasePose((10.0, 190.0), -1.5)], [BasePose((-3.0, 150.0), 2.0)]
    back = align_to_nominal(nominal, found).place(found[0])
    assert back.base_mm == pytest.approx((10.0, 190.0))
    assert math.remainder(back.heading_rad + 1.5, 2 * math.pi) == pytest.approx(0.0, abs=1e-9)


def test_points_and_places_move_alike() -> None:
    frame = RigidMotion(math.pi / 2, (10.0, -5.0))
    assert frame.point_mm((2.0, 1.0)) == pytest.approx((9.0, -3.0))
    place = frame.place(BasePose((2.0, 1.0), 0.25))
    assert place.base_mm == pytest.approx((9.0, -3.0))
    assert place.heading_rad == pytest.approx(0.25 + math.pi / 2)


@pytest.mark.parametrize(("nominal", "found"), [(0, 0), (1, 2), (3, 2)])
def test_numbers_of_places_must_agree(nominal: int, found: int) -> None:
    with pytest.raises(ValueError, match="at least one"):
        align_to_nominal(places(0, nominal), places(1, found))
