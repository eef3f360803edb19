"""Free space: paths of all fingers among the obstacles, at every stage angle worth having.

Everything is computed in the frame of the ring that carries the fingers; obstacles are turned back into it.
The stage turns with all fingers at home and passes all angles in between, so only the connected range of
angles round 0 counts at which every finger's home is clear.
"""

import math
from collections.abc import Sequence

import numpy as np

from palpate.base.errors import InputError
from palpate.base.geometry import Bools, Floats
from palpate.config import ArmFingerConfig, RigFile
from palpate.drivers.finger import Turn
from palpate.rig.reach.approach_paths import ApproachPath, joint_sweep, paths_of
from palpate.rig.reach.standby_poses import StandbyPoses, clear_aims, free_ranges, standby_poses_of
from palpate.rig.reach.swept_volume import Capsules, gap_mm, longest_way_mm, polygon_gap_mm
from palpate.rig.turning_stage import planned_turn

__all__ = ["free_paths", "furthest_mm", "stage_range_rad"]

_MARGIN_MM = 1.0
_MOST = 1500  # candidates in all
_APART_MM = 5.0  # between the same path at two stage angles, where tips wait
_STEP_MM = 1.0  # of a finger's furthest point, between two stage angles that are looked at


def free_paths(rig: RigFile, aims: int) -> list[tuple[float, ApproachPath]]:
    """All free paths, each with its stage angle; without a stage all at 0.

    Raises InputError for a finger that has no room even where it starts.
    """
    standby = [standby_poses_of(spec, rig.clear_radius_mm) for spec in rig.fingers]
    obstacles = [np.array(item.outline_mm) for item in rig.obstacles]
    known: dict[tuple[int, float, float], list[ApproachPath]] = {}

    def paths_at(angle: float) -> list[ApproachPath]:
        return _paths_at(rig, standby, _turned_back(rig, obstacles, angle), aims, known)

    middle = paths_at(0.0)
    if rig.stage is None:
        return [(0.0, path) for path in middle]
    return [
        (angle, path)
        for angle in _angles(rig, standby, obstacles, len(middle))
        for path in (middle if angle == 0.0 else paths_at(angle))
    ][:_MOST]


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
    room = max(_MOST // max(each, 1), 1) - 1
    wanted = math.ceil((hi - lo) * rig.clear_radius_mm / _APART_MM)
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
    step = _STEP_MM / furthest_mm(rig)
    homes = [poses.capsules.of(poses.capsules.owner == poses.home) for poses in standby]
    least = rig.closing.clearance_mm + _unsure_mm(rig) + _STEP_MM

    def clear(angle: float) -> bool:
        there = _turned_back(rig, obstacles, angle)
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


def _turned_back(rig: RigFile, obstacles: Sequence[Floats], angle_rad: float) -> list[Floats]:
    """Obstacles (c, 2) as they look from the ring at a stage angle."""
    if rig.stage is None or angle_rad == 0.0:
        return list(obstacles)
    back = Turn(rig.stage.centre_mm, -angle_rad)
    return [np.array([back.point_mm((float(x), float(y))) for x, y in corners]) for corners in obstacles]


def furthest_mm(rig: RigFile) -> float:
    """No part of a finger that can meet anything is further from the stage's centre."""
    centre = rig.stage.centre_mm if rig.stage else (0.0, 0.0)
    parts = [
        math.dist(spec.base_mm, centre) + (spec.links.upper_mm if isinstance(spec, ArmFingerConfig) else 0.0)
        for spec in rig.fingers
    ]
    return max(*parts, rig.clear_radius_mm + math.hypot(*centre))


def _unsure_mm(rig: RigFile) -> float:
    """How far off a finger may be from an obstacle, because the stage's angle and centre are."""
    if rig.stage is None:
        return 0.0
    widest = math.radians(max(map(abs, rig.stage.range_deg)))
    shifted = 2 * math.sin(min(widest, math.pi) / 2) * rig.stage.centre_bound_mm
    return planned_turn(rig.stage, 0.0).angle_bound_rad * furthest_mm(rig) + shifted


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
    wide = clearance + _unsure_mm(rig)
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
            _range(other, pair)
            for other, pair in zip(standby, ranges, strict=True)
            if other is not poses and pair is not None
        ]
        result += _unblocked(rig, known[key], obstacles, others)
    return result


def _range(poses: StandbyPoses, found: tuple[int, int]) -> Capsules:
    """All places of a finger's range."""
    owner = poses.capsules.owner
    return poses.capsules.of((owner >= found[0]) & (owner <= found[1]))


def _unblocked(
    rig: RigFile, paths: Sequence[ApproachPath], obstacles: Sequence[Floats], others: Sequence[Capsules]
) -> list[ApproachPath]:
    """The paths that are left, each as far as it is free."""
    if not paths:
        return []
    clearance = rig.closing.clearance_mm
    least = clearance + _unsure_mm(rig)

    def free(capsules: Capsules) -> Bools:
        result = np.ones(len(capsules.owner), dtype=bool)
        for corners in obstacles:
            result &= polygon_gap_mm(capsules, corners) >= least
        for other in others:
            result &= gap_mm(capsules, other) >= clearance
        return result

    travel = longest_way_mm(joint_sweep(paths), np.array([path.travel_mm for path in paths]), free)
    return [path.up_to(float(far)) for path, far in zip(paths, travel, strict=True) if far > _MARGIN_MM]
