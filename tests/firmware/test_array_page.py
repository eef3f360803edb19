"""`docs/tactile-protocol.md` asked of firmware and emulated array: requests, reasons, faults, TARE."""

import math
from fractions import Fraction
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from support.devices.firmware import Bench, EmulatedBench, PolledArray
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
    frame_counts,
    message_wire,
    request,
    said,
)

RATE_MHZ = 100_000
PERIOD_US = 10_000


def array_of(name: str, built: Path) -> PolledArray:
    return Bench(built) if name == "firmware" else EmulatedBench()


@pytest.fixture(params=["firmware", "emulated"])
def array(request: pytest.FixtureRequest, built: Path) -> PolledArray:
    return array_of(request.param, built)


@pytest.fixture
def streaming(array: PolledArray) -> PolledArray:
    assert array.ask(0, START, 1, RATE_MHZ).type == ACK
    return array


def test_it_says_nothing_until_it_is_told_to(array: PolledArray) -> None:
    assert array.frames(100_000) == []
    assert not array.is_on


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
def test_idle(array: PolledArray, kind: int, values: tuple[int, ...], answer: int) -> None:
    for number in (7, 7, 8):  # every request may be said twice
        assert array.ask(1, kind, number, *values).type == answer


@pytest.mark.parametrize(
    ("kind", "values", "answer"),
    [(RATE, (50_000,), ACK), (TARE, (4, 0), ACK), (GEOMETRY, (5,), TAXELS), (START, (50_000,), ACK)],
)
def test_streaming_goes_on(streaming: PolledArray, kind: int, values: tuple[int, ...], answer: int) -> None:
    assert streaming.ask(1, kind, 7, *values).type == answer
    assert {found.type for found in streaming.frames(25_000)} == {FRAME}
    assert streaming.is_on


@pytest.mark.parametrize(("kind", "answer"), [(HELLO, DESCRIBE), (STOP, ACK)])
def test_streaming_ends(streaming: PolledArray, kind: int, answer: int) -> None:
    assert streaming.ask(PERIOD_US - 1, kind, 7).type == answer
    assert streaming.frames(10 * PERIOD_US) == []
    assert not streaming.is_on


@pytest.mark.parametrize("rate", [0, 200_001, 0xFFFFFFFF])
@pytest.mark.parametrize("kind", [START, RATE])
def test_bad_rates_change_nothing(streaming: PolledArray, kind: int, rate: int) -> None:
    assert streaming.ask(1, kind, 7, rate).reason == Reason.BAD_RATE
    assert [found.time_us for found in streaming.frames(2 * PERIOD_US)] == [PERIOD_US, 2 * PERIOD_US]


def test_the_largest_rate_is_allowed(array: PolledArray) -> None:
    assert array.ask(0, START, 1, 200_000).type == ACK


def test_bad_state(array: PolledArray) -> None:
    assert array.ask(0, RATE, 1, RATE_MHZ).reason == Reason.BAD_STATE
    assert array.ask(0, RATE, 1, 0).reason == Reason.BAD_RATE, "the rate is looked at first"
    assert array.ask(0, START, 2, RATE_MHZ).type == ACK
    assert array.ask(0, SELF_TEST, 3).reason == Reason.BAD_STATE
    assert array.ask(0, STOP, 4).type == ACK
    assert array.ask(0, SELF_TEST, 5).type == REPORT


def test_a_start_that_the_hardware_refuses_leaves_the_stream_as_it_is(streaming: PolledArray) -> None:
    streaming.health(stream=False)
    assert streaming.ask(1, START, 7, 50_000).reason == Reason.HARDWARE
    assert [found.time_us for found in streaming.frames(2 * PERIOD_US)] == [PERIOD_US, 2 * PERIOD_US]


def test_numbers_begin_with_0_and_hello_does_not_set_them_back(array: PolledArray) -> None:
    assert [array.ask(0, HELLO, 1).sequence for _ in range(3)] == [0, 1, 2]


@pytest.mark.parametrize("kind", [0x00, 0x08, 0x7F])
def test_unknown_requests(array: PolledArray, kind: int) -> None:
    (told,) = array.told(message_wire(1, kind, 0, 0, b"\x07\x00 and more"))
    assert (told.request, told.reason) == (7, Reason.UNKNOWN_TYPE)


