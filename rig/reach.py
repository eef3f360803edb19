"""Which approaches each finger can take: from the rig's kinematics to the planner's candidates.

An approach starts with the tip waiting outside the workspace and goes along the slide's line until the tip
has crossed the workspace or the slide ends.
"""

import math
from dataclasses import dataclass

import numpy as np

from palpate.config import Finger as FingerFile
from palpate.config import RigFile
from palpate.drivers.finger import FingerKinematics
from palpate.recognizer import Approach, Candidate
from palpate.rig.convert import finger_of, kinematics_of

__all__ = ["Reach", "reach_of", "wait_distance_mm"]

_MARGIN_MM = 1.0


@dataclass(frozen=True, eq=False)
class Reach:
    """All approaches of a rig: what the planner sees, and the aim (rad) of each.

    `compatible` (n, n): candidates of different fingers go together; while they move, the closing keeps them
    apart.
    """

    candidates: tuple[Candidate, ...]
    aims_rad: tuple[float, ...]
    compatible: np.ndarray[tuple[int, ...], np.dtype[np.bool_]]

    def of_finger(self, finger_index: int) -> list[int]:
        """Indices of one finger's candidates, by ascending aim."""
        return [k for k, item in enumerate(self.candidates) if item.finger_index == finger_index]


def reach_of(rig: RigFile, *, aims: int = 41) -> Reach:
    """Candidate approaches with `aims` evenly spaced aims of each finger."""
    candidates: list[Candidate] = []
    angles: list[float] = []
    for index, spec in enumerate(rig.fingers):
        kinematics = kinematics_of(spec)
        wait = wait_distance_mm(spec, rig.workspace.radius_mm)
        lo, hi = (math.radians(value) for value in spec.aim.range_deg)
        for aim in np.linspace(lo, hi, aims):
            travel = _travel_mm(spec, kinematics, float(aim), wait, rig.workspace.radius_mm)
            if travel <= _MARGIN_MM:
                continue
            approach = Approach(
                finger_of(spec),
                kinematics.centre_mm(float(aim), wait),
                kinematics.direction_rad(float(aim)),
                travel,
                kinematics.position_bound_mm(wait + travel),
            )
            candidates.append(Candidate(index, approach))
            angles.append(float(aim))
    owner = np.array([item.finger_index for item in candidates])
    return Reach(tuple(candidates), tuple(angles), owner[:, None] != owner)


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


def _travel_mm(
    spec: FingerFile, kinematics: FingerKinematics, aim_rad: float, wait_mm: float, workspace_radius_mm: float
) -> float:
    """Travel until the tip has left the workspace on the far side, or the slide ends."""
    angle = kinematics.direction_rad(aim_rad)
    x, y = kinematics.base_mm
    middle = -(x * math.cos(angle) + y * math.sin(angle))
    miss = abs(x * math.sin(angle) - y * math.cos(angle))
    if miss >= workspace_radius_mm:
        return 0.0
    far = middle + math.sqrt(workspace_radius_mm**2 - miss**2)
    return min(far, spec.slide.range_mm[1] - _MARGIN_MM) - wait_mm
