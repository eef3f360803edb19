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
    NACK,
    RATE,
    REPORT,
    SELF_TEST,
    START,
    STOP,
    TARE,
    TAXELS,
    Reason,
    Said,
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


@pytest.fixture
def streaming(bench: Bench) -> Bench:
    assert bench.ask(0, START, 1, RATE_MHZ).type == ACK
    return bench


def send(bench: Bench, data: bytes, clock_us: int = 1) -> list[Said]:
    bench.send(data)
    return said(bench.poll(clock_us))


def frames(bench: Bench, until_us: int) -> list[Said]:
    """What comes when the array is polled every ms up to an instant."""
    return [found for now in range(0, until_us + 1, 1000) for found in said(bench.poll(now))]


def test_it_says_nothing_until_it_is_told_to(bench: Bench) -> None:
    assert frames(bench, 100_000) == []
    assert not bench.is_on


@pytest.mark.parametrize(
    ("kind", "values", "answer"),
    [
        (HELLO, (), DESCRIBE),
        (START, (RATE_MHZ,), ACK),
        (STOP, (), ACK),
        (TARE, (4, 0), ACK),
        (SELF_TEST, (), REPORT),
        (GEOMETRY, (0,), TAXELS),
    ],
)
def test_idle(bench: Bench, kind: int, values: tuple[int, ...], answer: int) -> None:
    for number in (7, 7, 8):  # every request may be said twice
        assert bench.ask(1, kind, number, *values).type == answer


@pytest.mark.parametrize(
    ("kind", "values", "answer"),
    [(RATE, (50_000,), ACK), (TARE, (4, 0), ACK), (GEOMETRY, (5,), TAXELS), (START, (50_000,), ACK)],
)
def test_streaming_goes_on(streaming: Bench, kind: int, values: tuple[int, ...], answer: int) -> None:
    assert streaming.ask(1, kind, 7, *values).type == answer
    assert {found.type for found in frames(streaming, 25_000)} == {FRAME}
    assert streaming.is_on


@pytest.mark.parametrize(("kind", "answer"), [(HELLO, DESCRIBE), (STOP, ACK)])
def test_streaming_ends(streaming: Bench, kind: int, answer: int) -> None:
    assert streaming.ask(PERIOD_US - 1, kind, 7).type == answer
    assert frames(streaming, 10 * PERIOD_US) == []
    assert not streaming.is_on


@pytest.mark.parametrize("rate", [0, 200_001, 0xFFFFFFFF])
@pytest.mark.parametrize("kind", [START, RATE])
def test_bad_rates_change_nothing(streaming: Bench, kind: int, rate: int) -> None:
    assert streaming.ask(1, kind, 7, rate).reason == Reason.BAD_RATE
    assert [found.time_us for found in frames(streaming, 2 * PERIOD_US)] == [PERIOD_US, 2 * PERIOD_US]


def test_the_largest_rate_is_allowed(bench: Bench) -> None:
    assert bench.ask(0, START, 1, 200_000).type == ACK


def test_bad_state(bench: Bench) -> None:
    assert bench.ask(0, RATE, 1, RATE_MHZ).reason == Reason.BAD_STATE
    assert bench.ask(0, RATE, 1, 0).reason == Reason.BAD_RATE, "the rate is looked at first"
    assert bench.ask(0, START, 2, RATE_MHZ).type == ACK
    assert bench.ask(0, SELF_TEST, 3).reason == Reason.BAD_STATE
    assert bench.ask(0, STOP, 4).type == ACK
    assert bench.ask(0, SELF_TEST, 5).type == REPORT


def test_broken_hardware(bench: Bench) -> None:
    bench.health(stream=False, test=False)
    assert bench.ask(0, START, 1, RATE_MHZ).reason == Reason.HARDWARE
    assert bench.ask(0, SELF_TEST, 2).reason == Reason.HARDWARE
    assert bench.ask(0, START, 3, 0).reason == Reason.BAD_RATE
    assert frames(bench, 100_000) == []


def test_a_start_that_the_hardware_refuses_leaves_the_stream_as_it_is(streaming: Bench) -> None:
    streaming.health(stream=False)
    assert streaming.ask(1, START, 7, 50_000).reason == Reason.HARDWARE
    assert [found.time_us for found in frames(streaming, 2 * PERIOD_US)] == [PERIOD_US, 2 * PERIOD_US]


