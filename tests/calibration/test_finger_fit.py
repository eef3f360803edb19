"""The fit of simulated fingers with hidden truth: values, deviations, derivatives, outliers."""

import math
from dataclasses import dataclass

import numpy as np
import pytest
from scipy.stats import chi2
from touched_references import (
    COLUMNS,
    HEADING,
    RADIUS,
    SIGMA_MM,
    SPECS,
    Floats,
    drawn,
    models,
    nearly,
    placings,
    some_places,
    spoilt,
    touches,
)

from palpate.calibration.finger_fit import FingerFit, TouchArrays, fit_fingers, predict_residuals
from palpate.calibration.frame_alignment import BasePose, align_fit, align_to_nominal

GAUGE = 3  # a shift and a turn of everything: what touches cannot show


@dataclass(frozen=True, eq=False)
class Simulated:
    """Touches, the values behind them, and what a fit of them begins with."""

    values: Floats
    touches: TouchArrays
    start: tuple[Floats, Floats]

    def fit(self, given: TouchArrays | None = None) -> FingerFit:
        return fit_fingers(models(), placings(), given or self.touches, self.start)


def simulated(seed: int, sigma_mm: float = SIGMA_MM) -> Simulated:
    rng = np.random.default_rng(seed)
    values, where = drawn(rng), some_places(rng)
    return Simulated(values, touches(values, where, rng, sigma_mm=sigma_mm), nearly(where))


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


def test_errors_are_as_large_as_the_fit_says() -> None:
    """Errors in the hand frame over many rigs, weighed by the stated covariance: chi-square."""
    squares, touched, freedom, problems = 0.0, 0.0, 0, 16
    for seed in range(problems):
        rig = simulated(seed)
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
