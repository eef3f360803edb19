"""Codec of Dynamixel Protocol 2.0: bytes to packets and packets to bytes, without port or clock.

    FF FF FD 00 | ID | LEN_L LEN_H | INST | params … | CRC_L CRC_H          instruction packet
    FF FF FD 00 | ID | LEN_L LEN_H | 55 | error | params … | CRC_L CRC_H    status packet
    FF FF FD 00 | FE | LEN_L LEN_H | 55 | block | block | …                 answer to a fast read
                                          block: error | ID | params … | CRC_L CRC_H

LEN counts everything after itself. Inside INST…params the sequence FF FF FD is followed by one stuffed FD
that is not part of the data; LEN and CRC are taken over the stuffed bytes. Before, between and after packets
there may be any garbage: the parser looks for the next header and counts what it skipped.

The answer to a fast sync or bulk read is one frame to which each servo adds its block. Nothing in it is
stuffed, and each CRC is taken over the whole frame so far, earlier CRCs included. A `Parser` is not for it:
it would take stuffing out that was never put in.

The emulated servos speak through this module; the host speaks through the vendor's SDK and borrows only
`stuff` and `unstuff` from here. Source: ROBOTIS e-Manual, "DYNAMIXEL Protocol 2.0" and "CRC calculation".
"""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple

from fastcrc.crc16 import umts

BROADCAST_ID = 0xFE
MAX_ID = 252
ALERT_BIT = 0x80

_HEADER = b"\xff\xff\xfd\x00"
_STUFFABLE = b"\xff\xff\xfd"
_STUFFED = b"\xff\xff\xfd\xfd"
_PREFIX_BYTES = 7  # header, ID and length
_STATUS_INSTRUCTION = 0x55
_FAST_BLOCK_BYTES = 4  # error, ID and CRC around a block's params
_MAX_PACKET_LENGTH = 1024  # LEN beyond this is noise: no servo has a buffer for it


class Instruction(IntEnum):
    """Instructions by the e-Manual's names."""

    PING = 0x01
    READ = 0x02
    WRITE = 0x03
    REG_WRITE = 0x04
    ACTION = 0x05
    FACTORY_RESET = 0x06
    REBOOT = 0x08
    CLEAR = 0x10
    CONTROL_TABLE_BACKUP = 0x20
    SYNC_READ = 0x82
    SYNC_WRITE = 0x83
    FAST_SYNC_READ = 0x8A
    BULK_READ = 0x92
    BULK_WRITE = 0x93
    FAST_BULK_READ = 0x9A


class StatusErrorCode(IntEnum):
    """Error numbers of a status packet by the e-Manual's names."""

    NONE = 0
    RESULT_FAIL = 1
    INSTRUCTION_ERROR = 2
    CRC_ERROR = 3
    DATA_RANGE_ERROR = 4
    DATA_LENGTH_ERROR = 5
    DATA_LIMIT_ERROR = 6
    ACCESS_ERROR = 7


@dataclass(frozen=True, slots=True)
class InstructionPacket:
    """Packet of a controller. `instruction` is a plain int: unknown ones must be answerable."""

    dxl_id: int
    instruction: int
    params: bytes = b""


class StatusPacket(NamedTuple):
    """Packet of a servo. `error` is the error byte: alert bit and error number."""

    dxl_id: int
    error: int = 0
    params: bytes = b""

    @property
    def alert(self) -> bool:
        """True if the servo reports a hardware error."""
        return bool(self.error & ALERT_BIT)

    @property
    def error_number(self) -> int:
        """The error number without the alert bit; 0 if the instruction was carried out."""
        return self.error & ~ALERT_BIT


@dataclass(frozen=True, slots=True)
class DamagedPacket:
    """A whole instruction packet with a wrong CRC, and the ID that stands in it."""

    dxl_id: int


def crc16(data: bytes, crc: int = 0) -> int:
    """CRC-16 with polynomial 0x8005, initial value 0, not reflected (catalogue name CRC-16/UMTS).

    `crc` is that of what came before `data`.
    """
    return umts(data, crc)


def stuff(body: bytes) -> bytes:
    """Put an FD after every FF FF FD in INST…params."""
    return body.replace(_STUFFABLE, _STUFFED)


def unstuff(body: bytes) -> bytes:
    """Take away what `stuff` put in."""
    return body.replace(_STUFFED, _STUFFABLE)


