"""The Protocol 2.0 codec against the e-Manual's printed examples, and round trips over hostile payloads."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from palpate.drivers.dynamixel.packet import (
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

# The examples that the e-Manual prints in full, page "DYNAMIXEL Protocol 2.0", in its order.
MANUAL: list[tuple[str, Packet]] = [
    ("FF FF FD 00 01 03 00 01 19 4E", InstructionPacket(1, Instruction.PING)),
    ("FF FF FD 00 01 07 00 55 00 06 04 26 65 5D", StatusPacket(1, 0, bytes([0x06, 0x04, 0x26]))),
    ("FF FF FD 00 FE 03 00 01 31 42", InstructionPacket(0xFE, Instruction.PING)),
    ("FF FF FD 00 02 07 00 55 00 06 04 26 6F 6D", StatusPacket(2, 0, bytes([0x06, 0x04, 0x26]))),
    ("FF FF FD 00 01 07 00 02 84 00 04 00 1D 15", InstructionPacket(1, Instruction.READ, b"\x84\0\4\0")),
    ("FF FF FD 00 01 08 00 55 00 A6 00 00 00 8C C0", StatusPacket(1, 0, b"\xa6\0\0\0")),
    (
        "FF FF FD 00 01 09 00 03 74 00 00 02 00 00 CA 89",
        InstructionPacket(1, Instruction.WRITE, b"\x74\0\0\2\0\0"),
    ),
    ("FF FF FD 00 01 04 00 55 00 A1 0C", StatusPacket(1)),
    (
        "FF FF FD 00 01 09 00 04 68 00 C8 00 00 00 AE 8E",
        InstructionPacket(1, Instruction.REG_WRITE, b"\x68\0\xc8\0\0\0"),
    ),
    ("FF FF FD 00 01 03 00 05 02 CE", InstructionPacket(1, Instruction.ACTION)),
    ("FF FF FD 00 01 04 00 06 01 A1 E6", InstructionPacket(1, Instruction.FACTORY_RESET, b"\1")),
    ("FF FF FD 00 01 03 00 08 2F 4E", InstructionPacket(1, Instruction.REBOOT)),
    (
        "FF FF FD 00 01 08 00 10 01 44 58 4C 22 B1 DC",
        InstructionPacket(1, Instruction.CLEAR, b"\x01DXL\x22"),
    ),
    (
        "FF FF FD 00 FE 09 00 82 84 00 04 00 01 02 CE FA",
        InstructionPacket(0xFE, Instruction.SYNC_READ, b"\x84\0\4\0\1\2"),
    ),
    ("FF FF FD 00 02 08 00 55 00 1F 08 00 00 BA BE", StatusPacket(2, 0, b"\x1f\x08\0\0")),
    (
        "FF FF FD 00 FE 11 00 83 74 00 04 00 01 96 00 00 00 02 AA 00 00 00 82 87",
        InstructionPacket(0xFE, Instruction.SYNC_WRITE, b"\x74\0\4\0\1\x96\0\0\0\2\xaa\0\0\0"),
    ),
    (
        "FF FF FD 00 FE 0D 00 92 01 90 00 02 00 02 92 00 01 00 1A 05",
        InstructionPacket(0xFE, Instruction.BULK_READ, b"\1\x90\0\2\0\2\x92\0\1\0"),
    ),
    ("FF FF FD 00 01 06 00 55 00 77 00 C3 69", StatusPacket(1, 0, b"\x77\0")),
    ("FF FF FD 00 02 05 00 55 00 24 8B A9", StatusPacket(2, 0, b"\x24")),
]


def encode(packet: Packet) -> bytes:
    return encode_status(packet) if isinstance(packet, StatusPacket) else encode_instruction(packet)


@pytest.mark.parametrize(("printed", "packet"), MANUAL)
def test_manual_example(printed: str, packet: Packet) -> None:
    wire = bytes.fromhex(printed)
    assert encode(packet) == wire
    assert Parser().feed(wire) == [packet]
    one_by_one = Parser()
    assert [p for byte in wire for p in one_by_one.feed(bytes([byte]))] == [packet]
    assert Parser().feed(wire + wire[:5]) == [packet]


def test_crc_check_value_of_the_catalogue() -> None:
    assert crc16(b"123456789") == 0xFEE8  # CRC-16/UMTS


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
    assert parser.dropped_bytes == 0


@given(st.binary(max_size=30).filter(lambda b: b"\xff" not in b), packets)
def test_garbage_before_is_counted_and_skipped(garbage: bytes, packet: Packet) -> None:
    parser = Parser()
    assert parser.feed(garbage + encode(packet)) == [packet]
    assert parser.dropped_bytes == len(garbage)


@given(packets, packets, st.data())
def test_a_damaged_packet_costs_only_itself(first: Packet, second: Packet, data: st.DataObject) -> None:
    wire = bytearray(encode(first))
    position = data.draw(st.integers(7, len(wire) - 1))
    wire[position] ^= 1 << data.draw(st.integers(0, 7))
    parser = Parser()
    found = parser.feed(bytes(wire) + encode(second))
    assert found[-1:] == [second]
    assert first not in found[:-1]
    assert parser.dropped_bytes >= len(wire) or len(found) > 1


@given(hostile | st.binary(max_size=200))
def test_any_bytes_parse_or_are_counted(noise: bytes) -> None:
    parser = Parser()
    parser.feed(noise)
    parser.reset()
    assert 0 <= parser.dropped_bytes <= len(noise)
    packet = StatusPacket(3, 0, b"\x2a")
    assert parser.feed(encode(packet)) == [packet]