@pytest.mark.parametrize("kind", [HELLO, START, STOP, RATE, TARE, SELF_TEST, GEOMETRY])
def test_payloads_of_another_length(array: PolledArray, kind: int) -> None:
    right = {START: 6, RATE: 6, TARE: 6, GEOMETRY: 4}.get(kind, 2)
    for length in {2, 3, 4, 5, 6, 7, 12} - {right}:
        (told,) = array.told(message_wire(1, kind, 0, 0, b"\x07\x00".ljust(length, b"\x00")))
        assert (told.request, told.reason) == (7, Reason.BAD_PAYLOAD), length


@pytest.mark.parametrize("kind", [HELLO, STOP, 0x30])
@pytest.mark.parametrize("payload", [b"", b"\x07"])
def test_a_request_without_a_number_gets_no_answer(array: PolledArray, kind: int, payload: bytes) -> None:
    assert array.told(message_wire(1, kind, 0, 0, payload)) == []
    assert array.counted in (None, 1)


@pytest.mark.parametrize(("samples", "pedestal"), [(1025, 0), (0xFFFF, 0), (1, 4096), (0, 4096)])
def test_bad_tares(array: PolledArray, samples: int, pedestal: int) -> None:
    assert array.ask(0, TARE, 1, samples, pedestal).reason == Reason.BAD_PAYLOAD


@pytest.mark.parametrize(("samples", "pedestal"), [(1024, 0), (1, 4095), (0, 0)])
def test_good_tares(array: PolledArray, samples: int, pedestal: int) -> None:
    assert array.ask(0, TARE, 1, samples, pedestal).type == ACK


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
def test_faults_get_no_answer_and_cost_one_message(array: PolledArray, data: bytes) -> None:
    told = array.told(data + request(STOP, 9))
    told += said(array.poll(2)) + said(array.poll(3)) + said(array.poll(4))
    assert [(found.type, found.request) for found in told] == [(ACK, 9)]
    assert array.counted in (None, 1)


def test_another_version_is_answered_whatever_it_asks(array: PolledArray) -> None:
    for version, kind in ((2, HELLO), (2, 0x44), (0, HELLO)):
        (told,) = array.told(message_wire(version, kind, 0, 0, b"\x07\x00 something new", length=3))
        assert (told.version, told.request, told.reason) == (1, 7, Reason.BAD_VERSION)


def test_delimiters_alone_mean_nothing(array: PolledArray) -> None:
    assert [found.type for found in array.told(b"\x00\x00\x00" + request(STOP, 1) + b"\x00")] == [ACK]
    assert array.counted in (None, 0)


def test_an_open_port_in_the_middle_of_a_message(array: PolledArray) -> None:
    hello = request(HELLO, 1)
    told = array.told(hello[7:] + hello)
    assert [found.type for found in told] == [DESCRIBE]
    assert array.counted in (None, 1)


def test_a_request_comes_byte_by_byte(array: PolledArray) -> None:
    told = [found for byte in request(HELLO, 1) for found in array.told(bytes([byte]))]
    assert [found.type for found in told] == [DESCRIBE]


def test_requests_are_answered_in_their_order(array: PolledArray) -> None:
    array.send(b"".join(request(kind, kind) for kind in (HELLO, STOP, SELF_TEST)))
    told = said(array.poll(0) + array.poll(0))
    assert [(found.type, found.request) for found in told] == [(DESCRIBE, 1), (ACK, 3), (REPORT, 6)]
    assert [found.sequence for found in told] == [0, 1, 2]


def test_refusals_use_numbers_too(array: PolledArray) -> None:
    told = [array.ask(0, kind, 1) for kind in (0x20, HELLO, 0x21)]
    assert [found.type for found in told] == [NACK, DESCRIBE, NACK]
    assert [found.sequence for found in told] == [0, 1, 2]


def test_the_first_frame_follows_one_period_after_start(array: PolledArray) -> None:
    array.stream(100_000)
    assert array.instants(range(0, 25_000, 500)) == [10_000, 20_000]
    array.stream(100_000, at_us=25_000)
    assert array.instants(range(25_000, 50_000, 500)) == [35_000, 45_000]


def test_rate_keeps_the_phase(array: PolledArray) -> None:
    array.stream(100_000)
    assert array.instants(range(0, 12_000, 500)) == [10_000]
    assert array.ask(12_000, RATE, 2, 200_000).type == ACK
    assert array.instants(range(12_500, 20_500, 500)) == [15_000, 20_000]


def test_rate_before_the_first_frame_counts_from_start(array: PolledArray) -> None:
    array.stream(100_000)
    assert array.ask(1_000, RATE, 2, 200_000).type == ACK
    assert array.instants(range(1_000, 11_000, 500)) == [5_000, 10_000]


