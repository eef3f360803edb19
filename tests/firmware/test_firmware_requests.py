"""Requests in every state, reasons to refuse them, and faults, as `docs/tactile-protocol.md` has them."""

import struct
from dataclasses import replace
from pathlib import Path

import pytest
from firmware_bench import Bench, Makeup
from wire_messages import (
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
    request,
    said,
    wire,
)

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
    data = wire(1, 0x33, 0, 0, b"\x07\x00".ljust(length - 23, b"\x01"))
    assert len(data) == length + 1
    bench.send(data)
    told = said(bench.poll(1) + bench.poll(2))
    assert [found.reason for found in told] == [Reason.UNKNOWN_TYPE] * heard
    assert bench.counters.faults == (not heard)


@pytest.mark.parametrize("kind", [0x00, 0x08, 0x7F])
def test_unknown_requests(bench: Bench, kind: int) -> None:
    (told,) = send(bench, wire(1, kind, 0, 0, b"\x07\x00 and more"))
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
        (told,) = send(bench, wire(1, kind, 0, 0, b"\x07\x00".ljust(length, b"\x00")))
        assert (told.request, told.reason) == (7, Reason.BAD_PAYLOAD), length


@pytest.mark.parametrize("kind", [HELLO, STOP, 0x30])
@pytest.mark.parametrize("payload", [b"", b"\x07"])
def test_a_request_without_a_number_gets_no_answer(bench: Bench, kind: int, payload: bytes) -> None:
    assert send(bench, wire(1, kind, 0, 0, payload)) == []
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
        wire(1, HELLO, 0, 0, b"\x07\x00", length=3),
        wire(1, ACK, 0, 0, b"\x07\x00"),  # what arrays send
        wire(1, 0xFF, 0, 0, b"\x07\x00"),
        wire(2, ACK, 0, 0, b"\x07\x00"),
        wire(2, HELLO, 0, 0, b"\x07"),
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
        (told,) = send(bench, wire(2, kind, 0, 0, b"\x07\x00 something new", length=3))
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
