"""The Protocol 2.0 codec against the e-Manual's printed examples, and round trips over hostile payloads."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from manual_examples import EXAMPLES, FAST_EXAMPLES, MISPRINTED_CRC, Example

from palpate.drivers.dynamixel.packet import (
    DamagedPacket,
    Instruction,
    InstructionPacket,
    Parser,
    StatusPacket,
    crc16,
    encode_instruction,
    encode_status,
    stuff,
    unstuff,
)

Packet = InstructionPacket | StatusPacket

RIGHT = [example for example in EXAMPLES if example.printed not in MISPRINTED_CRC]
WRONG = [example for example in EXAMPLES if example.printed in MISPRINTED_CRC]
FLUSH = bytes(1100)  # longer than any packet that a parser may be waiting for


def encode(packet: Packet) -> bytes:
    return encode_status(packet) if isinstance(packet, StatusPacket) else encode_instruction(packet)


def whole(packets: list[Packet | DamagedPacket]) -> list[Packet]:
    return [packet for packet in packets if not isinstance(packet, DamagedPacket)]


def crc_by_long_division(data: bytes) -> int:
    """The catalogue's definition: the remainder of data·x¹⁶ divided by x¹⁶ + x¹⁵ + x² + 1 over GF(2)."""
    rest = int.from_bytes(data, "big") << 16
    while (excess := rest.bit_length() - 17) >= 0:
        rest ^= 0x18005 << excess
    return rest


def test_the_page_has_an_example_of_every_instruction() -> None:
    sent = {e.meaning.instruction for e in EXAMPLES if isinstance(e.meaning, InstructionPacket)}
    assert sent == {int(instruction) for instruction in Instruction}
    assert len(EXAMPLES) == 17 + 16  # instructions and answers
    assert len(FAST_EXAMPLES) == 2


@pytest.mark.parametrize("example", RIGHT, ids=lambda e: f"{e.section}: {e.printed}")
def test_manual_example(example: Example) -> None:
    wire = example.wire
    assert encode(example.meaning) == wire
    assert int.from_bytes(wire[-2:], "little") == crc_by_long_division(wire[:-2])
    assert Parser().feed(wire) == [example.meaning]
    one_by_one = Parser()
    assert [p for byte in wire for p in one_by_one.feed(bytes([byte]))] == [example.meaning]
    assert Parser().feed(wire + wire[:5]) == [example.meaning]


@pytest.mark.parametrize("example", WRONG, ids=lambda e: e.section)
def test_misprinted_example(example: Example) -> None:
    wire, right = example.wire, bytes.fromhex(MISPRINTED_CRC[example.printed])
    assert wire[-2:] != right == crc_by_long_division(wire[:-2]).to_bytes(2, "little")
    assert encode(example.meaning) == wire[:-2] + right
    parser = Parser()
    assert whole(parser.feed(wire + FLUSH)) == []
    assert parser.feed(wire[:-2] + right) == [example.meaning]


def test_one_misprint_is_the_crc_of_another_example() -> None:
    (bulk,) = [example for example in WRONG if example.section == "Fast Bulk Read"]
    (sync,) = [example for example in RIGHT if example.section == "Fast Sync Read"]
    assert bulk.wire[-2:] == sync.wire[-2:]
    assert len(WRONG) == len(MISPRINTED_CRC) == 2


# what a line may carry besides packets: noise, bytes that look like a header, packets cut short
garbage = st.one_of(
    st.binary(max_size=30),
    st.lists(st.sampled_from([0xFF, 0xFF, 0xFD, 0x00, 0x55]), max_size=12).map(bytes),
    st.tuples(st.sampled_from(EXAMPLES), st.integers(1, 9)).map(lambda cut: cut[0].wire[: cut[1]]),
    st.sampled_from(WRONG).map(lambda example: example.wire),
)


