"""The codec against vectors from outside it, and against any bytes whatever."""

import re
import zlib
from itertools import pairwise

import pytest
from cobs import cobs
from hypothesis import given, settings
from hypothesis import strategies as st
from repository import ROOT
from tactile_bodies import bodies, frames, u16, u32, u64
from tactile_vectors import (
    BAD,
    DESCRIBE_PAYLOAD,
    FREE_PAYLOAD,
    PLACES,
    REPORT_PAYLOAD,
    TAXELS_PAYLOAD,
    VECTORS,
    VERSION_2,
    plain_cobs,
    wire,
)

from palpate.drivers.tactile.codec import MAX_ENCODED_BYTES, DecodeFault, Decoder, FaultKind, encode
from palpate.drivers.tactile.messages import (
    Ack,
    Frame,
    Hello,
    Message,
    MessageBody,
    SelfTestReport,
    SelfTestResult,
    Start,
    Tare,
    TaxelPlaces,
)

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


def test_document_shows_the_same_vectors() -> None:
    shown = re.findall(r"^\| ([A-Z_]+)[^|]* \| `([0-9a-f ]+)` \|$", DOC.read_text(), re.M)
    ours = [(name.partition(",")[0], data) for name, (_, data) in VECTORS.items()]
    assert sorted((name, bytes.fromhex(text)) for name, text in shown) == sorted(
        [*ours, ("HELLO", VERSION_2)]
    )


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
def test_a_stream_cut_anywhere(parts: list[MessageBody], first: int, cuts: list[int]) -> None:
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
def test_garbage_in_front_between_and_behind(a: MessageBody, b: MessageBody, garbage: bytes) -> None:
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
