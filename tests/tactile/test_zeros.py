"""Zeros of taxels: baseline and sums."""

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from palpate.base.errors import InputError
from palpate.drivers.tactile.baseline import Baseline, BaselineTracker, TaxelSums, Zeros, baseline_of
from palpate.drivers.tactile.columns import column_windows
from palpate.drivers.tactile.contact import ContactExtractor
from palpate.drivers.tactile.frames import TactileFrame
from palpate.drivers.tactile.patches import TipCalibration
from support.benches.presses import DESCRIPTION
from support.campaign.sampling import sample

# ----------------------------------------------------------------------------------------------------
# Zeros that drift: they are within their bounds, and what presses slowly is not taken for drift.

ROWS, COLS = 6, 7
SHAPE = (ROWS, COLS)
RATE_HZ = 50.0
NOISE = 2.0
OFFSET = 1200.0
TARE = 32
MIDDLE = (slice(2, 4), slice(2, 5))  # where it is touched
ONSET = 4 * NOISE  # what of a touch may pass for zero before it is noticed
SEEN_SHARE = 5e-4  # so many zeros may be outside: bounds on noise are four standard deviations


def wandering(kind: str, drift: float, time_s: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """True zeros (n, rows, cols), counts, never faster than `drift` a second."""
    t = (time_s - time_s[0])[:, None, None]
    if kind == "still":
        moved = np.zeros((len(time_s), *SHAPE))
    elif kind == "ramp":
        moved = drift * t * rng.choice((-1, 1), SHAPE)
    elif kind == "common ramp":
        moved = drift * t * np.ones(SHAPE)
    else:
        same = kind == "common sinusoid"
        speed = 2 * math.pi / rng.uniform(20, 120, () if same else SHAPE)
        phase = rng.uniform(0, 2 * math.pi, () if same else SHAPE)
        moved = drift / speed * (np.sin(speed * t + phase) - np.sin(phase)) * np.ones(SHAPE)
    return OFFSET + moved


def times(seconds: float) -> np.ndarray:
    return 7.0 + np.arange(int(seconds * RATE_HZ)) / RATE_HZ


def read(zeros: np.ndarray, load: np.ndarray, rng: np.random.Generator, noise: float = NOISE) -> np.ndarray:
    """What the array sends for zeros and loads, both in counts."""
    return np.clip(np.rint(zeros + load + noise * rng.standard_normal(zeros.shape)), 0, 4095).astype(
        np.uint16
    )


def tracker(drift: float, rng: np.random.Generator, noise: float = NOISE) -> BaselineTracker:
    """A tracker, just tared at zeros of 500 counts."""
    frames = read(np.full((TARE, *SHAPE), OFFSET), np.zeros(SHAPE), rng, noise)
    return BaselineTracker(baseline_of(frames, 4095, noise, None), drift)


def outside(zeros: Zeros, truth: np.ndarray, slack: float = 0.5) -> float:
    """Share of the true zeros that are more than `slack` counts outside their bounds; a half is rounding."""
    away = np.abs(truth - zeros.mean[zeros.block_of])
    return float((away > zeros.bound[zeros.block_of] + slack).mean())


def touches(time_s: np.ndarray, rng: np.random.Generator, most: float) -> np.ndarray:
    """Loads of several touches, pressed and let go within tenths of a second."""
    level = np.zeros(len(time_s))
    start = time_s[0] + 1.0
    while start < time_s[-1]:
        held, force = rng.uniform(0.3, 4.0), rng.uniform(0.3, 1.0) * most
        ramp = np.minimum((time_s - start) / 0.3, (start + held - time_s) / 0.3)
        level += force * np.clip(ramp, 0.0, 1.0)
        start += held + rng.uniform(1.0, 8.0)
    load = np.zeros((len(time_s), *SHAPE))
    load[(slice(None), *MIDDLE)] = level[:, None, None]
    return load


WEAK = "a touch that drift could explain is taken for drift until it is let go"
KINDS = ("still", "ramp", "common ramp", "sinusoid", "common sinusoid")


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("drift", sample([0.5, 2.0, 10.0], [2.0]))
def test_zeros_are_within_their_bounds_and_stay_narrow(kind: str, drift: float) -> None:
    rng = np.random.default_rng([1, KINDS.index(kind)])
    time_s = times(60)
    truth = wandering(kind, drift, time_s, rng)
    found = tracker(drift, rng).follow(read(truth, np.zeros(SHAPE), rng), time_s)
    assert outside(found, truth, 0.5 + 0.05 * drift) <= SEEN_SHARE  # a block's mean is that of its middle
    # Never touched: as narrow as noise and two blocks of drift allow.
    assert found.bound.max() < 4 * NOISE + 0.2 * drift


def between_touches(kind: str, most: float) -> float:
    """Share of zeros that are further outside than the onset of a touch explains, with touches in between."""
    rng = np.random.default_rng([2, KINDS.index(kind), int(most)])
    time_s, drift = times(90), 2.0
    truth = wandering(kind, drift, time_s, rng)
    load = touches(time_s, rng, most)
    found = tracker(drift, rng).follow(read(truth, load, rng), time_s)
    return outside(found, truth, ONSET)


@pytest.mark.parametrize("kind", sample(KINDS, KINDS[::2]))
def test_zeros_are_within_their_bounds_between_touches(kind: str) -> None:
    assert between_touches(kind, 1500.0) <= SEEN_SHARE


@pytest.mark.campaign
@pytest.mark.xfail(reason=WEAK, strict=True)
def test_zeros_are_within_their_bounds_between_weak_touches() -> None:
    assert max(between_touches(kind, most) for kind in KINDS for most in (20.0, 40.0, 200.0)) <= SEEN_SHARE


@settings(max_examples=8)
@given(
    kind=st.sampled_from(KINDS),
    drift=st.floats(0.1, 10.0),
    noise=st.floats(0.5, 6.0),
    most=st.floats(500.0, 2000.0),
    seed=st.integers(0, 2**32 - 1),
)
def test_zeros_are_within_their_bounds_whatever_happens(
    kind: str, drift: float, noise: float, most: float, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    time_s = times(30)
    truth = wandering(kind, drift, time_s, rng)
    counts = read(truth, touches(time_s, rng, most), rng, noise)
    found = tracker(drift, rng, noise).follow(counts, time_s)
    assert outside(found, truth, 4 * noise + 0.05 * drift) <= 0.005


@pytest.mark.parametrize("drift", [0.2, 1.0, 2.0])
@pytest.mark.parametrize("seconds", sample([5.0, 20.0, 60.0], [20.0]))
def test_a_slow_contact_is_not_eaten(seconds: float, drift: float) -> None:
    rng = np.random.default_rng([3, int(seconds)])
    time_s, full = times(seconds + 5), 600.0
    load = np.zeros((len(time_s), *SHAPE))
    growing = np.clip((time_s - time_s[0] - 2.0) / seconds, 0.0, 1.0) * full
    load[(slice(None), *MIDDLE)] = growing[:, None, None]
    follower = tracker(drift, rng)
    before = follower.follow(read(np.full((100, *SHAPE), OFFSET), np.zeros(SHAPE), rng), time_s[:100] - 2.0)
    after = follower.follow(read(np.full_like(load, OFFSET), load, rng), time_s)
    rate = full / seconds
    # As the module says; the interval is what zero and reading have between them, both bounds and a block.
    interval = 2 * float(before.bound.max()) + 8 * NOISE / math.sqrt(RATE_HZ / 10) + 0.1 * rate
    taken = drift * interval / (rate - drift)
    assert after.mean[-1][MIDDLE].max() - OFFSET <= float(before.bound.max()) + taken
    assert float((after.mean - after.bound).max()) - OFFSET <= float(before.bound.max()) + taken


def test_what_grows_no_faster_than_drift_is_taken_for_drift() -> None:
    rng = np.random.default_rng(4)
    time_s = times(60)
    truth = OFFSET + 1.0 * (time_s - time_s[0])[:, None, None] * np.ones(SHAPE)
    found = tracker(1.0, rng).follow(read(truth, np.zeros(SHAPE), rng), time_s)
    assert np.abs(found.mean[-1] - truth[-1]).max() < 4 * NOISE


@pytest.mark.parametrize("load", [60.0, 200.0, 3000.0])
@pytest.mark.parametrize("held_s", sample([2.0, 20.0], [2.0]))
def test_the_zero_is_followed_again_after_release(load: float, held_s: float) -> None:
    rng = np.random.default_rng([5, int(load)])
    time_s, drift = times(held_s + 25), 1.0
    truth = OFFSET + drift * (time_s - time_s[0])[:, None, None] * np.ones(SHAPE)
    pressed = (time_s > time_s[0] + 2) & (time_s < time_s[0] + 2 + held_s)
    loads = np.zeros((len(time_s), *SHAPE))
    loads[(pressed, *MIDDLE)] = load
    found = tracker(drift, rng).follow(read(truth, loads, rng), time_s)
    assert outside(found, truth, ONSET) <= SEEN_SHARE
    assert np.abs(found.mean[-1] - truth[-1]).max() <= 4 * NOISE
    assert found.bound[-1].max() < 4 * NOISE


def test_a_zero_above_the_readings_is_given_up() -> None:
    """Nothing pulls: a taxel that reads less than its zero shows that the zero is wrong."""
    rng = np.random.default_rng(12)
    time_s = times(60)
    loads = np.zeros((len(time_s), *SHAPE))
    since = time_s - time_s[0]
    loads[(slice(None), *MIDDLE)] = np.where((since > 2) & (since < 12), 300.0, 0.0)[:, None, None]
    loads[((since >= 12) & (since < 12.3), *MIDDLE)] = 45.0  # not let go all at once
    found = tracker(5.0, rng).follow(read(np.full_like(loads, OFFSET), loads, rng), time_s)
    assert np.abs(found.mean[-1] - OFFSET).max() <= 4 * NOISE
    assert found.bound[-1].max() < 4 * NOISE


def test_taxels_beside_a_touch_are_held() -> None:
    rng = np.random.default_rng(6)
    time_s = times(20)
    loads = np.zeros((len(time_s), *SHAPE))
    loads[:, 2, 3] = 800.0
    loads[:, 1:4, 2:5] += np.linspace(0, 6, len(time_s))[:, None, None]  # creeps in under the noise
    follower = tracker(1.0, rng)
    found = follower.follow(read(np.full_like(loads, OFFSET), loads, rng), time_s)
    around = np.zeros(SHAPE, dtype=bool)
    around[1:4, 2:5] = True
    # Nothing raises their zeros, and their intervals only grow downwards.
    assert (found.mean[-1] < OFFSET + NOISE)[around].all()
    assert (found.mean[-1] - found.bound[-1] < OFFSET - 15)[around].all()
    assert (found.mean[-1] + found.bound[-1] > OFFSET)[around].all()
    assert found.bound[-1][~around].max() < 2 * NOISE


def test_a_restarted_array_begins_its_clock_anew() -> None:
    rng = np.random.default_rng(7)
    time_s = times(10)
    truth = np.full((len(time_s), *SHAPE), OFFSET)
    follower = tracker(1.0, rng)
    follower.follow(read(truth, np.zeros(SHAPE), rng), 1000 + time_s)
    again = follower.follow(read(truth, np.zeros(SHAPE), rng), time_s)
    assert outside(again, truth) <= SEEN_SHARE
    assert again.bound.max() < 4 * NOISE
    joined = tracker(1.0, rng).follow(
        read(np.concatenate([truth, truth]), np.zeros(SHAPE), rng), np.concatenate([1000 + time_s, time_s])
    )
    assert outside(joined, np.concatenate([truth, truth])) <= SEEN_SHARE
    assert len(joined.block_of) == 2 * len(time_s)
    assert joined.bound.max() < 4 * NOISE


def test_a_pause_widens_by_what_may_have_drifted_meanwhile() -> None:
    rng = np.random.default_rng(8)
    follower = tracker(2.0, rng)
    time_s = times(5)
    truth = np.full((len(time_s), *SHAPE), OFFSET)
    follower.follow(read(truth, np.zeros(SHAPE), rng), time_s)
    after = follower.follow(read(truth + 100, np.zeros(SHAPE), rng), time_s + 60)
    assert 100 < after.bound[0].min() < 130
    assert outside(after, truth + 100) <= SEEN_SHARE
    assert after.bound[-1].max() < 4 * NOISE


def test_bounds_grow_until_the_time_that_is_asked_for() -> None:
    rng = np.random.default_rng(13)
    follower = tracker(2.0, rng)
    assert (follower.bound_at(1000.0) == follower.bound).all()  # tared at a time that is not known
    time_s = times(5)
    follower.follow(read(np.full((len(time_s), *SHAPE), OFFSET), np.zeros(SHAPE), rng), time_s)
    before, end = follower.bound, float(time_s[-1])
    grown = follower.bound_at(end + 30.0) - before
    # From the middle of the last complete block on; another tenth of a second may wait to be complete.
    assert grown.min() >= 60.0
    assert grown.max() <= 60.3
    assert (follower.bound == before).all()
    assert (follower.bound_at(0.0) == before).all()  # an array that was restarted


@settings(max_examples=5)
@given(cuts=st.lists(st.integers(1, 999), max_size=8), seed=st.integers(0, 1000))
def test_a_stream_may_be_cut_anywhere(cuts: list[int], seed: int) -> None:
    rng = np.random.default_rng(seed)
    time_s, drift = times(20), 2.0
    truth = wandering("sinusoid", drift, time_s, rng)
    counts = read(truth, touches(time_s, rng, 800.0), rng)
    whole, follower = tracker(drift, rng), tracker(drift, rng)
    whole.follow(counts, time_s)
    edges = [0, *sorted(set(cuts)), len(time_s)]
    for begin, end in pairwise(edges):
        found = follower.follow(counts[begin:end], time_s[begin:end])
        assert len(found.block_of) == end - begin
        assert outside(found, truth[begin:end], ONSET) <= 0.02
    free = whole.bound < 4 * NOISE
    assert np.abs(follower.mean - whole.mean)[free].max(initial=0.0) < 2 * NOISE
    assert follower.bound[free].max(initial=0.0) < 5 * NOISE  # a last block may be of one frame


def test_one_frame_at_a_time_is_no_worse_than_all_at_once() -> None:
    rng = np.random.default_rng(9)
    time_s = times(20)
    truth = wandering("ramp", 2.0, time_s, rng)
    counts = read(truth, np.zeros(SHAPE), rng)
    follower = tracker(2.0, rng)
    found = [follower.follow(counts[i : i + 1], time_s[i : i + 1]) for i in range(len(counts))]
    assert np.mean([outside(z, truth[i : i + 1]) for i, z in enumerate(found)]) <= SEEN_SHARE
    assert follower.bound.max() < 4 * NOISE


def test_dead_taxels_hold_nobody_and_unusable_ones_are_left_out() -> None:
    rng = np.random.default_rng(10)
    usable = np.ones(SHAPE, dtype=bool)
    usable[3, 3] = False
    baseline = Baseline(np.full(SHAPE, OFFSET), NOISE, usable)
    time_s = times(10)
    truth = np.full((len(time_s), *SHAPE), OFFSET)
    counts = read(truth, np.zeros(SHAPE), rng)
    counts[:, 3, 3] = 4095
    follower = BaselineTracker(baseline, 1.0)
    follower.follow(counts, time_s)
    assert follower.bound[usable].max() < 4 * NOISE


def test_tare_needs_frames_and_judges_noise_only_with_enough() -> None:
    with pytest.raises(InputError, match="no frames"):
        baseline_of(np.zeros((0, *SHAPE), np.uint16), 4095, NOISE, None)
    few = baseline_of(np.full((2, *SHAPE), int(OFFSET), np.uint16), 4095, NOISE, None)
    assert few.noise_counts >= NOISE
    assert few.usable.all()
    rng = np.random.default_rng(11)
    many = read(np.full((200, *SHAPE), OFFSET), np.zeros(SHAPE), rng, 3.0)
    many[:, 1, 1], many[:, 2, 2] = 4095, int(OFFSET)
    found = baseline_of(many, 4095, NOISE, None)
    assert {tuple(map(int, p)) for p in np.argwhere(~found.usable)} == {(1, 1), (2, 2)}
    assert found.noise_counts == pytest.approx(3.0, rel=0.05)


# ----------------------------------------------------------------------------------------------------
# Zeros of sums of taxels: true ones are within their bounds, and hidden loads within what is said.

SUM_ROWS, SUM_COLS, SUM_RATE_HZ, SUM_TARE, SUM_OFFSET = 8, 6, 125.0, 64, 800.0
SUM_SHAPE = (SUM_ROWS, SUM_COLS)
LOOKS = 5  # frames between two
SEEN_SHARE_OF_SUMS = (
    1e-3  # so many may be outside: bounds on noise are four standard deviations, and last for a while
)
FARTHEST = 0.3  # standard deviations of a frame: of the mean of a block that is one more, once in a million


def wandering_alike(
    drift: float,
    alike: float,
    time_s: np.ndarray,
    rng: np.random.Generator,
    shape: tuple[int, int] = SUM_SHAPE,
) -> np.ndarray:
    """True zeros (n, rows, cols): random steps, never faster than `drift`; a share of each is common."""
    alone = rng.uniform(-1, 1, (len(time_s) // 50 + 2, *shape))
    together = rng.choice((-1.0, 1.0), (len(alone), 1, 1))
    speed = drift * (alike * together + (1 - alike) * alone)
    steps = np.repeat(speed, 50, axis=0)[: len(time_s)] / SUM_RATE_HZ
    return SUM_OFFSET + np.cumsum(steps, axis=0)


def read_noisy(zeros: np.ndarray, load: np.ndarray, noise: float, rng: np.random.Generator) -> np.ndarray:
    return np.rint(zeros + load + noise * rng.standard_normal(zeros.shape)).astype(np.uint16)


def sums_outside(
    drift: float, alike: float, noise: float, load: np.ndarray, seed: int, *, may_touch: bool
) -> np.ndarray:
    """How far true sums are outside at every look (looks, sums), in standard deviations of a frame."""
    rng = np.random.default_rng(seed)
    time_s = np.arange(len(load) + SUM_TARE) / SUM_RATE_HZ
    zeros = wandering_alike(drift, alike, time_s, rng)
    loads = np.concatenate([np.zeros((SUM_TARE, *SUM_SHAPE)), load[:, None, None] * np.ones(SUM_SHAPE)])
    counts = read_noisy(zeros, loads, noise, rng)
    weights = column_windows(rng.uniform(0.7, 1.3, SUM_SHAPE))
    sums = TaxelSums(weights, drift * weights.sum(axis=0))
    baseline = baseline_of(counts[:SUM_TARE], 4095, noise, None)
    tracker = BaselineTracker(baseline, drift, float(time_s[:SUM_TARE].mean()), SUM_TARE, sums)
    sigma = baseline.noise_counts * np.sqrt((weights**2).sum(axis=0))
    found = []
    for begin in range(SUM_TARE, len(counts), LOOKS):
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


@settings(max_examples=10)
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
    assert sums_outside(drift, alike, noise, load, seed, may_touch=may_touch).max() <= FARTHEST


@pytest.mark.parametrize("may_touch", [False, True])
@pytest.mark.parametrize("most", sample([0.0, 4.0], [4.0]))
def test_sums_are_outside_no_more_often_than_noise_explains(most: float, *, may_touch: bool) -> None:
    rng = np.random.default_rng([int(most), may_touch])
    found = []
    for seed in range(25):
        load = np.zeros(1000)
        load[rng.integers(100, 900) :] = rng.uniform(0.0, most)
        drift, noise = rng.uniform(0.02, 1.0), rng.uniform(1.0, 4.0)
        found.append(sums_outside(drift, rng.uniform(), noise, load, seed, may_touch=may_touch) > 0)
    assert np.mean(found) <= SEEN_SHARE_OF_SUMS


def test_a_sum_is_known_better_than_its_taxels() -> None:
    rng = np.random.default_rng(1)
    time_s = np.arange(2500) / SUM_RATE_HZ
    zeros = np.full((len(time_s), *SUM_SHAPE), SUM_OFFSET)
    counts = read_noisy(zeros, 0.0 * zeros, 3.0, rng)
    weights = column_windows(np.ones(SUM_SHAPE))
    sums = TaxelSums(weights, np.full(weights.shape[1], 0.2))
    tracker = BaselineTracker(baseline_of(counts[:SUM_TARE], 4095, 3.0, None), 0.05, 0.25, SUM_TARE, sums)
    tracker.follow(counts[SUM_TARE:], time_s[SUM_TARE:])
    found = tracker.sums_at(float(time_s[-1]))
    together = (weights.T @ tracker.bound.ravel()).max()
    assert ((found.upper - found.lower) / 2).max() < 0.4 * together


@settings(max_examples=25)
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
    time_s = np.arange(1200) / SUM_RATE_HZ
    zeros = wandering_alike(drift, alike, time_s, rng, shape)
    columns = column_windows(np.full(shape, 1 / DESCRIPTION.counts_per_n))
    moved = np.abs(np.diff(zeros.reshape(len(zeros), -1) @ columns, axis=0)).max() * SUM_RATE_HZ
    pushed = np.zeros((len(time_s), *shape))
    pushed[rng.integers(SUM_TARE, 1000) :, :, 8:11] = force_n * DESCRIPTION.counts_per_n / (3 * shape[0])
    counts = read_noisy(zeros, pushed, noise, rng)
    calibration = TipCalibration(
        gain=np.ones(shape),
        noise_counts=noise,
        drift_counts_per_s=drift,
        force_drift_n_per_s=float(moved) if calibrated else None,
    )
    extractor = ContactExtractor(DESCRIPTION, calibration)
    times = time_s.tolist()
    frames = [TactileFrame(k, t, t, c) for k, (t, c) in enumerate(zip(times, counts, strict=True))]
    extractor.tare(frames[:SUM_TARE])
    for begin in range(SUM_TARE, len(frames), LOOKS):
        extractor.follow(frames[begin : begin + LOOKS], may_touch=True)
    readings = np.mean([extractor.sense(frame)[1] for frame in frames[-SUM_TARE:]], axis=0)
    if extractor.steady_force_n(readings, SUM_TARE) == 0.0:
        hidden = 1.5 * extractor.least_force_n * extractor.noise_share(SUM_TARE)
        assert force_n <= hidden + extractor.zero_doubt_n[0]
