"""The firmware's requests and stream, in process."""

import struct
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import pytest

from support.devices.firmware import Bench, Makeup
from support.oracles.array_messages import (
    ACK,
    DESCRIBE,
    FRAME,
    GEOMETRY,
    HELLO,
    RATE,
    SELF_TEST,
    START,
    STOP,
    TARE,
    Reason,
    frame_counts,
    message_wire,
    request,
    said,
)

# ----------------------------------------------------------------------------------------------------
# Requests in every state, reasons to refuse them, and faults, as `docs/tactile-protocol.md` has them.

RATE_MHZ = 100_000
PERIOD_US = 10_000
FLAT = Makeup(shape=0, radius_mm=0.0)
PLAIN = replace(FLAT, has_self_test=False, has_geometry=False)


@pytest.fixture
def bench(built: Path) -> Bench:
    return Bench(built)


def test_broken_hardware(bench: Bench) -> None:
    bench.health(stream=False, test=False)
    assert bench.ask(0, START, 1, RATE_MHZ).reason == Reason.HARDWARE
    assert bench.ask(0, SELF_TEST, 2).reason == Reason.HARDWARE
    assert bench.ask(0, START, 3, 0).reason == Reason.BAD_RATE
    assert bench.frames(100_000) == []


@pytest.mark.parametrize(("length", "heard"), [(64, True), (65, False)])
def test_messages_of_64_bytes_without_the_delimiter_are_listened_to(
    bench: Bench, length: int, heard: bool
) -> None:
    data = message_wire(1, 0x33, 0, 0, b"\x07\x00".ljust(length - 23, b"\x01"))
    assert len(data) == length + 1
    bench.send(data)
    told = said(bench.poll(1) + bench.poll(2))
    assert [found.reason for found in told] == [Reason.UNKNOWN_TYPE] * heard
    assert bench.counters.faults == (not heard)


def test_requests_that_a_plain_array_does_not_know(built: Path) -> None:
    bench = Bench(built, PLAIN)
    assert bench.ask(0, SELF_TEST, 1).reason == Reason.UNKNOWN_TYPE
    assert bench.ask(0, GEOMETRY, 2, 0xFFFF).reason == Reason.UNKNOWN_TYPE, "the type is looked at first"
    assert bench.ask(0, START, 3, RATE_MHZ).type == ACK
    assert bench.ask(0, SELF_TEST, 4).reason == Reason.UNKNOWN_TYPE


