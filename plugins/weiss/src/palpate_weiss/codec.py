"""Packet codec of Weiss Robotics' tactile sensors: bytes to packets and back, sans-IO.

    AA AA AA, command u8, size u16, payload, checksum u16            little endian

Two dialects: the WTS sensor modules check every packet, preamble included; the DSACON32 controller of
the DSA (in Schunk's SDH hand) checks packets with a payload only, from the command on.

Sources: ksatyaki/wts_driver and CNCR-NTU/wts-ft, which follow the Command Set Reference Manual of the
WTS family of Tactile Sensor Modules (March 2013); Schunk's SDHLibrary (dsa.cpp, dsa.h, dsa.py) and
RobWork's DSACON32 driver, which follow the DSACON32 Command Set Reference Manual.
"""

import enum
import struct
from collections import Counter
from dataclasses import dataclass

from palpate_weiss.crc import RunningCrc, crc16

__all__ = [
    "MAX_PAYLOAD",
    "WeissDecoder",
    "WeissDialect",
    "WeissFault",
    "WeissFaultKind",
    "WeissPacket",
    "encode",
]

MAX_PAYLOAD = 8197
"""Bytes: a frame of 4096 texels. A decoder takes a longer size for damage."""

_PREAMBLE = b"\xaa\xaa\xaa"
_HEADER = struct.Struct("<3sBH")
_CRC = struct.Struct("<H")
_MARK = 0xAA


class WeissDialect(enum.Enum):
    """Which packets have a checksum, and over what."""

    WTS = "WTS"
    DSA = "DSA"

    def has_checksum(self, size: int) -> bool:
        """Whether a packet with a payload of `size` bytes has a checksum."""
        return self is WeissDialect.WTS or size > 0

    @property
    def unchecked_head(self) -> int:
        """Bytes at a packet's beginning that its checksum leaves out."""
        return 0 if self is WeissDialect.WTS else len(_PREAMBLE)


class WeissFaultKind(enum.Enum):
    """What was wrong with the first byte of a stretch that is no packet."""

    NOISE = "not the beginning of a packet"
    LENGTH = "longer than any packet"
    CRC = "checksum does not match"
    CUT = "the rest of the packet did not come"


@dataclass(frozen=True)
class WeissPacket:
    """One command or answer."""

    command: int
    payload: bytes = b""


@dataclass(frozen=True)
class WeissFault:
    """A stretch of the stream that is no packet begins; it lasts until the next packet."""

    kind: WeissFaultKind


def encode(dialect: WeissDialect, packet: WeissPacket) -> bytes:
    """Return the wire bytes. Raises ValueError if a field does not fit its place on the wire.

    AA is no command of either dialect, and cannot be sent as one: it could not be distinguished from the
    preamble.
    """
    size = len(packet.payload)
    if not 0 <= packet.command <= 0xFF or packet.command == _MARK or size > 0xFFFF:
        raise ValueError(f"command {packet.command:#x} with {size} bytes does not fit a packet")
    data = _HEADER.pack(_PREAMBLE, packet.command, size) + packet.payload
    if not dialect.has_checksum(size):
        return data
    return data + _CRC.pack(crc16(data[dialect.unchecked_head :]))


class WeissDecoder:
    """Bytes in, packets and faults out, in the order of the stream, however the bytes are cut.

    Any bytes whatever give packets or faults, never an exception. Between calls at most a packet's
    length of bytes is kept, and the time taken grows with the number of bytes only. Where a packet
    turns out to be none, the search goes on behind its first byte, among the bytes that are there
    already: noise, a false preamble or a damaged size costs no packet after it. The one exception is
    noise whose checksum happens to hold, once in 65,536 false preambles.

    `faults` counts stretches that were no packet by kind, `skipped` their bytes.
    """

    def __init__(self, dialect: WeissDialect, max_payload: int = MAX_PAYLOAD) -> None:
        """`max_payload`: packets of more bytes are none; it may be changed between calls."""
        self.max_payload = max_payload
        self.faults: Counter[WeissFaultKind] = Counter()
        self.skipped = 0
        self._dialect = dialect
        self._pending = bytearray()
        self._crc = RunningCrc()
        self._in_step = True

    @property
    def waiting(self) -> int:
        """How many bytes are kept for a packet whose rest has not come."""
        return len(self._pending)

    def feed(self, data: bytes) -> list[WeissPacket | WeissFault]:
        """Take bytes as they came; return what they complete."""
        self._pending += data
        self._crc.extend(data)
        out: list[WeissPacket | WeissFault] = []
        self._forget(self._scan(0, out))
        return out

    def give_up(self) -> list[WeissPacket | WeissFault]:
        """Take what is incomplete for damaged, its rest being overdue; return packets inside of it."""
        out: list[WeissPacket | WeissFault] = []
        at = 0
        while at < len(self._pending):
            self._skip(WeissFaultKind.CUT, 1, out)
            at = self._scan(at + 1, out)
        self._forget(at)
        return out

    def _scan(self, at: int, out: list[WeissPacket | WeissFault]) -> int:
        """Decode from place `at` on; returns where the first packet begins that is not complete."""
        data = self._pending
        while True:
            start = data.find(_PREAMBLE, at)
            if start < 0:
                start = _first_of_marks(data, at)
            if start > at:
                self._skip(WeissFaultKind.NOISE, start - at, out)
                at = start
            if len(data) - at < _HEADER.size:
                return at
            found = self._packet_at(at)
            if found is None:
                return at
            if isinstance(found, WeissFaultKind):
                self._skip(found, 1, out)
                at += 1
            else:
                packet, length = found
                out.append(packet)
                self._in_step = True
                at += length

    def _packet_at(self, at: int) -> tuple[WeissPacket, int] | WeissFaultKind | None:
        """The packet at place `at` and its length, why there is none, or None if it is not complete."""
        _, command, size = _HEADER.unpack_from(self._pending, at)
        if command == _MARK:  # one AA too many: the preamble ends later
            return WeissFaultKind.NOISE
        if size > self.max_payload:
            return WeissFaultKind.LENGTH
        end = at + _HEADER.size + size
        checked = self._dialect.has_checksum(size)
        length = end - at + (_CRC.size if checked else 0)
        if len(self._pending) - at < length:
            return None
        if checked:
            sent = _CRC.unpack_from(self._pending, end)[0]
            if sent != self._crc.of(at + self._dialect.unchecked_head, end):
                return WeissFaultKind.CRC
        return WeissPacket(command, bytes(self._pending[at + _HEADER.size : end])), length

    def _skip(self, kind: WeissFaultKind, count: int, out: list[WeissPacket | WeissFault]) -> None:
        self.skipped += count
        if self._in_step:
            self._in_step = False
            self.faults[kind] += 1
            out.append(WeissFault(kind))

    def _forget(self, count: int) -> None:
        del self._pending[:count]
        self._crc.drop(count)


def _first_of_marks(data: bytearray, at: int) -> int:
    """Where the bytes AA at the end of `data` begin, at most two of them and not before `at`."""
    end = len(data)
    for start in (max(at, end - 2), max(at, end - 1)):
        if data[start:] == _PREAMBLE[: end - start]:
            return start
    return end
