"""Emulated part: what stands on the table, and where tips have pushed it.

The seam between the emulated bench and the engines that move a part. The bench asks `displacement` before it
works out what tips touch, and calls `step` once in each of its steps with a function that says what tips do
to the part wherever it may be. An engine decides what motion that makes.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np

from palpate.base.geometry import Floats

__all__ = ["IN_PLACE", "Displacement", "Part", "PointForce", "StillPart", "TipForces"]


@dataclass(frozen=True, eq=False)
class Displacement:
    """Rigid displacement of a part from where it was put: x ↦ centre + R(turn) (x − centre) + shift, in W.

    `centre_mm` and `shift_mm` are (2,).
    """

    centre_mm: Floats
    shift_mm: Floats
    turn_rad: float

    @cached_property
    def is_none(self) -> bool:
        """Whether the part is exactly where it was put."""
        return self.turn_rad == 0.0 and not self.shift_mm.any()

    def place(self, point_mm: Floats) -> Floats:
        """Where a point (2,) of the part is now."""
        if self.is_none:
            return point_mm
        result: Floats = self.centre_mm + self.turned(point_mm - self.centre_mm) + self.shift_mm
        return result

    def back(self, point_mm: Floats) -> Floats:
        """Point (2,) of W in the frame that moves with the part; the same array if the part did not move."""
        if self.is_none:
            return point_mm
        x, y = point_mm - self.centre_mm - self.shift_mm
        c, s = self._cos_sin
        result: Floats = self.centre_mm + np.array([c * x + s * y, c * y - s * x])
        return result

    def turned(self, vector: Floats) -> Floats:
        """Vector (2,) that turns with the part, in W."""
        if self.is_none:
            return vector
        (x, y), (c, s) = vector, self._cos_sin
        return np.array([c * x - s * y, s * x + c * y])

    @cached_property
    def _cos_sin(self) -> tuple[float, float]:
        return math.cos(self.turn_rad), math.sin(self.turn_rad)


IN_PLACE = Displacement(np.zeros(2), np.zeros(2), 0.0)
"""The displacement of a part that was not moved."""


@dataclass(frozen=True, eq=False)
class PointForce:
    """Force (2,) N on the part in W, parallel to the table, at a point (2,) mm of W and a height above it."""

    point_mm: Floats
    height_mm: float
    force_n: Floats


TipForces = Callable[[Displacement], Sequence[PointForce]]
"""What tips, where they are now, would do to the part at a displacement."""


class Part(Protocol):
    """What stands on the table."""

    @property
    def displacement(self) -> Displacement:
        """How far it has moved; the same value as long as it stands still."""
        ...

    @property
    def at_rest(self) -> bool:
        """Whether it stays where it is as long as no tip pushes it."""
        ...

    def step(self, tip_forces: TipForces, touched: bool, dt_s: float, /) -> None:
        """Move on by `dt_s`; `touched`: some tip pushes now."""
        ...


class StillPart:
    """A part that nothing moves: clamped, or far heavier than tips can push."""

    displacement = IN_PLACE
    at_rest = True

    def step(self, _tip_forces: TipForces, _touched: bool, _dt_s: float) -> None:
        """It stays where it is."""
