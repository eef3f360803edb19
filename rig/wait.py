"""Where a finger waits, and what it is told to do from there. Between reach and closing."""

import math
from dataclasses import dataclass

import numpy as np

from palpate.config import Finger as FingerFile
from palpate.rig.convert import kinematics_of

__all__ = ["Close", "wait_distance_mm"]

_MARGIN_MM = 1.0


@dataclass(frozen=True)
class Close:
    """One finger's part of a grip: turn to `aim_rad`, then go until touched or until `travel_mm` is done."""

    finger_index: int
    aim_rad: float
    travel_mm: float


def wait_distance_mm(spec: FingerFile, workspace_radius_mm: float) -> float:
    """Furthest distance from the base, coming from the retracted end, with the tip clear of the workspace."""
    kinematics = kinematics_of(spec)
    lo, hi = spec.slide.range_mm
    clear = workspace_radius_mm + spec.tip.radius_mm
    aims = np.radians(np.linspace(*spec.aim.range_deg, 15))
    wait = lo + _MARGIN_MM
    for distance in np.arange(wait, hi, 1.0):
        if any(math.hypot(*kinematics.centre_mm(float(aim), float(distance))) < clear for aim in aims):
            break
        wait = float(distance)
    return wait
