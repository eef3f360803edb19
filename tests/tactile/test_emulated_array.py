"""Emulated arrays: answers, tare, drivers by name."""

import math
from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from palpate.base.errors import DeviceError, InputError
from palpate.drivers.emulators.array import EmulatedArray
from palpate.drivers.emulators.taxels import Taxels
from palpate.drivers.tactile.codec import Decoder, encode
from palpate.drivers.tactile.messages import (
    Ack,
    BadTaxel,
    Describe,
    Frame,
    Geometry,
    Hello,
    Message,
    MessageBody,
    Nack,
    NackReason,
    Rate,
    SelfTest,
    SelfTestReport,
    SelfTestResult,
    Start,
    Stop,
    Tare,
    TaxelFault,
    TaxelPlaces,
)
from palpate.rig.arrays import array_plugin
from palpate.testing import ArrayConformance
from support.devices.array_wire import DESCRIPTION, RATE, emulated, heard, small, stream, told
from support.oracles.array_messages import FREE, PLACES, SMALL, VERSION_2, wire

# ----------------------------------------------------------------------------------------------------
# The emulated array, request by request, against `docs/tactile-protocol.md`.


@pytest.mark.parametrize("streaming", [False, True])
@pytest.mark.parametrize(
    ("request_", "idle", "busy"),
    [
        (Hello(9), Describe(9, SMALL), Describe(9, SMALL)),
        (Start(9, RATE), Ack(9), Ack(9)),
        (Stop(9), Ack(9), Ack(9)),
        (Rate(9, RATE), Nack(9, NackReason.BAD_STATE), Ack(9)),
        (Tare(9, 4, 10), Ack(9), Ack(9)),
        (Tare(9, 0, 0), Ack(9), Ack(9)),
        (SelfTest(9), None, Nack(9, NackReason.BAD_STATE)),
        (Start(9, 0), Nack(9, NackReason.BAD_RATE), Nack(9, NackReason.BAD_RATE)),
        (Start(9, 200_001), Nack(9, NackReason.BAD_RATE), Nack(9, NackReason.BAD_RATE)),
        (Rate(9, 0), Nack(9, NackReason.BAD_RATE), Nack(9, NackReason.BAD_RATE)),
        (Rate(9, 200_001), Nack(9, NackReason.BAD_RATE), Nack(9, NackReason.BAD_RATE)),
        (Tare(9, 1025, 0), Nack(9, NackReason.BAD_PAYLOAD), Nack(9, NackReason.BAD_PAYLOAD)),
        (Tare(9, 0, 4096), Nack(9, NackReason.BAD_PAYLOAD), Nack(9, NackReason.BAD_PAYLOAD)),
        (Geometry(9, 6), Nack(9, NackReason.BAD_PAYLOAD), Nack(9, NackReason.BAD_PAYLOAD)),
    ],
)
def test_every_request_in_every_state(
    request_: MessageBody, idle: MessageBody | None, busy: MessageBody | None, streaming: bool
) -> None:
    array = small()
    if streaming:
        told(array, Start(1, 50_000))
    want = busy if streaming else idle
    if want is not None:
        assert told(array, request_) == want
    refused = isinstance(want, Nack) or isinstance(request_, Tare)
    goes_on = streaming if refused else isinstance(request_, Start | Rate)
    assert (array.next_sample_s() is not None) is goes_on
    if refused and streaming:
        assert array.next_sample_s() == 0.02  # what was going on goes on


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (wire(0x42, 0, 0, b"\x07\x00"), NackReason.UNKNOWN_TYPE),
        (wire(0x42, 0, 0, b"\x07\x00\x01\x02\x03"), NackReason.UNKNOWN_TYPE),
        (wire(0x02, 0, 0, b"\x07\x00\x00\x00\x00"), NackReason.BAD_PAYLOAD),
        (wire(0x01, 0, 0, b"\x07\x00\x00"), NackReason.BAD_PAYLOAD),
        (wire(0x42, 0, 0, b"\x07\x00", version=2), NackReason.BAD_VERSION),
        (wire(0x01, 0, 0, b"\x07\x00", version=0, grow=3), NackReason.BAD_VERSION),
    ],
)
def test_what_an_array_cannot_read_is_refused_by_number(data: bytes, reason: NackReason) -> None:
    (answer,) = heard(small(), data)
    assert answer.body == Nack(7, reason)


