"""Reach of the rig: every approach that each finger can take, and which of them can be combined.

An approach starts with the tip waiting outside of the workspace and goes straight on until the tip has
crossed the workspace, the finger ends, or something stands in its way: an obstacle, or the place where
another finger may wait. Paths are computed in the frame of the ring that carries the fingers; obstacles are
turned back into it. The stage turns with all fingers at home and passes all angles in between, so only the
connected range of angles round 0 counts at which every finger's home is clear.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Self

import numpy as np

from palpate.base.errors import InputError
from palpate.base.geometry import Bools, Floats, Ints
from palpate.config import ClosingConfig, RigFile
from palpate.drivers.kinematics import Line, Turn
from palpate.recognizer import FingerApproach
from palpate.rig.conversion import finger_of, tip_bound_mm
from palpate.rig.fingers import Stage, dent_allowance_mm
from palpate.rig.mechanisms import mechanism_of
from palpate.rig.mechanisms.mechanism import ApproachPath, Mechanism, StandbyPoses
from palpate.rig.mechanisms.swept_volume import (
    BodyCapsules,
    Swept,
    gap_mm,
    gaps_mm,
    longest_way_mm,
    polygon_gap_mm,
)


def _joint_sweep(paths: Sequence[ApproachPath]) -> Swept:
    """Room that several paths sweep, numbered in their order."""
    count = [len(path.since) for path in paths]
    empty = np.empty((0, 2))
    return Swept(
        BodyCapsules(
            np.concatenate([empty, *(path.capsules.start for path in paths)]),
            np.concatenate([empty, *(path.capsules.end for path in paths)]),
            np.concatenate([empty[:, 0], *(path.capsules.half_width for path in paths)]),
            np.repeat(np.arange(len(paths)), count),
        ),
        np.concatenate([empty[:, 0], *(path.since for path in paths)]),
        np.concatenate([np.empty(0, bool), *(path.grows for path in paths)]),
        np.array([_heading(path.line) for path in paths]).reshape(-1, 2),
    )


def _heading(line: Line) -> tuple[float, float]:
    return math.cos(line.direction_rad), math.sin(line.direction_rad)


_MIN_FREE_TRAVEL_MM = 1.0
_STAGE_STEP_MM = 5.0  # between the same path at two stage angles, where tips wait
_STAGE_SCAN_MM = 1.0  # of a finger's furthest point, between two stage angles that are looked at


def free_paths(rig: RigFile, aims: int, most: int) -> list[tuple[float, ApproachPath]]:
    """All free paths, each with its stage angle; without a stage all at 0. With one, about `most` of them.

    Raises InputError for a finger that has no room even where it starts.
    """
    waiting = WaitingFingers.of(rig)
    known: dict[tuple[int, float, float], list[ApproachPath]] = {}
    middle = _paths_at(waiting, 0.0, aims, known)
    return [
        (angle, path)
        for angle in _angles(waiting, most // max(len(middle), 1))
        for path in (middle if angle == 0.0 else _paths_at(waiting, angle, aims, known))
    ][: max(most, len(middle))]


@dataclass(frozen=True, eq=False)
class WaitingFingers:
    """Fingers of a rig and the places where each may wait, with what stands round them."""

    rig: RigFile
    stage: Stage
    mechanisms: tuple[Mechanism, ...]
    poses: tuple[StandbyPoses, ...]

    @classmethod
    def of(cls, rig: RigFile) -> Self:
        """Fingers of a rig file."""
        mechanisms = tuple(mechanism_of(spec) for spec in rig.fingers)
        poses = tuple(item.standby(rig.clear_radius_mm) for item in mechanisms)
        return cls(rig, Stage.of(rig), mechanisms, poses)

    def obstacles(self, angle_rad: float) -> list[Floats]:
        """Obstacles (c, 2) as they look from the ring at a stage angle."""
        back = Turn(self.stage.centre_mm, -angle_rad)
        return [
            np.array([back.point_mm((float(x), float(y))) for x, y in item.outline_mm])
            for item in self.rig.obstacles
        ]

    @cached_property
    def reach_radius_mm(self) -> float:
        """Distance from the stage's centre within which all parts of fingers are that can meet anything."""
        centre = self.stage.centre_mm
        parts = [math.dist(item.spec.base_mm, centre) + item.swing_mm for item in self.mechanisms]
        return max(*parts, self.rig.clear_radius_mm + math.hypot(*centre))

    def free_ranges(self, obstacles: Sequence[Floats], unsure_mm: float) -> list[tuple[int, int] | None]:
        """Range of each finger among obstacles whose places are `unsure_mm`, as `free_ranges` has it."""
        clearance = self.rig.closing.clearance_mm
        clear = [_clear_aims(poses, obstacles, clearance + unsure_mm) for poses in self.poses]
        return free_ranges(self.poses, clear, clearance)

    @property
    def unsure_mm(self) -> float:
        """Error of fingers' distances from obstacles, because the stage's angle and centre are off."""
        widest = max(map(abs, self.stage.range_rad))
        shifted = 2 * math.sin(min(widest, math.pi) / 2) * self.stage.centre_bound_mm
        return self.stage.planned_turn(0.0).angle_bound_rad * self.reach_radius_mm + shifted

    @property
    def stage_range_rad(self) -> tuple[float, float]:
        """The connected range of stage angles round 0 at which every finger's home is clear."""
        step = _STAGE_SCAN_MM / self.reach_radius_mm
        homes = [poses.capsules.of(poses.capsules.owner == poses.home) for poses in self.poses]
        least = self.rig.closing.clearance_mm + self.unsure_mm + _STAGE_SCAN_MM

        def clear(angle: float) -> bool:
            there = self.obstacles(angle)
            return all(
                bool((polygon_gap_mm(home, corners) >= least).all()) for home in homes for corners in there
            )

        def reached(end: float) -> float:
            angles = np.linspace(0.0, end, math.ceil(abs(end) / step) + 1)[1:].tolist()
            blocked = next((k for k, angle in enumerate(angles) if not clear(angle)), len(angles))
            return float(angles[blocked - 1]) if blocked else 0.0

        lo, hi = self.stage.range_rad
        return reached(lo), reached(hi)


