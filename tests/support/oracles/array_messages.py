"""Messages of arrays written with struct alone."""

import math
import re
import struct
import zlib
from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from cobs import cobs
from hypothesis import strategies as st

from palpate.drivers.tactile.description import Description, Shape
from palpate.drivers.tactile.messages import (
    Ack,
    BadTaxel,
    Describe,
    Frame,
    Geometry,
    Hello,
    Message,
    MessageBody,
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
from support.commands.repository import ROOT

# ----------------------------------------------------------------------------------------------------
# The vectors of `docs/tactile-vectors.txt`, put together without the codec.


def plain_cobs(data: bytes) -> bytes:
    """COBS straight from the paper's description: cut at zeros, lead each block with its length."""
    out = bytearray()
    block = bytearray()
    for byte in data:
        if byte:
            block.append(byte)
        if byte == 0 or len(block) == 254:
            out += bytes((len(block) + 1,)) + block
            block.clear()
    return bytes(out) + bytes((len(block) + 1,)) + block


def seal(plain: bytes) -> bytes:
    """Header and payload, whatever they are, with a right CRC, on the wire."""
    return plain_cobs(plain + struct.pack("<I", zlib.crc32(plain))) + b"\0"


def wire(
    kind: int,
    sequence: int,
    time_us: int,
    payload: bytes,
    *,
    version: int = 1,
    flags: int = 0,
    grow: int = 0,
) -> bytes:
    """A message on the wire, right or wrong."""
    length = len(payload) + grow
    return seal(struct.pack("<BBHIQH", version, kind, flags, sequence, time_us, length) + payload)


SMALL = Description(
    unique_id=bytes(range(16)),
    firmware="emu 1",
    emulated=True,
    shape=Shape.CYLINDER,
    rows=2,
    cols=3,
    bit_depth=12,
    max_rate_hz=200.0,
    full_scale_n=2.0,
    counts_per_n=2047.5,
    tip_radius_mm=5.0,
    columns=(-0.5, 0.0, 0.5),
    row_heights_mm=(1.0, 3.0),
)
FREE = replace(SMALL, shape=Shape.FREE, rows=1, cols=2, tip_radius_mm=0.0, columns=(), row_heights_mm=())
PLACES = (5.0, 0.0, 1.0, 1.0, 0.0, 0.0, 0.0, 5.0, 1.0, 0.0, 1.0, 0.0)
DESCRIBE_PAYLOAD = (
    struct.pack("<H16sBBBBBIfff", 1, bytes(range(16)), 1, 1, 12, 2, 3, 200000, 2.0, 2047.5, 5.0)
    + struct.pack("<5f", -0.5, 0, 0.5, 1, 3)
    + b"\x05emu 1"
)
FREE_PAYLOAD = (
    struct.pack("<H16sBBBBBIfff", 1, bytes(range(16)), 1, 2, 12, 1, 2, 200000, 2.0, 2047.5, 0) + b"\x05emu 1"
)
REPORT_PAYLOAD = struct.pack("<HHH6B", 6, 16, 2, 0, 1, 1, 1, 2, 2)
TAXELS_PAYLOAD = struct.pack("<HHB12f", 7, 0, 2, *PLACES)
BAD = (BadTaxel(0, 1, TaxelFault.STUCK_LOW), BadTaxel(1, 2, TaxelFault.STUCK_HIGH))
VERSION_2 = wire(0x01, 7, 4000, b"\x08\x00", version=2)
VECTORS = {
    "HELLO": (Message(0, 0, Hello(1)), wire(0x01, 0, 0, b"\x01\x00")),
    "START": (Message(1, 1500, Start(2, 200000)), wire(0x02, 1, 1500, struct.pack("<HI", 2, 200000))),
    "STOP": (Message(2, 0x0102030405060708, Stop(3)), wire(0x03, 2, 0x0102030405060708, b"\x03\x00")),
    "RATE": (Message(3, 2000, Rate(4, 100000)), wire(0x04, 3, 2000, struct.pack("<HI", 4, 100000))),
    "TARE": (Message(4, 2500, Tare(5, 32, 64)), wire(0x05, 4, 2500, struct.pack("<HHH", 5, 32, 64))),
    "SELF_TEST": (Message(5, 3000, SelfTest(6)), wire(0x06, 5, 3000, b"\x06\x00")),
    "GEOMETRY": (Message(6, 3500, Geometry(7, 0)), wire(0x07, 6, 3500, b"\x07\x00\x00\x00")),
    "ACK": (Message(1, 250, Ack(2)), wire(0x82, 1, 250, b"\x02\x00")),
    "NACK": (Message(2, 300, Nack(9, NackReason.BAD_RATE)), wire(0x83, 2, 300, b"\x09\x00\x03")),
    "FRAME": (
        Message(3, 5250, Frame(2, 3, struct.pack("<6H", 0, 1, 255, 256, 4095, 65535))),
        wire(0x90, 3, 5250, struct.pack("<BB6H", 2, 3, 0, 1, 255, 256, 4095, 65535)),
    ),
    "DESCRIBE": (Message(0, 200, Describe(1, SMALL)), wire(0x81, 0, 200, DESCRIBE_PAYLOAD)),
    "DESCRIBE, free": (Message(0, 200, Describe(1, FREE)), wire(0x81, 0, 200, FREE_PAYLOAD)),
    "FRAME, tared": (
        Message(6, 9250, Frame(1, 2, struct.pack("<2H", 64, 70)), flags=1),
        wire(0x90, 6, 9250, struct.pack("<BB2H", 1, 2, 64, 70), flags=1),
    ),
    "REPORT": (
        Message(3, 400, SelfTestReport(6, SelfTestResult.TAXELS, 2, BAD)),
        wire(0x84, 3, 400, REPORT_PAYLOAD),
    ),
    "TAXELS": (Message(4, 450, TaxelPlaces(7, 0, PLACES)), wire(0x85, 4, 450, TAXELS_PAYLOAD)),
    "NACK, BAD_VERSION": (
        Message(5, 500, Nack(8, NackReason.BAD_VERSION)),
        wire(0x83, 5, 500, b"\x08\x00\x06"),
    ),
}


# ----------------------------------------------------------------------------------------------------
# The tactile protocol once more, by struct alone: independent of the drivers' codec, to test firmware with.
#
# Only what `docs/tactile-protocol.md` says is used here; its test vectors are those beside the page.

TEST_VECTORS = ROOT / "docs" / "tactile-vectors.txt"
HELLO, START, STOP, RATE, TARE, SELF_TEST, GEOMETRY = range(1, 8)
DESCRIBE, ACK, NACK, REPORT, TAXELS, FRAME = 0x81, 0x82, 0x83, 0x84, 0x85, 0x90
_HEADER = struct.Struct("<BBHIQH")
_FIELDS = {START: "<HI", RATE: "<HI", TARE: "<HHH", GEOMETRY: "<HH"}


class Reason:
    """Reasons of a NACK, as in the page's table."""

    UNKNOWN_TYPE, BAD_PAYLOAD, BAD_RATE, HARDWARE, BAD_STATE, BAD_VERSION = range(1, 7)


@dataclass(frozen=True)
class Said:
    """A message whose framing, CRC and length are right."""

    version: int
    type: int
    flags: int
    sequence: int
    time_us: int
    payload: bytes

    @property
    def request(self) -> int:
        return int.from_bytes(self.payload[:2], "little")

    @property
    def reason(self) -> int:
        assert self.type == NACK
        assert len(self.payload) == 3
        return self.payload[2]


def message_wire(
    version: int, kind: int, sequence: int, time_us: int, payload: bytes, length: int | None = None
) -> bytes:
    """A message of any contents, with its delimiter; `length` may lie."""
    grow = 0 if length is None else length - len(payload)
    return wire(kind, sequence, time_us, payload, version=version, grow=grow)


def request(
    kind: int, number: int, *values: int, sequence: int = 0, time_us: int = 0, version: int = 1
) -> bytes:
    """A request as a host sends it."""
    return message_wire(
        version, kind, sequence, time_us, struct.pack(_FIELDS.get(kind, "<H"), number, *values)
    )


def split(stream: bytes) -> list[bytes]:
    """The whole messages of a stream, without delimiters; fails if the last one is not whole."""
    *pieces, rest = stream.split(b"\x00")
    assert rest == b""
    return [piece for piece in pieces if piece]


def said(stream: bytes) -> list[Said]:
    """Every message of a stream in which nothing is wrong."""
    return [_said(piece) for piece in split(stream)]


def _said(piece: bytes) -> Said:
    plain = cobs.decode(piece)
    body, crc = plain[:-4], plain[-4:]
    assert struct.unpack("<I", crc)[0] == zlib.crc32(body)
    version, kind, flags, sequence, time_us, length = _HEADER.unpack_from(body)
    assert length == len(body) - _HEADER.size
    return Said(version, kind, flags, sequence, time_us, body[_HEADER.size :])


def frame_counts(message: Said) -> list[int]:
    """Counts of a FRAME, row by row."""
    assert message.type == FRAME
    rows, columns = message.payload[:2]
    return list(struct.unpack(f"<{rows * columns}H", message.payload[2:]))


def written_vectors() -> dict[str, bytes]:
    """The written test vectors: bytes by description."""
    text = TEST_VECTORS.read_text(encoding="utf-8")
    rows: Iterable[tuple[str, str]] = re.findall(r"^((?:[0-9a-f]{2} )+00)  # (.+)$", text, re.MULTILINE)
    return {name: bytes.fromhex(digits) for digits, name in rows}


# ----------------------------------------------------------------------------------------------------
# Hypothesis strategies of everything that an array and its host may say to each other.

u8, u16, u32, u64 = (st.integers(0, 2**n - 1) for n in (8, 16, 32, 64))
real = st.floats(-1000, 1000, width=32)
positive = st.floats(2**-9, 2**16, width=32)


@st.composite
def descriptions(draw: st.DrawFn) -> Description:
    """Any array, as DESCRIBE tells of it."""
    rows, cols = draw(st.integers(1, 6)), draw(st.integers(1, 30))
    shape = draw(st.sampled_from(Shape))
    grid = shape is not Shape.FREE
    return Description(
        unique_id=draw(st.binary(min_size=16, max_size=16)),
        firmware=draw(st.text(max_size=60)),
        emulated=draw(st.booleans()),
        shape=shape,
        rows=rows,
        cols=cols,
        bit_depth=draw(st.integers(1, 16)),
        max_rate_hz=draw(st.integers(1, 10**6)) / 1000,
        full_scale_n=draw(positive),
        counts_per_n=draw(positive),
        tip_radius_mm=draw(st.floats(0.125, 1000, width=32)),
        columns=_ascending(draw, cols, 3.0 if shape is Shape.CYLINDER else 900.0) if grid else (),
        row_heights_mm=_ascending(draw, rows, 900.0) if grid else (),
    )


def _ascending(draw: st.DrawFn, count: int, farthest: float) -> tuple[float, ...]:
    """Places within ± `farthest` that are a thousandth of it apart or more, as 32-bit floats have them."""
    steps = draw(st.lists(st.integers(-1000, 1000), min_size=count, max_size=count, unique=True))
    return tuple(float(np.float32(step / 1000 * farthest)) for step in sorted(steps))


@st.composite
def frames(draw: st.DrawFn) -> Frame:
    """Any frame of up to 9 x 21 taxels."""
    rows, cols = draw(st.integers(1, 9)), draw(st.integers(1, 21))
    return Frame(rows, cols, draw(st.binary(min_size=2 * rows * cols, max_size=2 * rows * cols)))


@st.composite
def places(draw: st.DrawFn) -> tuple[float, ...]:
    """Places of one to five taxels, with normals of length 1 as 32-bit floats have it."""
    out: list[float] = []
    for _ in range(draw(st.integers(1, 5))):
        azimuth, height = draw(st.floats(-math.pi, math.pi)), draw(st.floats(-1, 1))
        level = math.sqrt(1 - height**2)
        normal = (level * math.cos(azimuth), level * math.sin(azimuth), height)
        out += [draw(real) for _ in range(3)] + [float(np.float32(part)) for part in normal]
    return tuple(out)


@st.composite
def reports(draw: st.DrawFn) -> SelfTestReport:
    """Any report; its list is short, or as long as it can be."""
    count = draw(st.one_of(st.integers(0, 4), st.sampled_from([254, 255, 256, 4096])))
    one = draw(st.builds(BadTaxel, u8, u8, st.sampled_from(TaxelFault)))
    return SelfTestReport(draw(u16), SelfTestResult(draw(u16)), count, (one,) * min(count, 255))


bodies: st.SearchStrategy[MessageBody] = st.one_of(
    st.builds(Hello, u16),
    st.builds(Start, u16, u32),
    st.builds(Stop, u16),
    st.builds(Rate, u16, u32),
    st.builds(Tare, u16, u16, u16),
    st.builds(SelfTest, u16),
    st.builds(Geometry, u16, u16),
    st.builds(Ack, u16),
    st.builds(Nack, u16, st.sampled_from(NackReason)),
    st.builds(Describe, u16, descriptions()),
    reports(),
    st.builds(TaxelPlaces, u16, u16, places()),
    frames(),
)
