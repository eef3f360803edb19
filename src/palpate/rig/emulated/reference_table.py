"""Who puts references on an emulated table: near where asked, never exactly, and tells nobody where.

The counterpart of a person with a disc in the hand. Used by the composition root and tests only.
"""

import math

import numpy as np

from palpate.calibration.reference import Reference, ReferenceDisc, ReferencePlate
from palpate.drivers.emulators.bench import Bench
from palpate.drivers.emulators.tip import PartSection

__all__ = ["EmulatedTable", "outline_of"]

_OFF_MM = 8.0
_FACETS = 180  # a rim that is 0.002 mm off
_TOP_MM = 40.0


class EmulatedTable:
    """Puts references within 8 mm of where they should be, turned as it happens to be."""

    def __init__(self, bench: Bench, seed: int) -> None:
        self._bench = bench
        self._rng = np.random.default_rng([seed, 5])

    def put(self, reference: Reference, about_mm: tuple[float, float]) -> None:
        """Put it there, alone."""
        x, y = np.asarray(about_mm) + self._rng.uniform(-_OFF_MM, _OFF_MM, 2) / math.sqrt(2)
        self._lay(outline_of(reference, float(x), float(y), float(self._rng.uniform(-math.pi, math.pi))))

    def clear(self) -> None:
        """Take it away."""
        self._lay(None)

    def _lay(self, outline: PartSection | None) -> None:
        self._bench.put(lambda *_: outline)


def outline_of(reference: Reference, x_mm: float, y_mm: float, theta_rad: float) -> PartSection:
    """Edges of a reference in W; a disc's facets lie half within it, half outside."""
    if isinstance(reference, ReferenceDisc):
        angles = np.arange(_FACETS) * 2 * math.pi / _FACETS
        radius = reference.radius_mm * (1 + (math.pi / _FACETS) ** 2 / 3)
        corners = radius * np.column_stack([np.cos(angles), np.sin(angles)])
    elif isinstance(reference, ReferencePlate):
        corners = reference.corners_mm
    else:
        raise TypeError(f"{reference.name} cannot be emulated")
    c, s = math.cos(theta_rad), math.sin(theta_rad)
    start = corners @ np.array([[c, s], [-s, c]]) + [x_mm, y_mm]
    return PartSection(start, np.roll(start, -1, axis=0), _TOP_MM)