def _clear_aims(poses: StandbyPoses, obstacles: Sequence[Floats], clearance_mm: float) -> Bools:
    """Aims (m,) at which a waiting finger keeps clear of polygons (c, 2)."""
    clear = np.ones(len(poses.aims_rad), dtype=bool)
    for corners in obstacles:
        far = polygon_gap_mm(poses.capsules, corners) >= clearance_mm
        np.logical_and.at(clear, poses.capsules.owner, far)
    return clear


def free_ranges(
    standby: Sequence[StandbyPoses], clear: Sequence[Bools], clearance_mm: float
) -> list[tuple[int, int] | None]:
    """First and last aim of each finger's range, by index; None where not even home is clear.

    The ranges grow from home, each by one aim in turn at either end, as long as the new aim is clear and
    apart from all places in the other fingers' ranges.
    """
    meets = {
        (i, j): _clashing_pairs(one, other, clearance_mm)
        for i, one in enumerate(standby)
        for j, other in enumerate(standby)
        if i < j
    }
    ranges: list[tuple[int, int] | None] = [None] * len(standby)
    for finger, poses in enumerate(standby):
        if _fits(finger, poses.home, clear, meets, ranges):
            ranges[finger] = (poses.home, poses.home)
    growing = [(finger, step) for finger in range(len(standby)) for step in (-1, 1)]
    while growing:
        still = []
        for finger, step in growing:
            now = ranges[finger]
            if now is None:
                continue
            aim = now[0] - 1 if step < 0 else now[1] + 1
            if _fits(finger, aim, clear, meets, ranges):
                ranges[finger] = (min(now[0], aim), max(now[1], aim))
                still.append((finger, step))
        growing = still
    return ranges