@given(st.data())
@settings(max_examples=150)
def test_manual_examples_among_garbage_and_in_pieces(data: st.DataObject) -> None:
    """All of them in a row, garbage before, between and after; every one is found, in order."""
    stream = bytearray(data.draw(garbage))
    for example in RIGHT:
        stream += example.wire + data.draw(garbage)
    stream += FLUSH
    cuts = sorted(data.draw(st.lists(st.integers(0, len(stream)), max_size=40)))
    parser = Parser()
    found: list[Packet] = []
    for start, end in zip([0, *cuts], [*cuts, len(stream)], strict=True):
        found += whole(parser.feed(bytes(stream[start:end])))
    rest = iter(found)
    assert [example.meaning in rest for example in RIGHT] == [True] * len(RIGHT)


@pytest.mark.parametrize("example", RIGHT, ids=lambda e: f"{e.section}: {e.printed}")
def test_a_flipped_bit_anywhere_in_a_manual_example_is_noticed(example: Example) -> None:
    for bit in range(8 * len(example.wire)):
        wire = bytearray(example.wire)
        wire[bit // 8] ^= 1 << bit % 8
        assert whole(Parser().feed(bytes(wire) + FLUSH)) == []


def test_crc_check_value_of_the_catalogue() -> None:
    assert crc16(b"123456789") == crc_by_long_division(b"123456789") == 0xFEE8  # CRC-16/UMTS


@given(st.binary(max_size=60), st.binary(max_size=60))
def test_crc_is_the_remainder_and_may_be_taken_in_parts(first: bytes, second: bytes) -> None:
    assert crc16(second, crc16(first)) == crc16(first + second) == crc_by_long_division(first + second)


def test_stuffing_as_the_manual_words_it() -> None:
    assert stuff(bytes.fromhex("FFFFFD")) == bytes.fromhex("FFFFFDFD")
    assert stuff(bytes.fromhex("FFFFFDFD")) == bytes.fromhex("FFFFFDFDFD")
    wire = encode_instruction(InstructionPacket(1, Instruction.WRITE, bytes.fromhex("7400FFFFFD00")))
    assert wire[5:7] == b"\x0a\x00"  # LEN counts the stuffed byte
    assert wire[7:-2] == bytes.fromhex("037400FFFFFDFD00")


# header bytes are rare in random data and everything is decided by them
hostile = st.lists(st.sampled_from([0xFF, 0xFF, 0xFD, 0xFD, 0x00, 0x55, 0x01]), max_size=40).map(bytes)
packets = st.one_of(
    st.builds(
        InstructionPacket,
        st.integers(0, 252) | st.just(0xFE),
        st.sampled_from([int(i) for i in Instruction]),
        hostile | st.binary(max_size=40),
    ),
    st.builds(StatusPacket, st.integers(0, 252), st.integers(0, 255), hostile | st.binary(max_size=40)),
)


@given(hostile)
def test_stuffing_round_trip_never_leaves_a_header(body: bytes) -> None:
    assert unstuff(stuff(body)) == body
    assert b"\xff\xff\xfd\x00" not in stuff(body)


@given(st.lists(packets, max_size=5), st.integers(1, 7))
@settings(max_examples=150)
def test_round_trip_in_pieces(sent: list[Packet], piece: int) -> None:
    stream = b"".join(map(encode, sent))
    parser = Parser()
    found = [p for i in range(0, len(stream), piece) for p in parser.feed(stream[i : i + piece])]
    assert found == sent


@given(st.binary(max_size=30).filter(lambda b: b"\xff" not in b), packets)
def test_garbage_before_is_skipped(garbage: bytes, packet: Packet) -> None:
    assert Parser().feed(garbage + encode(packet)) == [packet]


@given(packets, packets, st.data())
def test_a_damaged_packet_costs_only_itself(first: Packet, second: Packet, data: st.DataObject) -> None:
    wire = bytearray(encode(first))
    position = data.draw(st.integers(7, len(wire) - 1))
    wire[position] ^= 1 << data.draw(st.integers(0, 7))
    found = Parser().feed(bytes(wire) + encode(second))
    assert found[-1:] == [second]
    assert first not in found[:-1]


@given(hostile | st.binary(max_size=200))
def test_any_bytes_parse_or_are_dropped(noise: bytes) -> None:
    parser = Parser()
    parser.feed(noise)
    parser.reset()
    packet = StatusPacket(3, 0, b"\x2a")
    assert parser.feed(encode(packet)) == [packet]