def test_a_report_lists_what_is_bad(built: Path) -> None:
    bench = Bench(built, replace(FLAT, size=(3, 170), columns=range(170), rows=range(3)))
    bench.ail([(i % 3) + 1 for i in range(510)], result=0x8001)
    told = bench.ask(0, SELF_TEST, 5)
    assert told.payload[2:6] == struct.pack("<HH", 0x8011, 510)
    listed = list(struct.iter_unpack("<BBB", told.payload[6:]))
    assert listed == [(i // 170, i % 170, i % 3 + 1) for i in range(255)]


def test_a_report_of_nothing_bad(bench: Bench) -> None:
    assert bench.ask(0, SELF_TEST, 5).payload == struct.pack("<HHH", 5, 0, 0)


def test_geometry_is_told_in_pieces(built: Path) -> None:
    bench = Bench(built, Makeup(shape=2, columns=None, rows=None, size=(7, 5), radius_mm=0.0))
    places = [(i, 2.0 * i, -i, 0.0, 0.0, 1.0) for i in range(35)]
    bench.place(places)
    told: list[tuple[float, ...]] = []
    while len(told) < 35:
        payload = bench.ask(0, GEOMETRY, 1, len(told)).payload
        first, count = struct.unpack_from("<HB", payload, 2)
        assert (first, len(payload)) == (len(told), 5 + 24 * count)
        assert count >= 1
        told += struct.iter_unpack("<6f", payload[5:])
    assert told == places
    assert bench.ask(0, GEOMETRY, 2, 35).reason == Reason.BAD_PAYLOAD


@pytest.mark.parametrize(
    ("makeup", "why"),
    [
        (replace(FLAT, size=(0, 3)), "rows and columns must be"),
        (replace(FLAT, size=(3, 171)), "PALPATE_MAX_TAXELS"),
        (replace(FLAT, columns=None), "places of columns"),
        (Makeup(shape=2, has_geometry=False), "geometry"),
        (replace(FLAT, bit_depth=17), "bit depth"),
        (replace(FLAT, bit_depth=0), "bit depth"),
        (replace(FLAT, max_rate_mhz=0), "maximum rate"),
        (replace(FLAT, firmware=b"x" * 33), "PALPATE_MAX_NAME"),
    ],
)
def test_descriptions_that_cannot_be_are_refused(built: Path, makeup: Makeup, why: str) -> None:
    problem = Bench(built, makeup).problem
    assert problem is not None
    assert why in problem


# ----------------------------------------------------------------------------------------------------
# When frames come, what is in them, and what happens if the line is full or the array is polled too late.

PAIR = Makeup(shape=0, columns=(0.0, 1.0), rows=(1.0,), size=(1, 2), radius_mm=0.0, max_rate_mhz=10**9)


@pytest.fixture
def pair_bench(built: Path) -> Bench:
    return Bench(built, PAIR)


@pytest.mark.parametrize("rate_mhz", [333_333, 7_000, 700_001, 90_909])
def test_frames_keep_their_pace_whatever_the_period(pair_bench: Bench, rate_mhz: int) -> None:
    pair_bench.stream(rate_mhz, at_us=17)
    period = Fraction(10**9, rate_mhz)
    for k in range(1, 400):
        due = 17 + int(k * period)
        assert pair_bench.poll(due - 1) == b""
        assert pair_bench.one(due).time_us == due


def test_rate_after_the_new_period_is_over(pair_bench: Bench) -> None:
    """The next frame comes at once, and those in between were never due."""
    pair_bench.stream(1_000)
    pair_bench.send(request(RATE, 2, 100_000))
    ack, frame = said(pair_bench.poll(503_000))
    assert (ack.type, frame.type, frame.sequence) == (ACK, FRAME, 2)
    assert pair_bench.instants(range(503_500, 524_000, 500)) == [513_000, 523_000]
    assert pair_bench.counters.given_up == 0


def test_frames_polled_too_late_leave_a_gap(pair_bench: Bench) -> None:
    pair_bench.stream(100_000)
    first = pair_bench.one(10_000)
    late = pair_bench.one(47_000)  # due at 20, 30 and 40 ms
    then = pair_bench.one(50_000)
    assert (late.sequence, late.time_us) == (first.sequence + 1, 47_000)
    assert then.sequence == late.sequence + 3
    assert pair_bench.counters.given_up == 2


def test_a_sample_that_failed_leaves_a_gap(pair_bench: Bench) -> None:
    pair_bench.stream(100_000)
    pair_bench.health(sample=False)
    assert pair_bench.poll(10_000) == b""
    pair_bench.health()
    assert pair_bench.one(20_000).sequence == 2


def test_a_full_line_does_not_block_and_leaves_a_gap(pair_bench: Bench) -> None:
    pair_bench.stream(100_000)
    pair_bench.room(10)
    out = b"".join(pair_bench.poll(now) for now in range(0, 1_000_001, 5_000))
    assert len(out) == 10, "part of the first frame"
    pair_bench.room(10**6)
    told = said(out + pair_bench.poll(1_005_000) + pair_bench.poll(1_010_000))
    numbers = [found.sequence for found in told]
    assert numbers == [*range(1, len(told)), 101], "what waited, then what is new"
    assert pair_bench.counters.given_up == 101 - len(told)
    assert [frame_counts(found) for found in told] == [[0, 0]] * len(told)


def test_an_answer_waits_for_the_line_and_goes_before_new_frames(pair_bench: Bench) -> None:
    pair_bench.stream(100_000)
    pair_bench.room(0)
    for now in range(0, 5_000_001, 10_000):
        assert pair_bench.poll(now) == b""
    given_up = pair_bench.counters.given_up
    assert given_up > 0
    pair_bench.send(request(HELLO, 7) + request(STOP, 8))
    for now in range(5_010_000, 6_000_001, 10_000):
        assert pair_bench.poll(now) == b""
    assert pair_bench.counters.given_up == given_up + 100, (
        "it goes on streaming until it can say that it stopped"
    )
    pair_bench.room(10**6)
    told = said(pair_bench.poll(6_005_000) + pair_bench.poll(6_006_000) + pair_bench.poll(7_000_000))
    kinds = [found.type for found in told]
    assert kinds == [FRAME] * (len(told) - 2) + [DESCRIBE, ACK]
    assert [found.request for found in told[-2:]] == [7, 8]
    assert told[-2].sequence == 1 + 600, "the numbers of frames that were given up are not used again"


def test_frames_do_not_keep_a_long_answer_waiting(pair_bench: Bench) -> None:
    """The line carries a frame in each period, and all that it has room for."""
    pair_bench.stream(100_000)
    pair_bench.room(0)
    for now in range(0, 5_000_001, 10_000):
        pair_bench.poll(now)
    assert pair_bench.counters.given_up > 0
    pair_bench.send(request(HELLO, 7))
    for now in range(5_010_000, 5_200_000, 10_000):
        pair_bench.room(30)
        pair_bench.poll(now)
    assert pair_bench.counters.requests == 2
    assert not pair_bench.is_on


def test_a_line_that_takes_a_byte_at_a_time(pair_bench: Bench) -> None:
    pair_bench.stream(10_000)
    out = b""
    for now in range(0, 1_000_000, 1_000):
        pair_bench.room(1)
        out += pair_bench.poll(now)
    told = said(out[: out.rindex(b"\x00") + 1])
    assert [found.sequence for found in told] == list(range(1, len(told) + 1))
    assert len(told) >= 9


def test_numbers_wrap(pair_bench: Bench) -> None:
    pair_bench.stream(100_000)
    pair_bench.number(2**32 - 1)
    assert [pair_bench.one(now).sequence for now in (10_000, 20_000)] == [2**32 - 1, 0]


def test_time_has_64_bits(pair_bench: Bench) -> None:
    late = 3 * 2**40
    pair_bench.stream(100_000, at_us=late)
    assert pair_bench.one(late + 10_000).time_us == late + 10_000


@pytest.mark.parametrize("taxels", [1, 2, 115, 116, 117, 118, 242, 243, 244, 245, 400])
def test_frames_of_any_length_without_a_zero(built: Path, taxels: int) -> None:
    """Blocks of 254 bytes begin and end everywhere in a message."""
    size = next((r, taxels // r) for r in (1, 2, 4) if taxels % r == 0 and taxels // r <= 255)
    makeup = Makeup(
        shape=0, bit_depth=16, columns=range(size[1]), rows=range(size[0]), size=size, max_rate_mhz=10**6
    )
    bench = Bench(built, makeup)
    bench.stream(100_000)
    for value, zeros in ((0xFFFF, ()), (0x0101, ()), (0x00FF, ()), (0xABCD, (taxels // 2,)), (0, ())):
        counts = [0 if i in zeros else value for i in range(taxels)]
        bench.feel(counts)
        before = bench.counters.frames
        assert frame_counts(bench.one(10_000 * (before + 1))) == counts


# ---- TARE ----


def test_the_longest_average_does_not_overflow(built: Path) -> None:
    bench = Bench(built, Makeup(shape=0, bit_depth=16, max_rate_mhz=10**9, radius_mm=0.0))
    bench.stream(100_000)
    assert bench.ask(0, TARE, 1, 1024, 0).type == ACK
    bench.feel([65534, 65535, 0, 1, 32767, 32768])
    for k in range(1, 1025):
        assert bench.one(10_000 * k).flags == 0
    tared = bench.one(10_250_000)
    assert (tared.flags, frame_counts(tared)) == (1, [0, 65535, 0, 0, 0, 0])