def test_numbers_begin_with_0_and_hello_does_not_set_them_back(bench: Bench) -> None:
    assert [bench.ask(0, HELLO, 1).sequence for _ in range(3)] == [0, 1, 2]


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


@pytest.mark.parametrize("kind", [0x00, 0x08, 0x7F])
def test_unknown_requests(bench: Bench, kind: int) -> None:
    (told,) = send(bench, message_wire(1, kind, 0, 0, b"\x07\x00 and more"))
    assert (told.request, told.reason) == (7, Reason.UNKNOWN_TYPE)


def test_requests_that_a_plain_array_does_not_know(built: Path) -> None:
    bench = Bench(built, PLAIN)
    assert bench.ask(0, SELF_TEST, 1).reason == Reason.UNKNOWN_TYPE
    assert bench.ask(0, GEOMETRY, 2, 0xFFFF).reason == Reason.UNKNOWN_TYPE, "the type is looked at first"
    assert bench.ask(0, START, 3, RATE_MHZ).type == ACK
    assert bench.ask(0, SELF_TEST, 4).reason == Reason.UNKNOWN_TYPE


@pytest.mark.parametrize("kind", [HELLO, START, STOP, RATE, TARE, SELF_TEST, GEOMETRY])
def test_payloads_of_another_length(bench: Bench, kind: int) -> None:
    right = {START: 6, RATE: 6, TARE: 6, GEOMETRY: 4}.get(kind, 2)
    for length in {2, 3, 4, 5, 6, 7, 12} - {right}:
        (told,) = send(bench, message_wire(1, kind, 0, 0, b"\x07\x00".ljust(length, b"\x00")))
        assert (told.request, told.reason) == (7, Reason.BAD_PAYLOAD), length


@pytest.mark.parametrize("kind", [HELLO, STOP, 0x30])
@pytest.mark.parametrize("payload", [b"", b"\x07"])
def test_a_request_without_a_number_gets_no_answer(bench: Bench, kind: int, payload: bytes) -> None:
    assert send(bench, message_wire(1, kind, 0, 0, payload)) == []
    assert bench.counters.faults == 1


@pytest.mark.parametrize(("samples", "pedestal"), [(1025, 0), (0xFFFF, 0), (1, 4096), (0, 4096)])
def test_bad_tares(bench: Bench, samples: int, pedestal: int) -> None:
    assert bench.ask(0, TARE, 1, samples, pedestal).reason == Reason.BAD_PAYLOAD


@pytest.mark.parametrize(("samples", "pedestal"), [(1024, 0), (1, 4095), (0, 0)])
def test_good_tares(bench: Bench, samples: int, pedestal: int) -> None:
    assert bench.ask(0, TARE, 1, samples, pedestal).type == ACK


@pytest.mark.parametrize(
    "data",
    [
        b"\x05\x01\x00",  # not COBS
        b"\x02\x01\x00",  # short
        b"\x01" * 200 + b"\x00",  # oversized
        request(HELLO, 1)[:-3] + b"\x55\x66\x00",  # CRC
        message_wire(1, HELLO, 0, 0, b"\x07\x00", length=3),
        message_wire(1, ACK, 0, 0, b"\x07\x00"),  # what arrays send
        message_wire(1, 0xFF, 0, 0, b"\x07\x00"),
        message_wire(2, ACK, 0, 0, b"\x07\x00"),
        message_wire(2, HELLO, 0, 0, b"\x07"),
    ],
    ids=["framing", "short", "oversized", "crc", "length", "an answer", "bit 7", "bit 7 of 2", "no number"],
)
def test_faults_get_no_answer_and_cost_one_message(bench: Bench, data: bytes) -> None:
    told = send(bench, data + request(STOP, 9))
    told += said(bench.poll(2)) + said(bench.poll(3)) + said(bench.poll(4))
    assert [(found.type, found.request) for found in told] == [(ACK, 9)]
    assert bench.counters.faults == 1


def test_another_version_is_answered_whatever_it_asks(bench: Bench) -> None:
    for kind in (HELLO, 0x44):
        (told,) = send(bench, message_wire(2, kind, 0, 0, b"\x07\x00 something new", length=3))
        assert (told.version, told.request, told.reason) == (1, 7, Reason.BAD_VERSION)


