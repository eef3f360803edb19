"""The tactile protocol once more, by struct alone: independent of the drivers' codec, to test firmware with.

Only what `docs/tactile-protocol.md` says is used here; its test vectors are read from the page itself.
"""

import re
import struct
import zlib
from collections.abc import Iterable
from dataclasses import dataclass

from cobs import cobs
from repository import ROOT

__all__ = [
    "ACK",
    "DESCRIBE",
    "FRAME",
    "GEOMETRY",
    "HELLO",
    "NACK",
    "RATE",
    "REPORT",
    "SELF_TEST",
    "START",
    "STOP",
    "TARE",
    "TAXELS",
    "Reason",
    "Said",
    "frame_counts",
    "page_vectors",
    "request",
    "said",
    "split",
]

PAGE = ROOT / "docs" / "tactile-protocol.md"
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


def wire(
    version: int, kind: int, sequence: int, time_us: int, payload: bytes, length: int | None = None
) -> bytes:
    """A message of any contents, with its delimiter; `length` may lie."""
    told = len(payload) if length is None else length
    plain = _HEADER.pack(version, kind, 0, sequence, time_us, told) + payload
    stuffed: bytes = cobs.encode(plain + struct.pack("<I", zlib.crc32(plain)))
    return stuffed + b"\x00"


def request(
    kind: int, number: int, *values: int, sequence: int = 0, time_us: int = 0, version: int = 1
) -> bytes:
    """A request as a host sends it."""
    return wire(version, kind, sequence, time_us, struct.pack(_FIELDS.get(kind, "<H"), number, *values))


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


def page_vectors() -> dict[str, bytes]:
    """The page's test vectors: bytes by description."""
    text = PAGE.read_text(encoding="utf-8")
    rows: Iterable[tuple[str, str]] = re.findall(
        r"^\| (.+) \| `((?:[0-9a-f]{2} )+00)` \|$", text, re.MULTILINE
    )
    return {name: bytes.fromhex(digits) for name, digits in rows}
