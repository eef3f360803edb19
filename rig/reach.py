"""The reach of the rig: every approach that each finger can take, and which of them go together.

From the rig file to the planner's candidates. An approach starts with the tip waiting outside of the
workspace and goes straight on until the tip has crossed the workspace, the finger ends, or something stands
in its way: an obstacle, or the place where another finger may wait.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from palpate.config import Closing, RigFile
from palpate.drivers.finger import Line
from palpate.errors import InputError
from palpate.recognizer import Approach, Candidate
from palpate.recognizer.arrays import Bools, Floats, Ints
from palpate.rig.convert import dent_allowance_mm, finger_of, kinematics_of
from palpate.rig.drives import AIM_TOLERANCE_RAD, STREAM_TOLERANCE_RAD
from palpate.rig.room import Pieces, Swept, gap_mm, longest_way_mm, polygon_gap_mm
from palpate.rig.waiting import Waiting, clear_aims, free_ranges, waiting_of
from palpate.rig.ways import Way, joined, ways_of

__all__ = ["Close", "Reach", "reach_of"]

_MARGIN_MM = 1.0
_SETTLE_S = 0.5  # servos settling, tare and measuring frames, in all


@dataclass(frozen=True)
class Close:
    """One finger's part of a grip: from `start_mm` along `direction_rad` in W, until it touches something.

    It goes `travel_mm` at most, with the turning stage at `stage_rad`.
    """

    finger_index: int
    start_mm: tuple[float, float]
    direction_rad: float
    travel_mm: float
    stage_rad: float = 0.0

    @property
    def line(self) -> Line:
        """The way in W."""
        return Line(self.start_mm, self.direction_rad)


@dataclass(frozen=True, eq=False)
class Reach:
    """All approaches of a rig: what the planner sees, and how each is carried out.

    `finger` (n,) and `stage_rad` (n,): whose each is, and the stage's angle. `aiming_s` (n,): rough time of
    turning to it. `swept`: what they sweep, with every finger's bounds. `closing`: the rig file's.
    """

    candidates: tuple[Candidate, ...]
    finger: Ints
    stage_rad: Floats
    aiming_s: Floats
    swept: Swept
    closing: Closing

    def of_finger(self, finger_index: int) -> list[int]:
        """Indices of one finger's candidates, by stage angle and ascending aim."""
        return np.flatnonzero(self.finger == finger_index).tolist()

    def close(self, index: int, travel_mm: float) -> Close:
        """What `close_fingers` carries out: candidate `index`, for `travel_mm` at most."""
        item = self.candidates[index]
        way = min(travel_mm, item.approach.travel_mm)
        return Close(
            item.finger_index,
            item.approach.start_mm,
            item.approach.direction_rad,
            way,
            float(self.stage_rad[index]),
        )

    @property
    def compatible(self) -> Bools:
        """Whether two candidates (n, n) are of different fingers at one stage angle.

        Such fingers may still meet if both go all the way (`together`); the closing then stops one of them.
        """
        apart: Bools = self.finger[:, None] != self.finger
        result: Bools = apart & (self.stage_rad[:, None] == self.stage_rad)
        return result

    def together(self, one: int, travel_mm: float, others: Ints, travels_mm: Floats) -> Bools:
        """Whether candidate `one`, going `travel_mm` at most, and each of `others` (n,) never come too near.

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
        """Rough time (n,) that each candidate takes for a travel (n,): aim, close, touch twice, go back."""
        closing = self.closing
        there = np.asarray(travels_mm) / closing.approach_speed_mm_s
        again = closing.back_off_mm * (1 / closing.approach_speed_mm_s + 1 / closing.touch_speed_mm_s)
        result: Floats = self.aiming_s + 2 * there + again + _SETTLE_S
        return result

    @property
    def _travels(self) -> Floats:
        return np.array([item.approach.travel_mm for item in self.candidates])


def reach_of(rig: RigFile, *, aims: int = 41) -> Reach:
    """Every approach of every finger, with `aims` evenly spaced aims over each finger's free range.

    Raises InputError for a finger that has no room even where it starts.
    """
    obstacles = [np.array(item.outline_mm) for item in rig.obstacles]
    waitings = [waiting_of(spec, rig.workspace.radius_mm) for spec in rig.fingers]
    ways = _ways_at(rig, waitings, obstacles, aims)
    candidates = [Candidate(way.finger_index, _approach(rig, way)) for way in ways]
    return Reach(
        tuple(candidates),
        np.array([way.finger_index for way in ways], dtype=np.int64),
        np.zeros(len(ways)),
        np.array([way.aiming_s for way in ways]),
        joined(ways),
        rig.closing,
    )


def _ways_at(rig: RigFile, waitings: Sequence[Waiting], obstacles: Sequence[Floats], aims: int) -> list[Way]:
    """What all fingers can do, in the frame that carries them, among obstacles that stand there."""
    clearance = rig.closing.clearance_mm
    ranges = free_ranges(waitings, [clear_aims(w, obstacles, clearance) for w in waitings], clearance)
    for spec, found in zip(rig.fingers, ranges, strict=True):
        if found is None:
            raise InputError(
                f'rig "{rig.name}": finger "{spec.name}" has no room where it waits: with its bounds it '
                f"comes nearer than closing.clearance_mm = {clearance:g} to an obstacle or to another finger"
            )
    result: list[Way] = []
    for index, (waiting, found) in enumerate(zip(waitings, ranges, strict=True)):
        if found is None:
            continue
        lo, hi = waiting.aims_rad[found[0]], waiting.aims_rad[found[1]]
        ways = ways_of(rig, index, float(lo), float(hi), aims)
        others = [_range(*pair) for pair in zip(waitings, ranges, strict=True) if pair[0] is not waiting]
        result += _unblocked(ways, obstacles, [item for item in others if item is not None], clearance)
    return result


def _range(waiting: Waiting, found: tuple[int, int] | None) -> Pieces | None:
    """All places of a finger's range; None for one that has none."""
    if found is None:
        return None
    owner = waiting.pieces.owner
    return waiting.pieces.of((owner >= found[0]) & (owner <= found[1]))


def _unblocked(
    ways: Sequence[Way], obstacles: Sequence[Floats], others: Sequence[Pieces], clearance_mm: float
) -> list[Way]:
    """The ways that are left, each as far as it is free."""
    if not ways:
        return []

    def free(pieces: Pieces) -> Bools:
        result = np.ones(len(pieces.owner), dtype=bool)
        for corners in obstacles:
            result &= polygon_gap_mm(pieces, corners) >= clearance_mm
        for other in others:
            result &= gap_mm(pieces, other) >= clearance_mm
        return result

    travel = longest_way_mm(joined(ways), np.array([way.travel_mm for way in ways]), free)
    return [way.up_to(float(far)) for way, far in zip(ways, travel, strict=True) if far > _MARGIN_MM]


def _approach(rig: RigFile, way: Way) -> Approach:
    """The way for the planner, with a bound that holds for it as it will be carried out and measured."""
    spec = rig.fingers[way.finger_index]
    kinematics = kinematics_of(spec)
    ends = [kinematics.servos_rad(way.line, travel) for travel in (0.0, way.travel_mm)]
    off = STREAM_TOLERANCE_RAD if spec.type == "two-link" else AIM_TOLERANCE_RAD
    bound = max(kinematics.position_bound_mm(servos) + kinematics.strayed_mm(servos, off) for servos in ends)
    return Approach(
        finger_of(spec),
        way.line.start_mm,
        math.remainder(way.line.direction_rad, 2 * math.pi),
        way.travel_mm,
        bound + dent_allowance_mm(spec, rig.closing),
    )
