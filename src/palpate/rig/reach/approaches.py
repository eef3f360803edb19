"""Reach of the rig: every approach that each finger can take, and which of them go together.

An approach starts with the tip waiting outside of the workspace and goes straight on until the tip has
crossed the workspace, the finger ends, or something stands in its way: an obstacle, or the place where
another finger may wait. Paths are computed in the frame of the ring that carries the fingers; obstacles are
turned back into it. The stage turns with all fingers at home and passes all angles in between, so only the
connected range of angles round 0 counts at which every finger's home is clear.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from palpate.base.errors import InputError
from palpate.base.geometry import Bools, Floats, Ints
from palpate.config import ArmFingerConfig, ClosingConfig, RigFile, SlideFingerConfig
from palpate.drivers.kinematics import FingerBody, FingerKinematics, Line, Turn
from palpate.drivers.slide_kinematics import SlideKinematics
from palpate.recognizer import FingerApproach
from palpate.rig.conversion import (
    arm_kinematics,
    array_bound_rad,
    dent_allowance_mm,
    finger_of,
    kinematics_of,
    slide_kinematics,
    tip_bound_mm,
)
from palpate.rig.drives import (
    AIM_SPEED_RAD_S,
    AIM_TOLERANCE_RAD,
    ARM_AIM_SPEED_MM_S,
    STREAM_TOLERANCE_RAD,
    is_steady,
    point_on_circle,
    wait_distance_mm,
    wait_radius_mm,
)
from palpate.rig.fingers import STAGE_SPEED_RAD_S, planned_turn
from palpate.rig.reach.standby_poses import StandbyPoses, body_of, clear_aims, free_ranges, standby_poses_of
from palpate.rig.reach.swept_volume import (
    BodyCapsules,
    Swept,
    capsules_of,
    gap_mm,
    longest_way_mm,
    polygon_gap_mm,
)

_AIM_END_MARGIN_RAD = 1e-7
_PATH_END_MARGIN_MM = 1.0
_ARM_SAMPLE_MM = 8.0  # of an arm's path, between two postures
_MAX_OBLIQUITY_DEG = 42.0  # of an arm's path, from straight inward


@dataclass(frozen=True, eq=False)
class ApproachPath:
    """Straight path of finger `finger_index` along `line` in the ring's frame, at most `travel_mm`.

    `aiming_s`: rough time of turning to its start. `capsules` are what it sweeps, counted from travels
    `since` (s,) on; those that `grow` (s,) have ends that move along the line.
    """

    finger_index: int
    line: Line
    travel_mm: float
    aiming_s: float
    capsules: BodyCapsules
    since: Floats
    grows: np.ndarray[tuple[int, ...], np.dtype[np.bool_]]

    def up_to(self, travel_mm: float) -> "ApproachPath":
        """The same path, not as far."""
        return replace(self, travel_mm=travel_mm)


def joint_sweep(paths: Sequence[ApproachPath]) -> Swept:
    """What several paths sweep, numbered in their order."""
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


def paths_of(rig: RigFile, finger_index: int, lo_rad: float, hi_rad: float, count: int) -> list[ApproachPath]:
    """Ways of a finger from aims between two: `count` of a slide, about five times as many of an arm."""
    spec = rig.fingers[finger_index]
    radius = rig.clear_radius_mm
    if isinstance(spec, ArmFingerConfig):
        aims = np.linspace(lo_rad, hi_rad, count // 3 + 1) if hi_rad > lo_rad else np.array([lo_rad])
        turns = np.radians(np.linspace(-_MAX_OBLIQUITY_DEG, _MAX_OBLIQUITY_DEG, 2 * (count // 6) + 1))
        paths = [_arm_path(spec, finger_index, aim, turn, radius) for aim in aims for turn in turns]
    else:
        # An aim at the very end of its servo's range may be beyond it once it has been a line in between.
        inner = min(_AIM_END_MARGIN_RAD, (hi_rad - lo_rad) / 2)
        aims = np.unique(np.linspace(lo_rad + inner, hi_rad - inner, count))
        wait = wait_distance_mm(spec, radius)
        kinematics = slide_kinematics(spec)
        paths = [_slide_path(spec, kinematics, finger_index, float(aim), wait, radius) for aim in aims]
    return [path for path in paths if path is not None and path.travel_mm > _PATH_END_MARGIN_MM]


def crossing_mm(line: Line, radius_mm: float) -> float:
    """Travel at which a line leaves the circle round the origin; 0 if it misses it."""
    middle = line.travel_mm((0.0, 0.0))
    miss = math.hypot(*line.point_mm(middle))
    return 0.0 if miss >= radius_mm else middle + math.sqrt(radius_mm**2 - miss**2)


def _slide_path(
    spec: SlideFingerConfig,
    kinematics: SlideKinematics,
    finger_index: int,
    aim_rad: float,
    wait_mm: float,
    workspace_radius_mm: float,
) -> ApproachPath:
    """Until the tip has left the workspace on the far side, or the slide ends."""
    line = kinematics.line(aim_rad, wait_mm)
    room = spec.slide.range_mm[1] - _PATH_END_MARGIN_MM - wait_mm
    travel = min(crossing_mm(line, workspace_radius_mm), room)
    # What bounds the tip's place is largest at one of the ends.
    far = body_of(kinematics, kinematics.servos_rad(line, max(travel, 0.0)), spec)
    here = body_of(kinematics, kinematics.servos_rad(line, 0.0), spec)
    one = np.zeros(1)
    return ApproachPath(
        finger_index,
        line,
        travel,
        abs(kinematics.gear_ratio * aim_rad) / AIM_SPEED_RAD_S,
        BodyCapsules(
            here.start, here.end, np.maximum(here.half_width, far.half_width), np.zeros(1, np.int64)
        ),
        one - 1.0,
        np.ones(1, bool),
    )


def _arm_path(
    spec: ArmFingerConfig, finger_index: int, aim_rad: float, turn_rad: float, workspace_radius_mm: float
) -> ApproachPath | None:
    """From a place on the circle, at a turn from straight inward: as far as joints and array allow.

    None where not even the start is within reach. All of the path the arm is off its singular postures, and
    the array sees everything that the tip may touch: a quarter turn either way of the direction of travel.
    """
    kinematics = arm_kinematics(spec)
    start = point_on_circle(wait_radius_mm(spec, workspace_radius_mm), aim_rad)
    line = Line(start, aim_rad + math.pi + turn_rad)
    view = math.radians(spec.array.coverage_deg / 2) - math.pi / 2 - array_bound_rad(spec)
    middle = math.radians(spec.array.heading_deg)

    def good(travel_mm: float) -> bool:
        if not is_steady(kinematics, line.point_mm(travel_mm)):
            return False
        seen = kinematics.facing_rad(kinematics.servos_rad(line, travel_mm)) + middle
        return abs(math.remainder(line.direction_rad - seen, 2 * math.pi)) <= view

    most = crossing_mm(line, workspace_radius_mm)
    travels = np.append(np.arange(0.0, most, _ARM_SAMPLE_MM), most)
    usable = [bool(good(float(travel))) for travel in travels]
    if not all(usable):
        travels = travels[: usable.index(False)]
    if len(travels) < 2:
        return None
    bodies = [body_of(kinematics, kinematics.servos_rad(line, float(travel)), spec) for travel in travels]
    links = [FingerBody(body.start[:2], body.end[:2], body.half_width[:2]) for body in bodies]
    swept = capsules_of(links, between=True)
    tip = max(float(body.half_width[2]) for body in bodies)
    since = np.concatenate([[-1.0], travels[:-1]])
    home = math.atan2(spec.base_mm[1], spec.base_mm[0])
    return ApproachPath(
        finger_index,
        line,
        float(travels[-1]),
        abs(math.remainder(aim_rad - home, 2 * math.pi)) * math.hypot(*start) / ARM_AIM_SPEED_MM_S,
        BodyCapsules(
            np.vstack([swept.start, [start]]),
            np.vstack([swept.end, [start]]),
            np.append(swept.half_width, tip),
            np.zeros(len(swept.owner) + 1, np.int64),
        ),
        np.append(np.repeat(since, 2), -1.0),
        np.append(np.zeros(len(swept.owner), bool), True),
    )


def _heading(line: Line) -> tuple[float, float]:
    return math.cos(line.direction_rad), math.sin(line.direction_rad)


_MIN_FREE_TRAVEL_MM = 1.0
_MAX_PATHS = 1500  # candidates in all
_STAGE_STEP_MM = 5.0  # between the same path at two stage angles, where tips wait
_STAGE_SCAN_MM = 1.0  # of a finger's furthest point, between two stage angles that are looked at


def free_paths(rig: RigFile, aims: int) -> list[tuple[float, ApproachPath]]:
    """All free paths, each with its stage angle; without a stage all at 0.

    Raises InputError for a finger that has no room even where it starts.
    """
    standby = [standby_poses_of(spec, rig.clear_radius_mm) for spec in rig.fingers]
    obstacles = [np.array(item.outline_mm) for item in rig.obstacles]
    known: dict[tuple[int, float, float], list[ApproachPath]] = {}

    def paths_at(angle: float) -> list[ApproachPath]:
        return _paths_at(rig, standby, _obstacles_in_ring(rig, obstacles, angle), aims, known)

    middle = paths_at(0.0)
    if rig.stage is None:
        return [(0.0, path) for path in middle]
    return [
        (angle, path)
        for angle in _angles(rig, standby, obstacles, len(middle))
        for path in (middle if angle == 0.0 else paths_at(angle))
    ][:_MAX_PATHS]


def stage_range_rad(rig: RigFile) -> tuple[float, float]:
    """Angles between which a rig's stage may turn, with every finger at its home."""
    standby = [standby_poses_of(spec, rig.clear_radius_mm) for spec in rig.fingers]
    return _stage_range(rig, standby, [np.array(item.outline_mm) for item in rig.obstacles])


