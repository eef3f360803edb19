"""Payloads of the packets of Weiss Robotics' tactile sensors: answers, descriptions and frames.

Every answer begins with a status u16. A frame is a timestamp u32, flags u8 and the texels, u16 each and
row by row, or, with bit 0 of the flags, run-length units of u16: count in bits 12 to 15, value in bits
0 to 11. All little endian.

Sources as in `codec`: wts_driver for the WTS's answers, SDHLibrary for the DSA's, RobWork for its
descriptor strings. Where SDHLibrary and RobWork differ (type of the full scale, where compressed texels
begin) it is as in SDHLibrary.
"""

import struct
from dataclasses import dataclass
from typing import Any

import numpy as np

from palpate.plugins import Counts

__all__ = [
    "COMPRESSED",
    "FRAME",
    "MAX_TEXEL",
    "STATUS_SIZE",
    "ControllerInfo",
    "MatrixInfo",
    "RawFrame",
    "SystemInfo",
    "compress",
    "expand",
    "frame_payload",
    "frame_size",
    "parse_frame",
    "status_of",
]

FRAME = 0x00
"""Command under which both dialects send frames of their own accord."""

COMPRESSED = 0x01
"""Bit of a frame's flags, and of the requests for frames."""

MAX_TEXEL = 0xFFF

STATUS_SIZE = 2
_STATUS = struct.Struct("<H")
_FRAME_HEAD = struct.Struct("<IB")
_LONGEST_RUN = 15
_WTS_MATRIX = struct.Struct("<HHHHH")
_WTS_SYSTEM = struct.Struct("<BBHI")
_DSA_CONTROLLER = struct.Struct("<IBH")
_DSA_MATRIX = struct.Struct("<ffHH6s2xBffffff")  # then the full scale, four bytes, and flags
_DSA_FULL_SCALE = struct.Struct("<fB")
_DSA_MATRICES = struct.Struct("<H")


@dataclass(frozen=True)
class SystemInfo:
    """What a WTS says of itself. `firmware` is four digits, a nibble each: 0x2140 is 2.1.4.0."""

    type_code: int
    hardware: int
    firmware: int
    serial: int

    @property
    def version(self) -> str:
        """Firmware as people write it."""
        return ".".join(str(self.firmware >> shift & 0xF) for shift in (12, 8, 4, 0))

    def pack(self) -> bytes:
        """Bytes of the answer behind the status."""
        return _WTS_SYSTEM.pack(self.type_code, self.hardware, self.firmware, self.serial)

    @classmethod
    def parse(cls, data: bytes) -> "SystemInfo":
        """Read what `pack` makes; ValueError if it is too short."""
        return cls(*_unpack(_WTS_SYSTEM, data, "system information"))


@dataclass(frozen=True)
class ControllerInfo:
    """What a DSACON32 says of itself: serial number, hardware, and release of its firmware."""

    serial: int
    hardware: int
    release: int

    def pack(self) -> bytes:
        """Bytes of the answer behind the status: one fewer than documented, as SDHLibrary found."""
        return _DSA_CONTROLLER.pack(self.serial, self.hardware, self.release) + bytes(9)

    @classmethod
    def parse(cls, data: bytes) -> "ControllerInfo":
        """Read what `pack` makes; ValueError if it is too short."""
        return cls(*_unpack(_DSA_CONTROLLER, data, "controller information"))

    @staticmethod
    def matrices(sensor_info: bytes) -> int:
        """Number of matrices, from the answer to SENSOR_INFO behind the status."""
        count: int = _unpack(_DSA_MATRICES, sensor_info, "sensor information")[0]
        return count