def encode_instruction(packet: InstructionPacket) -> bytes:
    """Bytes of an instruction packet."""
    return _frame(packet.dxl_id, bytes((packet.instruction,)) + packet.params)


def encode_status(packet: StatusPacket) -> bytes:
    """Bytes of a status packet."""
    return _frame(packet.dxl_id, bytes((_STATUS_INSTRUCTION, packet.error)) + packet.params)


def parse_fast_status(frame: bytes, lengths: Sequence[int]) -> list[StatusPacket | None]:
    """Blocks of the answer to a fast read of `lengths` bytes from each servo, in the order of the request.

    `frame` begins with the header and may be cut short; what follows the last block is ignored. From the
    first block on that is not whole, or whose CRC is wrong, all are None: later CRCs cover the damage too.
    All are None if the frame's head is not that of the answer to such a request. Which ID a block should have
    is the caller's to check. Raises ValueError if the answer would be longer than a servo takes.
    """
    blocks: list[StatusPacket | None] = [None] * len(lengths)
    end = _PREFIX_BYTES + 1
    head = frame[:end]
    if not lengths or head != _fast_head(lengths):
        return blocks
    crc = checked = 0  # of so many bytes
    for index, length in enumerate(lengths):
        start, end = end, end + length + _FAST_BLOCK_BYTES
        crc = crc16(frame[checked : end - 2], crc)
        checked = end - 2
        if frame[checked:end] != crc.to_bytes(2, "little"):
            break  # wrong or, if the frame ends before, missing
        blocks[index] = StatusPacket(frame[start + 1], frame[start], frame[start + 2 : checked])
    return blocks


def _fast_head(lengths: Sequence[int]) -> bytes:
    length = 1 + sum(lengths) + _FAST_BLOCK_BYTES * len(lengths)
    _check_length(length)
    return _HEADER + bytes((BROADCAST_ID,)) + length.to_bytes(2, "little") + bytes((_STATUS_INSTRUCTION,))


def _frame(dxl_id: int, body: bytes) -> bytes:
    stuffed = stuff(body)
    length = len(stuffed) + 2
    _check_length(length)
    head = _HEADER + bytes((dxl_id,)) + length.to_bytes(2, "little") + stuffed
    return head + crc16(head).to_bytes(2, "little")


def _check_length(length: int) -> None:
    if length > _MAX_PACKET_LENGTH:
        raise ValueError(
            f"a packet of {length} bytes after LEN is longer than the {_MAX_PACKET_LENGTH} a servo takes"
        )


class Parser:
    """Finds packets in a stream that may start, stop and break anywhere; skips garbage between them.

    After a wrong CRC the search goes on right behind that header, so that a packet that begins inside a
    damaged one is still found.
    """

    def __init__(self) -> None:
        self._buffer = bytearray()

    def feed(self, data: bytes) -> list[InstructionPacket | StatusPacket | DamagedPacket]:
        """Take more bytes and return the packets that they complete, in order."""
        self._buffer += data
        packets: list[InstructionPacket | StatusPacket | DamagedPacket] = []
        while (frame := self._next_frame()) is not None:
            whole = crc16(frame[:-2]) == int.from_bytes(frame[-2:], "little")
            del self._buffer[: len(frame) if whole else 1]
            body = unstuff(frame[_PREFIX_BYTES:-2])
            if body[0] != _STATUS_INSTRUCTION:
                instruction = InstructionPacket(frame[4], body[0], body[1:])
                packets.append(instruction if whole else DamagedPacket(frame[4]))
            elif whole and len(body) >= 2:
                packets.append(StatusPacket(frame[4], body[1], body[2:]))
        return packets

    def reset(self) -> None:
        """Forget an unfinished packet, as a servo does when the line falls silent."""
        self._buffer.clear()

    def _next_frame(self) -> bytes | None:
        """The next complete frame, still in the buffer; what stands before it is dropped."""
        buffer = self._buffer
        while True:
            start = buffer.find(_HEADER)
            # without a header the last bytes may be the beginning of one
            del buffer[: start if start >= 0 else max(0, len(buffer) - len(_HEADER) + 1)]
            if start < 0 or len(buffer) < _PREFIX_BYTES:
                return None
            length = int.from_bytes(buffer[5:7], "little")
            if not 3 <= length <= _MAX_PACKET_LENGTH or buffer[4] in (0xFD, 0xFF):
                del buffer[0]
                continue
            end = _PREFIX_BYTES + length
            return bytes(buffer[:end]) if len(buffer) >= end else None
