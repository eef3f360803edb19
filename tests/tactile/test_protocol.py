"""The protocol of arrays: messages, description, fuzzing."""

import itertools
import math
import pickle
import re
import struct
import tracemalloc
import zlib
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from cobs import cobs
from hypothesis import given, settings
from hypothesis import strategies as st

from palpate.base.errors import DeviceError
from palpate.drivers.emulators.array import EmulatedArray
from palpate.drivers.emulators.taxels import Taxels
from palpate.drivers.tactile.codec import MAX_ENCODED_BYTES, DecodeFault, Decoder, FaultKind, encode
from palpate.drivers.tactile.description import Description, Shape
from palpate.drivers.tactile.messages import (
    Ack,
    BadTaxel,
    Describe,
    Frame,
    Geometry,
    Hello,
    Message,
    MessageBody,
    MessageType,
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
from palpate.testing import fuzz
from support.commands.repository import ROOT
from support.devices.array_wire import emulated
from support.oracles.array_messages import (
    BAD,
    DESCRIBE_PAYLOAD,
    FREE,
    FREE_PAYLOAD,
    PLACES,
    REPORT_PAYLOAD,
    SMALL,
    TAXELS_PAYLOAD,
    VECTORS,
    VERSION_2,
    bodies,
    frames,
    plain_cobs,
    seal,
    u16,
    u32,
    u64,
    wire,
    written_vectors,
)

# ----------------------------------------------------------------------------------------------------
# The codec against vectors from outside it, and against any bytes whatever.

DOC = ROOT / "docs" / "tactile-protocol.md"


def test_crc_check_value() -> None:
    assert zlib.crc32(b"123456789") == 0xCBF43926


@pytest.mark.parametrize(
    ("plain", "stuffed"),
    [  # the example packet of the 1999 paper, then those that everyone's implementation shows
        ("45 00 00 2c 4c 79 00 00 40 06 4f 37", "02 45 01 04 2c 4c 79 01 05 40 06 4f 37"),
        ("00", "01 01"),
        ("00 00", "01 01 01"),
        ("11 22 00 33", "03 11 22 02 33"),
        ("11 22 33 44", "05 11 22 33 44"),
        ("11 00 00 00", "02 11 01 01 01"),
    ],
)
def test_cobs_published_examples(plain: str, stuffed: str) -> None:
    assert cobs.encode(bytes.fromhex(plain)) == bytes.fromhex(stuffed)
    assert plain_cobs(bytes.fromhex(plain)) == bytes.fromhex(stuffed)


@pytest.mark.parametrize("name", VECTORS)
def test_vectors_computed_apart_from_the_codec(name: str) -> None:
    message, expected = VECTORS[name]
    assert encode(message) == expected
    assert Decoder().feed(expected) == [message]


def test_written_vectors_are_the_same() -> None:
    ours = [(name.partition(",")[0], data) for name, (_, data) in VECTORS.items()]
    shown = [(re.split("[ ,]", name)[0], data) for name, data in written_vectors().items()]
    assert sorted(shown) == sorted([*ours, ("HELLO", VERSION_2)])
    assert f"    {VECTORS['HELLO'][1].hex(' ')}\n" in DOC.read_text()


def test_a_message_of_another_version_says_what_is_needed_to_refuse_it() -> None:
    (fault,) = Decoder().feed(VERSION_2)
    assert fault == DecodeFault(FaultKind.VERSION, type_code=0x01, request_id=8, version=2)
    (theirs,) = Decoder(version=2).feed(VERSION_2)
    assert theirs == Message(7, 4000, Hello(8))
    assert encode(theirs, version=2) == VERSION_2


def test_the_longest_message_is_as_long_as_the_document_says() -> None:
    longest = encode(Message(2**32 - 1, 2**64 - 1, Frame(64, 64, b"\xff" * 8192), 0xFFFF))
    assert len(longest) - 1 == MAX_ENCODED_BYTES
    assert f"at most {MAX_ENCODED_BYTES} without its delimiter" in DOC.read_text()
    assert len(Decoder().feed(longest)) == 1


def test_a_last_block_of_254_bytes_may_be_closed_or_not() -> None:
    body = Frame(1, 124, b"\x11" * 248)  # 2 + 248 + 4 bytes follow the header's last zero
    closed = wire(0x90, 1, 2, b"\x01\x7c" + body.taxels)
    brief = encode(Message(1, 2, body))
    assert closed == brief[:-1] + b"\x01\x00"
    assert Decoder().feed(closed) == Decoder().feed(brief) == [Message(1, 2, body)]


def numbered(parts: list[MessageBody], first: int) -> list[Message]:
    return [Message((first + i) % 2**32, 1000 * i, body) for i, body in enumerate(parts)]


def messages_of(items: list[Message | DecodeFault]) -> list[Message]:
    return [item for item in items if isinstance(item, Message)]


@given(st.builds(Message, u32, u64, bodies, u16))
@settings(max_examples=150)
def test_one_message_whole_and_byte_by_byte(message: Message) -> None:
    data = encode(message)
    assert data.count(0) == 1
    assert data[-1] == 0
    assert Decoder().feed(data) == [message]
    decoder = Decoder()
    assert [item for byte in data for item in decoder.feed(bytes((byte,)))] == [message]


@given(bodies, bodies, st.binary(min_size=1, max_size=60))
@settings(max_examples=150)
def test_garbage_in_front_between_and_behind(a: MessageBody, b: MessageBody, garbage: bytes) -> None:
    # Each piece of garbage is closed off by a delimiter, so it can take no message with it.
    one, two = numbered([a, b], 7)
    decoder = Decoder()
    data = garbage + b"\0" + encode(one) + garbage + b"\0" + encode(two) + garbage + b"\0"
    assert messages_of(decoder.feed(data)) == [one, two]
    assert decoder.faults.total() == 3 * sum(1 for piece in garbage.split(b"\0") if piece)


@given(frames(), st.binary(min_size=1, max_size=40), st.integers(0, 10**6))
@settings(max_examples=150)
def test_garbage_inside_costs_one_message(body: Frame, garbage: bytes, where: int) -> None:
    before, hit, after = numbered([body, body, body], 0)
    data = encode(hit)
    at = where % len(data)
    decoder = Decoder()
    got = decoder.feed(encode(before) + data[:at] + garbage + data[at:] + encode(after))
    kept = messages_of(got)
    assert kept[0] == before
    assert kept[-1] == after
    assert decoder.faults.total() >= 1 or kept == [before, hit, after]  # extra delimiters at the ends


@pytest.mark.parametrize(
    ("data", "kind"),
    [
        (b"\x05\x01\x00", FaultKind.FRAMING),
        (b"\x03\x01\x02\x00", FaultKind.SHORT),
        (VECTORS["ACK"][1].replace(b"\x87", b"\x88"), FaultKind.CRC),
        (wire(0x82, 1, 2, b"\x01\x00", version=2), FaultKind.VERSION),
        (wire(0x82, 1, 2, b"\x01\x00", grow=1), FaultKind.LENGTH),
        (wire(0x42, 1, 2, b"\x01\x00"), FaultKind.UNKNOWN_TYPE),
        (wire(0x82, 1, 2, b"\x01"), FaultKind.PAYLOAD),
        (wire(0x83, 1, 2, b"\x01\x00\x63"), FaultKind.PAYLOAD),
        (wire(0x90, 1, 2, b"\x02\x03\x00"), FaultKind.PAYLOAD),
        (wire(0x90, 1, 2, b"\x00\x03"), FaultKind.PAYLOAD),
        (wire(0x81, 1, 2, DESCRIBE_PAYLOAD[:-1]), FaultKind.PAYLOAD),
        (wire(0x81, 1, 2, DESCRIBE_PAYLOAD[:-1] + b"\xff"), FaultKind.PAYLOAD),
        (
            wire(0x81, 1, 2, DESCRIBE_PAYLOAD[:27] + b"\0\0\xc0\x7f" + DESCRIBE_PAYLOAD[31:]),
            FaultKind.PAYLOAD,
        ),
        (wire(0x81, 1, 2, FREE_PAYLOAD[:39] + b"\0\0\x80\x3f" + FREE_PAYLOAD[39:]), FaultKind.PAYLOAD),
        (wire(0x81, 1, 2, FREE_PAYLOAD[:19] + b"\x03" + FREE_PAYLOAD[20:]), FaultKind.PAYLOAD),
        (wire(0x84, 1, 2, REPORT_PAYLOAD[:-3]), FaultKind.PAYLOAD),
        (wire(0x84, 1, 2, REPORT_PAYLOAD[:-1] + b"\x04"), FaultKind.PAYLOAD),
        (wire(0x85, 1, 2, TAXELS_PAYLOAD[:-1]), FaultKind.PAYLOAD),
        (wire(0x85, 1, 2, b"\x07\x00\x00\x00\x00"), FaultKind.PAYLOAD),
        (wire(0x85, 1, 2, TAXELS_PAYLOAD.replace(b"\0\0\x80\x3f", b"\0\0\x84\x3f")), FaultKind.PAYLOAD),
        (wire(0x85, 1, 2, TAXELS_PAYLOAD.replace(b"\0\0\xa0\x40", b"\0\0\xc0\x7f")), FaultKind.PAYLOAD),
        (wire(0x05, 1, 2, b"\x01\x00\x02\x00"), FaultKind.PAYLOAD),
        (wire(0x07, 1, 2, b"\x01\x00"), FaultKind.PAYLOAD),
        (b"\x01" * (MAX_ENCODED_BYTES + 1) + b"\x00", FaultKind.OVERSIZED),
    ],
)
def test_each_fault_is_named_and_the_next_message_heard(data: bytes, kind: FaultKind) -> None:
    decoder = Decoder()
    fault, message = decoder.feed(data + VECTORS["HELLO"][1])
    assert isinstance(fault, DecodeFault)
    assert fault.kind is kind
    assert message == VECTORS["HELLO"][0]


def test_gaps_are_counted_over_the_wrap_and_late_frames_dropped() -> None:
    body = Frame(1, 1, b"\x01\x02")
    decoder = Decoder()
    got = decoder.feed(b"".join(encode(Message(n, 0, body)) for n in (2**32 - 2, 1, 1, 0, 2)))
    assert [(i.sequence if isinstance(i, Message) else i.kind) for i in got] == [
        2**32 - 2,
        FaultKind.SEQUENCE_GAP,
        1,
        FaultKind.STALE,
        FaultKind.STALE,
        2,
    ]
    assert decoder.lost == 2


def test_an_answer_from_a_restarted_array_starts_the_count_anew() -> None:
    decoder = Decoder()
    frame = Frame(1, 1, b"\x01\x02")
    data = b"".join(map(encode, (Message(900, 0, frame), Message(0, 0, Ack(4)), Message(1, 0, frame))))
    assert len(messages_of(decoder.feed(data))) == 3
    assert decoder.lost == 0


@pytest.mark.parametrize(
    "message",
    [
        Message(2**32, 0, Hello(1)),
        Message(0, -1, Hello(1)),
        Message(0, 0, Hello(70000)),
        Message(0, 0, Frame(2, 2, b"\0")),
        Message(0, 0, Start(1, -5)),
        Message(0, 0, Tare(1, 70000)),
        Message(0, 0, SelfTestReport(1, SelfTestResult.TAXELS, 3, BAD)),
        Message(0, 0, TaxelPlaces(1, 0, ())),
        Message(0, 0, TaxelPlaces(1, 0, PLACES[:-1])),
        Message(0, 0, TaxelPlaces(1, 0, (0.0,) * 6)),
        Message(0, 0, TaxelPlaces(1, 0, (1e300, *PLACES[1:]))),
    ],
)
def test_encode_refuses_what_does_not_fit(message: Message) -> None:
    with pytest.raises(ValueError, match=r"out of range|frame with|six each|taxels are bad|where 3|allowed"):
        encode(message)


# ----------------------------------------------------------------------------------------------------
# What an array says of itself: places and normals of its taxels, and what makes it unusable.

PAD = replace(SMALL, shape=Shape.FLAT, tip_radius_mm=0.0, columns=(-2.0, 0.0, 2.0))


def test_places_on_a_cylinder() -> None:
    place, normal = SMALL.positions_mm(), SMALL.normals()
    assert place.shape == normal.shape == (2, 3, 3)
    np.testing.assert_allclose(place[1, 2], [5 * math.cos(0.5), 5 * math.sin(0.5), 3.0])
    np.testing.assert_allclose(normal[0, 0], [math.cos(0.5), -math.sin(0.5), 0.0])


def test_places_on_a_flat_pad() -> None:
    np.testing.assert_allclose(PAD.positions_mm()[1, 2], [2.0, 0.0, 3.0])
    np.testing.assert_allclose(PAD.normals(), np.broadcast_to([0.0, -1.0, 0.0], (2, 3, 3)), atol=1e-15)


def test_places_on_a_free_surface() -> None:
    known = replace(FREE, geometry=PLACES)
    assert known.problem() is None
    np.testing.assert_array_equal(known.positions_mm(), [[[5, 0, 1], [0, 5, 1]]])
    np.testing.assert_array_equal(known.normals(), [[[1, 0, 0], [0, 1, 0]]])


def test_normals_that_were_rounded_come_out_with_length_one() -> None:
    known = replace(FREE, geometry=(*PLACES[:3], 1.009, 0.0, 0.0, *PLACES[6:]))
    assert known.problem() is None
    np.testing.assert_array_equal(known.normals(), [[[1, 0, 0], [0, 1, 0]]])


def test_places_that_were_never_fetched_are_no_places() -> None:
    assert FREE.problem() is None
    for ask in (FREE.positions_mm, FREE.normals):
        with pytest.raises(DeviceError, match=r"2 taxels of array 000102.* not known; .* fetch its geometry"):
            ask()


@pytest.mark.parametrize(
    ("bad", "problem"),
    [
        (replace(FREE, geometry=PLACES[:-1]), "11 reals of geometry (allowed: 12)"),
        (replace(FREE, geometry=PLACES[:6]), "6 reals of geometry (allowed: 12)"),
        (replace(FREE, geometry=(*PLACES[:3], 1.011, *PLACES[4:])), "length 1.011 (allowed: 1 within 1 %)"),
        (replace(FREE, geometry=(*PLACES[:3], 0.989, *PLACES[4:])), "length 0.989 (allowed: 1 within 1 %)"),
        (replace(FREE, geometry=(math.inf, *PLACES[1:])), "position of inf mm (allowed: -1000 to 1000 mm)"),
        (replace(FREE, geometry=(*PLACES[:3], math.nan, *PLACES[4:])), "normal of length nan"),
        (replace(FREE, columns=(0.0, 1.0)), "allowed: on a surface that is not free"),
        (replace(FREE, row_heights_mm=(1.0,)), "allowed: on a surface that is not free"),
        (replace(SMALL, geometry=PLACES * 3), "place of its own for each taxel"),
        (replace(SMALL, columns=(0.0, 1.0)), "2 column positions (allowed: 3)"),
        (replace(SMALL, columns=(-20.0, 0.0, 20.0)), "column 0 at -20 rad (allowed: -3.1416 to 3.1416 rad)"),
        (replace(PAD, columns=(-1e4, 0.0, 2.0)), "column 0 at -10000 mm (allowed: -1000 to 1000 mm)"),
        (replace(SMALL, columns=(0.0, 1e-9, 1.0)), "column 1 at 1e-09 rad after one at 0 rad"),
        (replace(SMALL, row_heights_mm=(3.0, 1.0)), "row 1 at 1 mm after one at 3 mm (allowed: ascending"),
        (replace(SMALL, tip_radius_mm=0.0), "tip radius 0 mm (allowed: 0.1 to 1000 mm)"),
        (replace(SMALL, tip_radius_mm=1e30), "tip radius 1e+30 mm"),
        (replace(SMALL, full_scale_n=math.nan), "full scale nan N (allowed: 0.001 to 100000 N)"),
        (replace(SMALL, full_scale_n=-math.inf), "full scale -inf N"),
        (replace(SMALL, full_scale_n=1e38), "full scale 1e+38 N"),
        (replace(SMALL, counts_per_n=1e-38), "counts per N 1e-38 (allowed: 0.001 to 1e+07)"),
        (replace(SMALL, counts_per_n=1e38), "counts per N 1e+38"),
        (replace(SMALL, row_heights_mm=(1.0, 3e6)), "row 1 at 3000000 mm (allowed: -1000 to 1000 mm)"),
        (replace(SMALL, max_rate_hz=0.0), "maximum rate 0 Hz (allowed: 0.001 to"),
        (replace(SMALL, rows=0), "rows 0 (allowed: 1 to 255)"),
        (replace(SMALL, rows=64, cols=65), "64 x 65 taxels, together 4160 (allowed: 1 to 4096)"),
        (replace(SMALL, bit_depth=17), "bit depth 17 (allowed: 1 to 16)"),
    ],
)
def test_what_cannot_be_used_is_said(bad: Description, problem: str) -> None:
    assert problem in str(bad.problem())


# ----------------------------------------------------------------------------------------------------
# Ten million wrong bytes through the decoder, and some through the emulated array.


def from_an_array() -> bytes:
    """A delimiter, and 90 messages of every type that an array sends, about 30 kB."""
    rng = np.random.default_rng(705)
    bad = (BadTaxel(1, 2, TaxelFault.UNSTEADY),)
    parts = [
        Describe(1, SMALL),
        Ack(2),
        Nack(3, NackReason.BAD_STATE),
        SelfTestReport(4, SelfTestResult.TAXELS, 1, bad),
        Describe(5, FREE),
        TaxelPlaces(6, 0, PLACES),
    ]
    parts += [Frame(8, 20, rng.integers(0, 4096, 160, dtype="<u2").tobytes()) for _ in range(84)]
    return b"\0" + b"".join(encode(Message(n, 5000 * n, body)) for n, body in enumerate(parts))


def from_a_host() -> bytes:
    """A delimiter, and every request, right and wrong."""
    parts = [Hello(1), Start(2, 100_000), Rate(3, 200_000), Tare(4, 3, 9), Geometry(5, 1), SelfTest(6)]
    parts += [Stop(7), SelfTest(8), Start(9, 0), Tare(10, 5000, 0), Geometry(11, 99), Stop(12)]
    once = b"\0" + b"".join(encode(Message(n, n, body)) for n, body in enumerate(parts)) + VERSION_2
    return once * 40


def test_ten_million_bytes_give_messages_or_counted_faults() -> None:
    tally = fuzz(Decoder, from_an_array(), 10_000_000, seed=705)
    assert tally.fed == 10_000_000
    assert MAX_ENCODED_BYTES // 2 < tally.most_waiting <= MAX_ENCODED_BYTES
    assert tally.items["DecodeFault"] == tally.faults.total() > 20_000
    assert tally.items["Message"] > 5_000
    assert set(tally.items) == {"Message", "DecodeFault"}
    for after in tally.recovered:  # the delimiter in front ends what was left of the garbage
        assert after["Message"] == tally.undisturbed["Message"] == 90


class Receiver:
    """An emulated array as a decoder: what it sends must be well-formed."""

    def __init__(self) -> None:
        self.array: EmulatedArray = emulated(Taxels(SMALL, seed=1), self_test_s=0.003)
        self.ears = Decoder()
        self.now = 0.0

    @property
    def faults(self) -> Counter[FaultKind]:
        return self.ears.faults

    @property
    def waiting(self) -> int:
        return self.ears.waiting

    def feed(self, data: bytes, /) -> list[Message | DecodeFault]:
        self.now += 0.001
        return self.ears.feed(b"".join(said for _, said in self.array.feed(data, self.now)))


def test_an_emulated_array_answers_garbage_with_nothing_but_messages() -> None:
    receivers: list[Receiver] = []

    def make() -> Receiver:
        receivers.append(Receiver())
        return receivers[-1]

    fresh = len(pickle.dumps(Receiver().array))
    tally = fuzz(make, from_a_host(), 1_000_000, seed=17)
    assert tally.fed == 1_000_000
    assert set(tally.items) == {"Message"}
    assert tally.items["Message"] > 3_000
    assert tally.most_waiting == 0
    for receiver in receivers:
        receiver.array.poll(receiver.now + 1.0)
        assert len(pickle.dumps(receiver.array)) < fresh + MAX_ENCODED_BYTES + 2_000


def test_a_gap_without_end_takes_no_memory() -> None:
    decoder = Decoder()
    gap = b"\x55" * 5_000
    tracemalloc.start()
    try:
        faults = [item for _ in range(1_000) for item in decoder.feed(gap)]
        held, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert [fault.kind for fault in faults if isinstance(fault, DecodeFault)] == [FaultKind.OVERSIZED]
    assert held < 20_000
    (message,) = decoder.feed(b"\0" + VECTORS["HELLO"][1])
    assert message == VECTORS["HELLO"][0]


def test_whatever_has_a_right_crc_gives_messages_or_faults() -> None:
    rng = np.random.default_rng(3)
    decoder = Decoder()
    plains = [cobs.decode(data[:-1])[:-4] for _, data in VECTORS.values()]
    seen: Counter[str] = Counter()
    for k in range(20_000):
        plain = bytearray(plains[k % len(plains)])
        for at in rng.integers(0, len(plain), int(rng.integers(1, 4))):
            plain[at] = int(rng.choice([0, 1, 2, 127, 128, 255, int(rng.integers(256))]))
        cut = bytes(plain[: int(rng.integers(18, len(plain) + 1))] if k % 3 == 0 else plain)
        if k % 2:
            cut = cut[:16] + struct.pack("<H", len(cut) - 18) + cut[18:]
        (item,) = decoder.feed(seal(cut))[-1:]
        seen[item.kind.name if isinstance(item, DecodeFault) else type(item.body).__name__] += 1
    wanted = {
        "VERSION",
        "LENGTH",
        "UNKNOWN_TYPE",
        "PAYLOAD",
        "Describe",
        "SelfTestReport",
        "TaxelPlaces",
        "Tare",
        "Frame",
    }
    assert wanted <= set(seen)
    assert {"FRAMING", "SHORT", "CRC", "OVERSIZED"}.isdisjoint(seen)


damaged = st.builds(
    lambda body, at, new: encode(Message(5, 6, body))[:at] + new,
    bodies,
    st.integers(0, 60),
    st.binary(max_size=8),
)
sealed = st.builds(
    lambda head, payload: seal(struct.pack("<BBHIQH", *head, len(payload)) + payload),
    st.tuples(st.integers(0, 2), st.sampled_from([*MessageType, 0x42]), u16, u32, u64),
    st.binary(max_size=80),
)
parts = st.one_of(
    st.binary(max_size=60),
    sealed,
    st.builds(lambda body, number: encode(Message(number, 0, body)), bodies, st.integers(0, 5)),
    damaged,
    st.sampled_from([b"\0", VERSION_2, b"\x77" * MAX_ENCODED_BYTES, b"\x77" * (MAX_ENCODED_BYTES + 1)]),
)


@given(st.lists(parts, max_size=8), st.lists(st.integers(1, 300), min_size=1, max_size=8))
@settings(max_examples=150)
def test_how_the_bytes_are_cut_makes_no_difference(stream: list[bytes], sizes: list[int]) -> None:
    data = b"".join(stream) + b"\0"
    whole, cut = Decoder(), Decoder()
    items = whole.feed(data)
    pieces: list[Message | DecodeFault] = []
    at, lengths = 0, itertools.cycle(sizes)
    while at < len(data):
        size = next(lengths)
        pieces += cut.feed(data[at : at + size])
        at += size
        assert cut.waiting <= MAX_ENCODED_BYTES
    assert pieces == items
    assert cut.faults == whole.faults
    assert whole.faults.total() == sum(isinstance(item, DecodeFault) for item in items)
    assert cut.waiting == whole.waiting == 0
    assert Message(0, 0, Hello(9)) in cut.feed(encode(Message(0, 0, Hello(9))))
