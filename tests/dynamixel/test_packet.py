"""Packets of protocol 2.0: codec, the manual's answers, fast status."""

import math
from collections.abc import Sequence
from itertools import pairwise

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from palpate.drivers.dynamixel.packet import (
    BROADCAST_ID,
    DamagedPacket,
    Instruction,
    InstructionPacket,
    Parser,
    StatusErrorCode,
    StatusPacket,
    crc16,
    encode_instruction,
    encode_status,
    parse_fast_status,
    stuff,
    unstuff,
)
from palpate.drivers.emulators.servo import EmulatedServo
from palpate.drivers.emulators.servo_chain import FastFrame, ServoChain
from support.oracles.manual_examples import (
    EXAMPLES,
    EXCHANGES,
    FAST_EXAMPLES,
    MISPRINTED_CRC,
    Example,
    Exchange,
    FastExample,
)

# ----------------------------------------------------------------------------------------------------
# The Protocol 2.0 codec against the e-Manual's printed examples, and round trips over hostile payloads.

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


# ----------------------------------------------------------------------------------------------------
# Emulated servos answer the e-Manual's requests with the e-Manual's answers, whole, byte by byte.
#
# The page's servos are XM430-W210s with firmware 38, or XC330-T288s with firmware new enough for backup and
# fast reads; the emulated one takes their model number and the values that the examples' conditions name.

# Strike a section from here once the emulated servo knows its instruction.
EXCHANGE = {exchange.section: exchange for exchange in EXCHANGES}
FOREIGN = encode_instruction(InstructionPacket(99, Instruction.PING))


def emulated(
    dxl_id: int,
    position: int = 2048,
    firmware: int = 38,
    model: int = 1030,
    volts: float = 12.0,
    celsius: float = 25.0,
    present_pwm: int = 0,
) -> EmulatedServo:
    """A servo standing still at a Present Position (ticks), with what it measures."""
    servo = EmulatedServo(dxl_id, firmware=firmware, start_rad=(position - 2048) / 4096 * 2 * math.pi)
    servo._unit.table.set("Model Number", model)
    servo.set_supply(volts)
    servo.set_temperature(celsius)
    servo.answer_block(132, 4)  # brings the items that report the shaft up to date, once and for all
    servo._unit.drive.refresh = lambda: None
    servo._unit.table.set("Present PWM", present_pwm)
    return servo


def chain_for(section: str) -> ServoChain:
    """Servos as the conditions of the page's example in that section say."""
    if section.startswith("Fast"):
        modern = {"firmware": 46, "model": 1220}
        servos = [
            emulated(3, 166, **modern),
            emulated(7, 2079, **modern, present_pwm=421),
            emulated(4, 1023, **modern, celsius=31),
        ]
    elif section.startswith("Control Table Backup"):
        servos = [emulated(1, firmware=46, model=1220)]
    elif section in ("Ping, example 2", "Sync Read", "Sync Write", "Bulk Read", "Bulk Write"):
        servos = [
            emulated(1, 166, volts=11.9),
            emulated(2, 2079, celsius=36),
        ]
    else:
        servos = [emulated(1, 166)]
    return ServoChain(servos, lambda _: None)


def said(chain: ServoChain, data: bytes, now: float = 1.0) -> bytes:
    return b"".join(piece for _, piece in chain.feed(data, now))


def asked_before(section: str, chain: ServoChain) -> None:
    """What an example's condition says to have been sent before."""
    if section == "Action":
        said(chain, EXCHANGE["Reg Write"].instruction.wire)
    elif section == "Control Table Backup, example 2":
        said(chain, EXCHANGE["Control Table Backup, example 1"].instruction.wire)


def request(exchange: Exchange) -> bytes:
    """The instruction as printed, with the right CRC where the page has a misprint."""
    right = MISPRINTED_CRC.get(exchange.instruction.printed)
    wire = exchange.instruction.wire
    return wire if right is None else wire[:-2] + bytes.fromhex(right)