def _fits(
    finger: int,
    aim: int,
    clear: Sequence[Bools],
    meets: Mapping[tuple[int, int], Bools],
    ranges: Sequence[tuple[int, int] | None],
) -> bool:
    """True if an aim is clear, and the finger there is apart from all places in the other fingers' ranges."""
    if not 0 <= aim < len(clear[finger]) or not clear[finger][aim]:
        return False
    for other, found in enumerate(ranges):
        if other == finger or found is None:
            continue
        pair = meets[finger, other][aim] if finger < other else meets[other, finger][:, aim]
        if pair[found[0] : found[1] + 1].any():
            return False
    return True


def _clashing_pairs(one: StandbyPoses, other: StandbyPoses, clearance_mm: float) -> Bools:
    """Matrix (m, n): True where a finger at an aim of one may meet the other finger at one of its aims."""
    near = gaps_mm(one.capsules, other.capsules) < clearance_mm
    result = np.zeros((len(one.aims_rad), len(other.aims_rad)), dtype=bool)
    rows, columns = np.nonzero(near)
    result[one.capsules.owner[rows], other.capsules.owner[columns]] = True
    return result


def _angles(waiting: WaitingFingers, most: int) -> list[float]:
    """Stage angles to offer paths at, 0 and at `most` so many: evenly spaced on both sides of 0."""
    lo, hi = waiting.stage_range_rad
    wanted = math.ceil((hi - lo) * waiting.rig.clear_radius_mm / _STAGE_STEP_MM)
    count = min(max(most, 1) - 1, wanted)
    before = round(count * -lo / (hi - lo)) if hi > lo else 0
    low = np.linspace(lo, 0.0, before + 1)[:-1]
    high = np.linspace(hi, 0.0, count - before + 1)[:-1][::-1]
    return [*low.tolist(), 0.0, *high.tolist()]


def _paths_at(
    waiting: WaitingFingers,
    angle_rad: float,
    aims: int,
    known: dict[tuple[int, float, float], list[ApproachPath]],
) -> list[ApproachPath]:
    """Paths of all fingers, in the frame that carries them, with the stage at an angle.

    `known`: paths by finger and range of aims, without what stands in their way.
    """
    rig, obstacles = waiting.rig, waiting.obstacles(angle_rad)
    ranges = waiting.free_ranges(obstacles, waiting.unsure_mm)
    result: list[ApproachPath] = []
    for index, (poses, found) in enumerate(zip(waiting.poses, ranges, strict=True)):
        if found is None:
            raise InputError(
                f'rig "{rig.name}": finger "{rig.fingers[index].name}" has no room where it waits: with its '
                f"bounds it comes nearer than closing.clearance_mm = {rig.closing.clearance_mm:g} to an "
                "obstacle or to another finger"
            )
        lo, hi = float(poses.aims_rad[found[0]]), float(poses.aims_rad[found[1]])
        if (index, lo, hi) not in known:
            paths = waiting.mechanisms[index].paths(index, (lo, hi), aims, rig.clear_radius_mm)
            known[index, lo, hi] = [path for path in paths if path.travel_mm > _MIN_FREE_TRAVEL_MM]
        others = [
            _range_capsules(other, pair)
            for other, pair in zip(waiting.poses, ranges, strict=True)
            if other is not poses and pair is not None
        ]
        result += _cut_at_obstacles(waiting, known[index, lo, hi], obstacles, others)
    return result


def _range_capsules(poses: StandbyPoses, found: tuple[int, int]) -> BodyCapsules:
    """All places of a finger's range."""
    owner = poses.capsules.owner
    return poses.capsules.of((owner >= found[0]) & (owner <= found[1]))


def _cut_at_obstacles(
    waiting: WaitingFingers,
    paths: Sequence[ApproachPath],
    obstacles: Sequence[Floats],
    others: Sequence[BodyCapsules],
) -> list[ApproachPath]:
    """The paths that are left, each as far as it is free."""
    if not paths:
        return []
    clearance = waiting.rig.closing.clearance_mm
    least = clearance + waiting.unsure_mm

    def free(capsules: BodyCapsules) -> Bools:
        result = np.ones(len(capsules.owner), dtype=bool)
        for corners in obstacles:
            result &= polygon_gap_mm(capsules, corners) >= least
        for other in others:
            result &= gap_mm(capsules, other) >= clearance
        return result

    travel = longest_way_mm(_joint_sweep(paths), np.array([path.travel_mm for path in paths]), free)
    return [
        path.up_to(float(far)) for path, far in zip(paths, travel, strict=True) if far > _MIN_FREE_TRAVEL_MM
    ]


