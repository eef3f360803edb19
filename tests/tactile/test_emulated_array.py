"""Emulated arrays: answers, tare, drivers by name."""

from dataclasses import replace

import numpy as np
import pytest

from palpate.base.errors import DeviceError, InputError
from palpate.drivers.emulators.array import EmulatedArray
from palpate.drivers.emulators.taxels import Taxels
from palpate.drivers.tactile.codec import Decoder, encode
from palpate.drivers.tactile.messages import (
    Ack,
    BadTaxel,
    Describe,
    Geometry,
    Hello,
    Message,
    Nack,
    NackReason,
    Rate,
    SelfTest,
    SelfTestReport,
    SelfTestResult,
    Start,
    Stop,
    TaxelFault,
    TaxelPlaces,
)
from palpate.rig.arrays import array_plugin
from palpate.testing import ArrayConformance
from support.devices.array_wire import DESCRIPTION, RATE, emulated, heard, small, stream, told
from support.oracles.array_messages import FREE, PLACES, SMALL, VERSION_2, wire

# ----------------------------------------------------------------------------------------------------
# The emulated array, request by request, against `docs/tactile-protocol.md`.


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