@pytest.mark.parametrize("exchange", EXCHANGES, ids=lambda e: e.section)
def test_answer_byte_by_byte(exchange: Exchange) -> None:
    chain = chain_for(exchange.section)
    asked_before(exchange.section, chain)
    assert said(chain, request(exchange)) == exchange.answer_wire


@pytest.mark.parametrize("exchange", EXCHANGES, ids=lambda e: e.section)
@given(before=st.binary(max_size=20), after=st.binary(max_size=20), cuts=st.lists(st.integers(0, 60)))
@settings(max_examples=15)
def test_answer_among_garbage_and_in_pieces(
    exchange: Exchange, before: bytes, after: bytes, cuts: list[int]
) -> None:
    chain = chain_for(exchange.section)
    asked_before(exchange.section, chain)
    stream = before + FOREIGN + request(exchange) + after + FLUSH
    edges = [0, *sorted(cuts), len(stream)]
    heard = b"".join(said(chain, stream[a:b]) for a, b in pairwise(edges))
    assert heard == exchange.answer_wire


@pytest.mark.parametrize("printed", MISPRINTED_CRC)
def test_a_misprinted_request_is_not_carried_out(printed: str) -> None:
    """A servo that is meant says so (CRC Error); one of a group, or nobody in particular, is silent."""
    (example,) = [example for example in EXAMPLES if example.printed == printed]
    answers = Parser().feed(said(chain_for(example.section), example.wire))
    meant = [] if example.wire[4] == BROADCAST_ID else [StatusPacket(1, StatusErrorCode.CRC_ERROR)]
    assert answers == meant


def item(chain: ServoChain, dxl_id: int, address: int, length: int) -> int:
    """Read an item as a host would."""
    params = address.to_bytes(2, "little") + length.to_bytes(2, "little")
    packet = InstructionPacket(dxl_id, Instruction.READ, params)
    (answer,) = Parser().feed(said(chain, encode_instruction(packet)))
    assert not isinstance(answer, InstructionPacket)
    assert answer.error == 0
    return int.from_bytes(answer.params, "little")


@pytest.mark.parametrize(
    ("sections", "kept"),
    [
        (["Write"], {(1, 116, 4): 512}),
        (["Reg Write"], {(1, 104, 4): 0, (1, 69, 1): 1}),
        (["Reg Write", "Action"], {(1, 104, 4): 200, (1, 69, 1): 0}),
        (["Sync Write"], {(1, 116, 4): 150, (2, 116, 4): 170}),
        (["Bulk Write"], {(1, 32, 2): 160, (2, 31, 1): 80}),
    ],
    ids=lambda value: " + ".join(value) if isinstance(value, list) else "",
)
def test_what_the_manual_writes_is_kept(sections: list[str], kept: dict[tuple[int, int, int], int]) -> None:
    chain = chain_for(sections[0])
    for dxl_id in {where[0] for where in kept}:  # other than what the examples write
        change = encode_instruction(InstructionPacket(dxl_id, Instruction.WRITE, b"\x1f\0\x4f\x9b\0"))
        assert said(chain, change)[8] == 0
    for section in sections:
        said(chain, EXCHANGE[section].instruction.wire)
    assert {where: item(chain, *where) for where in kept} == kept


# ----------------------------------------------------------------------------------------------------
# The one frame that answers a fast sync or bulk read: the e-Manual's examples, damage, and round trips.

of_both = pytest.mark.parametrize("example", FAST_EXAMPLES, ids=lambda example: example.section)

blocks = st.builds(
    StatusPacket,
    st.integers(0, 252),
    st.integers(0, 255),
    st.lists(st.sampled_from([0xFF, 0xFF, 0xFD, 0xFD, 0x00]), max_size=12).map(bytes)
    | st.binary(max_size=20),
)


def encoded(answers: Sequence[StatusPacket]) -> list[bytes]:
    """What each servo sends, by the emulator."""
    frame = FastFrame([len(answer.params) for answer in answers])
    return [frame.part(answer) for answer in answers]


