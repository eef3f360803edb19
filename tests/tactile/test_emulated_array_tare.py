"""TARE of the emulated array against an arithmetic of its own."""

import math
from fractions import Fraction

import pytest
from array_talk import RATE, small, stream, told
from hypothesis import given, settings
from hypothesis import strategies as st

from palpate.drivers.tactile.messages import Ack, Frame, Hello, Message, MessageBody, Rate, Start, Stop, Tare

counts = st.integers(0, 4095)


@given(
    st.lists(st.lists(counts, min_size=6, max_size=6), min_size=1, max_size=8),
    st.lists(counts, min_size=6, max_size=6),
    counts,
)
@settings(max_examples=60, deadline=None)
def test_tare_does_what_the_page_says(seen: list[list[int]], then: list[int], pedestal: int) -> None:
    array = small([*seen, then])
    told(array, Start(1, RATE))
    told(array, Tare(2, len(seen), pedestal), 0.001)
    *before, after = stream(array, 0.0101 * (len(seen) + 1))
    assert [list(m.body.counts.ravel()) for m in before if isinstance(m.body, Frame)] == seen
    assert [m.flags for m in before] == [0] * len(seen)
    zero = [math.floor(Fraction(sum(one), len(seen)) + Fraction(1, 2)) for one in zip(*seen, strict=True)]
    want = [
        4095 if raw == 4095 else min(max(raw - z + pedestal, 0), 4095)
        for raw, z in zip(then, zero, strict=True)
    ]
    assert isinstance(after.body, Frame)
    assert list(after.body.counts.ravel()) == want
    assert after.flags == 1


def values(frames: list[Message]) -> list[tuple[int, int]]:
    """Count of the first taxel and flags of each frame."""
    return [(int(m.body.counts[0, 0]), m.flags) for m in frames if isinstance(m.body, Frame)]


def test_tare_outlives_stop_start_and_rate_and_waits_while_nothing_is_sampled() -> None:
    array = small([(10,) * 6, (13,) * 6, (20,) * 6])
    told(array, Tare(1, 2, 5))
    told(array, Start(2, RATE), 1.0)
    assert values(stream(array, 1.0101)) == [(10, 0)]
    told(array, Stop(3), 1.011)
    told(array, Start(4, 50_000), 2.0)
    assert values(stream(array, 2.0201)) == [(13, 0)]
    assert told(array, Rate(5, RATE), 2.021) == Ack(5)
    assert values(stream(array, 2.0301)) == [(20 - 12 + 5, 1)]  # 11.5 is rounded up
    told(array, Start(6, RATE), 3.0)
    assert values(stream(array, 3.0101)) == [(13, 1)]


def test_a_second_tare_keeps_the_first_zero_until_it_has_its_own() -> None:
    array = small([(10,) * 6, (20,) * 6, (30,) * 6, (40,) * 6])
    told(array, Start(1, RATE))
    told(array, Tare(2, 1, 0))
    assert values(stream(array, 0.0101)) == [(10, 0)]
    told(array, Tare(3, 9, 1), 0.011)
    told(array, Tare(4, 2, 7), 0.012)
    assert values(stream(array, 0.0401)) == [(10, 1), (20, 1), (40 - 25 + 7, 1)]


@pytest.mark.parametrize("undo", [Tare(3, 0, 0), Hello(3)])
@pytest.mark.parametrize("samples", [1, 2])
def test_raw_counts_come_back(undo: MessageBody, samples: int) -> None:
    array = small([(10,) * 6, (20,) * 6])
    told(array, Start(1, RATE))
    told(array, Tare(2, samples, 0))
    stream(array, 0.0101)
    told(array, undo, 0.011)
    told(array, Start(4, RATE), 0.02)
    assert values(stream(array, 0.0501)) == [(20, 0)] * 3
