"""Codec of the tactile protocol: bytes to messages and back.

    COBS(version u8, type u8, flags u16, sequence u32, time_us u64, length u16, payload, crc u32) 00

Little endian throughout. The CRC is CRC-32 (zlib) over everything before it. COBS (Cheshire and Baker,
"Consistent Overhead Byte Stuffing", 1999) keeps 0x00 out of the frame, so that whatever happened on the wire
the next 0x00 starts afresh. Sans-IO: no port, no clock. What is in a payload is in `payloads`. Tables and
test vectors: `docs/tactile-protocol.md`.
"""

import enum
import struct
import zlib
from collections import Counter
from dataclasses import dataclass, field

from cobs import cobs

from palpate.drivers.tactile.messages import Describe, Frame, Message
from palpate.drivers.tactile.payloads import MAX_PAYLOAD, pack, request_id, unpack

__all__ = [
    "DELIMITER",
    "MAX_ENCODED",
    "VERSION",
    "DecodeFault",
    "Decoder",
    "FaultKind",
    "encode",
    "frame_bytes",
]

VERSION = 1
DELIMITER = b"\x00"
_HEADER = struct.Struct("<BBHIQH")
_CRC = struct.Struct("<I")
_RESIDUE = zlib.crc32(_CRC.pack(zlib.crc32(b"")))  # CRC of anything with its own CRC behind it
_SHORTEST = _HEADER.size + _CRC.size
_MAX_PLAIN = _SHORTEST + MAX_PAYLOAD
MAX_ENCODED = _MAX_PLAIN + _MAX_PLAIN // 254 + 1  # COBS adds one byte in 254 and one more
_HALF_CIRCLE = 1 << 31  # sequence numbers are compared on a circle of 2**32


class FaultKind(enum.Enum):
    """What was wrong with a stretch of the stream."""

    FRAMING = "not COBS"
    SHORT = "shorter than header and CRC"
    OVERSIZED = "longer than any message"
    CRC = "CRC does not match"
    VERSION = "unknown protocol version"
    LENGTH = "length field does not match"
    UNKNOWN_TYPE = "unknown message type"
    PAYLOAD = "payload does not fit its type"
    SEQUENCE_GAP = "messages missing"
    STALE = "frame repeated or late"


@dataclass(frozen=True)
class DecodeFault:
    """Something in the stream that is not a message.

    `missing` is the number of messages lost at a SEQUENCE_GAP. `version`, `type_code` and `request_id` are
    there where the CRC held but what is inside cannot be used (VERSION, LENGTH, UNKNOWN_TYPE, PAYLOAD), so
    that a device can answer NACK and a host knows which version was spoken to it. `request_id` is None if the
    payload is too short for one. `reason` names the field and its value then (LENGTH, PAYLOAD). `dropped` is
    the frame that was STALE.
    """

    kind: FaultKind
    missing: int = 0
    type_code: int | None = None
    request_id: int | None = None
    version: int | None = None
    reason: str = field(default="", compare=False)
    dropped: Message | None = field(default=None, compare=False)


def encode(message: Message, version: int = VERSION) -> bytes:
    """Return the wire bytes, closing delimiter included.

    Raises ValueError if a field does not fit its place on the wire.
    """
    kind, payload = pack(message.body)
    try:
        head = _HEADER.pack(version, kind, message.flags, message.sequence, message.time_us, len(payload))
    except struct.error as problem:
        raise ValueError(f"header field out of range in {message!r}: {problem}") from problem
    plain = head + payload
    stuffed: bytes = cobs.encode(plain + _CRC.pack(zlib.crc32(plain)))
    return stuffed + DELIMITER


def frame_bytes(taxels: int) -> int:
    """Bytes of an encoded FRAME at most, delimiter included."""
    plain = _SHORTEST + 2 + 2 * taxels
    return plain + plain // 254 + 2


