"""What the force of a calibration's touch may do to the finger: bend what carries the tip, push its aim.

A contact at the bearing b from the direction of travel pushes the tip with N along its normal, sideways with
N sin b less what friction takes off. It slips at friction times N; where it sticks, a third is left or more,
as the skin is softer along the surface.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from palpate.base.geometry import Bools, Floats
from palpate.base.geometry.plane import wrap_angle
from palpate.calibration.measurements import TouchMeasurement
from palpate.config import ArmFingerConfig, FingerConfig

__all__ = ["TouchLoads", "touch_loads"]

_SHEAR_SHARE = 2 / 3  # of the skin's stiffnesses along and across a surface, at least


@dataclass(frozen=True, eq=False)
class TouchLoads:
    """Loads of n touches, all (n,).

    `side`: +1 for a contact to the left of the way, -1 to the right: the tip is pushed to the other side.
    `give_mm` ± `give_sigma_mm`: how far the tip has given way along the normal; all of a finger's are wrong
    alike. `sheared_rad` ± `sheared_sigma_rad`: how much nearer to the way the contact was felt than it was.
    `towards_rad`: direction of the contact, from where the finger faces. `pushes` (n, 2): whether the force
    may have pushed a joint through its play.
    """

    side: Floats
    give_mm: Floats
    give_sigma_mm: Floats
    sheared_rad: Floats
    sheared_sigma_rad: Floats
    towards_rad: Floats
    pushes: Bools


def touch_loads(touched: Sequence[TouchMeasurement], specs: Sequence[FingerConfig]) -> TouchLoads:
    """By the rig file's bounds, taken for uniform distributions; arrays' headings need not be well known."""
    by_name = {spec.name: spec for spec in specs}
    own = [by_name[item.finger] for item in touched]
    towards = np.array(
        [
            item.angle_rad + math.radians(spec.array.heading_deg)
            for item, spec in zip(touched, own, strict=True)
        ]
    )
    bearing = np.array([item.facing_rad for item in touched]) + towards
    bearing = np.where(np.abs(bearing) > math.pi, wrap_angle(bearing), bearing)
    force = np.array([item.force_n for item in touched])
    deflection = np.array([spec.bounds.deflection_mm_per_n for spec in own])
    friction = np.array([spec.tip.max_friction for spec in own])
    radius = np.array([spec.tip.radius_mm for spec in own])
    dent = force / np.array([spec.tip.stiffness_n_per_mm for spec in own])
    side, sine = np.sign(bearing), np.abs(np.sin(bearing))
    # A slide gives way across its travel; an arm, whose joints both turn, in any direction.
    arms = np.array([isinstance(spec, ArmFingerConfig) for spec in own], dtype=bool)
    give = deflection * force * np.where(arms, 1.0, sine**2)
    # Compliance from 0 to what is declared, and of the sideways push from the least that friction leaves.
    tangent = np.tan(np.minimum(np.abs(bearing), 1.5))
    least = np.maximum(1 - _SHEAR_SHARE, 1 - friction / np.maximum(tangent, 1e-9))
    least = np.where(arms, 1.0, least)
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
        towards_rad=towards,
        pushes=np.array([_may_be_pushed(spec) for spec in own]),
    )


def _may_be_pushed(spec: FingerConfig) -> tuple[bool, bool]:
    """Which joints a force may push through their play, as the rig file says."""
    if isinstance(spec, ArmFingerConfig):
        return spec.shoulder.backlash_holds_n is not None, spec.elbow.backlash_holds_n is not None
    return spec.aim.backlash_holds_n is not None, False
