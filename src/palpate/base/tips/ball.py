"""Ball: a tip that meets each section with the circle at its height (docs/recogniser.md, "A ball")."""

import math
from typing import ClassVar

from palpate.base.tips.tip import Refusals, Tip


class Ball(Tip):
    """A ball with its equator at the finger's height, which touches parts within 60° of it."""

    shape = noun = "ball"
    is_upright = False
    least_share = 0.5  # the cosine of 60°
    half_height_key = "radius_mm"
    max_bound_share = 0.1  # beside its equator errors of the radius count more
    lacks: ClassVar = {
        "width_mm": 'is for shape = "pad"; a ball has radius_mm',
        "length_mm": "is for cylinders; a ball has a radius only",
        "array.pitch_mm": 'is for tip.shape = "pad"; the tip is a ball',
    }
    cannot: ClassVar[Refusals] = {
        "calibrate taxels": "gains of an array on a ball are not measured by presses, as its rows do "
        "not bear even shares; give them in the rig file, and do without a calibration",
        "simulate": "simulated touches are those of cylinders; run palpate identify with seeds on an "
        "emulated rig instead",
        "check what parts hold": "it may push parts down or up as well as aside, so that what they hold is "
        "not known; measure it with cylinders, or with a spring balance",
    }

    def half_height_mm(self, radius_mm: float, half_length_mm: float) -> float:  # noqa: ARG002
        """Radius."""
        return radius_mm

    def radius_at_mm(self, radius_mm: float, away_mm: float) -> float:
        """Radius of the circle of latitude; 0 above the ball and below."""
        return math.sqrt(max(radius_mm**2 - away_mm**2, 0.0))
