"""When frames come, what is in them, and what happens if the line is full or the array is polled too late."""

from fractions import Fraction
from pathlib import Path

import pytest
from firmware_bench import Bench, Makeup
from wire_messages import (
    ACK,
    DESCRIBE,
    FRAME,
    HELLO,
    RATE,
    START,
    STOP,
    TARE,
    Said,
    frame_counts,
    request,
    said,
)

PAIR = Makeup(shape=0, columns=(0.0, 1.0), rows=(1.0,), size=(1, 2), radius_mm=0.0, max_rate_mhz=10**9)


@pytest.fixture
def bench(built: Path) -> Bench:
    return Bench(built, PAIR)


def stream(bench: Bench, rate_mhz: int, at_us: int = 0) -> None:
    assert bench.ask(at_us, START, 1, rate_mhz).type == ACK


def instants(bench: Bench, times: range) -> list[int]:
    return [found.time_us for now in times for found in said(bench.poll(now))]


def one(bench: Bench, clock_us: int) -> Said:
    (found,) = said(bench.poll(clock_us))
    assert found.type == FRAME
    return found


@pytest.mark.parametrize("rate_mhz", [333_333, 7_000, 700_001, 90_909])
def test_frames_keep_their_pace_whatever_the_period(bench: Bench, rate_mhz: int) -> None:
    stream(bench, rate_mhz, at_us=17)
    period = Fraction(10**9, rate_mhz)
    for k in range(1, 400):
        due = 17 + int(k * period)
        assert bench.poll(due - 1) == b""
        assert one(bench, due).time_us == due


def test_the_first_frame_follows_one_period_after_start(bench: Bench) -> None:
    stream(bench, 100_000)
    assert instants(bench, range(0, 25_000, 500)) == [10_000, 20_000]
    stream(bench, 100_000, at_us=25_000)
    assert instants(bench, range(25_000, 50_000, 500)) == [35_000, 45_000]


def test_rate_keeps_the_phase(bench: Bench) -> None:
    stream(bench, 100_000)
    assert instants(bench, range(0, 12_000, 500)) == [10_000]
    assert bench.ask(12_000, RATE, 2, 250_000).type == ACK
    assert instants(bench, range(12_500, 20_000, 500)) == [14_000, 18_000]


def test_rate_before_the_first_frame_counts_from_start(bench: Bench) -> None:
    stream(bench, 100_000)
    assert bench.ask(1_000, RATE, 2, 200_000).type == ACK
    assert instants(bench, range(1_000, 11_000, 500)) == [5_000, 10_000]


def test_rate_after_the_new_period_is_over(bench: Bench) -> None:
    """The next frame comes at once, and those in between were never due."""
    stream(bench, 1_000)
    bench.send(request(RATE, 2, 100_000))
    ack, frame = said(bench.poll(503_000))
    assert (ack.type, frame.type, frame.sequence) == (ACK, FRAME, 2)
    assert instants(bench, range(503_500, 524_000, 500)) == [513_000, 523_000]
    assert bench.counters.given_up == 0


def test_frames_polled_too_late_leave_a_gap(bench: Bench) -> None:
    stream(bench, 100_000)
    first = one(bench, 10_000)
    late = one(bench, 47_000)  # due at 20, 30 and 40 ms
    then = one(bench, 50_000)
    assert (late.sequence, late.time_us) == (first.sequence + 1, 47_000)
    assert then.sequence == late.sequence + 3
    assert bench.counters.given_up == 2


def test_a_sample_that_failed_leaves_a_gap(bench: Bench) -> None:
    stream(bench, 100_000)
    bench.health(sample=False)
    assert bench.poll(10_000) == b""
    bench.health()
    assert one(bench, 20_000).sequence == 2


