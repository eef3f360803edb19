"""Zeros of sums of taxels: true ones are within their bounds, and hidden loads within what is said."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from simulated_presses import DESCRIPTION

from palpate.drivers.tactile.baseline import BaselineTracker, TaxelSums, baseline_of
from palpate.drivers.tactile.columns import column_windows
from palpate.drivers.tactile.contact import ContactExtractor
from palpate.drivers.tactile.frames import TactileFrame
from palpate.drivers.tactile.patches import TipCalibration

ROWS, COLS, RATE_HZ, TARE, OFFSET = 8, 6, 125.0, 64, 800.0
SHAPE = (ROWS, COLS)
LOOKS = 5  # frames between two
SEEN_SHARE = (
    1e-3  # so many may be outside: bounds on noise are four standard deviations, and last for a while
)
FARTHEST = 0.3  # standard deviations of a frame: of the mean of a block that is one more, once in a million


def wandering(
    drift: float, alike: float, time_s: np.ndarray, rng: np.random.Generator, shape: tuple[int, int] = SHAPE
) -> np.ndarray:
    """True zeros (n, rows, cols): random steps, never faster than `drift`; a share of each is common."""
    alone = rng.uniform(-1, 1, (len(time_s) // 50 + 2, *shape))
    together = rng.choice((-1.0, 1.0), (len(alone), 1, 1))
    speed = drift * (alike * together + (1 - alike) * alone)
    steps = np.repeat(speed, 50, axis=0)[: len(time_s)] / RATE_HZ
    return OFFSET + np.cumsum(steps, axis=0)


def read(zeros: np.ndarray, load: np.ndarray, noise: float, rng: np.random.Generator) -> np.ndarray:
    return np.rint(zeros + load + noise * rng.standard_normal(zeros.shape)).astype(np.uint16)


def outside(
    drift: float, alike: float, noise: float, load: np.ndarray, seed: int, *, may_touch: bool
) -> np.ndarray:
    """How far true sums are outside at every look (looks, sums), in standard deviations of a frame."""
    rng = np.random.default_rng(seed)
    time_s = np.arange(len(load) + TARE) / RATE_HZ
    zeros = wandering(drift, alike, time_s, rng)
    loads = np.concatenate([np.zeros((TARE, *SHAPE)), load[:, None, None] * np.ones(SHAPE)])
    counts = read(zeros, loads, noise, rng)
    weights = column_windows(rng.uniform(0.7, 1.3, SHAPE))
    sums = TaxelSums(weights, drift * weights.sum(axis=0))
    baseline = baseline_of(counts[:TARE], 4095, noise, None)
    tracker = BaselineTracker(baseline, drift, float(time_s[:TARE].mean()), TARE, sums)
    sigma = baseline.noise_counts * np.sqrt((weights**2).sum(axis=0))
    found = []
    for begin in range(TARE, len(counts), LOOKS):
        part = slice(begin, begin + LOOKS)
        tracker.follow(counts[part], time_s[part], may_touch=may_touch)
        now = min(begin + LOOKS, len(counts)) - 1
        bounds, truth = tracker.sums_at(float(time_s[now])), zeros[now].ravel() @ weights
        lower = bounds.lower if may_touch or not load.any() else bounds.least
        found.append(np.maximum(np.maximum(lower - truth, truth - bounds.upper), 0.0) / sigma)
    return np.array(found)


CASES = {
    "drift": st.floats(0.02, 3.0),
    "alike": st.floats(0.0, 1.0),
    "noise": st.floats(0.5, 5.0),
    "seed": st.integers(0, 2**32 - 1),
}


@settings(max_examples=25, deadline=None)
@given(
    steps=st.lists(st.tuples(st.integers(1, 1500), st.floats(0.0, 6.0)), max_size=4),
    may_touch=st.booleans(),
    **CASES,
)
def test_no_load_takes_sums_out_of_their_bounds(
    steps: list[tuple[int, float]], drift: float, alike: float, noise: float, seed: int, *, may_touch: bool
) -> None:
    """However light and long: told that the tip may touch, or by bounds that hold in any case."""
    load = np.zeros(1500)
    for begin, counts in steps:
        load[begin:] = counts * noise
    assert outside(drift, alike, noise, load, seed, may_touch=may_touch).max() <= FARTHEST


@pytest.mark.parametrize("may_touch", [False, True])
@pytest.mark.parametrize("most", [0.0, 4.0])
def test_sums_are_outside_no_more_often_than_noise_explains(most: float, *, may_touch: bool) -> None:
    rng = np.random.default_rng([int(most), may_touch])
    found = []
    for seed in range(25):
        load = np.zeros(1000)
        load[rng.integers(100, 900) :] = rng.uniform(0.0, most)
        drift, noise = rng.uniform(0.02, 1.0), rng.uniform(1.0, 4.0)
        found.append(outside(drift, rng.uniform(), noise, load, seed, may_touch=may_touch) > 0)
    assert np.mean(found) <= SEEN_SHARE


def test_a_sum_is_known_better_than_its_taxels() -> None:
    rng = np.random.default_rng(1)
    time_s = np.arange(2500) / RATE_HZ
    zeros = np.full((len(time_s), *SHAPE), OFFSET)
    counts = read(zeros, 0.0 * zeros, 3.0, rng)
    weights = column_windows(np.ones(SHAPE))
    sums = TaxelSums(weights, np.full(weights.shape[1], 0.2))
    tracker = BaselineTracker(baseline_of(counts[:TARE], 4095, 3.0, None), 0.05, 0.25, TARE, sums)
    tracker.follow(counts[TARE:], time_s[TARE:])
    found = tracker.sums_at(float(time_s[-1]))
    together = (weights.T @ tracker.bound.ravel()).max()
    assert ((found.upper - found.lower) / 2).max() < 0.4 * together


@settings(max_examples=25, deadline=None)
@given(
    force_n=st.floats(0.0, 0.06),
    alike=st.floats(0.0, 1.0),
    drift=st.floats(0.02, 0.5),
    calibrated=st.booleans(),
    seed=st.integers(0, 2**32 - 1),
)
def test_what_an_array_hides_of_a_force_is_said(
    force_n: float, alike: float, drift: float, seed: int, *, calibrated: bool
) -> None:
    """A light steady push while zeros drift: no more than noise and the doubt of the zero hide."""
    rng, noise = np.random.default_rng(seed), 3.0
    shape = (DESCRIPTION.rows, DESCRIPTION.cols)
    time_s = np.arange(1200) / RATE_HZ
    zeros = wandering(drift, alike, time_s, rng, shape)
    columns = column_windows(np.full(shape, 1 / DESCRIPTION.counts_per_n))
    moved = np.abs(np.diff(zeros.reshape(len(zeros), -1) @ columns, axis=0)).max() * RATE_HZ
    pushed = np.zeros((len(time_s), *shape))
    pushed[rng.integers(TARE, 1000) :, :, 8:11] = force_n * DESCRIPTION.counts_per_n / (3 * shape[0])
    counts = read(zeros, pushed, noise, rng)
    calibration = TipCalibration(
        gain=np.ones(shape),
        noise_counts=noise,
        drift_counts_per_s=drift,
        force_drift_n_per_s=float(moved) if calibrated else None,
    )
    extractor = ContactExtractor(DESCRIPTION, calibration)
    times = time_s.tolist()
    frames = [TactileFrame(k, t, t, c) for k, (t, c) in enumerate(zip(times, counts, strict=True))]
    extractor.tare(frames[:TARE])
    for begin in range(TARE, len(frames), LOOKS):
        extractor.follow(frames[begin : begin + LOOKS], may_touch=True)
    readings = np.mean([extractor.sense(frame)[1] for frame in frames[-TARE:]], axis=0)
    if extractor.steady_force_n(readings, TARE) == 0.0:
        hidden = 1.5 * extractor.least_force_n * extractor.noise_share(TARE)
        assert force_n <= hidden + extractor.zero_doubt_n[0]
