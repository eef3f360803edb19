"""What an array says of itself: size, scale and the place of every taxel. Part of `messages`.

The tip frame has z along the tip's axis, pointing up, z = 0 at the tip's lower end; angle 0 is the array's
middle, counter-clockwise seen from above.
"""

import enum
import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from palpate.base.errors import DeviceError
from palpate.base.geometry import Floats

__all__ = ["MAX_TAXELS", "REALS_PER_TAXEL", "Description", "Shape", "unusable_places"]

MAX_TAXELS = 4096
REALS_PER_TAXEL = 6
_NORMAL_TOLERANCE = 0.01

# What lies outside of these is a mistake in the firmware, such as degrees for radians, and no array.
RATES_HZ = (0.001, 4294967.295)
FULL_SCALES_N = (1e-3, 1e5)
COUNTS_PER_N = (1e-3, 1e7)
RADII_MM = (0.1, 1000.0)
FARTHEST_MM = 1000.0
HALF_TURN_RAD = 3.1416  # half a turn, and what rounding adds
PITCH_MM = 0.01
PITCH_RAD = 1e-4


class Shape(enum.IntEnum):
    """Surface that carries the taxels."""

    FLAT = 0
    CYLINDER = 1
    FREE = 2


@dataclass(frozen=True)
class Description:
    """What an array says of itself. Reals travel as 32-bit floats.

    `columns` holds one position per column, ascending: rad about the tip's axis on a cylinder, mm along x on
    a flat pad. `row_heights_mm` holds one z per row, ascending. Both are empty on a free surface; there
    `geometry` holds six reals a taxel, row by row: position x, y, z (mm) and outward unit normal x, y, z, in
    the tip frame. It does not travel with DESCRIBE and is empty until it has been fetched.
    `full_scale_n` is the force on one taxel that brings it to its largest count. `tip_radius_mm` is 0 for
    a flat or free array.
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
    geometry: tuple[float, ...] = ()

    @property
    def max_count(self) -> int:
        """Largest value a taxel can have."""
        return (1 << self.bit_depth) - 1

    @property
    def taxels(self) -> int:
        """How many taxels there are."""
        return self.rows * self.cols

    def positions_mm(self) -> Floats:
        """Taxel centres, shape (rows, cols, 3), mm, tip frame.

        Raises DeviceError if the array is free and its geometry has not been fetched.
        """
        if self.shape is Shape.FREE:
            return self._places()[..., :3]
        columns = np.asarray(self.columns)
        flat = self.shape is Shape.FLAT
        x = columns if flat else self.tip_radius_mm * np.cos(columns)
        y = np.zeros(self.cols) if flat else self.tip_radius_mm * np.sin(columns)
        out = np.empty((self.rows, self.cols, 3))
        out[..., 0], out[..., 1] = x, y
        out[..., 2] = np.asarray(self.row_heights_mm)[:, None]
        return out

    def normals(self) -> Floats:
        """Outward unit normals of the taxels, shape (rows, cols, 3), tip frame.

        Raises DeviceError if the array is free and its geometry has not been fetched.
        """
        if self.shape is Shape.FREE:
            normals = self._places()[..., 3:]
            unit: Floats = normals / np.linalg.norm(normals, axis=-1, keepdims=True)
            return unit
        angles = np.full(self.cols, -math.pi / 2) if self.shape is Shape.FLAT else np.asarray(self.columns)
        out = np.zeros((self.rows, self.cols, 3))
        out[..., 0], out[..., 1] = np.cos(angles), np.sin(angles)
        return out

    def _places(self) -> Floats:
        if not self.geometry:
            raise DeviceError(
                f"the places of the {self.taxels} taxels of array {self.unique_id.hex()} are not known; "
                "its surface is free: fetch its geometry first, as TactileArray.connect() does"
            )
        return np.reshape(np.asarray(self.geometry), (self.rows, self.cols, REALS_PER_TAXEL))

    def problem(self) -> str | None:
        """Name the first field that cannot be used, its value and what is allowed; None if all can be."""
        return next(filter(None, self._problems()), None)

    def _problems(self) -> Iterator[str | None]:
        yield (
            None if len(self.unique_id) == 16 else f"a unique id of {len(self.unique_id)} bytes (allowed: 16)"
        )
        yield _outside("rows", self.rows, 1, 255)
        yield _outside("columns", self.cols, 1, 255)
        yield _outside(f"{self.rows} x {self.cols} taxels, together", self.taxels, 1, MAX_TAXELS)
        yield _outside("bit depth", self.bit_depth, 1, 16)
        yield _outside("maximum rate", self.max_rate_hz, *RATES_HZ, "Hz")
        yield _outside("full scale", self.full_scale_n, *FULL_SCALES_N, "N")
        yield _outside("counts per N", self.counts_per_n, *COUNTS_PER_N)
        least_mm = RADII_MM[0] if self.shape is Shape.CYLINDER else 0.0
        yield _outside("tip radius", self.tip_radius_mm, least_mm, RADII_MM[1], "mm")
        yield _outside("bytes of firmware name", len(self.firmware.encode()), 0, 255)
        yield from self._free_problems() if self.shape is Shape.FREE else self._grid_problems()

    def _grid_problems(self) -> Iterator[str | None]:
        cylinder = self.shape is Shape.CYLINDER
        farthest, nearest, unit = (
            (HALF_TURN_RAD, PITCH_RAD, "rad") if cylinder else (FARTHEST_MM, PITCH_MM, "mm")
        )
        yield _unlike("column positions", len(self.columns), self.cols)
        yield _misplaced("column", self.columns, farthest, nearest, unit)
        yield _unlike("row heights", len(self.row_heights_mm), self.rows)
        yield _misplaced("row", self.row_heights_mm, FARTHEST_MM, PITCH_MM, "mm")
        yield "a place of its own for each taxel (allowed: on a free surface)" if self.geometry else None

    def _free_problems(self) -> Iterator[str | None]:
        if self.columns or self.row_heights_mm:
            yield "column positions or row heights (allowed: on a surface that is not free)"
        if self.geometry:
            yield _unlike("reals of geometry", len(self.geometry), REALS_PER_TAXEL * self.taxels)
            yield unusable_places(self.geometry)


def unusable_places(reals: tuple[float, ...]) -> str | None:
    """Say what is wrong with places of taxels, six reals each, or None if nothing is."""
    places = np.reshape(np.asarray(reals, dtype=np.float64), (-1, REALS_PER_TAXEL))
    off = ~(np.abs(places[:, :3]) <= FARTHEST_MM)
    if off.any():
        value = places[:, :3][off][0]
        return f"a taxel's position of {value:g} mm (allowed: {-FARTHEST_MM:g} to {FARTHEST_MM:g} mm)"
    with np.errstate(over="ignore", invalid="ignore"):
        length = np.linalg.norm(places[:, 3:], axis=1)
    wrong = ~(np.abs(length - 1) <= _NORMAL_TOLERANCE)
    return (
        f"a taxel's normal of length {length[wrong][0]:.4g} (allowed: 1 within 1 %)" if wrong.any() else None
    )


def _outside(what: str, value: float, lo: float, hi: float, unit: str = "") -> str | None:
    unit = f" {unit}" if unit else ""
    return None if lo <= value <= hi else f"{what} {value:.7g}{unit} (allowed: {lo:.7g} to {hi:.7g}{unit})"


def _unlike(what: str, count: int, wanted: int) -> str | None:
    return None if count == wanted else f"{count} {what} (allowed: {wanted})"


def _misplaced(
    what: str, values: tuple[float, ...], farthest: float, nearest: float, unit: str
) -> str | None:
    """What is wrong with the positions of columns or rows; the first has number 0."""
    for number, value in enumerate(values):
        if not -farthest <= value <= farthest:
            return _outside(f"{what} {number} at", value, -farthest, farthest, unit)
    for number, (before, value) in enumerate(pairwise(values), 1):
        if not value - before >= nearest:
            return (
                f"{what} {number} at {value:.7g} {unit} after one at {before:.7g} {unit} "
                f"(allowed: ascending, {nearest:g} {unit} apart or more)"
            )
    return None