def test_a_full_line_does_not_block_and_leaves_a_gap(bench: Bench) -> None:
    stream(bench, 100_000)
    bench.room(10)
    out = b"".join(bench.poll(now) for now in range(0, 1_000_001, 5_000))
    assert len(out) == 10, "part of the first frame"
    bench.room(10**6)
    told = said(out + bench.poll(1_005_000) + bench.poll(1_010_000))
    numbers = [found.sequence for found in told]
    assert numbers == [*range(1, len(told)), 101], "what waited, then what is new"
    assert bench.counters.given_up == 101 - len(told)
    assert [frame_counts(found) for found in told] == [[0, 0]] * len(told)


def test_an_answer_waits_for_the_line_and_goes_before_new_frames(bench: Bench) -> None:
    stream(bench, 100_000)
    bench.room(0)
    for now in range(0, 5_000_001, 10_000):
        assert bench.poll(now) == b""
    given_up = bench.counters.given_up
    assert given_up > 0
    bench.send(request(HELLO, 7) + request(STOP, 8))
    for now in range(5_010_000, 6_000_001, 10_000):
        assert bench.poll(now) == b""
    assert bench.counters.given_up == given_up + 100, "it goes on streaming until it can say that it stopped"
    bench.room(10**6)
    told = said(bench.poll(6_005_000) + bench.poll(6_006_000) + bench.poll(7_000_000))
    kinds = [found.type for found in told]
    assert kinds == [FRAME] * (len(told) - 2) + [DESCRIBE, ACK]
    assert [found.request for found in told[-2:]] == [7, 8]
    assert told[-2].sequence == 1 + 600, "the numbers of frames that were given up are not used again"


def test_frames_do_not_keep_a_long_answer_waiting(bench: Bench) -> None:
    """The line carries a frame in each period, and all that it has room for."""
    stream(bench, 100_000)
    bench.room(0)
    for now in range(0, 5_000_001, 10_000):
        bench.poll(now)
    assert bench.counters.given_up > 0
    bench.send(request(HELLO, 7))
    for now in range(5_010_000, 5_200_000, 10_000):
        bench.room(30)
        bench.poll(now)
    assert bench.counters.requests == 2
    assert not bench.is_on


def test_a_line_that_takes_a_byte_at_a_time(bench: Bench) -> None:
    stream(bench, 10_000)
    out = b""
    for now in range(0, 1_000_000, 1_000):
        bench.room(1)
        out += bench.poll(now)
    told = said(out[: out.rindex(b"\x00") + 1])
    assert [found.sequence for found in told] == list(range(1, len(told) + 1))
    assert len(told) >= 9


def test_numbers_wrap(bench: Bench) -> None:
    stream(bench, 100_000)
    bench.number(2**32 - 1)
    assert [one(bench, now).sequence for now in (10_000, 20_000)] == [2**32 - 1, 0]


def test_time_has_64_bits(bench: Bench) -> None:
    late = 3 * 2**40
    stream(bench, 100_000, at_us=late)
    assert one(bench, late + 10_000).time_us == late + 10_000


