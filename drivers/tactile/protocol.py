"""Bytes to tactile messages and back. Stands between a port's bytes and `array.TactileArray`.

    COBS(version u8, type u8, flags u16, sequence u32, time_us u64, length u16, payload, crc u32) 00

Little endian throughout. The CRC is CRC-32 (zlib) over everything before it. COBS (Cheshire and Baker,
"Consistent Overhead Byte Stuffing", 1999) keeps 0x00 out of the frame, so that whatever happened on the wire
the next 0x00 starts afresh. Sans-IO: no port, no clock. Tables and test vectors: `docs/tactile-protocol.md`.
"""

import enum
import struct
import zlib
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass

from cobs import cobs

from palpate.drivers.tactile.messages import (
    MAX_TAXELS,
    Ack,
    Body,
    Describe,
    Description,
    Frame,
    Hello,
    Message,
    MessageType,
    Nack,
    NackReason,
    Shape,
    Start,
    Stop,
)

__all__ = ["MAX_ENCODED", "VERSION", "DecodeFault", "Decoder", "FaultKind", "encode"]

VERSION = 1
DELIMITER = b"\x00"
_HEADER = struct.Struct("<BBHIQH")
_CRC = struct.Struct("<I")
_REQUEST = struct.Struct("<H")
_START = struct.Struct("<HI")
_NACK = struct.Struct("<HB")
_SIZE = struct.Struct("<BB")
_DESCRIBE = struct.Struct("<H16sBBBBBIfff")
_MAX_PAYLOAD = _SIZE.size + 2 * MAX_TAXELS
_MAX_PLAIN = _HEADER.size + _MAX_PAYLOAD + _CRC.size
MAX_ENCODED = _MAX_PLAIN + _MAX_PLAIN // 254 + 1  # COBS adds one byte in 254 and one more
_PLAIN_REQUESTS: dict[type, MessageType] = {
    Hello: MessageType.HELLO,
    Stop: MessageType.STOP,
    Ack: MessageType.ACK,
}
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

    `missing` is the number of messages lost at a SEQUENCE_GAP. `request_id` and `type_code` are there where
    the CRC held but the content made no sense, so that a device can answer NACK.
    """

    kind: FaultKind
    missing: int = 0
    type_code: int | None = None
    request_id: int | None = None


def encode(message: Message) -> bytes:
    """Return the wire bytes, closing delimiter included.

    Raises ValueError if a field does not fit its place on the wire.
    """
    kind, payload = _pack(message.body)
    try:
        head = _HEADER.pack(VERSION, kind, message.flags, message.sequence, message.time_us, len(payload))
    except struct.error as problem:
        raise ValueError(f"header field out of range in {message!r}: {problem}") from problem
    plain = head + payload
    stuffed: bytes = cobs.encode(plain + _CRC.pack(zlib.crc32(plain)))
    return stuffed + DELIMITER


def _pack(body: Body) -> tuple[MessageType, bytes]:
    try:
        match body:
            case Frame():
                if (
                    len(body.taxels) != 2 * body.rows * body.cols
                    or not 0 < body.rows * body.cols <= MAX_TAXELS
                ):
                    raise ValueError(f"{body.rows} x {body.cols} frame with {len(body.taxels)} bytes")
                return MessageType.FRAME, _SIZE.pack(body.rows, body.cols) + body.taxels
            case Hello() | Stop() | Ack():
                return _PLAIN_REQUESTS[type(body)], _REQUEST.pack(body.request_id)
            case Start():
                return MessageType.START, _START.pack(body.request_id, body.rate_mhz)
            case Nack():
                return MessageType.NACK, _NACK.pack(body.request_id, body.reason)
            case Describe():
                return MessageType.DESCRIBE, _pack_describe(body)
    except (struct.error, OverflowError) as problem:
        raise ValueError(f"field out of range in {body!r}: {problem}") from problem


def _pack_describe(body: Describe) -> bytes:
    d = body.description
    problem = d.problem()
    if problem is not None:
        raise ValueError(f"unusable description: {problem}")
    fixed = _DESCRIBE.pack(
        body.request_id,
        d.unique_id,
        int(d.emulated),
        d.shape,
        d.bit_depth,
        d.rows,
        d.cols,
        round(d.max_rate_hz * 1000),
        d.full_scale_n,
        d.counts_per_n,
        d.tip_radius_mm,
    )
    reals = struct.pack(f"<{d.cols + d.rows}f", *d.columns, *d.row_heights_mm)
    name = d.firmware.encode()
    return fixed + reals + bytes((len(name),)) + name


def _unpack_describe(payload: bytes) -> Describe:
    request, uid, flags, shape, depth, rows, cols, rate, scale, per_n, radius = _DESCRIBE.unpack_from(payload)
    reals = struct.unpack_from(f"<{rows + cols}f", payload, _DESCRIBE.size)
    at = _DESCRIBE.size + 4 * (rows + cols)
    if len(payload) <= at or len(payload) != at + 1 + payload[at]:
        raise ValueError("firmware name does not end with the payload")
    description = Description(
        unique_id=uid,
        firmware=payload[at + 1 :].decode(),
        emulated=bool(flags & 1),
        shape=Shape(shape),
        rows=rows,
        cols=cols,
        bit_depth=depth,
        max_rate_hz=rate / 1000,
        full_scale_n=scale,
        counts_per_n=per_n,
        tip_radius_mm=radius,
        columns=reals[:cols],
        row_heights_mm=reals[cols:],
    )
    problem = description.problem()
    if problem is not None:
        raise ValueError(problem)
    return Describe(request, description)


def _unpack_frame(payload: bytes) -> Frame:
    rows, cols = _SIZE.unpack_from(payload)
    if not 0 < rows * cols <= MAX_TAXELS or len(payload) != _SIZE.size + 2 * rows * cols:
        raise ValueError("frame size does not match its rows and columns")
    return Frame(rows, cols, payload[_SIZE.size :])


def _unpack_nack(payload: bytes) -> Nack:
    request, reason = _NACK.unpack(payload)
    return Nack(request, NackReason(reason))


_UNPACK: dict[int, Callable[[bytes], Body]] = {
    MessageType.HELLO: lambda p: Hello(*_REQUEST.unpack(p)),
    MessageType.START: lambda p: Start(*_START.unpack(p)),
    MessageType.STOP: lambda p: Stop(*_REQUEST.unpack(p)),
    MessageType.DESCRIBE: _unpack_describe,
    MessageType.ACK: lambda p: Ack(*_REQUEST.unpack(p)),
    MessageType.NACK: _unpack_nack,
    MessageType.FRAME: _unpack_frame,
}


class Decoder:
    """Bytes in, messages and typed faults out, in the order of the stream.

    Any bytes whatever give messages or faults, never an exception, and at most `MAX_ENCODED` bytes are kept
    between calls. `faults` counts what went wrong by kind; `lost` counts messages that the sender numbered
    and that never came.
    """

    def __init__(self) -> None:
        self._pending = bytearray()
        self._skipping = False
        self._last: int | None = None
        self.faults: Counter[FaultKind] = Counter()
        self.lost = 0

    def feed(self, data: bytes) -> list[Message | DecodeFault]:
        """Take bytes as they came; return what they complete."""
        out: list[Message | DecodeFault] = []
        *closed, rest = bytes(data).split(DELIMITER)
        for piece in closed:
            self._close(piece, out)
        self._keep(rest, out)
        return out

    def _keep(self, piece: bytes, out: list[Message | DecodeFault]) -> None:
        if self._skipping:
            return
        if len(self._pending) + len(piece) > MAX_ENCODED:
            self._pending.clear()
            self._skipping = True
            self._fault(DecodeFault(FaultKind.OVERSIZED), out)
        else:
            self._pending += piece

    def _close(self, piece: bytes, out: list[Message | DecodeFault]) -> None:
        self._keep(piece, out)
        if self._pending:
            self._decode(bytes(self._pending), out)
        self._pending.clear()
        self._skipping = False

    def _decode(self, stuffed: bytes, out: list[Message | DecodeFault]) -> None:
        result = _decode_one(stuffed)
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
            self._fault(DecodeFault(FaultKind.STALE), out)
            return False
        return True

    def _fault(self, fault: DecodeFault, out: list[Message | DecodeFault]) -> None:
        self.faults[fault.kind] += 1
        out.append(fault)


def _decode_one(stuffed: bytes) -> Message | DecodeFault:
    try:
        plain = cobs.decode(stuffed)
    except cobs.DecodeError:
        return DecodeFault(FaultKind.FRAMING)
    if len(plain) < _HEADER.size + _CRC.size:
        return DecodeFault(FaultKind.SHORT)
    body, crc = plain[: -_CRC.size], plain[-_CRC.size :]
    if _CRC.unpack(crc)[0] != zlib.crc32(body):
        return DecodeFault(FaultKind.CRC)
    return _unpack_message(body)


def _unpack_message(plain: bytes) -> Message | DecodeFault:
    version, kind, flags, sequence, time_us, length = _HEADER.unpack_from(plain)
    payload = plain[_HEADER.size :]
    if version != VERSION:
        return DecodeFault(FaultKind.VERSION)
    if length != len(payload):
        return DecodeFault(FaultKind.LENGTH)
    request = _REQUEST.unpack_from(payload)[0] if len(payload) >= _REQUEST.size else None
    unpack = _UNPACK.get(kind)
    if unpack is None:
        return DecodeFault(FaultKind.UNKNOWN_TYPE, type_code=kind, request_id=request)
    try:
        return Message(sequence, time_us, unpack(payload), flags)
    except (ValueError, struct.error):
        return DecodeFault(FaultKind.PAYLOAD, type_code=kind, request_id=request)
