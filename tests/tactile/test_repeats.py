"""Frames that repeat a reading are told from those of a quiet array."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from palpate.drivers.tactile import TactileFrame, count_repeats, is_new

_RATE_HZ = 250.0


def _frames(counts: np.ndarray) -> list[TactileFrame]:
    times = np.arange(len(counts)) / _RATE_HZ
    return [
        TactileFrame(k, t, t, c.astype(np.uint16), tared=False)
        for k, (t, c) in enumerate(zip(times, counts, strict=True))
    ]


def _noise(
    rng: np.random.Generator, frames: int, sigma: float, offset: float, taxels: tuple[int, int] = (8, 20)
) -> np.ndarray:
    return np.clip(np.rint(offset + sigma * rng.standard_normal((frames, *taxels))), 0, 4095)


@settings(max_examples=150, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    sigma=st.floats(0.0, 4.0),
    offset=st.floats(0.0, 30.0),
    frames=st.integers(2, 300),
    taxels=st.sampled_from([(8, 20), (4, 2), (1, 3)]),
    known=st.booleans(),
)
def test_a_quiet_array_does_not_repeat(  # what is drawn
    seed: int, sigma: float, offset: float, frames: int, taxels: tuple[int, int], known: bool
) -> None:
    counts = _noise(np.random.default_rng(seed), frames, sigma, offset, taxels)
    assert not count_repeats(_frames(counts), sigma if known else 0.0).certain


@pytest.mark.parametrize("hz", [5.0, 10.0, 30.0, 60.0, 125.0])
@pytest.mark.parametrize("sigma", [0.3, 1.0, 2.0])
@pytest.mark.parametrize("seconds", [0.256, 3.0])
def test_held_samples_are_told_with_their_rate(hz: float, sigma: float, seconds: float) -> None:
    if hz * seconds < 2:
        return
    frames = round(seconds * _RATE_HZ)
    held = (np.arange(frames) / _RATE_HZ * hz).astype(int)
    found = count_repeats(_frames(_noise(np.random.default_rng(1), held[-1] + 1, sigma, 20.0)[held]))
    assert found.certain
    assert found.rate_hz == pytest.approx(hz, abs=1 / seconds + 0.02 * hz)


def test_a_hung_array_is_told_where_its_noise_is_known() -> None:
    frames = _frames(np.repeat(_noise(np.random.default_rng(2), 1, 2.0, 0.0), 40, axis=0))
    assert count_repeats(frames, 2.0).certain
    assert not count_repeats(frames).certain
    assert count_repeats(frames, 2.0).last == 39
    alive = count_repeats(_frames(_noise(np.random.default_rng(3), 64, 1.0, 5.0)))
    assert alive.are_stuck(3)
    assert not alive.are_stuck(0)
    assert not count_repeats(_frames(np.ones((64, 2, 2)))).are_stuck(1000)


def test_new_frames_go_on_from_the_one_before() -> None:
    first, *rest = _frames(np.array([[[1]], [[1]], [[2]], [[2]]]))
    assert is_new([first, *rest]).tolist() == [True, False, True, False]
    assert is_new(rest, first).tolist() == [False, True, False]
