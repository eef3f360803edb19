"""Dry friction between a tip's skin and what it touches: the skin shears as long as it sticks, then slips.

A spring along the surface at the contact, limited by friction times the force normal to it (Mindlin's ratio
of stiffnesses, 2 (1 − ν) / (2 − ν), is about 0.7 for rubber; Johnson, Contact Mechanics, ch. 7). Where a tip
touches in several places, it is one spring across the sum of their forces. All is in the frame that moves
with the part.
"""

import math
from dataclasses import dataclass

import numpy as np

from palpate.base.geometry import Floats
from palpate.drivers.emulators.tip import TipLoad

__all__ = ["Shear", "sheared"]

_STIFFNESS_SHARE = 0.7


@dataclass(frozen=True, eq=False)
class Shear:
    """Skin that is sheared by `shear_mm` along a surface, with the tip's axis at `centre_mm` (2,) then.

    `turn_rad`: how far the part was turned. `force_n` (2,) on the tip, and where it acts: `point_mm` (2,).
    `angle_rad`: how far round the tip the skin is carried from where the contact is.
    """

    shear_mm: float
    centre_mm: Floats
    turn_rad: float
    force_n: Floats
    point_mm: Floats
    angle_rad: float


def sheared(
    before: Shear | None,
    load: TipLoad,
    centre_mm: Floats,
    turn_rad: float,
    *,
    radius_mm: float,
    stiffness_n_per_mm: float,
    friction: float,
) -> Shear:
    """The skin after the tip has moved from `before` to `centre_mm`, without turning itself.

    `load`: what presses on it there; `before`: None for a tip that did not touch.
    """
    normal_n = math.hypot(*load.force_n)
    normal = load.force_n / max(normal_n, 1e-12)
    along = np.array([-normal[1], normal[0]])
    from_axis_mm = radius_mm - normal_n / stiffness_n_per_mm
    shear = 0.0
    if before is not None:
        shear = before.shear_mm + float(along @ (centre_mm - before.centre_mm))
        shear += from_axis_mm * (turn_rad - before.turn_rad)
    stiffness = _STIFFNESS_SHARE * stiffness_n_per_mm
    most = friction * normal_n / stiffness
    shear = min(max(shear, -most), most)
    return Shear(
        shear,
        centre_mm,
        turn_rad,
        -stiffness * shear * along,
        centre_mm - from_axis_mm * normal,
        -shear / radius_mm,
    )