@pytest.mark.parametrize("taxels", [1, 2, 115, 116, 117, 118, 242, 243, 244, 245, 400])
def test_frames_of_any_length_without_a_zero(built: Path, taxels: int) -> None:
    """Blocks of 254 bytes begin and end everywhere in a message."""
    size = next((r, taxels // r) for r in (1, 2, 4) if taxels % r == 0 and taxels // r <= 255)
    makeup = Makeup(
        shape=0, bit_depth=16, columns=range(size[1]), rows=range(size[0]), size=size, max_rate_mhz=10**6
    )
    bench = Bench(built, makeup)
    stream(bench, 100_000)
    for value, zeros in ((0xFFFF, ()), (0x0101, ()), (0x00FF, ()), (0xABCD, (taxels // 2,)), (0, ())):
        counts = [0 if i in zeros else value for i in range(taxels)]
        bench.feel(counts)
        before = bench.counters.frames
        assert frame_counts(one(bench, 10_000 * (before + 1))) == counts


# ---- TARE ----


class Tared:
    """A stream of 100 frames a second whose samples are given one by one."""

    def __init__(self, bench: Bench) -> None:
        self.bench = bench
        self.now_us = 0
        stream(bench, 100_000)

    def ask(self, kind: int, *values: int) -> None:
        answer = self.bench.ask(self.now_us, kind, 9, *values)
        assert answer.type in {ACK, DESCRIBE}

    def frame(self, *counts: int) -> tuple[int, list[int]]:
        self.bench.feel(counts)
        self.now_us += 10_000
        found = one(self.bench, self.now_us)
        return found.flags, frame_counts(found)


def test_tare_takes_the_mean_off(bench: Bench) -> None:
    array = Tared(bench)
    array.ask(TARE, 2, 64)
    assert array.frame(10, 1000) == (0, [10, 1000])
    assert array.frame(11, 1002) == (0, [11, 1002])
    assert array.frame(11, 1001) == (1, [64, 64]), "10.5 is rounded to 11"
    assert array.frame(0, 900) == (1, [53, 0]), "noise below zero is seen down to the pedestal"
    assert array.frame(4095, 4094) == (1, [4095, 3157]), "saturated stays saturated"
    assert array.frame(4094, 4095) == (1, [4095, 4095]), "the pedestal does not lead beyond the largest"


def test_tare_survives_stop_start_and_rate(bench: Bench) -> None:
    array = Tared(bench)
    array.ask(TARE, 2, 0)
    array.frame(100, 100)
    array.ask(STOP)
    array.ask(START, 100_000)
    assert array.frame(102, 102) == (0, [102, 102]), "the average goes on in the next stream"
    array.ask(RATE, 100_000)
    assert array.frame(111, 121) == (1, [10, 20])


def test_tare_0_and_hello_go_back_to_raw_counts(bench: Bench) -> None:
    array = Tared(bench)
    for again in ((TARE, 0, 0), (HELLO,)):
        array.ask(TARE, 1, 0)
        array.frame(100, 100)
        assert array.frame(101, 101) == (1, [1, 1])
        array.ask(*again)
        array.ask(START, 100_000)
        assert array.frame(101, 101) == (0, [101, 101])


def test_tare_0_and_hello_end_an_average(bench: Bench) -> None:
    array = Tared(bench)
    for again in ((TARE, 0, 0), (HELLO,)):
        array.ask(TARE, 2, 0)
        array.frame(100, 100)
        array.ask(*again)
        array.ask(START, 100_000)
        assert [array.frame(100, 100) for _ in range(3)] == [(0, [100, 100])] * 3


def test_a_tare_while_one_is_averaging_begins_anew(bench: Bench) -> None:
    array = Tared(bench)
    array.ask(TARE, 2, 0)
    array.frame(4000, 4000)
    array.ask(TARE, 2, 7)
    assert array.frame(100, 100) == (0, [100, 100])
    assert array.frame(100, 100) == (0, [100, 100])
    assert array.frame(101, 102) == (1, [8, 9])


def test_a_tared_array_keeps_its_zero_until_the_new_one_is_there(bench: Bench) -> None:
    array = Tared(bench)
    array.ask(TARE, 1, 5)
    array.frame(100, 100)
    array.ask(TARE, 2, 50)
    assert array.frame(110, 110) == (1, [15, 15])
    assert array.frame(110, 110) == (1, [15, 15])
    assert array.frame(110, 110) == (1, [50, 50])


def test_the_longest_average_does_not_overflow(built: Path) -> None:
    bench = Bench(built, Makeup(shape=0, bit_depth=16, max_rate_mhz=10**9, radius_mm=0.0))
    stream(bench, 100_000)
    assert bench.ask(0, TARE, 1, 1024, 0).type == ACK
    bench.feel([65534, 65535, 0, 1, 32767, 32768])
    for k in range(1, 1025):
        assert one(bench, 10_000 * k).flags == 0
    tared = one(bench, 10_250_000)
    assert (tared.flags, frame_counts(tared)) == (1, [0, 65535, 0, 0, 0, 0])
