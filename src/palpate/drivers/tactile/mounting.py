"""Mounting of a matrix of texels on a tip: what an array cannot report that knows its cells only.

The rig file says it; drivers of such arrays make their `Description` with it.
"""

import enum
import math
from dataclasses import dataclass

import numpy as np

from palpate.base.geometry import Counts
from palpate.drivers.tactile.messages import Description, Shape

__all__ = ["Corner", "Mounting"]


class Corner(enum.Enum):
    """Where on the tip a matrix begins, seen from outside with the tip's axis upright."""

    LOWER_LEFT = "lower-left"
    LOWER_RIGHT = "lower-right"
    UPPER_LEFT = "upper-left"
    UPPER_RIGHT = "upper-right"


@dataclass(frozen=True)
class Mounting:
    """A matrix on a tip.

    `counts_per_n`: what a force of 1 N on one taxel adds to its count. `first`: where its first texel is;
    `upright`: its rows run along the tip's axis, not across.
    """

    shape: Shape
    tip_radius_mm: float
    counts_per_n: float
    first: Corner = Corner.LOWER_LEFT
    upright: bool = False

    def to_tip(self, cells: Counts) -> Counts:
        """From the matrix as the device counts (its rows, its columns) to the tip's (rows, columns)."""
        return np.ascontiguousarray(self._flipped(cells.T if self.upright else cells))

    def to_device(self, taxels: Counts) -> Counts:
        """The other way round."""
        flipped = self._flipped(taxels)
        return np.ascontiguousarray(flipped.T if self.upright else flipped)

    def pitch(self, texel_mm: tuple[float, float]) -> tuple[float, float]:
        """Distance of columns (rad; mm on a pad) and of rows (mm), from a texel's size in x and y."""
        along, up = texel_mm[::-1] if self.upright else texel_mm
        return (along if self.shape is Shape.FLAT else along / self.tip_radius_mm), up

    def describe(
        self,
        cells: tuple[int, int],
        texel_mm: tuple[float, float],
        *,
        unique_id: bytes,
        firmware: str,
        emulated: bool,
        bit_depth: int,
        max_rate_hz: float,
    ) -> Description:
        """Description of a matrix of `cells` (x, y), texels of `texel_mm` (x, y), that sits like this.

        Raises ValueError if it cannot: no cells, or more than go round the tip.
        """
        cols, rows = cells[::-1] if self.upright else cells
        along, up = self.pitch(texel_mm)
        if self.shape is Shape.CYLINDER and cols * along > 2 * math.pi * 1.01:
            raise ValueError(
                f"{cols} columns of {along * self.tip_radius_mm:.2f} mm do not fit round a tip "
                f"of radius {self.tip_radius_mm:g} mm"
            )
        found = Description(
            unique_id=unique_id[:16].ljust(16, b"\0"),
            firmware=firmware,
            emulated=emulated,
            shape=self.shape,
            rows=rows,
            cols=cols,
            bit_depth=bit_depth,
            max_rate_hz=max_rate_hz,
            full_scale_n=((1 << bit_depth) - 1) / self.counts_per_n,
            counts_per_n=self.counts_per_n,
            tip_radius_mm=0.0 if self.shape is Shape.FLAT else self.tip_radius_mm,
            columns=tuple((k - (cols - 1) / 2) * along for k in range(cols)),
            row_heights_mm=tuple((k + 0.5) * up for k in range(rows)),
        )
        problem = found.problem()
        if problem is not None:
            raise ValueError(problem)
        return found

    def _flipped(self, taxels: Counts) -> Counts:
        rows = slice(None, None, -1 if self.first in (Corner.UPPER_LEFT, Corner.UPPER_RIGHT) else 1)
        cols = slice(None, None, -1 if self.first in (Corner.LOWER_RIGHT, Corner.UPPER_RIGHT) else 1)
        return taxels[rows, cols]
