"""The codec against vectors from outside it, and against any bytes whatever."""

import math
import re
import struct
import zlib
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from cobs import cobs
from hypothesis import given, settings
from hypothesis import strategies as st

from palpate.drivers.tactile.messages import (
    Ack,
    Body,
    Describe,
    Description,
    Frame,
    Hello,
    Message,
    Nack,
    NackReason,
    Shape,
    Start,
    Stop,
)
from palpate.drivers.tactile.protocol import MAX_ENCODED, DecodeFault, Decoder, FaultKind, encode

DOC = Path(__file__).parents[2] / "docs" / "tactile-protocol.md"


def plain_cobs(data: bytes) -> bytes:
    """COBS straight from the paper's description: cut at zeros, lead each block with its length."""
    out = bytearray()
    block = bytearray()
    for byte in data:
        if byte:
            block.append(byte)
        if byte == 0 or len(block) == 254:
            out += bytes((len(block) + 1,)) + block
            block.clear()
    return bytes(out) + bytes((len(block) + 1,)) + block


def wire(kind: int, sequence: int, time_us: int, payload: bytes, *, version: int = 1, grow: int = 0) -> bytes:
    head = struct.pack("<BBHIQH", version, kind, 0, sequence, time_us, len(payload) + grow) + payload
    return plain_cobs(head + struct.pack("<I", zlib.crc32(head))) + b"\0"


SMALL = Description(
    unique_id=bytes(range(16)),
    firmware="emu 1",
    emulated=True,
    shape=Shape.CYLINDER,
    rows=2,
    cols=3,
    bit_depth=12,
    max_rate_hz=200.0,
    full_scale_n=2.0,
    counts_per_n=2047.5,
    tip_radius_mm=5.0,
    columns=(-0.5, 0.0, 0.5),
    row_heights_mm=(1.0, 3.0),
)
DESCRIBE_PAYLOAD = (
    struct.pack("<H16sBBBBBIfff", 1, bytes(range(16)), 1, 1, 12, 2, 3, 200000, 2.0, 2047.5, 5.0)
    + struct.pack("<5f", -0.5, 0, 0.5, 1, 3)
    + b"\x05emu 1"
)
VECTORS = {
    "HELLO": (Message(0, 0, Hello(1)), wire(0x01, 0, 0, b"\x01\x00")),
    "START": (Message(1, 1500, Start(2, 200000)), wire(0x02, 1, 1500, struct.pack("<HI", 2, 200000))),
    "STOP": (Message(2, 0x0102030405060708, Stop(3)), wire(0x03, 2, 0x0102030405060708, b"\x03\x00")),
    "ACK": (Message(1, 250, Ack(2)), wire(0x82, 1, 250, b"\x02\x00")),
    "NACK": (Message(2, 300, Nack(9, NackReason.BAD_RATE)), wire(0x83, 2, 300, b"\x09\x00\x03")),
    "FRAME": (
        Message(3, 5250, Frame(2, 3, struct.pack("<6H", 0, 1, 255, 256, 4095, 65535))),
        wire(0x90, 3, 5250, struct.pack("<BB6H", 2, 3, 0, 1, 255, 256, 4095, 65535)),
    ),
    "DESCRIBE": (Message(0, 200, Describe(1, SMALL)), wire(0x81, 0, 200, DESCRIBE_PAYLOAD)),
}


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


def test_document_shows_the_same_vectors() -> None:
    shown = dict(re.findall(r"^\| ([A-Z]+), .*\| `([0-9a-f ]+)` \|$", DOC.read_text(), re.M))
    assert {name: bytes.fromhex(text) for name, text in shown.items()} == {
        n: v[1] for n, v in VECTORS.items()
    }


def test_geometry_is_derivable() -> None:
    place, normal = SMALL.positions_mm(), SMALL.normals()
    assert place.shape == normal.shape == (2, 3, 3)
    np.testing.assert_allclose(place[1, 2], [5 * math.cos(0.5), 5 * math.sin(0.5), 3.0])
    np.testing.assert_allclose(normal[0, 0], [math.cos(0.5), -math.sin(0.5), 0.0])


u16, u32, u64 = (st.integers(0, 2**n - 1) for n in (16, 32, 64))
real = st.floats(-1e6, 1e6, width=32)
positive = st.floats(2**-10, 2**20, width=32)


@st.composite
def descriptions(draw: st.DrawFn) -> Description:
    rows, cols = draw(st.integers(1, 6)), draw(st.integers(1, 30))
    return Description(
        unique_id=draw(st.binary(min_size=16, max_size=16)),
        firmware=draw(st.text(max_size=60)),
        emulated=draw(st.booleans()),
        shape=draw(st.sampled_from(Shape)),
        rows=rows,
        cols=cols,
        bit_depth=draw(st.integers(1, 16)),
        max_rate_hz=draw(st.integers(1, 10**6)) / 1000,
        full_scale_n=draw(positive),
        counts_per_n=draw(positive),
        tip_radius_mm=draw(positive),
        columns=tuple(sorted(draw(st.lists(real, min_size=cols, max_size=cols, unique=True)))),
        row_heights_mm=tuple(sorted(draw(st.lists(real, min_size=rows, max_size=rows, unique=True)))),
    )