def _angles(
    rig: RigFile, standby: Sequence[StandbyPoses], obstacles: Sequence[Floats], each: int
) -> list[float]:
    """Stage angles to offer paths at, with `each` paths at one of them: evenly spaced on both sides of 0."""
    assert rig.stage is not None
    lo, hi = _stage_range(rig, standby, obstacles)
    room = max(_MAX_PATHS // max(each, 1), 1) - 1
    wanted = math.ceil((hi - lo) * rig.clear_radius_mm / _STAGE_STEP_MM)
    count = min(room, wanted)
    before = round(count * -lo / (hi - lo)) if hi > lo else 0
    low = np.linspace(lo, 0.0, before + 1)[:-1]
    high = np.linspace(hi, 0.0, count - before + 1)[:-1][::-1]
    return [*low.tolist(), 0.0, *high.tolist()]


def _stage_range(
    rig: RigFile, standby: Sequence[StandbyPoses], obstacles: Sequence[Floats]
) -> tuple[float, float]:
    """The connected range of stage angles round 0 at which every finger's home is clear."""
    assert rig.stage is not None
    lo, hi = (math.radians(angle) for angle in rig.stage.range_deg)
    step = _STAGE_SCAN_MM / reach_radius_mm(rig)
    homes = [poses.capsules.of(poses.capsules.owner == poses.home) for poses in standby]
    least = rig.closing.clearance_mm + _stage_bound_mm(rig) + _STAGE_SCAN_MM

    def clear(angle: float) -> bool:
        there = _obstacles_in_ring(rig, obstacles, angle)
        return all(
            bool((polygon_gap_mm(home, corners) >= least).all()) for home in homes for corners in there
        )

    def reached(end: float) -> float:
        angles = np.linspace(0.0, end, math.ceil(abs(end) / step) + 1)[1:]
        far = 0.0
        for angle in angles.tolist():
            if not clear(angle):
                break
            far = angle
        return far

    return reached(lo), reached(hi)


def _obstacles_in_ring(rig: RigFile, obstacles: Sequence[Floats], angle_rad: float) -> list[Floats]:
    """Obstacles (c, 2) as they look from the ring at a stage angle."""
    if rig.stage is None or angle_rad == 0.0:
        return list(obstacles)
    back = Turn(rig.stage.centre_mm, -angle_rad)
    return [np.array([back.point_mm((float(x), float(y))) for x, y in corners]) for corners in obstacles]


def reach_radius_mm(rig: RigFile) -> float:
    """No part of a finger that can meet anything is further from the stage's centre."""
    centre = rig.stage.centre_mm if rig.stage else (0.0, 0.0)
    parts = [
        math.dist(spec.base_mm, centre) + (spec.links.upper_mm if isinstance(spec, ArmFingerConfig) else 0.0)
        for spec in rig.fingers
    ]
    return max(*parts, rig.clear_radius_mm + math.hypot(*centre))


def _stage_bound_mm(rig: RigFile) -> float:
    """How far off a finger may be from an obstacle, because the stage's angle and centre are."""
    if rig.stage is None:
        return 0.0
    widest = math.radians(max(map(abs, rig.stage.range_deg)))
    shifted = 2 * math.sin(min(widest, math.pi) / 2) * rig.stage.centre_bound_mm
    return planned_turn(rig.stage, 0.0).angle_bound_rad * reach_radius_mm(rig) + shifted


def _paths_at(
    rig: RigFile,
    standby: Sequence[StandbyPoses],
    obstacles: Sequence[Floats],
    aims: int,
    known: dict[tuple[int, float, float], list[ApproachPath]],
) -> list[ApproachPath]:
    """What all fingers can do, in the frame that carries them, among obstacles that stand there.

    `known`: paths by finger and range of aims, without what stands in their way.
    """
    clearance = rig.closing.clearance_mm
    wide = clearance + _stage_bound_mm(rig)
    ranges = free_ranges(standby, [clear_aims(w, obstacles, wide) for w in standby], clearance)
    result: list[ApproachPath] = []
    for index, (poses, found) in enumerate(zip(standby, ranges, strict=True)):
        if found is None:
            raise InputError(
                f'rig "{rig.name}": finger "{rig.fingers[index].name}" has no room where it waits: with its '
                f"bounds it comes nearer than closing.clearance_mm = {clearance:g} to an obstacle or to "
                "another finger"
            )
        key = (index, float(poses.aims_rad[found[0]]), float(poses.aims_rad[found[1]]))
        if key not in known:
            known[key] = paths_of(rig, *key, aims)
        others = [
            _range_capsules(other, pair)
            for other, pair in zip(standby, ranges, strict=True)
            if other is not poses and pair is not None
        ]
        result += _cut_at_obstacles(rig, known[key], obstacles, others)
    return result


def _range_capsules(poses: StandbyPoses, found: tuple[int, int]) -> BodyCapsules:
    """All places of a finger's range."""
    owner = poses.capsules.owner
    return poses.capsules.of((owner >= found[0]) & (owner <= found[1]))


def _cut_at_obstacles(
    rig: RigFile, paths: Sequence[ApproachPath], obstacles: Sequence[Floats], others: Sequence[BodyCapsules]
) -> list[ApproachPath]:
    """The paths that are left, each as far as it is free."""
    if not paths:
        return []
    clearance = rig.closing.clearance_mm
    least = clearance + _stage_bound_mm(rig)

    def free(capsules: BodyCapsules) -> Bools:
        result = np.ones(len(capsules.owner), dtype=bool)
        for corners in obstacles:
            result &= polygon_gap_mm(capsules, corners) >= least
        for other in others:
            result &= gap_mm(capsules, other) >= clearance
        return result

    travel = longest_way_mm(joint_sweep(paths), np.array([path.travel_mm for path in paths]), free)
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
        result: Floats = self.aiming_s + 2 * there + again + _OVERHEAD_S
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
        np.array([path.aiming_s + _stage_turning_s(rig, angle) for angle, path in found]),
        joint_sweep([path for _, path in found]),
        rig.closing,
    )


def _stage_turning_s(rig: RigFile, angle_rad: float) -> float:
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
