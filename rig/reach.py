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
from palpate.recognizer.arrays import Bools, Floats, Ints
from palpate.recognizer.segments import distance_range
from palpate.rig.convert import finger_of, kinematics_of
from palpate.rig.wait import Close, wait_distance_mm

__all__ = ["Reach", "reach_of"]

_MARGIN_MM = 1.0


@dataclass(frozen=True, eq=False)
class Reach:
    """All approaches of a rig: what the planner sees, and the aim (rad) of each.

    `compatible` (n, n): candidates of different fingers go together; while they move, the closing keeps them
    apart.
    """

    candidates: tuple[Candidate, ...]
    aims_rad: tuple[float, ...]
    bases: Floats
    speed_mm_s: float
    gap_mm: float

    def together(self, one: int, travel_mm: float, others: Ints, travels_mm: Floats) -> Bools:
        """Whether two fingers keep apart, however far they come on their ways."""
        if not len(others):
            return np.ones(0, dtype=bool)
        owner = np.array([item.finger_index for item in self.candidates])
        ends = self._ends(others, travels_mm)
        own = np.repeat(self._ends(np.array([one]), np.array([travel_mm])), len(others), axis=0)
        base = np.repeat(self.bases[[one]], len(others), axis=0)
        apart, _ = distance_range(base, own, self.bases[others], ends)
        result: Bools = (apart > self.gap_mm) & (owner[others] != owner[one])
        return result

    def seconds(self, travels_mm: Floats) -> Floats:
        """Rough time of each candidate."""
        result: Floats = 5.0 + 2 * travels_mm / self.speed_mm_s
        return result

    def close(self, index: int, travel_mm: float) -> Close:
        """What closing carries out."""
        return Close(self.candidates[index].finger_index, self.aims_rad[index], travel_mm)

    def _ends(self, rows: Ints, travels_mm: Floats) -> Floats:
        start = np.array([self.candidates[k].approach.start_mm for k in rows.tolist()])
        angle = np.array([self.candidates[k].approach.direction_rad for k in rows.tolist()])
        result: Floats = start + travels_mm[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
        return result

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
                kinematics.position_bound_mm(wait + travel) + 0.45,
            )
            candidates.append(Candidate(index, approach))
            angles.append(float(aim))
    bases = np.array([rig.fingers[item.finger_index].base_mm for item in candidates])
    gap = 2 * max(f.tip.radius_mm for f in rig.fingers) + rig.closing.clearance_mm
    return Reach(tuple(candidates), tuple(angles), bases, rig.closing.approach_speed_mm_s, gap)


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