@st.composite
def frames(draw: st.DrawFn) -> Frame:
    rows, cols = draw(st.integers(1, 9)), draw(st.integers(1, 21))
    return Frame(rows, cols, draw(st.binary(min_size=2 * rows * cols, max_size=2 * rows * cols)))


bodies: st.SearchStrategy[Body] = st.one_of(
    st.builds(Hello, u16),
    st.builds(Start, u16, u32),
    st.builds(Stop, u16),
    st.builds(Ack, u16),
    st.builds(Nack, u16, st.sampled_from(NackReason)),
    st.builds(Describe, u16, descriptions()),
    frames(),
)


def numbered(parts: list[Body], first: int) -> list[Message]:
    return [Message((first + i) % 2**32, 1000 * i, body) for i, body in enumerate(parts)]


def messages_of(items: list[Message | DecodeFault]) -> list[Message]:
    return [item for item in items if isinstance(item, Message)]


@given(st.builds(Message, u32, u64, bodies, u16))
@settings(max_examples=150, deadline=None)
def test_one_message_whole_and_byte_by_byte(message: Message) -> None:
    data = encode(message)
    assert data.count(0) == 1
    assert data[-1] == 0
    assert Decoder().feed(data) == [message]
    decoder = Decoder()
    assert [item for byte in data for item in decoder.feed(bytes((byte,)))] == [message]


@given(st.lists(bodies, min_size=1, max_size=5), u32, st.lists(st.integers(0, 400), max_size=8))
@settings(max_examples=80, deadline=None)
def test_a_stream_cut_anywhere(parts: list[Body], first: int, cuts: list[int]) -> None:
    sent = numbered(parts, first)
    data = b"".join(map(encode, sent))
    decoder = Decoder()
    got: list[Message | DecodeFault] = []
    edges = [0, *sorted(min(c, len(data)) for c in cuts), len(data)]
    for a, b in pairwise(edges):
        got += decoder.feed(data[a:b])
    assert got == sent
    assert not decoder.faults


@given(bodies, bodies, st.binary(min_size=1, max_size=60))
@settings(max_examples=150, deadline=None)
def test_garbage_in_front_between_and_behind(a: Body, b: Body, garbage: bytes) -> None:
    # Each piece of garbage is closed off by a delimiter, so it can take no message with it.
    one, two = numbered([a, b], 7)
    decoder = Decoder()
    data = garbage + b"\0" + encode(one) + garbage + b"\0" + encode(two) + garbage + b"\0"
    assert messages_of(decoder.feed(data)) == [one, two]
    assert decoder.faults.total() == 3 * sum(1 for piece in garbage.split(b"\0") if piece)


@given(frames(), st.binary(min_size=1, max_size=40), st.integers(0, 10**6))
@settings(max_examples=150, deadline=None)
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


@given(st.lists(st.binary(max_size=300), max_size=20))
@settings(max_examples=150, deadline=None)
def test_any_bytes_give_messages_or_faults(chunks: list[bytes]) -> None:
    decoder = Decoder()
    items = [item for chunk in chunks for item in decoder.feed(chunk)]
    assert all(isinstance(item, Message | DecodeFault) for item in items)
    assert decoder.faults.total() == sum(isinstance(item, DecodeFault) for item in items)


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
        (b"\x01" * (MAX_ENCODED + 1) + b"\x00", FaultKind.OVERSIZED),
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
    ],
)
def test_encode_refuses_what_does_not_fit(message: Message) -> None:
    with pytest.raises(ValueError, match=r"out of range|frame with"):
        encode(message)


def test_a_million_random_and_mutated_bytes() -> None:
    rng = np.random.default_rng(705)
    taxels = rng.integers(0, 4096, 160, dtype=np.uint16).tobytes()
    clean = b"".join(encode(Message(n, 5000 * n, Frame(8, 20, taxels))) for n in range(1500))
    mutated = np.frombuffer(clean, np.uint8).copy()
    places = rng.integers(0, mutated.size, 2000)
    mutated[places] = rng.integers(0, 256, places.size, dtype=np.uint8)
    noise = rng.integers(0, 256, 500_000, dtype=np.uint8)
    noise[rng.random(noise.size) < 0.02] = 0
    stream = noise.tobytes() + b"\0" + mutated.tobytes() + b"\0" + rng.bytes(50_000) + b"\0"
    assert len(stream) > 1_000_000
    decoder = Decoder()
    messages = faults = at = 0
    while at < len(stream):
        step = int(rng.integers(1, 700))
        for item in decoder.feed(stream[at : at + step]):
            messages += isinstance(item, Message)
            faults += isinstance(item, DecodeFault)
        at += step
    assert faults == decoder.faults.total()
    assert 300 < messages < 1500
    last = Message(2000, 1, Frame(1, 1, b"\x05\x00"))
    assert messages_of(decoder.feed(encode(last))) == [last]
