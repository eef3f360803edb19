"""What the force of a calibration's touch may do to the finger: bend what carries the tip, push its aim.

A contact at the bearing b from the direction of travel pushes the tip with N along its normal, sideways with
N sin b less what friction takes off. It slips at friction times N; where it sticks, a third is left or more,
as the skin is softer along the surface.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from palpate.calibration.measurements import TouchMeasurement
from palpate.config import SlideFingerConfig
from palpate.geometry import Floats

__all__ = ["TouchLoads", "touch_loads"]

_SHEAR_SHARE = 2 / 3  # of the skin's stiffnesses along and across a surface, at least


@dataclass(frozen=True, eq=False)
class TouchLoads:
    """Loads of n touches, all (n,).

    `side`: +1 for a contact to the left of the way, -1 to the right: the tip is pushed to the other side.
    `give_mm` ± `give_sigma_mm`: how far the tip has given way along the normal; all of a finger's are wrong
    alike. `sheared_rad` ± `sheared_sigma_rad`: how much nearer to the way the contact was felt than it was.
    `flank`: +1 or -1 for the flank of the play that the force may have pushed the aim to, as `aim_way`
    counts, 0 if it cannot have.
    """

    side: Floats
    give_mm: Floats
    give_sigma_mm: Floats
    sheared_rad: Floats
    sheared_sigma_rad: Floats
    flank: Floats


def touch_loads(touched: Sequence[TouchMeasurement], specs: Sequence[SlideFingerConfig]) -> TouchLoads:
    """By the rig file's bounds, taken for uniform distributions; arrays' headings need not be well known."""
    by_name = {spec.name: spec for spec in specs}
    own = [by_name[item.finger] for item in touched]
    bearing = np.array(
        [
            item.angle_rad + math.radians(spec.array.heading_deg)
            for item, spec in zip(touched, own, strict=True)
        ]
    )
    force = np.array([item.force_n for item in touched])
    deflection = np.array([spec.bounds.deflection_mm_per_n for spec in own])
    friction = np.array([spec.tip.max_friction for spec in own])
    radius = np.array([spec.tip.radius_mm for spec in own])
    dent = force / np.array([spec.tip.stiffness_n_per_mm for spec in own])
    pushes = np.array([spec.aim.backlash_holds_n is not None for spec in own])
    side, sine = np.sign(bearing), np.abs(np.sin(bearing))
    give = deflection * force * sine**2
    # Compliance from 0 to what is declared, and of the sideways push from the least that friction leaves.
    tangent = np.tan(np.minimum(np.abs(bearing), 1.5))
    least = np.maximum(1 - _SHEAR_SHARE, 1 - friction / np.maximum(tangent, 1e-9))
    mean = (1 + least) / 4
    sigma = np.sqrt((1 + least + least**2) / 9 - mean**2)
    # It slips at friction times the force; skin is sheared no further than the tip has gone along the face.
    sheared = np.minimum(friction / _SHEAR_SHARE, tangent) * dent / radius
    return TouchLoads(
        side=side,
        give_mm=give * mean,
        give_sigma_mm=give * sigma,
        sheared_rad=sheared / 2,
        sheared_sigma_rad=sheared / math.sqrt(12),
        flank=np.where(pushes, side, 0.0),
    )