def test_delimiters_alone_mean_nothing(bench: Bench) -> None:
    assert [found.type for found in send(bench, b"\x00\x00\x00" + request(STOP, 1) + b"\x00")] == [ACK]
    assert bench.counters.faults == 0


def test_an_open_port_in_the_middle_of_a_message(bench: Bench) -> None:
    hello = request(HELLO, 1)
    told = send(bench, hello[7:] + hello)
    assert [found.type for found in told] == [DESCRIBE]
    assert bench.counters.faults == 1


def test_a_request_comes_byte_by_byte(bench: Bench) -> None:
    told = [found for byte in request(HELLO, 1) for found in send(bench, bytes([byte]))]
    assert [found.type for found in told] == [DESCRIBE]


def test_requests_are_answered_in_their_order(bench: Bench) -> None:
    bench.send(b"".join(request(kind, kind) for kind in (HELLO, STOP, SELF_TEST)))
    told = said(bench.poll(0) + bench.poll(0))
    assert [(found.type, found.request) for found in told] == [(DESCRIBE, 1), (ACK, 3), (REPORT, 6)]
    assert [found.sequence for found in told] == [0, 1, 2]


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


def test_refusals_use_numbers_too(bench: Bench) -> None:
    told = [bench.ask(0, kind, 1) for kind in (0x20, HELLO, 0x21)]
    assert [found.type for found in told] == [NACK, DESCRIBE, NACK]
    assert [found.sequence for found in told] == [0, 1, 2]


# ----------------------------------------------------------------------------------------------------
# When frames come, what is in them, and what happens if the line is full or the array is polled too late.

PAIR = Makeup(shape=0, columns=(0.0, 1.0), rows=(1.0,), size=(1, 2), radius_mm=0.0, max_rate_mhz=10**9)


@pytest.fixture
def pair_bench(built: Path) -> Bench:
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
def test_frames_keep_their_pace_whatever_the_period(pair_bench: Bench, rate_mhz: int) -> None:
    stream(pair_bench, rate_mhz, at_us=17)
    period = Fraction(10**9, rate_mhz)
    for k in range(1, 400):
        due = 17 + int(k * period)
        assert pair_bench.poll(due - 1) == b""
        assert one(pair_bench, due).time_us == due


def test_the_first_frame_follows_one_period_after_start(pair_bench: Bench) -> None:
    stream(pair_bench, 100_000)
    assert instants(pair_bench, range(0, 25_000, 500)) == [10_000, 20_000]
    stream(pair_bench, 100_000, at_us=25_000)
    assert instants(pair_bench, range(25_000, 50_000, 500)) == [35_000, 45_000]


def test_rate_keeps_the_phase(pair_bench: Bench) -> None:
    stream(pair_bench, 100_000)
    assert instants(pair_bench, range(0, 12_000, 500)) == [10_000]
    assert pair_bench.ask(12_000, RATE, 2, 250_000).type == ACK
    assert instants(pair_bench, range(12_500, 20_000, 500)) == [14_000, 18_000]


def test_rate_before_the_first_frame_counts_from_start(pair_bench: Bench) -> None:
    stream(pair_bench, 100_000)
    assert pair_bench.ask(1_000, RATE, 2, 200_000).type == ACK
    assert instants(pair_bench, range(1_000, 11_000, 500)) == [5_000, 10_000]


def test_rate_after_the_new_period_is_over(pair_bench: Bench) -> None:
    """The next frame comes at once, and those in between were never due."""
    stream(pair_bench, 1_000)
    pair_bench.send(request(RATE, 2, 100_000))
    ack, frame = said(pair_bench.poll(503_000))
    assert (ack.type, frame.type, frame.sequence) == (ACK, FRAME, 2)
    assert instants(pair_bench, range(503_500, 524_000, 500)) == [513_000, 523_000]
    assert pair_bench.counters.given_up == 0