@pytest.mark.parametrize(
    "data",
    [
        wire(0xC2, 0, 0, b"\x07\x00"),
        wire(0x82, 0, 0, b"\x07"),
        wire(0x81, 0, 0, b"\x07\x00", version=2),
        wire(0x82, 0, 0, b"\x07\x00"),
        wire(0x01, 0, 0, b"\x07"),
        wire(0x42, 0, 0, b""),
        wire(0x01, 0, 0, b"\x07", version=2),
        wire(0x01, 0, 0, b"\x07\x00", grow=1),
        b"\x05\x01\x00",
        b"\x01" * 100 + b"\x00",
    ],
)
def test_what_is_no_request_gets_no_answer(data: bytes) -> None:
    array = small()
    assert heard(array, data) == []
    assert told(array, Stop(3)) == Ack(3)


def test_the_document_s_message_of_version_2_gets_the_document_s_answer() -> None:
    array = small()
    for number in range(5):
        told(array, Stop(number))
    (answer,) = array.feed(VERSION_2, 0.0005)
    assert answer == (0.0005, wire(0x83, 5, 500, b"\x08\x00\x06"))


def test_an_array_of_another_version_answers_in_its_own() -> None:
    array = EmulatedArray(Taxels(SMALL, seed=0), version=2)
    (answer,) = heard(array, encode(Message(0, 0, Hello(4))), version=2)
    assert answer.body == Nack(4, NackReason.BAD_VERSION)
    assert heard(array, VERSION_2, version=2)[0].body == Describe(8, SMALL)


def test_a_new_rate_keeps_the_phase() -> None:
    array = small()
    told(array, Start(1, RATE))
    assert told(array, Rate(2, 50_000), 0.004) == Ack(2)
    assert [m.time_us for m in stream(array, 0.061)] == [20_000, 40_000, 60_000]
    assert told(array, Rate(3, 200_000), 0.062) == Ack(3)
    assert [m.time_us for m in stream(array, 0.071)] == [65_000, 70_000]


def test_a_frame_that_would_be_late_already_comes_at_once() -> None:
    array = small()
    told(array, Start(1, 10_000))
    told(array, Rate(2, RATE), 0.055)
    assert [m.time_us for m in stream(array, 0.08)] == [55_000, 65_000, 75_000]


def test_the_self_test_finds_dead_and_hot_taxels() -> None:
    taxels = Taxels(
        DESCRIPTION,
        seed=3,
        gain_spread=0.2,
        offset_counts=40,
        crosstalk=0.1,
        dead=[(7, 19), (0, 1)],
        hot=[(4, 4)],
    )
    array = emulated(taxels)
    assert heard(array, encode(Message(0, 0, SelfTest(8))), 1.0) == []
    assert array.next_due() == 1.25
    (answer,) = heard(array, b"", 1.25)
    bad = (
        BadTaxel(0, 1, TaxelFault.STUCK_LOW),
        BadTaxel(4, 4, TaxelFault.STUCK_HIGH),
        BadTaxel(7, 19, TaxelFault.STUCK_LOW),
    )
    assert answer.body == SelfTestReport(8, SelfTestResult.TAXELS, 3, bad)


@pytest.mark.parametrize("depth", [4, 8, 12, 16])
def test_the_self_test_of_good_taxels_finds_nothing_at_any_depth(depth: int) -> None:
    most = (1 << depth) - 1
    description = replace(DESCRIPTION, bit_depth=depth, counts_per_n=float(most))
    array = emulated(Taxels(description, seed=1, noise_counts=most / 2000, gain_spread=0.3), self_test_s=0.0)
    assert told(array, SelfTest(1)) == SelfTestReport(1, SelfTestResult(0), 0, ())


