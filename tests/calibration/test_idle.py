"""Idle recordings of emulated arrays, whose noise, drift and faults are known."""

import math

import numpy as np
import pytest
from simulated_presses import DESCRIPTION

from palpate.base.errors import InputError
from palpate.calibration.idle_statistics import IdleFit, analyse_idle, least_contact_force_n
from palpate.calibration.measurements import IdleMeasurement
from palpate.drivers.emulators.taxels import Taxels

SHAPE = (DESCRIPTION.rows, DESCRIPTION.cols)


def recorded(taxels: Taxels, start_s: float, frames: int = 1000, rate_hz: float = 100.0) -> IdleMeasurement:
    time_s = start_s + np.arange(frames) / rate_hz
    return IdleMeasurement("f1", taxels.counts(np.zeros((frames, *SHAPE)), time_s), time_s)


def fit(*idles: IdleMeasurement) -> IdleFit:
    return analyse_idle(idles, DESCRIPTION.max_count)


@pytest.mark.parametrize("noise", [0.0, 1.0, 4.0])
def test_noise_and_zeros(noise: float) -> None:
    taxels = Taxels(DESCRIPTION, seed=1, noise_counts=noise, offset_counts=40)
    found = fit(recorded(taxels, 0.0))
    assert found.noise_counts == pytest.approx(math.hypot(noise, 1 / math.sqrt(12)), rel=0.03)
    assert found.zero_counts == pytest.approx(np.full(SHAPE, 40.0), abs=0.5)


@pytest.mark.parametrize("drift", [0.2, 1.0])
def test_drift_is_bounded_and_not_exaggerated(drift: float) -> None:
    # Zeros wander by sines: the fastest of 160 comes near the largest speed within half a minute.
    taxels = Taxels(DESCRIPTION, seed=2, noise_counts=2.0, offset_counts=200, drift_counts_per_s=drift)
    found = fit(recorded(taxels, 0.0), recorded(taxels, 20.0))
    assert drift <= found.drift_counts_per_s <= 1.1 * drift + 0.15


def test_drift_of_a_still_array_is_what_noise_hides() -> None:
    taxels = Taxels(DESCRIPTION, seed=3, noise_counts=2.0, offset_counts=20)
    assert fit(recorded(taxels, 0.0)).drift_counts_per_s < 0.2


def test_drift_between_short_recordings_is_seen() -> None:
    counts = np.full((20, *SHAPE), 50) + np.random.default_rng(4).normal(0, 2, (2, 20, *SHAPE)).round()
    counts[1, :, 3, 4] += 30
    time_s = np.arange(20) * 0.01
    first, second = (
        IdleMeasurement("f1", c.astype(np.uint16), time_s + t) for c, t in zip(counts, (0, 60), strict=True)
    )
    assert 0.5 <= fit(second, first).drift_counts_per_s < 0.6  # 30 counts in a minute


def test_faults_are_told_from_live_taxels() -> None:
    dead, hot = [(0, 0), (3, 7)], [(7, 19)]
    taxels = Taxels(DESCRIPTION, seed=5, noise_counts=2.0, offset_counts=20, dead=dead, hot=hot)
    found = fit(recorded(taxels, 0.0), recorded(taxels, 30.0))
    assert found.dead == tuple(dead)
    assert found.hot == tuple(hot)
    assert np.argwhere(~found.live).tolist() == [list(place) for place in (*dead, *hot)]


def test_a_quiet_array_has_no_dead_taxels() -> None:
    assert fit(recorded(Taxels(DESCRIPTION, seed=6, noise_counts=0.0, offset_counts=9), 0.0)).dead == ()


def test_least_force_stands_out_of_the_sum_of_three_columns() -> None:
    taxels = Taxels(DESCRIPTION, seed=7, noise_counts=2.0, offset_counts=20)
    found = fit(recorded(taxels, 0.0))
    sums = recorded(taxels, 50.0).counts[:, :, 4:7].astype(float).sum(axis=(1, 2))
    least = least_contact_force_n(found, DESCRIPTION.counts_per_n)
    assert least == pytest.approx(4 * sums.std() / DESCRIPTION.counts_per_n, rel=0.08)


def test_recordings_that_say_nothing_are_errors() -> None:
    short = recorded(Taxels(DESCRIPTION, seed=8), 0.0, frames=4)
    with pytest.raises(InputError, match="few"):
        fit(short)
    with pytest.raises(InputError, match="alive"):
        fit(
            IdleMeasurement(
                "f1", np.full((20, *SHAPE), DESCRIPTION.max_count, dtype=np.uint16), np.arange(20.0)
            )
        )
    with pytest.raises(InputError, match="time"):
        fit(IdleMeasurement("f1", np.ones((20, *SHAPE), dtype=np.uint16), np.zeros(20)))