def test_frames_polled_too_late_leave_a_gap(pair_bench: Bench) -> None:
    stream(pair_bench, 100_000)
    first = one(pair_bench, 10_000)
    late = one(pair_bench, 47_000)  # due at 20, 30 and 40 ms
    then = one(pair_bench, 50_000)
    assert (late.sequence, late.time_us) == (first.sequence + 1, 47_000)
    assert then.sequence == late.sequence + 3
    assert pair_bench.counters.given_up == 2


def test_a_sample_that_failed_leaves_a_gap(pair_bench: Bench) -> None:
    stream(pair_bench, 100_000)
    pair_bench.health(sample=False)
    assert pair_bench.poll(10_000) == b""
    pair_bench.health()
    assert one(pair_bench, 20_000).sequence == 2


def test_a_full_line_does_not_block_and_leaves_a_gap(pair_bench: Bench) -> None:
    stream(pair_bench, 100_000)
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
    stream(pair_bench, 100_000)
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
    stream(pair_bench, 100_000)
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
    stream(pair_bench, 10_000)
    out = b""
    for now in range(0, 1_000_000, 1_000):
        pair_bench.room(1)
        out += pair_bench.poll(now)
    told = said(out[: out.rindex(b"\x00") + 1])
    assert [found.sequence for found in told] == list(range(1, len(told) + 1))
    assert len(told) >= 9


def test_numbers_wrap(pair_bench: Bench) -> None:
    stream(pair_bench, 100_000)
    pair_bench.number(2**32 - 1)
    assert [one(pair_bench, now).sequence for now in (10_000, 20_000)] == [2**32 - 1, 0]


def test_time_has_64_bits(pair_bench: Bench) -> None:
    late = 3 * 2**40
    stream(pair_bench, 100_000, at_us=late)
    assert one(pair_bench, late + 10_000).time_us == late + 10_000


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


def test_tare_takes_the_mean_off(pair_bench: Bench) -> None:
    array = Tared(pair_bench)
    array.ask(TARE, 2, 64)
    assert array.frame(10, 1000) == (0, [10, 1000])
    assert array.frame(11, 1002) == (0, [11, 1002])
    assert array.frame(11, 1001) == (1, [64, 64]), "10.5 is rounded to 11"
    assert array.frame(0, 900) == (1, [53, 0]), "noise below zero is seen down to the pedestal"
    assert array.frame(4095, 4094) == (1, [4095, 3157]), "saturated stays saturated"
    assert array.frame(4094, 4095) == (1, [4095, 4095]), "the pedestal does not lead beyond the largest"


def test_tare_survives_stop_start_and_rate(pair_bench: Bench) -> None:
    array = Tared(pair_bench)
    array.ask(TARE, 2, 0)
    array.frame(100, 100)
    array.ask(STOP)
    array.ask(START, 100_000)
    assert array.frame(102, 102) == (0, [102, 102]), "the average goes on in the next stream"
    array.ask(RATE, 100_000)
    assert array.frame(111, 121) == (1, [10, 20])


def test_tare_0_and_hello_go_back_to_raw_counts(pair_bench: Bench) -> None:
    array = Tared(pair_bench)
    for again in ((TARE, 0, 0), (HELLO,)):
        array.ask(TARE, 1, 0)
        array.frame(100, 100)
        assert array.frame(101, 101) == (1, [1, 1])
        array.ask(*again)
        array.ask(START, 100_000)
        assert array.frame(101, 101) == (0, [101, 101])


def test_tare_0_and_hello_end_an_average(pair_bench: Bench) -> None:
    array = Tared(pair_bench)
    for again in ((TARE, 0, 0), (HELLO,)):
        array.ask(TARE, 2, 0)
        array.frame(100, 100)
        array.ask(*again)
        array.ask(START, 100_000)
        assert [array.frame(100, 100) for _ in range(3)] == [(0, [100, 100])] * 3


def test_a_tare_while_one_is_averaging_begins_anew(pair_bench: Bench) -> None:
    array = Tared(pair_bench)
    array.ask(TARE, 2, 0)
    array.frame(4000, 4000)
    array.ask(TARE, 2, 7)
    assert array.frame(100, 100) == (0, [100, 100])
    assert array.frame(100, 100) == (0, [100, 100])
    assert array.frame(101, 102) == (1, [8, 9])


def test_a_tared_array_keeps_its_zero_until_the_new_one_is_there(pair_bench: Bench) -> None:
    array = Tared(pair_bench)
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
