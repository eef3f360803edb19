"""The parameters of sync and bulk instructions, and the one frame that answers a fast read.

Used by `chain`. Source: e-Manual, "DYNAMIXEL Protocol 2.0", sections Sync Read to Fast Bulk Read. A fast read
is answered as if by one servo with ID FE:

    FF FF FD 00 | FE | LEN | 55 | ERR ID data CRC | ERR ID data CRC | …

without byte stuffing; every CRC is taken over all bytes before it, CRCs included.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from palpate.drivers.dynamixel.packet import BROADCAST_ID, Instruction, InstructionPacket, StatusPacket, crc16

__all__ = ["FastFrame", "ReadRequest", "WriteRequest", "read_requests", "write_requests"]

_FAST_BLOCK = 4  # bytes of a block besides its data: ERR, ID, CRC


class ReadRequest(NamedTuple):
    """What one servo is asked for."""

    dxl_id: int
    address: int
    length: int


@dataclass(frozen=True, slots=True)
class WriteRequest:
    """What one servo is to write."""

    dxl_id: int
    address: int
    data: bytes


class FastFrame:
    """The answer to a fast read as it grows, servo by servo."""

    def __init__(self, lengths: Sequence[int]) -> None:
        """`lengths`: bytes that are read from each servo."""
        length = 1 + sum(lengths) + _FAST_BLOCK * len(lengths)
        self._head = b"\xff\xff\xfd\x00" + bytes((BROADCAST_ID, length & 0xFF, length >> 8 & 0xFF, 0x55))
        self._end, self._crc = b"", 0  # CRC that was sent last, and that of all before it

    def part(self, answer: StatusPacket) -> bytes:
        """The bytes that the next servo sends; the first one sends the head too."""
        block = self._head + bytes((answer.error, answer.dxl_id)) + answer.params
        self._head = b""
        self._crc = crc16(self._end + block, self._crc)
        self._end = self._crc.to_bytes(2, "little")
        return block + self._end


def read_requests(packet: InstructionPacket) -> list[ReadRequest]:
    """What a sync, bulk or fast read asks for, in order; none if the packet is cut short.

    In a bulk read each servo is asked once: a second request to the same ID counts for nothing.
    """
    params = packet.params
    if packet.instruction in (Instruction.SYNC_READ, Instruction.FAST_SYNC_READ):
        if len(params) < 5:
            return []
        return [ReadRequest(dxl_id, _word(params, 0), _word(params, 2)) for dxl_id in params[4:]]
    asked: dict[int, ReadRequest] = {}
    for at in range(0, len(params) - 4, 5):
        request = ReadRequest(params[at], _word(params, at + 1), _word(params, at + 3))
        asked.setdefault(request.dxl_id, request)
    return list(asked.values())


def write_requests(packet: InstructionPacket) -> Iterator[WriteRequest]:
    """What a sync or bulk write tells, up to where the packet is cut short; see `read_requests` for IDs."""
    if packet.instruction == Instruction.SYNC_WRITE:
        yield from _sync_writes(packet.params)
        return
    seen: set[int] = set()
    params, at = packet.params, 0
    while at + 5 <= len(params):
        length = _word(params, at + 3)
        if at + 5 + length > len(params):
            return
        if params[at] not in seen:
            yield WriteRequest(params[at], _word(params, at + 1), params[at + 5 : at + 5 + length])
        seen.add(params[at])
        at += 5 + length


def _sync_writes(params: bytes) -> Iterator[WriteRequest]:
    if len(params) < 5:
        return
    address, length = _word(params, 0), _word(params, 2)
    for at in range(4, len(params) - length, length + 1):
        yield WriteRequest(params[at], address, params[at + 1 : at + 1 + length])


def _word(params: bytes, at: int) -> int:
    return params[at] | params[at + 1] << 8