def lengths_of(example: FastExample) -> list[int]:
    return [len(block.params) for block in example.meaning]


@of_both
def test_manual_example_byte_by_byte(example: FastExample) -> None:
    assert encoded(example.meaning) == list(example.pieces)
    assert parse_fast_status(b"".join(example.pieces), lengths_of(example)) == list(example.meaning)


@of_both
def test_each_crc_covers_all_before_it(example: FastExample) -> None:
    frame = b""
    for index, piece in enumerate(example.pieces):
        frame += piece
        printed = int.from_bytes(frame[-2:], "little")
        assert printed == crc16(frame[:-2])
        assert (printed == crc16(piece[:-2])) == (index == 0)


@of_both
def test_the_blocks_before_a_cut_are_good(example: FastExample) -> None:
    frame = b"".join(example.pieces)
    ends = [len(b"".join(example.pieces[: i + 1])) for i in range(3)]
    for size in range(len(frame) + 1):
        good = sum(end <= size for end in ends)
        found = parse_fast_status(frame[:size], lengths_of(example))
        assert found == [*example.meaning[:good], *[None] * (3 - good)]
    assert parse_fast_status(frame + b"\xff\x00", lengths_of(example)) == list(example.meaning)


@of_both
def test_the_blocks_before_a_flipped_bit_are_good(example: FastExample) -> None:
    frame = b"".join(example.pieces)
    ends = [len(b"".join(example.pieces[: i + 1])) for i in range(3)]
    for bit in range(8 * len(frame)):
        broken = bytearray(frame)
        broken[bit // 8] ^= 1 << bit % 8
        good = sum(end <= bit // 8 for end in ends)
        found = parse_fast_status(bytes(broken), lengths_of(example))
        assert found == [*example.meaning[:good], *[None] * (3 - good)], bit


@of_both
def test_an_answer_to_another_request_is_no_answer(example: FastExample) -> None:
    frame = b"".join(example.pieces)
    lengths = lengths_of(example)
    assert parse_fast_status(frame, lengths[:2]) == [None, None]
    assert parse_fast_status(frame, [*lengths, 1]) == [None] * 4
    assert parse_fast_status(frame, []) == []


def test_what_a_servo_would_not_take_is_refused() -> None:
    with pytest.raises(ValueError, match="1029 bytes"):
        parse_fast_status(b"", [1024])


@given(st.lists(blocks, min_size=1, max_size=8))
@settings(max_examples=200)
def test_round_trip_without_stuffing(sent: list[StatusPacket]) -> None:
    pieces = encoded(sent)
    assert [len(piece) for piece in pieces[1:]] == [len(block.params) + 4 for block in sent[1:]]
    assert parse_fast_status(b"".join(pieces), [len(block.params) for block in sent]) == sent
    assert b"".join(pieces)[5:7] == (1 + sum(len(block.params) + 4 for block in sent)).to_bytes(2, "little")


@given(st.lists(blocks, min_size=1, max_size=8), st.data())
def test_noise_never_gives_a_block_that_was_not_sent(sent: list[StatusPacket], data: st.DataObject) -> None:
    frame = bytearray(b"".join(encoded(sent)))
    for at in data.draw(st.lists(st.integers(0, len(frame) - 1), max_size=4)):
        frame[at] = data.draw(st.integers(0, 255))
    found = parse_fast_status(bytes(frame), [len(block.params) for block in sent])
    assert all(block is None or block == original for block, original in zip(found, sent, strict=True))
    if None in found:
        assert set(found[found.index(None) :]) == {None}


def test_the_parser_of_other_packets_is_not_for_it() -> None:
    """It finds the frame, but takes out an FD that was data."""
    (frame,) = encoded([StatusPacket(1, 0, bytes.fromhex("FFFFFDFD"))])
    (found,) = Parser().feed(frame)
    assert isinstance(found, StatusPacket)
    assert bytes.fromhex("FFFFFDFD") not in found.params
    assert parse_fast_status(frame, [4]) == [StatusPacket(1, 0, bytes.fromhex("FFFFFDFD"))]