class Tared:
    """A stream of 100 frames a second whose samples are given one by one, two counts three times."""

    def __init__(self, array: PolledArray) -> None:
        self.array = array
        self.now_us = 0
        array.stream(100_000)

    def ask(self, kind: int, *values: int) -> None:
        answer = self.array.ask(self.now_us, kind, 9, *values)
        assert answer.type in {ACK, DESCRIBE}

    def frame(self, *counts: int) -> tuple[int, list[int]]:
        self.array.feel(counts * 3)
        self.now_us += 10_000
        found = self.array.one(self.now_us)
        shown = frame_counts(found)
        assert shown == shown[:2] * 3
        return found.flags, shown[:2]


@pytest.fixture
def tared(array: PolledArray) -> Tared:
    return Tared(array)


def test_tare_takes_the_mean_off(tared: Tared) -> None:
    tared.ask(TARE, 2, 64)
    assert tared.frame(10, 1000) == (0, [10, 1000])
    assert tared.frame(11, 1002) == (0, [11, 1002])
    assert tared.frame(11, 1001) == (1, [64, 64]), "10.5 is rounded to 11"
    assert tared.frame(0, 900) == (1, [53, 0]), "noise below zero is seen down to the pedestal"
    assert tared.frame(4095, 4094) == (1, [4095, 3157]), "saturated stays saturated"
    assert tared.frame(4094, 4095) == (1, [4095, 4095]), "the pedestal does not lead beyond the largest"


def test_tare_survives_stop_start_and_rate(tared: Tared) -> None:
    tared.ask(TARE, 2, 0)
    tared.frame(100, 100)
    tared.ask(STOP)
    tared.ask(START, 100_000)
    assert tared.frame(102, 102) == (0, [102, 102]), "the average goes on in the next stream"
    tared.ask(RATE, 100_000)
    assert tared.frame(111, 121) == (1, [10, 20])


def test_tare_0_and_hello_go_back_to_raw_counts(tared: Tared) -> None:
    for again in ((TARE, 0, 0), (HELLO,)):
        tared.ask(TARE, 1, 0)
        tared.frame(100, 100)
        assert tared.frame(101, 101) == (1, [1, 1])
        tared.ask(*again)
        tared.ask(START, 100_000)
        assert tared.frame(101, 101) == (0, [101, 101])


def test_tare_0_and_hello_end_an_average(tared: Tared) -> None:
    for again in ((TARE, 0, 0), (HELLO,)):
        tared.ask(TARE, 2, 0)
        tared.frame(100, 100)
        tared.ask(*again)
        tared.ask(START, 100_000)
        assert [tared.frame(100, 100) for _ in range(3)] == [(0, [100, 100])] * 3


def test_a_tare_while_one_is_averaging_begins_anew(tared: Tared) -> None:
    tared.ask(TARE, 2, 0)
    tared.frame(4000, 4000)
    tared.ask(TARE, 2, 7)
    assert tared.frame(100, 100) == (0, [100, 100])
    assert tared.frame(100, 100) == (0, [100, 100])
    assert tared.frame(101, 102) == (1, [8, 9])


def test_a_tared_array_keeps_its_zero_until_the_new_one_is_there(tared: Tared) -> None:
    tared.ask(TARE, 1, 5)
    tared.frame(100, 100)
    tared.ask(TARE, 2, 50)
    assert tared.frame(110, 110) == (1, [15, 15])
    assert tared.frame(110, 110) == (1, [15, 15])
    assert tared.frame(110, 110) == (1, [50, 50])


counts = st.integers(0, 4095)


@pytest.mark.parametrize("name", ["firmware", "emulated"])
@given(
    st.lists(st.lists(counts, min_size=2, max_size=2), min_size=1, max_size=8),
    st.lists(counts, min_size=2, max_size=2),
    counts,
)
@settings(max_examples=60)
def test_tare_does_what_the_page_says(
    built: Path, name: str, seen: list[list[int]], then: list[int], pedestal: int
) -> None:
    array = Tared(array_of(name, built))
    array.ask(TARE, len(seen), pedestal)
    assert [array.frame(*one) for one in seen] == [(0, one) for one in seen]
    zero = [math.floor(Fraction(sum(one), len(seen)) + Fraction(1, 2)) for one in zip(*seen, strict=True)]
    raised = [min(max(raw - z + pedestal, 0), 4095) for raw, z in zip(then, zero, strict=True)]
    full = [4095 if raw == 4095 else value for raw, value in zip(then, raised, strict=True)]
    assert array.frame(*then) == (1, full)