@dataclass(frozen=True)
class MatrixInfo:
    """A matrix of texels: `width_mm` × `height_mm` is the room of one texel. `uid` is the DSA's only."""

    cells_x: int
    cells_y: int
    width_mm: float
    height_mm: float
    full_scale: float
    uid: bytes = b""

    @property
    def cells(self) -> int:
        """How many texels there are."""
        return self.cells_x * self.cells_y

    def pack_wts(self) -> bytes:
        """Bytes of the WTS's answer behind the status; lengths in 1/100 mm."""
        width, height = round(self.width_mm * 100), round(self.height_mm * 100)
        return _WTS_MATRIX.pack(self.cells_x, self.cells_y, width, height, round(self.full_scale))

    @classmethod
    def parse_wts(cls, data: bytes) -> "MatrixInfo":
        """Read what `pack_wts` makes; ValueError if it is too short."""
        x, y, width, height, full = _unpack(_WTS_MATRIX, data, "matrix information")
        return cls(x, y, width / 100, height / 100, full)

    def pack_dsa(self) -> bytes:
        """Bytes of the DSA's answer behind the status; place and direction of the matrix are 0."""
        place = (0.0,) * 6
        uid = self.uid.ljust(6, b"\0")
        head = _DSA_MATRIX.pack(self.width_mm, self.height_mm, self.cells_x, self.cells_y, uid, 0x10, *place)
        return head + _DSA_FULL_SCALE.pack(self.full_scale, 0)

    @classmethod
    def parse_dsa(cls, data: bytes) -> "MatrixInfo":
        """Read what `pack_dsa` makes; ValueError if it is too short."""
        size = _DSA_MATRIX.size
        width, height, x, y, uid = _unpack(_DSA_MATRIX, data, "matrix information")[:5]
        full = _unpack(_DSA_FULL_SCALE, data[size:], "matrix information")[0]
        return cls(x, y, width, height, full, uid)


@dataclass(frozen=True, eq=False)
class RawFrame:
    """One sample: the device's own clock, and `texels` (cells,) uint16 in the device's order."""

    timestamp: int
    texels: Counts


def status_of(payload: bytes) -> int | None:
    """The status at an answer's beginning, or None if it has none."""
    return int(_STATUS.unpack_from(payload)[0]) if len(payload) >= STATUS_SIZE else None


def frame_size(cells: int) -> int:
    """Most bytes that a frame of `cells` texels may have, compressed or not."""
    return _FRAME_HEAD.size + 2 * cells


def frame_payload(timestamp: int, texels: Counts, *, compressed: bool) -> bytes:
    """Bytes of a frame. Raises ValueError if a texel has more than 12 bits."""
    data = compress(texels) if compressed else texels
    head = _FRAME_HEAD.pack(timestamp & 0xFFFFFFFF, COMPRESSED if compressed else 0)
    return head + data.astype("<u2").tobytes()


def parse_frame(payload: bytes, cells: int) -> RawFrame:
    """Read a frame of `cells` texels; ValueError if it has another number of them, or one above 12 bits."""
    if len(payload) < _FRAME_HEAD.size or (len(payload) - _FRAME_HEAD.size) % 2:
        raise ValueError(f"{len(payload)} bytes are no frame")
    timestamp, flags = _FRAME_HEAD.unpack_from(payload)
    words = np.frombuffer(payload, "<u2", offset=_FRAME_HEAD.size)
    texels = expand(words) if flags & COMPRESSED else words
    if len(texels) != cells:
        raise ValueError(f"a frame of {len(texels)} texels instead of {cells}")
    if not flags & COMPRESSED and cells and int(texels.max()) > MAX_TEXEL:
        raise ValueError(f"texel {texels.max()} (allowed: 0 to {MAX_TEXEL})")
    return RawFrame(timestamp, texels)


def compress(texels: Counts) -> Counts:
    """Run-length units for `texels` (n,). Raises ValueError if one has more than 12 bits."""
    if not len(texels):
        return np.zeros(0, np.uint16)
    if int(texels.max()) > MAX_TEXEL:
        raise ValueError(f"texel {texels.max()} has more than 12 bits")
    starts = np.flatnonzero(np.diff(texels.astype(np.int32), prepend=-1))
    lengths = np.diff(starts, append=len(texels))
    pieces = -(-lengths // _LONGEST_RUN)
    counts = np.full(int(pieces.sum()), _LONGEST_RUN)
    counts[np.cumsum(pieces) - 1] = lengths - (pieces - 1) * _LONGEST_RUN
    return (counts << 12 | np.repeat(texels[starts], pieces)).astype(np.uint16)


def expand(units: Counts) -> Counts:
    """Counts that run-length units stand for; a unit may stand for none."""
    return np.repeat(units & MAX_TEXEL, units >> 12).astype(np.uint16)


def _unpack(form: struct.Struct, data: bytes, what: str) -> tuple[Any, ...]:
    if len(data) < form.size:
        raise ValueError(f"{what} of {len(data)} bytes, {form.size} are needed")
    return form.unpack_from(data)
