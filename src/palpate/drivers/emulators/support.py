"""Support of an emulated part: the points on which it stands, what each bears, and dry friction there.

Coulomb friction at any number of points (Goyal, Ruina and Papadopoulos, Wear 143, 1991): each point resists
with friction times its load, against its own motion.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from palpate.base.geometry import Floats

__all__ = ["GRAVITY_M_S2", "Support"]

GRAVITY_M_S2 = 9.80665


@dataclass(frozen=True, eq=False)
class Support:
    """`feet_mm` (n, 2) in W as the part is put, and `share` (n,) of its weight on each."""

    feet_mm: Floats
    share: Floats
    mass_kg: float
    friction: float

    @cached_property
    def centre_mm(self) -> Floats:
        """Centre of friction (2,): where a force makes the part slide without turning."""
        result: Floats = self.share @ self.feet_mm
        return result

    @property
    def slip_n(self) -> float:
        """Force through the centre of friction at which the part slides."""
        return self.friction * self.mass_kg * GRAVITY_M_S2

    @cached_property
    def median_distance_mm(self) -> float:
        """Mean distance ρ of the load from its geometric median: the moment slip_n · ρ turns the part."""
        at = self.centre_mm
        for _ in range(200):  # Weiszfeld
            weight = self.share / np.maximum(np.hypot(*(self.feet_mm - at).T), 1e-9)
            at = weight @ self.feet_mm / weight.sum()
        return float(self.share @ np.hypot(*(self.feet_mm - at).T))
