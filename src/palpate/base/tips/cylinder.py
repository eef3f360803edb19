"""Cylinder: an upright round tip; with length 0 mm, a disc."""

from typing import ClassVar

from palpate.base.tips.tip import Refusals, Tip


class Cylinder(Tip):
    """An upright cylinder, which meets the sections of a part all along it by its own radius."""

    shape = "cylinder"
    cannot: ClassVar[Refusals] = {}
    lacks: ClassVar = {
        "width_mm": 'is for shape = "pad"; a cylinder has radius_mm',
        "max_latitude_deg": "is for balls; others touch at their own radius or width",
        "array.pitch_mm": 'is for tip.shape = "pad"; the tip is a cylinder',
    }

    def radius_at_mm(self, radius_mm: float, away_mm: float) -> float:  # noqa: ARG002
        """Radius, the same at all heights."""
        return radius_mm
