"""The one frame that answers a fast sync or bulk read: the e-Manual's examples, damage, and round trips."""

from collections.abc import Sequence

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from manual_examples import FAST_EXAMPLES, FastExample

from palpate.drivers.dynamixel.packet import (
    Parser,
    StatusPacket,
    crc16,
    parse_fast_status,
)
from palpate.drivers.emulators.servo_chain import FastFrame

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
