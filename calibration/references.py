"""Names of references and where they are to lie. Between the references file and the steps of calibration."""

import math

from palpate.calibration.finger_fit import ReferencePlacement
from palpate.calibration.reference import Reference

__all__ = ["placings_for"]

_AWAY = 0.4  # of the workspace's radius


def placings_for(disc: Reference, plate: Reference, radius_mm: float) -> list[ReferencePlacement]:
    """Where references are to lie: the disc on three sides of the middle, then the plate between these."""
    away = min(_AWAY * radius_mm, radius_mm - max(disc.radius_mm, plate.radius_mm) - 10.0)
    found = []
    for reference, first in ((disc, math.pi / 2), (plate, -math.pi / 2)):
        for k in range(3):
            angle = first + 2 * math.pi / 3 * k
            found.append(ReferencePlacement(reference, (away * math.cos(angle), away * math.sin(angle))))
    return found
