"""Standby poses: where a finger may wait between approaches, the room that it takes there, and its home."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from palpate.base.geometry import Bools, Floats
from palpate.config import ArmFingerConfig, FingerConfig
from palpate.drivers.kinematics import FingerBody, FingerKinematics, Line, Servos
from palpate.rig.conversion import arm_kinematics, slide_kinematics, tip_bound_mm
from palpate.rig.drives import AIM_TOLERANCE_RAD, is_steady, point_on_circle, wait_distance_mm, wait_radius_mm
from palpate.rig.reach.swept_volume import BodyCapsules, capsules_of, gaps_mm, polygon_gap_mm

_STEP_RAD = math.radians(1.0)
_ARM_STEP_RAD = math.radians(2.0)
_MAX_ARM_STEPS = 90  # half a turn either way


@dataclass(frozen=True, eq=False)
class StandbyPoses:
    """A finger at its sampled aims (m,): what room it takes there (`capsules.owner`: the aim), and its home.

    `home`: index of the aim at which the finger must stand when it is switched on.
    """

    aims_rad: Floats
    capsules: BodyCapsules
    home: int


def standby_poses_of(spec: FingerConfig, workspace_radius_mm: float) -> StandbyPoses:
    """Sample the aims of a finger: directions of a slide, places of an arm's tip on its waiting circle.

    Both are angles: a slide's counts from its heading, an arm's is the place's direction from W's origin.
    """
    if isinstance(spec, ArmFingerConfig):
        return _arm_poses(spec, workspace_radius_mm)
    lo, hi = (math.radians(value) for value in spec.aim.range_deg)
    home = min(max(0.0, lo), hi)
    before = np.linspace(lo, home, math.ceil((home - lo) / _STEP_RAD) + 1)
    after = np.linspace(home, hi, math.ceil((hi - home) / _STEP_RAD) + 1)
    aims = np.concatenate([before[:-1], after])
    kinematics = slide_kinematics(spec)
    wait = wait_distance_mm(spec, workspace_radius_mm)
    lines = [kinematics.line(float(aim), wait) for aim in aims]
    bodies = [body_of(kinematics, kinematics.servos_rad(line, 0.0), spec) for line in lines]
    return StandbyPoses(aims, capsules_of(bodies, between=True), len(before) - 1)


def _arm_poses(spec: ArmFingerConfig, workspace_radius_mm: float) -> StandbyPoses:
    """The part of the circle that the arm can follow from its home, which is next to its base."""
    kinematics = arm_kinematics(spec)
    home = math.atan2(spec.base_mm[1], spec.base_mm[0])
    radius = wait_radius_mm(spec, workspace_radius_mm)

    def reached(step: int) -> list[float]:
        found: list[float] = []
        while len(found) < _MAX_ARM_STEPS:
            aim = home + (len(found) + 1) * step * _ARM_STEP_RAD
            if not is_steady(kinematics, point_on_circle(radius, aim)):
                break
            found.append(aim)
        return found

    before = reached(-1)[::-1]
    aims = np.array([*before, home, *reached(1)])
    postures = [kinematics.servos_at(point_on_circle(radius, float(aim))) for aim in aims]
    bodies = [body_of(kinematics, servos, spec) for servos in postures]
    return StandbyPoses(aims, capsules_of(bodies, between=True), len(before))


def home_line(spec: FingerConfig, workspace_radius_mm: float) -> Line:
    """A way that starts at the finger's home, where it stands at power-up and when a stage turns."""
    if isinstance(spec, ArmFingerConfig):
        angle = math.atan2(spec.base_mm[1], spec.base_mm[0])
        return Line(point_on_circle(wait_radius_mm(spec, workspace_radius_mm), angle), angle + math.pi)
    lo, hi = (math.radians(value) for value in spec.aim.range_deg)
    wait = wait_distance_mm(spec, workspace_radius_mm)
    return slide_kinematics(spec).line(min(max(0.0, lo), hi), wait)


def body_of(kinematics: FingerKinematics, servos_rad: Servos, spec: FingerConfig) -> FingerBody:
    """Room that a finger may take up, given how well place and tip are known and how exactly it aims."""
    body = kinematics.body(servos_rad, spec.tip.radius_mm)
    unsure = kinematics.position_bound_mm(servos_rad) + kinematics.cross_track_bound_mm(
        servos_rad, AIM_TOLERANCE_RAD
    )
    return FingerBody(body.start, body.end, body.half_width + (unsure + tip_bound_mm(spec)))


def clear_aims(poses: StandbyPoses, obstacles: Sequence[Floats], clearance_mm: float) -> Bools:
    """Aims (m,) at which a waiting finger keeps clear of polygons (c, 2)."""
    clear = np.ones(len(poses.aims_rad), dtype=bool)
    for corners in obstacles:
        far = polygon_gap_mm(poses.capsules, corners) >= clearance_mm
        np.logical_and.at(clear, poses.capsules.owner, far)
    return clear


def free_ranges(
    standby: Sequence[StandbyPoses], clear: Sequence[Bools], clearance_mm: float
) -> list[tuple[int, int] | None]:
    """For each finger the first and last aim of its range, by index; None where not even home is clear.

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

    def fits(finger: int, aim: int) -> bool:
        if not 0 <= aim < len(standby[finger].aims_rad) or not clear[finger][aim]:
            return False
        for other, found in enumerate(ranges):
            if other == finger or found is None:
                continue
            pair = meets[finger, other][aim] if finger < other else meets[other, finger][:, aim]
            if pair[found[0] : found[1] + 1].any():
                return False
        return True

    for finger, poses in enumerate(standby):
        if fits(finger, poses.home):
            ranges[finger] = (poses.home, poses.home)
    growing = [(finger, step) for finger in range(len(standby)) for step in (-1, 1)]
    while growing:
        still = []
        for finger, step in growing:
            now = ranges[finger]
            if now is None:
                continue
            aim = now[0] - 1 if step < 0 else now[1] + 1
            if fits(finger, aim):
                ranges[finger] = (min(now[0], aim), max(now[1], aim))
                still.append((finger, step))
        growing = still
    return ranges


def _clashing_pairs(one: StandbyPoses, other: StandbyPoses, clearance_mm: float) -> Bools:
    """Whether the finger at each aim (m,) of one may meet the other finger at each of its aims: (m, n)."""
    near = gaps_mm(one.capsules, other.capsules) < clearance_mm
    result = np.zeros((len(one.aims_rad), len(other.aims_rad)), dtype=bool)
    rows, columns = np.nonzero(near)
    result[one.capsules.owner[rows], other.capsules.owner[columns]] = True
    return result
