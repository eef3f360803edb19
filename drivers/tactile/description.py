"""What an array says of itself: size, scale and the place of every taxel. Part of `messages`.

The tip frame has z along the tip's axis, pointing up, z = 0 at the tip's lower end; angle 0 is the array's
middle, counter-clockwise seen from above.
"""

import enum
import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from palpate.errors import DeviceError

__all__ = ["MAX_TAXELS", "REALS_PER_TAXEL", "Description", "Shape", "unusable_places"]

MAX_TAXELS = 4096
REALS_PER_TAXEL = 6
_NORMAL_TOLERANCE = 0.01


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

    def positions_mm(self) -> NDArray[np.float64]:
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

    def normals(self) -> NDArray[np.float64]:
        """Outward unit normals of the taxels, shape (rows, cols, 3), tip frame.

        Raises DeviceError if the array is free and its geometry has not been fetched.
        """
        if self.shape is Shape.FREE:
            normals = self._places()[..., 3:]
            unit: NDArray[np.float64] = normals / np.linalg.norm(normals, axis=-1, keepdims=True)
            return unit
        angles = np.full(self.cols, -math.pi / 2) if self.shape is Shape.FLAT else np.asarray(self.columns)
        out = np.zeros((self.rows, self.cols, 3))
        out[..., 0], out[..., 1] = np.cos(angles), np.sin(angles)
        return out

    def _places(self) -> NDArray[np.float64]:
        if not self.geometry:
            raise DeviceError(
                f"the places of the {self.taxels} taxels of array {self.unique_id.hex()} are not known; "
                "its surface is free: fetch its geometry first, as TactileArray.connect() does"
            )
        return np.reshape(np.asarray(self.geometry), (self.rows, self.cols, REALS_PER_TAXEL))

    def problem(self) -> str | None:
        """Say what makes this description unusable, or None if nothing does."""
        checks = (
            (len(self.unique_id) == 16, "the unique id is not 16 bytes long"),
            (1 <= self.rows <= 255 and 1 <= self.cols <= 255, "rows or columns outside 1..255"),
            (self.taxels <= MAX_TAXELS, f"more than {MAX_TAXELS} taxels"),
            (1 <= self.bit_depth <= 16, "bit depth outside 1..16"),
            (self._is_finite(), "a number is not finite"),
            (self.full_scale_n > 0 and self.counts_per_n > 0, "full scale or counts per N not positive"),
            (self.max_rate_hz > 0, "rate not positive"),
            (self.shape is not Shape.CYLINDER or self.tip_radius_mm > 0, "a cylinder without a radius"),
            (len(self.firmware.encode()) <= 255, "firmware name longer than 255 bytes"),
        )
        general = next((text for good, text in checks if not good), None)
        return general or (self._free_problem() if self.shape is Shape.FREE else self._grid_problem())

    def _is_finite(self) -> bool:
        scales = (self.full_scale_n, self.counts_per_n, self.tip_radius_mm, self.max_rate_hz)
        return all(map(math.isfinite, (*self.columns, *self.row_heights_mm, *scales)))

    def _grid_problem(self) -> str | None:
        checks = (
            (len(self.columns) == self.cols, "not one position per column"),
            (len(self.row_heights_mm) == self.rows, "not one height per row"),
            (_ascending(self.columns), "column positions do not ascend"),
            (_ascending(self.row_heights_mm), "row heights do not ascend"),
            (not self.geometry, "a place of its own for each taxel, on a surface that is not free"),
        )
        return next((text for good, text in checks if not good), None)

    def _free_problem(self) -> str | None:
        if self.columns or self.row_heights_mm:
            return "columns or row heights on a free surface"
        if not self.geometry:
            return None
        if len(self.geometry) != REALS_PER_TAXEL * self.taxels:
            return "not six reals a taxel"
        return unusable_places(self.geometry)


def unusable_places(reals: tuple[float, ...]) -> str | None:
    """Say what is wrong with places of taxels, six reals each, or None if nothing is."""
    places = np.reshape(np.asarray(reals, dtype=np.float64), (-1, REALS_PER_TAXEL))
    if not np.isfinite(places).all():
        return "a taxel's place is not finite"
    length = np.linalg.norm(places[:, 3:], axis=1)
    return None if (np.abs(length - 1) <= _NORMAL_TOLERANCE).all() else "a normal that is not of length 1"


def _ascending(values: tuple[float, ...]) -> bool:
    return all(a < b for a, b in pairwise(values))