class Decoder:
    """Bytes in, messages and typed faults out, in the order of the stream.

    Any bytes whatever give messages or faults, never an exception, and at most `MAX_ENCODED` bytes are kept
    between calls. `faults` counts what went wrong by kind; `lost` counts messages that the sender numbered
    and that never came. Messages of another version than `version` are faults.
    """

    def __init__(self, version: int = VERSION) -> None:
        self._version = version
        self._pending = bytearray()
        self._skipping = False
        self._last: int | None = None
        self.faults: Counter[FaultKind] = Counter()
        self.lost = 0

    @property
    def waiting(self) -> int:
        """How many bytes are kept of a message whose rest has not come."""
        return len(self._pending)

    def feed(self, data: bytes) -> list[Message | DecodeFault]:
        """Take bytes as they came; return what they complete."""
        out: list[Message | DecodeFault] = []
        *closed, rest = bytes(data).split(DELIMITER)
        for piece in closed:
            is_rest = self._pending or self._skipping or len(piece) > MAX_ENCODED
            if whole := self._finished(piece, out) if is_rest else piece:
                self._decode(whole, out)
        if rest:
            self._keep(rest, out)
        return out

    def _keep(self, piece: bytes, out: list[Message | DecodeFault]) -> None:
        if self._skipping:
            return
        if len(self._pending) + len(piece) > MAX_ENCODED:
            self._pending = bytearray()
            self._skipping = True
            self._fault(DecodeFault(FaultKind.OVERSIZED), out)
        else:
            self._pending += piece

    def _finished(self, piece: bytes, out: list[Message | DecodeFault]) -> bytes:
        """What was kept with its end; nothing of what is too long."""
        self._keep(piece, out)
        whole, self._pending = bytes(self._pending), bytearray()
        self._skipping = False
        return whole

    def _decode(self, stuffed: bytes, out: list[Message | DecodeFault]) -> None:
        result = _decode_one(stuffed, self._version)
        if isinstance(result, DecodeFault):
            self._fault(result, out)
        elif self._in_order(result, out):
            out.append(result)

    def _in_order(self, message: Message, out: list[Message | DecodeFault]) -> bool:
        # Only frames are dropped as stale: an answer with a low number comes from a device that started anew.
        last, self._last = self._last, message.sequence
        if last is None or isinstance(message.body, Describe):
            return True
        step = (message.sequence - last) % (1 << 32)
        if 1 < step < _HALF_CIRCLE:
            self.lost += step - 1
            self._fault(DecodeFault(FaultKind.SEQUENCE_GAP, missing=step - 1), out)
        elif (step == 0 or step >= _HALF_CIRCLE) and isinstance(message.body, Frame):
            self._last = last
            self._fault(DecodeFault(FaultKind.STALE, dropped=message), out)
            return False
        return True

    def _fault(self, fault: DecodeFault, out: list[Message | DecodeFault]) -> None:
        self.faults[fault.kind] += 1
        out.append(fault)


def _decode_one(stuffed: bytes, version: int) -> Message | DecodeFault:
    try:
        plain = cobs.decode(stuffed)
    except cobs.DecodeError:
        return DecodeFault(FaultKind.FRAMING)
    if len(plain) < _SHORTEST:
        return DecodeFault(FaultKind.SHORT)
    if zlib.crc32(plain) != _RESIDUE:
        return DecodeFault(FaultKind.CRC)
    return _unpack_message(plain, version)


def _unpack_message(plain: bytes, version: int) -> Message | DecodeFault:
    said, kind, flags, sequence, time_us, length = _HEADER.unpack_from(plain)
    payload = plain[_HEADER.size : -_CRC.size]
    if said != version:
        return _unusable(FaultKind.VERSION, said, kind, payload)
    if length != len(payload):
        reason = f"length {length} (allowed: {len(payload)}, the bytes of its payload)"
        return _unusable(FaultKind.LENGTH, said, kind, payload, reason)
    try:
        body = unpack(kind, payload)
    except ValueError as problem:
        return _unusable(FaultKind.PAYLOAD, said, kind, payload, str(problem))
    if body is None:
        return _unusable(FaultKind.UNKNOWN_TYPE, said, kind, payload)
    return Message(sequence, time_us, body, flags)


def _unusable(what: FaultKind, version: int, kind: int, payload: bytes, reason: str = "") -> DecodeFault:
    number = request_id(payload)
    return DecodeFault(what, type_code=kind, request_id=number, version=version, reason=reason)
