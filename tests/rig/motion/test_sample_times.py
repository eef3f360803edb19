"""Sample times: whatever adapters do, a frame was sampled between the bounds that are stated for it."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from palpate.drivers.tactile.frames import TactileFrame
from palpate.rig.motion.array_guard import SampleTimes

COUNTS = np.zeros((2, 3), np.uint16)
ON_WIRE_S = 0.003


def arrivals(
    sampled_s: np.ndarray, timer_s: float, phase: float, stalls: list[tuple[float, float]]
) -> np.ndarray:
    """When frames reach the host: by a latency timer's next tick, after stalls [begin, end), in order."""
    found = sampled_s + ON_WIRE_S
    if timer_s:
        found = (np.ceil(found / timer_s - phase) + phase) * timer_s
    for begin, end in stalls:
        found = np.where((found >= begin) & (found < end), end, found)
    result: np.ndarray = np.maximum.accumulate(found)
    return result


def bounds_of(
    sampled_s: np.ndarray, arrived_s: np.ndarray, *, clock: float, rate: float, look_s: float, asked_s: float
) -> tuple[np.ndarray, np.ndarray, list[tuple[int, float]]]:
    """Earliest and latest instants of frames, and how far `sampled_s` was after each look, by frames read."""
    times = SampleTimes(asked_s)
    earliest, latest, reached = [], [], []
    read, looked_s = 0, 0.0
    while read < len(sampled_s):
        looked_s += look_s
        upto = int(np.searchsorted(arrived_s, looked_s, side="right"))
        if upto == read:
            continue
        frames = [
            TactileFrame(k, float(clock + sampled_s[k] * rate), looked_s, COUNTS) for k in range(read, upto)
        ]
        found = np.array(times.latest_s(frames))
        earliest.extend((found - times.spread_s).tolist())
        latest.extend(found.tolist())
        reached.append((upto, times.sampled_s))
        read = upto
    return np.array(earliest), np.array(latest), reached


@given(
    period_s=st.sampled_from([0.004, 0.008, 0.01, 0.016, 0.033]),
    timer_s=st.sampled_from([0.0, 0.001, 0.016]),
    phase=st.floats(0.0, 1.0),
    look_s=st.floats(0.002, 0.03),
    clock=st.floats(-100.0, 1e5),
    stalls=st.lists(st.tuples(st.floats(0.0, 8.0), st.floats(0.01, 0.14)), max_size=8),
)
def test_a_frame_was_sampled_between_its_bounds(
    period_s: float,
    timer_s: float,
    phase: float,
    look_s: float,
    clock: float,
    stalls: list[tuple[float, float]],
) -> None:
    sampled = 0.1 + period_s * np.arange(1, 1500)
    arrived = arrivals(sampled, timer_s, phase, [(begin, begin + lasts) for begin, lasts in stalls])
    earliest, latest, reached = bounds_of(sampled, arrived, clock=clock, rate=1.0, look_s=look_s, asked_s=0.1)
    assert (earliest <= sampled + 1e-9).all()
    assert (latest >= sampled - 1e-9).all()
    for read, upto_s in reached:
        assert upto_s <= sampled[read - 1] + 1e-9


@pytest.mark.parametrize("rate", [0.98, 0.998, 1.002, 1.02])
def test_a_clock_that_is_wrong_shifts_bounds_by_little(rate: float) -> None:
    sampled = 0.1 + 0.004 * np.arange(1, 5000)
    arrived = arrivals(sampled, 0.016, 0.3, [])
    earliest, latest, _ = bounds_of(sampled, arrived, clock=7.0, rate=rate, look_s=0.004, asked_s=0.1)
    slack_s = 128 * 0.004 * abs(rate - 1) + 1e-9
    assert (earliest <= sampled + slack_s).all()
    assert (latest >= sampled - slack_s).all()


def test_delays_that_grow_after_the_start_widen_the_bounds() -> None:
    sampled = 0.1 + 0.004 * np.arange(1, 1000)
    arrived = sampled + ON_WIRE_S + np.where(sampled > 1.0, 0.06, 0.0)
    earliest, latest, _ = bounds_of(sampled, arrived, clock=0.0, rate=1.0, look_s=0.004, asked_s=0.1)
    assert (earliest <= sampled + 1e-9).all()
    assert (latest >= sampled - 1e-9).all()
    assert (latest - earliest)[100] < 0.02
    assert 0.06 < (latest - earliest)[-1] < 0.08


def test_before_the_first_frame_nothing_is_known() -> None:
    times = SampleTimes(3.0)
    assert math.isinf(times.spread_s)
    assert times.sampled_s == -math.inf