def test_the_list_of_bad_taxels_ends_at_255() -> None:
    wide = replace(DESCRIPTION, rows=16, row_heights_mm=tuple(map(float, range(16))))
    array = emulated(Taxels(wide, seed=1, noise_counts=400.0), self_test_s=0.0)
    report = told(array, SelfTest(1))
    assert isinstance(report, SelfTestReport)
    assert report.bad_count == 320
    assert len(report.bad) == 255
    assert set(report.bad) == {BadTaxel(k // 20, k % 20, TaxelFault.UNSTEADY) for k in range(255)}


def test_what_arrives_during_a_self_test_waits_for_its_turn() -> None:
    array = small([(0,) * 6] * 16 + [(3000,) * 6] * 17)
    requests = encode(Message(0, 0, SelfTest(1))) + encode(Message(1, 0, Start(2, RATE)))
    assert array.feed(requests, 1.0) == []
    assert array.feed(encode(Message(2, 0, Stop(3))), 1.1) == []
    answers = array.poll(1.3)
    assert [at for at, _ in answers] == [1.25] * 3
    bodies = [m.body for m in Decoder().feed(b"".join(data for _, data in answers)) if isinstance(m, Message)]
    assert bodies == [SelfTestReport(1, SelfTestResult(0), 0, ()), Ack(2), Ack(3)]
    assert array.next_due() is None


def test_a_broken_converter_is_reported_and_streams_nothing() -> None:
    array = EmulatedArray(Taxels(SMALL, seed=0), broken=SelfTestResult.CONVERTER, self_test_s=0.0)
    assert told(array, Start(1, RATE)) == Nack(1, NackReason.HARDWARE)
    assert told(array, Start(2, 0)) == Nack(2, NackReason.BAD_RATE)
    report = told(array, SelfTest(3))
    assert isinstance(report, SelfTestReport)
    assert SelfTestResult.CONVERTER in report.result


def test_a_start_that_the_hardware_refuses_leaves_the_stream_as_it_is() -> None:
    array = small()
    told(array, Start(1, RATE))
    array.broken = SelfTestResult.CONVERTER
    assert told(array, Start(2, 50_000), 0.001) == Nack(2, NackReason.HARDWARE)
    assert array.next_sample_s() == 0.01


def test_numbers_begin_with_0_and_hello_does_not_set_them_back() -> None:
    array = small()
    hello = encode(Message(0, 0, Hello(4)))
    assert [heard(array, hello)[0].sequence for _ in range(3)] == [0, 1, 2]


def test_places_of_a_free_array() -> None:
    array = EmulatedArray(Taxels(replace(FREE, geometry=PLACES), seed=0))
    assert told(array, Hello(1)) == Describe(1, FREE)
    assert told(array, Geometry(2, 0)) == TaxelPlaces(2, 0, PLACES)
    assert told(array, Geometry(3, 1)) == TaxelPlaces(3, 1, PLACES[6:])
    assert told(array, Geometry(4, 2)) == Nack(4, NackReason.BAD_PAYLOAD)
    with pytest.raises(DeviceError, match="not known"):
        EmulatedArray(Taxels(FREE, seed=0))


def test_places_of_a_cylinder_are_those_that_describe_implies() -> None:
    array = EmulatedArray(Taxels(DESCRIPTION, seed=0))
    places: list[float] = []
    while len(places) < 6 * DESCRIPTION.taxels:
        part = told(array, Geometry(1, len(places) // 6))
        assert isinstance(part, TaxelPlaces)
        places += part.places
    got = np.reshape(places, (8, 20, 6))
    np.testing.assert_allclose(got[..., :3], DESCRIPTION.positions_mm(), atol=1e-5)
    np.testing.assert_allclose(got[..., 3:], DESCRIPTION.normals(), atol=1e-6)


# ----------------------------------------------------------------------------------------------------
# TARE of the emulated array against an arithmetic of its own.

counts = st.integers(0, 4095)


@given(
    st.lists(st.lists(counts, min_size=6, max_size=6), min_size=1, max_size=8),
    st.lists(counts, min_size=6, max_size=6),
    counts,
)
@settings(max_examples=60)
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


# ----------------------------------------------------------------------------------------------------
# The built-in protocol passes the suite that plug-ins have to pass; unknown protocols are named.


class TestPalpateArray(ArrayConformance):
    protocol = "palpate"


def test_an_unknown_protocol_lists_known_ones_and_says_how_to_add_one() -> None:
    with pytest.raises(InputError) as caught:
        array_plugin("braille")
    for words in (
        '"braille"',
        '"palpate"',
        '"weiss-dsa"',
        '"weiss-wts"',
        "install",
        "palpate.tactile_arrays",
    ):
        assert words in str(caught.value)
