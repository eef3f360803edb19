"""What a tactile array and its host say to each other, as values. Next: `protocol` turns them into bytes.

The byte layout is in `docs/tactile-protocol.md`. Angles are in the tip frame: z along the tip's axis,
pointing up, z = 0 at the tip's lower end; angle 0 is the array's middle, counter-clockwise seen from above.
"""

import enum
import math
from dataclasses import dataclass
from itertools import pairwise
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

__all__ = [
    "Ack",
    "Body",
    "Describe",
    "Description",
    "Frame",
    "Hello",
    "Message",
    "MessageType",
    "Nack",
    "NackReason",
    "Shape",
    "Start",
    "Stop",
]

MAX_TAXELS = 4096


class MessageType(enum.IntEnum):
    """Second byte of the header. The high bit is set in what a device sends."""

    HELLO = 0x01
    START = 0x02
    STOP = 0x03
    DESCRIBE = 0x81
    ACK = 0x82
    NACK = 0x83
    FRAME = 0x90


class NackReason(enum.IntEnum):
    """Why a device did not do what it was asked to."""

    UNKNOWN_TYPE = 1
    BAD_PAYLOAD = 2
    BAD_RATE = 3
    HARDWARE = 4


class Shape(enum.IntEnum):
    """Surface that carries the taxels."""

    FLAT = 0
    CYLINDER = 1


@dataclass(frozen=True)
class Description:
    """What an array says of itself. Reals travel as 32-bit floats.

    `columns` holds one position per column, ascending: rad about the tip's axis on a cylinder, mm along x on
    a flat pad. `row_heights_mm` holds one z per row, ascending. `full_scale_n` is the force on one taxel that
    brings it to its largest count. `tip_radius_mm` is 0 for a flat pad.
    """

    unique_id: bytes
    firmware: str
    emulated: bool
    shape: Shape
    rows: int
    cols: int
    bit_depth: int
    max_rate_hz: float
    full_scale_n: float
    counts_per_n: float
    tip_radius_mm: float
    columns: tuple[float, ...]
    row_heights_mm: tuple[float, ...]

    @property
    def max_count(self) -> int:
        """Largest value a taxel can have."""
        return (1 << self.bit_depth) - 1

    @property
    def taxels(self) -> int:
        """How many taxels there are."""
        return self.rows * self.cols

    def positions_mm(self) -> NDArray[np.float64]:
        """Taxel centres, shape (rows, cols, 3), mm, tip frame."""
        columns = np.asarray(self.columns)
        flat = self.shape is Shape.FLAT
        x = columns if flat else self.tip_radius_mm * np.cos(columns)
        y = np.zeros(self.cols) if flat else self.tip_radius_mm * np.sin(columns)
        out = np.empty((self.rows, self.cols, 3))
        out[..., 0], out[..., 1] = x, y
        out[..., 2] = np.asarray(self.row_heights_mm)[:, None]
        return out

    def normals(self) -> NDArray[np.float64]:
        """Outward unit normals of the taxels, shape (rows, cols, 3), tip frame."""
        angles = np.full(self.cols, -math.pi / 2) if self.shape is Shape.FLAT else np.asarray(self.columns)
        out = np.zeros((self.rows, self.cols, 3))
        out[..., 0], out[..., 1] = np.cos(angles), np.sin(angles)
        return out

    def problem(self) -> str | None:
        """Say what makes this description unusable, or None if nothing does."""
        reals = (
            *self.columns,
            *self.row_heights_mm,
            self.full_scale_n,
            self.counts_per_n,
            self.tip_radius_mm,
            self.max_rate_hz,
        )
        checks = (
            (len(self.unique_id) == 16, "the unique id is not 16 bytes long"),
            (1 <= self.rows <= 255 and 1 <= self.cols <= 255, "rows or columns outside 1..255"),
            (self.taxels <= MAX_TAXELS, f"more than {MAX_TAXELS} taxels"),
            (1 <= self.bit_depth <= 16, "bit depth outside 1..16"),
            (len(self.columns) == self.cols, "not one position per column"),
            (len(self.row_heights_mm) == self.rows, "not one height per row"),
            (all(map(math.isfinite, reals)), "a number is not finite"),
            (_ascending(self.columns), "column positions do not ascend"),
            (_ascending(self.row_heights_mm), "row heights do not ascend"),
            (self.full_scale_n > 0 and self.counts_per_n > 0, "full scale or counts per N not positive"),
            (self.max_rate_hz > 0, "rate not positive"),
            (self.shape is Shape.FLAT or self.tip_radius_mm > 0, "a cylinder without a radius"),
            (len(self.firmware.encode()) <= 255, "firmware name longer than 255 bytes"),
        )
        return next((text for good, text in checks if not good), None)


def _ascending(values: tuple[float, ...]) -> bool:
    return all(a < b for a, b in pairwise(values))


@dataclass(frozen=True)
class Hello:
    """Host: stop streaming and say what you are."""

    request_id: int


@dataclass(frozen=True)
class Start:
    """Host: stream frames at `rate_mhz` thousandths of a frame per second."""

    request_id: int
    rate_mhz: int


@dataclass(frozen=True)
class Stop:
    """Host: stop streaming."""

    request_id: int


@dataclass(frozen=True)
class Describe:
    """Device: the answer to HELLO."""

    request_id: int
    description: Description


@dataclass(frozen=True)
class Ack:
    """Device: request carried out."""

    request_id: int


@dataclass(frozen=True)
class Nack:
    """Device: request not carried out."""

    request_id: int
    reason: NackReason


@dataclass(frozen=True)
class Frame:
    """Device: one sample of every taxel; `taxels` is u16 little endian, lowest row first."""

    rows: int
    cols: int
    taxels: bytes

    @property
    def counts(self) -> NDArray[np.uint16]:
        """Read-only array, shape (rows, cols)."""
        return np.frombuffer(self.taxels, dtype="<u2").reshape(self.rows, self.cols)


Body: TypeAlias = Hello | Start | Stop | Describe | Ack | Nack | Frame


@dataclass(frozen=True)
class Message:
    """A body with the header's fields: the sender's running number and its own time in µs."""

    sequence: int
    time_us: int
    body: Body
    flags: int = 0
