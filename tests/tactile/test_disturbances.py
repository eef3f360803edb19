"""Disturbances of readings are told from noise, drift and contacts."""

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from palpate.drivers.tactile import Disturbances, find_disturbances
from support.devices.spoilt_taxels import Spoil, drift, drop_rows, hold, interference, loose, low_pass

_SHAPE = (8, 20)


def _found(spoil: Spoil, seed: int, sigma: float, frames: int = 250, press: float = 0.0) -> Disturbances:
    """What is found where a tip is pressed for a while, firmly and quickly, by two columns of taxels."""
    rng, usable = np.random.default_rng(seed), np.ones(_SHAPE, dtype=bool)
    counts = np.clip(np.rint(20 + sigma * rng.standard_normal((frames, *_SHAPE))), 0, 4095)
    counts[frames // 3 : frames // 2, :, 8:12] += press
    sent = np.stack([spoil(item, k / 250) for k, item in enumerate(counts)])
    return find_disturbances(np.clip(np.rint(sent), 0, 4095), usable, 4095)


@settings(max_examples=60, deadline=None)
@given(
    st.integers(0, 2**32 - 1),
    st.floats(0.0, 5.0),
    st.floats(0.0, 400.0),
    st.sampled_from([lambda: drift(2.0), lambda: hold(30.0), lambda: low_pass(0.05)]),
)
def test_noise_drift_and_contacts_are_no_disturbance(
    seed: int, sigma: float, press: float, make: Callable[[], Spoil]
) -> None:
    assert not _found(make(), seed, sigma, press=press)


@pytest.mark.parametrize("times", [1, 2])
def test_a_taxel_that_jumps_once_may_have_brushed_past_something(times: int) -> None:
    def jump(frame: np.ndarray, time_s: float) -> np.ndarray:
        frame = frame.copy()
        frame[2, 3] += 3000.0 * (round(250 * time_s) in (60, 180)[:times])
        return frame

    assert _found(jump, 1, 2.0).taxels == ({} if times == 1 else {(2, 3): 2})


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("press", [0.0, 300.0])
def test_each_disturbance_is_told_by_its_shape(seed: int, press: float) -> None:
    for size in (-15.0, 30.0, 100.0):
        burst = _found(interference(size, seed), seed, 2.0, 750, press)
        assert burst.common > 0
        assert abs(burst.common_counts - abs(size)) < 2
        assert not burst.rows
    rows = _found(drop_rows(0.05, seed), seed, 2.0, 250, press)
    assert rows.rows
    assert rows.common == 0
    wire = _found(loose(0.05, seed), seed, 2.0, 250, press)
    assert set(wire.taxels) == {(2, 3)}
    assert not wire.rows
    assert not wire.common
