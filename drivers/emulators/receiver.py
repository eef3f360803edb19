"""A servo's receiver: from bytes to instruction packets, and to damaged ones that still say for whom.

    FF FF FD 00 | ID | LEN_L LEN_H | INST | params … | CRC_L CRC_H

Between the wire and `chain`. Garbage before and between packets is skipped. After a wrong CRC the search goes
on right behind that header, so that a packet that begins inside a damaged one is found. The host's parser in
`dynamixel.packet` has no use for damaged packets; a servo may have to answer them.
"""

from dataclasses import dataclass

from palpate.drivers.dynamixel.packet import InstructionPacket, crc16, unstuff

__all__ = ["DamagedPacket", "Receiver"]

_HEADER = b"\xff\xff\xfd\x00"
_PREFIX = 7  # header, ID and length
_STATUS = 0x55
_LONGEST = 1024  # LEN beyond this is noise: no servo has a buffer for it


@dataclass(frozen=True, slots=True)
class DamagedPacket:
    """A whole instruction packet with a wrong CRC, and the ID that stands in it."""

    dxl_id: int


class Receiver:
    """Finds packets in a stream that may start, stop and break anywhere."""

    def __init__(self) -> None:
        self._buffer = bytearray()

    def feed(self, data: bytes) -> list[InstructionPacket | DamagedPacket]:
        """Take more bytes and return the packets that they complete, in order."""
        self._buffer += data
        packets: list[InstructionPacket | DamagedPacket] = []
        while (frame := self._next_frame()) is not None:
            whole = crc16(frame[:-2]) == int.from_bytes(frame[-2:], "little")
            del self._buffer[: len(frame) if whole else 1]
            if frame[_PREFIX] == _STATUS:
                continue
            if whole:
                body = unstuff(frame[_PREFIX:-2])
                packets.append(InstructionPacket(frame[4], body[0], body[1:]))
            else:
                packets.append(DamagedPacket(frame[4]))
        return packets

    def reset(self) -> None:
        """Forget an unfinished packet."""
        self._buffer.clear()

    def _next_frame(self) -> bytes | None:
        """The next complete frame, still in the buffer; what stands before it is dropped."""
        buffer = self._buffer
        while True:
            start = buffer.find(_HEADER)
            # without a header the last bytes may be the beginning of one
            del buffer[: start if start >= 0 else max(0, len(buffer) - len(_HEADER) + 1)]
            if start < 0 or len(buffer) < _PREFIX:
                return None
            length = int.from_bytes(buffer[5:7], "little")
            if not 3 <= length <= _LONGEST or buffer[4] in (0xFD, 0xFF):
                del buffer[0]
                continue
            end = _PREFIX + length
            return bytes(buffer[:end]) if len(buffer) >= end else None
