"""Sync, bulk and fast reads on a chain of emulated servos, against the e-Manual's own examples."""

import pytest

from palpate.drivers.dynamixel.packet import (
    BROADCAST_ID,
    Instruction,
    InstructionPacket,
    Parser,
    StatusErrorCode,
    StatusPacket,
    crc16,
    encode_instruction,
)
from palpate.drivers.emulators.servo import EmulatedServo
from palpate.drivers.emulators.servo_chain import ServoChain

POSITION = (132, 4)


def group_read(instruction: int, *requests: tuple[int, int, int]) -> bytes:
    """(id, address, length) each; sync reads take address and length of the first."""
    if instruction in (Instruction.SYNC_READ, Instruction.FAST_SYNC_READ):
        _, address, length = requests[0]
        params = _words(address, length) + bytes(dxl_id for dxl_id, _, _ in requests)
    else:
        params = b"".join(bytes([dxl_id]) + _words(address, length) for dxl_id, address, length in requests)
    return encode_instruction(InstructionPacket(BROADCAST_ID, instruction, params))


def _words(*values: int) -> bytes:
    return b"".join(value.to_bytes(2, "little") for value in values)


def chain_of(
    *ids: int, skip_missing: bool = False, **options: object
) -> tuple[ServoChain, list[EmulatedServo]]:
    servos = [EmulatedServo(dxl_id, **({"firmware": 45} | options)) for dxl_id in ids]  # type: ignore[arg-type]
    return ServoChain(servos, lambda _: None, skip_missing=skip_missing), servos


# -- on the wire ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("instruction", [Instruction.FAST_SYNC_READ, Instruction.FAST_BULK_READ])
def test_a_fast_read_is_one_frame_after_one_return_delay(instruction: int) -> None:
    chain, _ = chain_of(1, 2, 3)
    parts = chain.feed(group_read(instruction, (3, *POSITION), (1, *POSITION), (2, *POSITION)), 1.0)
    frame = b"".join(data for _, data in parts)
    assert len(frame) == int.from_bytes(frame[5:7], "little") + 7
    assert crc16(frame[:-2]) == int.from_bytes(frame[-2:], "little")
    assert [frame[9 + 8 * k] for k in range(3)] == [3, 1, 2]
    assert frame[10:14] == (2048).to_bytes(4, "little")
    # 500 µs Return Delay Time, then byte after byte
    assert [instant for instant, _ in parts] == pytest.approx([1.0005, 1.00066, 1.00074])


def test_a_fast_read_does_not_stuff_bytes() -> None:
    chain, [servo] = chain_of(1)
    servo.take_block(224, bytes.fromhex("FFFFFD00"))  # Indirect Data 1 … 4 hold what they are given
    [(_, frame)] = chain.feed(group_read(Instruction.FAST_SYNC_READ, (1, 224, 4)), 0.0)
    assert frame[10:-2] == bytes.fromhex("FFFFFD00")
    [(_, status)] = chain.feed(group_read(Instruction.SYNC_READ, (1, 224, 4)), 0.0)
    assert bytes.fromhex("FFFFFDFD00") in status


def test_a_fast_read_breaks_off_at_a_missing_servo() -> None:
    chain, servos = chain_of(1, 2, 3)
    servos[1].power_off()
    [(_, part)] = chain.feed(group_read(Instruction.FAST_SYNC_READ, *((k, *POSITION) for k in (1, 2, 3))), 0)
    assert len(part) == 8 + 8 < int.from_bytes(part[5:7], "little") + 7
    servos[0].power_off()
    assert chain.feed(group_read(Instruction.FAST_SYNC_READ, *((k, *POSITION) for k in (1, 2, 3))), 0) == []


@pytest.mark.parametrize(("model", "first"), [("XM430-W350", 45), ("XL330-M288", 46), ("XC330-M288", 46)])
@pytest.mark.parametrize("instruction", [Instruction.FAST_SYNC_READ, Instruction.FAST_BULK_READ])
def test_older_firmware_keeps_silent_at_fast_reads(model: str, first: int, instruction: int) -> None:
    request = group_read(instruction, (1, *POSITION))
    old, _ = chain_of(1, model=model, firmware=first - 1)
    new, _ = chain_of(1, model=model, firmware=first)
    assert old.feed(request, 0.0) == []
    assert len(new.feed(request, 0.0)) == 1


def test_a_fast_read_to_one_servo_is_an_instruction_error() -> None:
    chain, _ = chain_of(1)
    packet = InstructionPacket(1, Instruction.FAST_SYNC_READ, _words(*POSITION) + b"\1")
    [(_, answer)] = chain.feed(encode_instruction(packet), 0.0)
    assert Parser().feed(answer) == [StatusPacket(1, StatusErrorCode.INSTRUCTION_ERROR)]


def test_a_refused_block_of_a_fast_read_keeps_its_length() -> None:
    chain, _ = chain_of(1, 2)
    parts = chain.feed(group_read(Instruction.FAST_BULK_READ, (1, 14, 4), (2, *POSITION)), 0.0)
    frame = b"".join(data for _, data in parts)
    assert frame[8:14] == bytes([StatusErrorCode.ACCESS_ERROR, 1, 0, 0, 0, 0])
    assert crc16(frame[:-2]) == int.from_bytes(frame[-2:], "little")


def test_alerts_travel_in_fast_blocks() -> None:
    chain, servos = chain_of(1, 2)
    servos[1].report_hardware_error(4)
    parts = chain.feed(group_read(Instruction.FAST_SYNC_READ, (1, *POSITION), (2, *POSITION)), 0.0)
    assert (parts[0][1][8], parts[1][1][0]) == (0, 0x80)


@pytest.mark.parametrize("instruction", [Instruction.SYNC_READ, Instruction.BULK_READ])
def test_behind_a_missing_servo(instruction: int) -> None:
    request = group_read(instruction, *((k, *POSITION) for k in (1, 2, 3)))
    strict, servos = chain_of(1, 2, 3)
    servos[1].power_off()
    assert len(strict.feed(request, 0.0)) == 1
    lenient, servos = chain_of(1, 2, 3, skip_missing=True)
    servos[1].power_off()
    answers = lenient.feed(request, 0.0)
    assert [Parser().feed(data)[0].dxl_id for _, data in answers] == [1, 3]
    # its own return delay comes after the time that the missing answer of 15 bytes would have taken
    assert [instant for instant, _ in answers] == pytest.approx([0.0005, 0.00065 + 0.00015 + 0.0005])


def test_a_bulk_read_asks_each_servo_once() -> None:
    chain, _ = chain_of(1, 2)
    answers = chain.feed(group_read(Instruction.BULK_READ, (1, 0, 2), (1, 7, 1), (2, 7, 1)), 0.0)
    assert [Parser().feed(data)[0].params for _, data in answers] == [(1020).to_bytes(2, "little"), b"\2"]


def test_status_return_level_zero_is_silent_in_group_reads() -> None:
    chain, [servo] = chain_of(1)
    servo.take_block(68, b"\0")
    for instruction in (Instruction.SYNC_READ, Instruction.FAST_SYNC_READ):
        assert chain.feed(group_read(instruction, (1, *POSITION)), 0.0) == []
