"""Which touches are predicted, against simulated ones, and that the chosen ones say more than others."""

import math

import numpy as np
import pytest

from palpate.calibration.experiment_design import (
    PredictedTouches,
    choose_touches,
    predict_touches,
    probes_towards,
)
from palpate.calibration.finger_fit import FingerFit, fit_fingers
from palpate.calibration.measurements import ServoPath
from support.benches.touched_references import (
    AIM_ZEROS_RAD,
    GEARS,
    HEADING,
    SIGMA_MM,
    Floats,
    Laid,
    drawn,
    laid,
    met,
    models,
    nearly,
    placings,
    servos_rad,
    some_places,
    touches,
)

FIRST_MM, LAST_MM = 50.0, 245.0
AIMS = 25
PLACING = 2
FEW = 2  # touches of each finger by which the plate was found


def approaches() -> list[ServoPath]:
    """Ways of all fingers, a degree or so apart, from near their bases through the table's middle."""
    found = []
    for index, model in enumerate(models()):
        for off in np.radians(np.linspace(-17.0, 17.0, AIMS)):
            direction = float(model.prior[HEADING] + off)
            aim, start = servos_rad(model.prior, index, direction, FIRST_MM, 0.0)
            end = servos_rad(model.prior, index, direction, LAST_MM, 0.0)[1]
            found.append(ServoPath(index, np.array([[aim, start], [aim, end]]), LAST_MM - FIRST_MM))
    return found


@pytest.fixture(scope="module")
def fit() -> FingerFit:
    """A fit of many touches of a disc, and of few of a plate that has just been found."""
    rng = np.random.default_rng(15)
    values, where = drawn(rng), some_places(rng)[: PLACING + 1]
    given = touches(values, where, rng)
    seen = np.zeros(3 * len(where), dtype=int)
    used = np.ones(len(given.finger), dtype=bool)
    for k, key in enumerate(given.placing * 3 + given.finger):
        used[k] = given.placing[k] < PLACING or seen[key] < FEW
        seen[key] += 1
    return fit_fingers(models(), placings()[: PLACING + 1], given.with_used(used), nearly(where))


@pytest.fixture(scope="module")
def predicted(fit: FingerFit) -> PredictedTouches:
    return predict_touches(models(), placings()[: PLACING + 1], fit, PLACING, approaches())


def as_fitted(fit: FingerFit) -> Laid:
    x, y, theta = fit.poses[PLACING]
    return laid(placings()[PLACING].reference, float(x), float(y), float(theta))


def direction_rad(fit: FingerFit, approach: ServoPath) -> float:
    own = approach.finger
    return float(fit.values[own, HEADING] + (approach.servos_rad[0, 0] - AIM_ZEROS_RAD[own]) / GEARS[own])


def test_approaches_end_where_they_would_if_the_fit_were_true(
    fit: FingerFit, predicted: PredictedTouches
) -> None:
    plate, hits = as_fitted(fit), 0
    for k, approach in enumerate(approaches()):
        own = fit.values[approach.finger]
        expected = met(own[:2], direction_rad(fit, approach), plate, own[3])
        if expected is None:
            assert math.isnan(predicted.travel_mm[k])
            continue
        if expected.room_mm == 0.0:
            assert not predicted.good[k]
            continue
        hits += 1
        _, slide = servos_rad(own, approach.finger, 0.0, expected.travel_mm, 0.0)
        (found,) = approach.servos_at(predicted.travel_mm[[k]])
        assert found[1] == pytest.approx(slide, abs=1e-5)
        assert predicted.oblique_rad[k] == pytest.approx(expected.oblique_rad, abs=1e-4)
        assert predicted.room_mm[k] == pytest.approx(expected.room_mm, abs=1e-3)
        wanted = abs(expected.oblique_rad) <= math.radians(48.0) and expected.room_mm >= 4.0
        assert predicted.good[k] == wanted
    assert hits > AIMS


def told(predicted: PredictedTouches, covariance: Floats, numbers: list[int]) -> float:
    """By how much touches shrink the ellipsoid of what is unknown: the logarithm of its volumes' ratio."""
    rows = predicted.rows[numbers]
    return float(np.linalg.slogdet(np.eye(len(rows)) + rows @ covariance @ rows.T / SIGMA_MM**2)[1])


def test_chosen_touches_say_more_than_random_ones(fit: FingerFit, predicted: PredictedTouches) -> None:
    count, every = 3, approaches()
    grips = choose_touches(predicted, every, models(), fit.covariance, SIGMA_MM, count)
    chosen = [probe.approach for grip in grips for probe in grip]
    assert len(grips) == count
    assert len(set(chosen)) == len(chosen)
    assert predicted.good[chosen].all()
    assert [[every[probe.approach].finger for probe in grip] for grip in grips] == [[0, 1, 2]] * count
    rng = np.random.default_rng(0)
    finger = np.array([approach.finger for approach in every])
    others = []
    for _ in range(100):
        drawn_ones = [
            rng.choice(np.flatnonzero(predicted.good & (finger == k)), count, False) for k in range(3)
        ]
        others.append(told(predicted, fit.covariance, [int(k) for k in np.concatenate(drawn_ones)]))
    assert told(predicted, fit.covariance, chosen) > max(others) - 1e-9
    assert max(others) > min(others) + 0.1


def test_a_probe_goes_beyond_its_contact_and_not_beyond_its_approach(
    fit: FingerFit, predicted: PredictedTouches
) -> None:
    every = approaches()
    for grip in choose_touches(predicted, every, models(), fit.covariance, SIGMA_MM, 4):
        for probe in grip:
            approach = every[probe.approach]
            beyond = probe.end_mm - predicted.travel_mm[probe.approach]
            left = approach.length_mm - predicted.travel_mm[probe.approach]
            assert beyond == pytest.approx(min(12.0, left))


def test_a_finger_without_good_touches_takes_no_part(fit: FingerFit, predicted: PredictedTouches) -> None:
    every = approaches()
    mine = np.array([approach.finger == 1 for approach in every])
    nowhere = PredictedTouches(
        np.where(mine, np.nan, predicted.travel_mm), predicted.oblique_rad, predicted.room_mm, predicted.rows
    )
    for grip in choose_touches(nowhere, every, models(), fit.covariance, SIGMA_MM, 2):
        assert [every[probe.approach].finger for probe in grip] == [0, 2]


def test_approaches_pass_a_point_at_the_distance_asked_for() -> None:
    every, values = approaches(), np.array([model.prior for model in models()])
    point = (4.0, -7.0)
    passed = []
    for aside in (-9.0, 0.0, 9.0):
        grip = probes_towards(point, aside, every, models(), values)
        assert [every[probe.approach].finger for probe in grip] == [0, 1, 2]
        for probe in grip:
            approach = every[probe.approach]
            finger, own = approach.finger, values[approach.finger]
            angle = own[HEADING] + (approach.servos_rad[0, 0] - AIM_ZEROS_RAD[finger]) / GEARS[finger]
            rel = np.array(point) - own[:2]
            passed.append(float(math.cos(angle) * rel[1] - math.sin(angle) * rel[0]))
            assert probe.end_mm == approach.length_mm
    sides = np.array(passed).reshape(3, 3)
    # Half of what lies between two approaches there.
    step = 200 * math.radians(34.0) / (AIMS - 1) / 2
    assert np.abs(np.abs(sides) - [[9.0], [0.0], [9.0]]).max() < step
    assert (np.sign(sides[0]) == -np.sign(sides[2])).all()
