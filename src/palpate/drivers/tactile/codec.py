"""Codec of the tactile protocol: bytes to messages and back.

    COBS(version u8, type u8, flags u16, sequence u32, time_us u64, length u16, payload, crc u32) 00

Little endian throughout. The CRC is CRC-32 (zlib) over everything before it. COBS (Cheshire and Baker,
"Consistent Overhead Byte Stuffing", 1999) keeps 0x00 out of the frame, so that whatever happened on the wire
the next 0x00 starts afresh. Payloads: `docs/tactile-protocol.md`, section 2; packing and unpacking them
raises ValueError where something does not fit.
"""

import enum
import struct
import zlib
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from cobs import cobs

from palpate.drivers.tactile.description import (
    MAX_TAXELS,
    REALS_PER_TAXEL,
    Description,
    Shape,
    geometry_problem,
)
from palpate.drivers.tactile.messages import (
    MAX_LISTED_TAXELS,
    Ack,
    BadTaxel,
    Describe,
    Frame,
    Geometry,
    Hello,
    Message,
    MessageBody,
    MessageType,
    Nack,
    NackReason,
    Rate,
    SelfTest,
    SelfTestReport,
    SelfTestResult,
    Start,
    Stop,
    Tare,
    TaxelFault,
    TaxelPlaces,
)

_REQUEST = struct.Struct("<H")
_RATE = struct.Struct("<HI")
_TARE = struct.Struct("<HHH")
_GEOMETRY = struct.Struct("<HH")
_NACK = struct.Struct("<HB")
_SIZE = struct.Struct("<BB")
_DESCRIBE = struct.Struct("<H16sBBBBBIfff")
_REPORT = struct.Struct("<HHH")
_BAD_TAXEL = struct.Struct("<BBB")
_TAXELS = struct.Struct("<HHB")
_MAX_PAYLOAD_BYTES = _SIZE.size + 2 * MAX_TAXELS
_NACK_REASONS = frozenset(map(int, NackReason))
_TAXEL_FAULTS = frozenset(map(int, TaxelFault))
_SHAPES = ", ".join(f"{shape.value} {shape.name.lower()}" for shape in Shape)


def request_id(payload: bytes) -> int | None:
    """Return the number that every message but FRAME begins with, or None if there is none."""
    number: int | None = _REQUEST.unpack_from(payload)[0] if len(payload) >= _REQUEST.size else None
    return number


def pack_payload(body: MessageBody) -> tuple[MessageType, bytes]:
    """Return a body's type and payload. Raises ValueError if a field does not fit its place."""
    try:
        if type(body) in _FIXED:
            kind, form = _FIXED[type(body)]
            return kind, form.pack(*vars(body).values())
        kind, writer = _PACK[type(body)]
        return kind, writer(body)
    except (struct.error, OverflowError) as problem:
        raise ValueError(f"field out of range in {body!r}: {problem}") from problem


def _unpack_payload(kind: int, payload: bytes) -> MessageBody | None:
    """Return the body, or None of a type that is not known. Raises ValueError if it makes no sense."""
    reader = _UNPACK.get(kind)
    if reader is None:
        return None
    try:
        return reader(payload)
    except struct.error as problem:
        raise ValueError(f"a payload of {len(payload)} bytes: {problem}") from problem


def _struct_reader(body: Callable[..., MessageBody], form: struct.Struct) -> Callable[[bytes], MessageBody]:
    return lambda payload: body(*form.unpack(payload))


def _pack_frame(body: Frame) -> bytes:
    taxels = body.rows * body.cols
    if len(body.taxels) != 2 * taxels or not 0 < taxels <= MAX_TAXELS:
        raise ValueError(f"{body.rows} x {body.cols} frame with {len(body.taxels)} bytes")
    return _SIZE.pack(body.rows, body.cols) + body.taxels


def _unpack_frame(payload: bytes) -> Frame:
    rows, cols = _SIZE.unpack_from(payload)
    if not 0 < rows * cols <= MAX_TAXELS or len(payload) != _SIZE.size + 2 * rows * cols:
        raise ValueError(f"{rows} x {cols} taxels in a payload of {len(payload)} bytes")
    return Frame(rows, cols, payload[_SIZE.size :])


def _unpack_nack(payload: bytes) -> Nack:
    request, reason = _NACK.unpack(payload)
    if reason not in _NACK_REASONS:
        raise ValueError(f"reason {reason} (allowed: {min(_NACK_REASONS)} to {max(_NACK_REASONS)})")
    return Nack(request, NackReason(reason))


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
    reals = (*d.columns, *d.row_heights_mm)
    name = d.firmware.encode()
    return fixed + struct.pack(f"<{len(reals)}f", *reals) + bytes((len(name),)) + name


