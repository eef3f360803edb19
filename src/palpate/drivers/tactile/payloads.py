"""Payloads of tactile messages: bodies to bytes and back.

Tables: `docs/tactile-protocol.md`, section 2. Little endian throughout. Both ways raise ValueError where
something does not fit.
"""

import struct
from collections.abc import Callable
from typing import Any

from palpate.drivers.tactile.description import MAX_TAXELS, REALS_PER_TAXEL, unusable_places
from palpate.drivers.tactile.messages import (
    MAX_LISTED,
    Ack,
    BadTaxel,
    Body,
    Describe,
    Description,
    Frame,
    Geometry,
    Hello,
    MessageType,
    Nack,
    NackReason,
    Rate,
    SelfTest,
    SelfTestReport,
    SelfTestResult,
    Shape,
    Start,
    Stop,
    Tare,
    TaxelFault,
    TaxelPlaces,
)

__all__ = ["MAX_PAYLOAD", "pack", "request_id", "unpack"]

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
MAX_PAYLOAD = _SIZE.size + 2 * MAX_TAXELS
_NACK_REASONS = frozenset(map(int, NackReason))
_TAXEL_FAULTS = frozenset(map(int, TaxelFault))
_SHAPES = ", ".join(f"{shape.value} {shape.name.lower()}" for shape in Shape)


def request_id(payload: bytes) -> int | None:
    """Return the number that every message but FRAME begins with, or None if there is none."""
    number: int | None = _REQUEST.unpack_from(payload)[0] if len(payload) >= _REQUEST.size else None
    return number


def pack(body: Body) -> tuple[MessageType, bytes]:
    """Return a body's type and payload. Raises ValueError if a field does not fit its place."""
    try:
        if type(body) in _FIXED:
            kind, form = _FIXED[type(body)]
            return kind, form.pack(*vars(body).values())
        kind, writer = _PACK[type(body)]
        return kind, writer(body)
    except (struct.error, OverflowError) as problem:
        raise ValueError(f"field out of range in {body!r}: {problem}") from problem


def unpack(kind: int, payload: bytes) -> Body | None:
    """Return the body, or None of a type that is not known. Raises ValueError if it makes no sense."""
    reader = _UNPACK.get(kind)
    if reader is None:
        return None
    try:
        return reader(payload)
    except struct.error as problem:
        raise ValueError(f"a payload of {len(payload)} bytes: {problem}") from problem


def _reader(body: Callable[..., Body], form: struct.Struct) -> Callable[[bytes], Body]:
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
        firmware=_text(name),
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


def _text(name: bytes) -> str:
    try:
        return name.decode()
    except UnicodeDecodeError as problem:
        raise ValueError(f"firmware name {ascii(name)[1:]} (allowed: UTF-8)") from problem


def _pack_report(body: SelfTestReport) -> bytes:
    if len(body.bad) != min(body.bad_count, MAX_LISTED):
        raise ValueError(f"a list of {len(body.bad)} taxels where {body.bad_count} are bad")
    listed = (_BAD_TAXEL.pack(bad.row, bad.col, bad.fault) for bad in body.bad)
    return _REPORT.pack(body.request_id, body.result, body.bad_count) + b"".join(listed)


def _unpack_report(payload: bytes) -> SelfTestReport:
    request, result, count = _REPORT.unpack_from(payload)
    listed = payload[_REPORT.size :]
    if len(listed) != _BAD_TAXEL.size * min(count, MAX_LISTED):
        raise ValueError(f"{count} bad taxels in a payload of {len(payload)} bytes")
    unknown = {kind for _, _, kind in _BAD_TAXEL.iter_unpack(listed)} - _TAXEL_FAULTS
    if unknown:
        raise ValueError(f"kind {min(unknown)} of a bad taxel (allowed: 1 to {max(_TAXEL_FAULTS)})")
    bad = tuple(BadTaxel(row, col, TaxelFault(kind)) for row, col, kind in _BAD_TAXEL.iter_unpack(listed))
    return SelfTestReport(request, SelfTestResult(result), count, bad)


def _pack_taxels(body: TaxelPlaces) -> bytes:
    if not 1 <= body.count <= MAX_LISTED or len(body.places) % REALS_PER_TAXEL:
        raise ValueError(f"{len(body.places)} reals, which are not six each for 1..{MAX_LISTED} taxels")
    problem = unusable_places(body.places)
    if problem is not None:
        raise ValueError(problem)
    reals = struct.pack(f"<{len(body.places)}f", *body.places)
    return _TAXELS.pack(body.request_id, body.first, body.count) + reals


def _unpack_taxels(payload: bytes) -> TaxelPlaces:
    request, first, count = _TAXELS.unpack_from(payload)
    if count == 0 or len(payload) != _TAXELS.size + 4 * REALS_PER_TAXEL * count:
        raise ValueError(f"count {count} of taxels in a payload of {len(payload)} bytes")
    places = struct.unpack_from(f"<{REALS_PER_TAXEL * count}f", payload, _TAXELS.size)
    problem = unusable_places(places)
    if problem is not None:
        raise ValueError(problem)
    return TaxelPlaces(request, first, places)


_FIXED: dict[type[Body], tuple[MessageType, struct.Struct]] = {
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

_PACK: dict[type[Body], tuple[MessageType, Callable[[Any], bytes]]] = {
    Describe: (MessageType.DESCRIBE, _pack_describe),
    SelfTestReport: (MessageType.REPORT, _pack_report),
    TaxelPlaces: (MessageType.TAXELS, _pack_taxels),
    Frame: (MessageType.FRAME, _pack_frame),
}
_UNPACK: dict[int, Callable[[bytes], Body]] = {
    **{kind: _reader(body, form) for body, (kind, form) in _FIXED.items()},
    MessageType.DESCRIBE: _unpack_describe,
    MessageType.NACK: _unpack_nack,
    MessageType.REPORT: _unpack_report,
    MessageType.TAXELS: _unpack_taxels,
    MessageType.FRAME: _unpack_frame,
}
