"""The vectors of `docs/tactile-protocol.md`, put together without the codec."""

import struct
import zlib
from dataclasses import replace

from palpate.drivers.tactile.description import Description, Shape
from palpate.drivers.tactile.messages import (
    Ack,
    BadTaxel,
    Describe,
    Frame,
    Geometry,
    Hello,
    Message,
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