def _unpack_describe(payload: bytes) -> Describe:
    request, uid, flags, shape, depth, rows, cols, rate, scale, per_n, radius = _DESCRIBE.unpack_from(payload)
    if shape not in tuple(Shape):
        raise ValueError(f"shape {shape} (allowed: {_SHAPES})")
    count = 0 if shape == Shape.FREE else rows + cols
    at = _DESCRIBE.size + 4 * count
    if len(payload) <= at:
        size = f"{rows} rows and {cols} columns" if count else "a free surface"
        raise ValueError(f"a payload of {len(payload)} bytes (allowed: {at + 1} or more, with {size})")
    reals = struct.unpack_from(f"<{count}f", payload, _DESCRIBE.size)
    name = payload[at + 1 :]
    if len(name) != payload[at]:
        raise ValueError(f"name length {payload[at]} (allowed: {len(name)}, the bytes that follow)")
    description = Description(
        unique_id=uid,
        firmware=_decode_name(name),
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


def _decode_name(name: bytes) -> str:
    try:
        return name.decode()
    except UnicodeDecodeError as problem:
        raise ValueError(f"firmware name {ascii(name)[1:]} (allowed: UTF-8)") from problem


def _pack_report(body: SelfTestReport) -> bytes:
    if len(body.bad) != min(body.bad_count, MAX_LISTED_TAXELS):
        raise ValueError(f"a list of {len(body.bad)} taxels where {body.bad_count} are bad")
    listed = (_BAD_TAXEL.pack(bad.row, bad.col, bad.fault) for bad in body.bad)
    return _REPORT.pack(body.request_id, body.result, body.bad_count) + b"".join(listed)


def _unpack_report(payload: bytes) -> SelfTestReport:
    request, result, count = _REPORT.unpack_from(payload)
    listed = payload[_REPORT.size :]
    if len(listed) != _BAD_TAXEL.size * min(count, MAX_LISTED_TAXELS):
        raise ValueError(f"{count} bad taxels in a payload of {len(payload)} bytes")
    unknown = {kind for _, _, kind in _BAD_TAXEL.iter_unpack(listed)} - _TAXEL_FAULTS
    if unknown:
        raise ValueError(f"kind {min(unknown)} of a bad taxel (allowed: 1 to {max(_TAXEL_FAULTS)})")
    bad = tuple(BadTaxel(row, col, TaxelFault(kind)) for row, col, kind in _BAD_TAXEL.iter_unpack(listed))
    return SelfTestReport(request, SelfTestResult(result), count, bad)


def _pack_taxels(body: TaxelPlaces) -> bytes:
    if not 1 <= body.count <= MAX_LISTED_TAXELS or len(body.places) % REALS_PER_TAXEL:
        raise ValueError(
            f"{len(body.places)} reals, which are not six each for 1..{MAX_LISTED_TAXELS} taxels"
        )
    problem = geometry_problem(body.places)
    if problem is not None:
        raise ValueError(problem)
    reals = struct.pack(f"<{len(body.places)}f", *body.places)
    return _TAXELS.pack(body.request_id, body.first, body.count) + reals


def _unpack_taxels(payload: bytes) -> TaxelPlaces:
    request, first, count = _TAXELS.unpack_from(payload)
    if count == 0 or len(payload) != _TAXELS.size + 4 * REALS_PER_TAXEL * count:
        raise ValueError(f"count {count} of taxels in a payload of {len(payload)} bytes")
    places = struct.unpack_from(f"<{REALS_PER_TAXEL * count}f", payload, _TAXELS.size)
    problem = geometry_problem(places)
    if problem is not None:
        raise ValueError(problem)
    return TaxelPlaces(request, first, places)


_FIXED: dict[type[MessageBody], tuple[MessageType, struct.Struct]] = {
    Hello: (MessageType.HELLO, _REQUEST),
    Start: (MessageType.START, _RATE),
    Stop: (MessageType.STOP, _REQUEST),
    Rate: (MessageType.RATE, _RATE),
    Tare: (MessageType.TARE, _TARE),
    SelfTest: (MessageType.SELF_TEST, _REQUEST),
    Geometry: (MessageType.GEOMETRY, _GEOMETRY),
    Ack: (MessageType.ACK, _REQUEST),
    Nack: (MessageType.NACK, _NACK),
}
"""Bodies whose fields are the numbers of their payload, in order."""

_PACK: dict[type[MessageBody], tuple[MessageType, Callable[[Any], bytes]]] = {
    Describe: (MessageType.DESCRIBE, _pack_describe),
    SelfTestReport: (MessageType.REPORT, _pack_report),
    TaxelPlaces: (MessageType.TAXELS, _pack_taxels),
    Frame: (MessageType.FRAME, _pack_frame),
}
_UNPACK: dict[int, Callable[[bytes], MessageBody]] = {
    **{kind: _struct_reader(body, form) for body, (kind, form) in _FIXED.items()},
    MessageType.DESCRIBE: _unpack_describe,
    MessageType.NACK: _unpack_nack,
    MessageType.REPORT: _unpack_report,
    MessageType.TAXELS: _unpack_taxels,
    MessageType.FRAME: _unpack_frame,
}


VERSION = 1
DELIMITER = b"\x00"
_HEADER = struct.Struct("<BBHIQH")
_CRC = struct.Struct("<I")
_CRC_RESIDUE = zlib.crc32(_CRC.pack(zlib.crc32(b"")))  # CRC of anything with its own CRC behind it
_MIN_PLAIN_BYTES = _HEADER.size + _CRC.size
_MAX_PLAIN_BYTES = _MIN_PLAIN_BYTES + _MAX_PAYLOAD_BYTES
MAX_ENCODED_BYTES = _MAX_PLAIN_BYTES + _MAX_PLAIN_BYTES // 254 + 1  # COBS adds one byte in 254 and one more
_HALF_SEQUENCE_RANGE = 1 << 31  # sequence numbers are compared on a circle of 2**32


class FaultKind(enum.Enum):
    """Kind of fault in a stretch of the stream."""

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
    """Stretch of the stream that is not a message.

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
    kind, payload = pack_payload(message.body)
    try:
        head = _HEADER.pack(version, kind, message.flags, message.sequence, message.time_us, len(payload))
    except struct.error as problem:
        raise ValueError(f"header field out of range in {message!r}: {problem}") from problem
    plain = head + payload
    stuffed: bytes = cobs.encode(plain + _CRC.pack(zlib.crc32(plain)))
    return stuffed + DELIMITER


def frame_bytes(taxels: int) -> int:
    """Bytes of an encoded FRAME at most, delimiter included."""
    plain = _MIN_PLAIN_BYTES + 2 + 2 * taxels
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
        """Number of bytes kept of a message whose rest has not come."""
        return len(self._pending)

    def feed(self, data: bytes) -> list[Message | DecodeFault]:
        """Take bytes as they came; return what they complete."""
        out: list[Message | DecodeFault] = []
        *closed, rest = bytes(data).split(DELIMITER)
        for piece in closed:
            is_rest = self._pending or self._skipping or len(piece) > MAX_ENCODED_BYTES
            if whole := self._complete(piece, out) if is_rest else piece:
                self._decode(whole, out)
        if rest:
            self._keep(rest, out)
        return out

    def _keep(self, piece: bytes, out: list[Message | DecodeFault]) -> None:
        if self._skipping:
            return
        if len(self._pending) + len(piece) > MAX_ENCODED_BYTES:
            self._pending = bytearray()
            self._skipping = True
            self._fault(DecodeFault(FaultKind.OVERSIZED), out)
        else:
            self._pending += piece

    def _complete(self, piece: bytes, out: list[Message | DecodeFault]) -> bytes:
        """Kept bytes with their end; empty if they are too long."""
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
        if 1 < step < _HALF_SEQUENCE_RANGE:
            self.lost += step - 1
            self._fault(DecodeFault(FaultKind.SEQUENCE_GAP, missing=step - 1), out)
        elif (step == 0 or step >= _HALF_SEQUENCE_RANGE) and isinstance(message.body, Frame):
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
    if len(plain) < _MIN_PLAIN_BYTES:
        return DecodeFault(FaultKind.SHORT)
    if zlib.crc32(plain) != _CRC_RESIDUE:
        return DecodeFault(FaultKind.CRC)
    return _unpack_message(plain, version)


def _unpack_message(plain: bytes, version: int) -> Message | DecodeFault:
    said, kind, flags, sequence, time_us, length = _HEADER.unpack_from(plain)
    payload = plain[_HEADER.size : -_CRC.size]
    if said != version:
        return _unusable_message(FaultKind.VERSION, said, kind, payload)
    if length != len(payload):
        reason = f"length {length} (allowed: {len(payload)}, the bytes of its payload)"
        return _unusable_message(FaultKind.LENGTH, said, kind, payload, reason)
    try:
        body = _unpack_payload(kind, payload)
    except ValueError as problem:
        return _unusable_message(FaultKind.PAYLOAD, said, kind, payload, str(problem))
    if body is None:
        return _unusable_message(FaultKind.UNKNOWN_TYPE, said, kind, payload)
    return Message(sequence, time_us, body, flags)


def _unusable_message(
    what: FaultKind, version: int, kind: int, payload: bytes, reason: str = ""
) -> DecodeFault:
    number = request_id(payload)
    return DecodeFault(what, type_code=kind, request_id=number, version=version, reason=reason)