_OVERHEAD_S = 0.5  # servos settling, tare and measuring frames, in all


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
        """Part of the approaches: `rows` (indices), ascending."""
        swept = self.swept.only(rows)
        return Reach(
            tuple(self.approaches[k] for k in rows.tolist()), self.aiming_s[rows], swept, self.closing
        )

    @property
    def middle_rad(self) -> float:
        """The stage angle that is nearest to 0; all of a grip must have the same one."""
        return float(self.stage_rad[np.argmin(np.abs(self.stage_rad))])

    def together(self, one: int, travel_mm: float, others: Ints, travels_mm: Floats) -> Bools:
        """True where approach `one`, going `travel_mm` at most, never comes too near to `others` (n,).

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
        way_mm = np.asarray(travels_mm)
        there, back = way_mm / closing.approach_speed_mm_s, way_mm / closing.retract_mm_s
        again = closing.back_off_mm * (1 / closing.approach_speed_mm_s + 1 / closing.touch_speed_mm_s)
        result: Floats = self.aiming_s + there + back + again + _OVERHEAD_S
        return result

    def grip_seconds(self, grip: Sequence[FingerApproach], travels_mm: Sequence[float]) -> float:
        """Rough time of a grip of some of the approaches, or their first parts, after so much travel each."""
        rows, travels = [self._rows[line_of(item)] for item in grip], np.zeros(len(self.approaches))
        travels[rows] = travels_mm
        return float(self.seconds(travels)[rows].max())

    @cached_property
    def _rows(self) -> Mapping[tuple[float, ...], int]:
        return {line_of(item): row for row, item in enumerate(self.approaches)}

    @cached_property
    def _travels(self) -> Floats:
        return np.array([item.travel_mm for item in self.approaches])


def line_of(approach: FingerApproach) -> tuple[float, ...]:
    """Finger, stage angle and line of an approach, by which it is known however far it goes."""
    return approach.finger_index, approach.stage_rad, *approach.start_mm, approach.direction_rad


def reach_of(rig: RigFile, *, aims: int = 41, most_paths: int = 1500) -> Reach:
    """Every approach of every finger, with `aims` evenly spaced aims over each finger's free range.

    With a turning stage, also at other stage angles, up to about `most_paths` in all. Raises InputError for a
    finger that has no room even where it starts.
    """
    found = free_paths(rig, aims, most_paths)
    stage, mechanisms = Stage.of(rig), [mechanism_of(spec) for spec in rig.fingers]
    return Reach(
        tuple(
            _approach(mechanisms[path.finger_index], path, stage.planned_turn(angle), rig.closing)
            for angle, path in found
        ),
        np.array([path.aiming_s + stage.turning_s(angle) for angle, path in found]),
        _joint_sweep([path for _, path in found]),
        rig.closing,
    )


def _approach(mechanism: Mechanism, path: ApproachPath, turn: Turn, closing: ClosingConfig) -> FingerApproach:
    """The approach in W, with a bound that holds for it as it will be carried out and measured."""
    spec, kinematics = mechanism.spec, mechanism.kinematics
    bound = 0.0
    for travel in (0.0, path.travel_mm):
        servos = kinematics.servos_rad(path.line, travel)
        own = kinematics.position_bound_mm(servos)
        own += kinematics.cross_track_bound_mm(servos, mechanism.settling_rad)
        bound = max(bound, own + turn.position_bound_mm(path.line.point_mm(travel)))
    line = turn.line(path.line)
    return FingerApproach(
        finger_of(spec),
        line.start_mm,
        math.remainder(line.direction_rad, 2 * math.pi),
        path.travel_mm,
        bound + dent_allowance_mm(spec, closing) + tip_bound_mm(spec),
        path.finger_index,
        turn.angle_rad,
    )
