"""The reach of the rig: every approach that each finger can take, and which of them go together.

An approach starts with the tip waiting outside of the
workspace and goes straight on until the tip has crossed the workspace, the finger ends, or something stands
in its way: an obstacle, or the place where another finger may wait.
"""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from palpate.base.geometry import Bools, Floats, Ints
from palpate.config import ClosingConfig, RigFile
from palpate.drivers.finger import FingerKinematics
from palpate.recognizer import FingerApproach
from palpate.rig.conversion import dent_allowance_mm, finger_of, kinematics_of, tip_bound_mm
from palpate.rig.drives import AIM_TOLERANCE_RAD, STREAM_TOLERANCE_RAD
from palpate.rig.reach.approach_paths import ApproachPath, joint_sweep
from palpate.rig.reach.free_space import free_paths
from palpate.rig.reach.swept_volume import Swept, gap_mm
from palpate.rig.turning_stage import STAGE_SPEED_RAD_S, planned_turn

__all__ = ["Reach", "reach_of"]

_SETTLE_S = 0.5  # servos settling, tare and measuring frames, in all


@dataclass(frozen=True, eq=False)
class Reach:
    """All approaches (n) of a rig, and which of them go together.

    `aiming_s` (n,): rough time of turning to each. `swept`: what they sweep in the ring's frame, with every
    finger's bounds. `closing`: the rig file's.
    """

    approaches: tuple[FingerApproach, ...]
    aiming_s: Floats
    swept: Swept
    closing: ClosingConfig

    @cached_property
    def finger(self) -> Ints:
        """Index of each approach's finger (n,)."""
        return np.array([item.finger_index for item in self.approaches], dtype=np.int64)

    @cached_property
    def stage_rad(self) -> Floats:
        """Angle of the stage (n,) for each approach."""
        return np.array([item.stage_rad for item in self.approaches])

    def of_finger(self, finger_index: int, stage_rad: float | None = None) -> list[int]:
        """Indices of one finger's approaches, by stage angle (one, if given) and ascending aim."""
        wanted = self.finger == finger_index
        if stage_rad is not None:
            wanted &= self.stage_rad == stage_rad
        return np.flatnonzero(wanted).tolist()

    def of_stage(self, stage_rad: float) -> list[int]:
        """Indices of all approaches at one stage angle."""
        return np.flatnonzero(self.stage_rad == stage_rad).tolist()

    def only(self, rows: Ints) -> "Reach":
        """Some of the approaches: `rows` (indices), ascending."""
        swept = self.swept.only(rows)
        return Reach(
            tuple(self.approaches[k] for k in rows.tolist()), self.aiming_s[rows], swept, self.closing
        )

    @property
    def middle_rad(self) -> float:
        """The stage angle that is nearest to 0; all of a grip must have the same one."""
        return float(self.stage_rad[np.argmin(np.abs(self.stage_rad))])

    def together(self, one: int, travel_mm: float, others: Ints, travels_mm: Floats) -> Bools:
        """Whether approach `one`, going `travel_mm` at most, and each of `others` (n,) never come too near.

        `travels_mm` (n,): how far the others go at most. False for the same finger and for another stage
        angle. What fingers sweep up to their ends is compared, so their timing does not matter.
        """
        others = np.asarray(others, dtype=np.int64)
        apart: Bools = self.finger[others] != self.finger[one]
        result: Bools = apart & (self.stage_rad[others] == self.stage_rad[one])
        theirs = self.swept.at(others, np.minimum(travels_mm, self._travels[others]))
        alone = np.array([one])
        mine = self.swept.at(alone, np.minimum(travel_mm, self._travels[alone]))
        asked = result[theirs.owner]
        near = gap_mm(theirs.of(asked), mine) < self.closing.clearance_mm
        result[theirs.owner[asked][near]] = False
        return result

    def seconds(self, travels_mm: Floats) -> Floats:
        """Rough time (n,) that each approach takes for a travel (n,): aim, close, touch twice, go back."""
        closing = self.closing
        there = np.asarray(travels_mm) / closing.approach_speed_mm_s
        again = closing.back_off_mm * (1 / closing.approach_speed_mm_s + 1 / closing.touch_speed_mm_s)
        result: Floats = self.aiming_s + 2 * there + again + _SETTLE_S
        return result

    @cached_property
    def _travels(self) -> Floats:
        return np.array([item.travel_mm for item in self.approaches])


def reach_of(rig: RigFile, *, aims: int = 41) -> Reach:
    """Every approach of every finger, with `aims` evenly spaced aims over each finger's free range.

    With a turning stage, also at other stage angles. Raises InputError for a finger that has no room even
    where it starts.
    """
    found = free_paths(rig, aims)
    kinds = [kinematics_of(spec) for spec in rig.fingers]
    return Reach(
        tuple(_approach(rig, kinds[path.finger_index], path, angle) for angle, path in found),
        np.array([path.aiming_s + _turning_s(rig, angle) for angle, path in found]),
        joint_sweep([path for _, path in found]),
        rig.closing,
    )


def _turning_s(rig: RigFile, angle_rad: float) -> float:
    """Rough time to turn the stage from 0."""
    return 0.0 if rig.stage is None else abs(rig.stage.gear_ratio * angle_rad) / STAGE_SPEED_RAD_S


def _approach(
    rig: RigFile, kinematics: FingerKinematics, path: ApproachPath, stage_rad: float
) -> FingerApproach:
    """The approach in W, with a bound that holds for it as it will be carried out and measured."""
    spec = rig.fingers[path.finger_index]
    turn = planned_turn(rig.stage, stage_rad)
    off = STREAM_TOLERANCE_RAD if spec.type == "two-link" else AIM_TOLERANCE_RAD
    bound = 0.0
    for travel in (0.0, path.travel_mm):
        servos = kinematics.servos_rad(path.line, travel)
        own = kinematics.position_bound_mm(servos) + kinematics.cross_track_bound_mm(servos, off)
        bound = max(bound, own + turn.position_bound_mm(path.line.point_mm(travel)))
    line = turn.line(path.line)
    return FingerApproach(
        finger_of(spec),
        line.start_mm,
        math.remainder(line.direction_rad, 2 * math.pi),
        path.travel_mm,
        bound + dent_allowance_mm(spec, rig.closing) + tip_bound_mm(spec),
        path.finger_index,
        stage_rad,
    )
