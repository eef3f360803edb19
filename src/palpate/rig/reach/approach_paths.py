"""Straight paths that a finger's mechanics allow, and what the finger sweeps on each."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from palpate.base.geometry import Floats
from palpate.config import ArmFingerConfig, RigFile, SlideFingerConfig
from palpate.drivers.finger import Body, Line
from palpate.drivers.slide_finger import SlideKinematics
from palpate.rig.conversion import arm_kinematics, array_bound_rad, slide_kinematics
from palpate.rig.drives import AIM_SPEED_RAD_S, ARM_AIM_SPEED_MM_S
from palpate.rig.reach.standby_poses import body_of
from palpate.rig.reach.swept_volume import Capsules, Swept, capsules_of
from palpate.rig.standby_geometry import is_steady, on_circle, wait_distance_mm, wait_radius_mm

__all__ = ["ApproachPath", "joint_sweep", "paths_of"]

_INNER_RAD = 1e-7
_MARGIN_MM = 1.0
_SAMPLE_MM = 8.0  # of an arm's path, between two postures
_MOST_TURN_DEG = 42.0  # of an arm's path, from straight inward


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
    capsules: Capsules
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
        Capsules(
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
        turns = np.radians(np.linspace(-_MOST_TURN_DEG, _MOST_TURN_DEG, 2 * (count // 6) + 1))
        paths = [_arm_path(spec, finger_index, aim, turn, radius) for aim in aims for turn in turns]
    else:
        # An aim at the very end of its servo's range may be beyond it once it has been a line in between.
        inner = min(_INNER_RAD, (hi_rad - lo_rad) / 2)
        aims = np.unique(np.linspace(lo_rad + inner, hi_rad - inner, count))
        wait = wait_distance_mm(spec, radius)
        kinematics = slide_kinematics(spec)
        paths = [_slide_path(spec, kinematics, finger_index, float(aim), wait, radius) for aim in aims]
    return [path for path in paths if path is not None and path.travel_mm > _MARGIN_MM]


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
    room = spec.slide.range_mm[1] - _MARGIN_MM - wait_mm
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
        Capsules(here.start, here.end, np.maximum(here.half_width, far.half_width), np.zeros(1, np.int64)),
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
    start = on_circle(wait_radius_mm(spec, workspace_radius_mm), aim_rad)
    line = Line(start, aim_rad + math.pi + turn_rad)
    view = math.radians(spec.array.coverage_deg / 2) - math.pi / 2 - array_bound_rad(spec)
    middle = math.radians(spec.array.heading_deg)

    def good(travel_mm: float) -> bool:
        if not is_steady(kinematics, line.point_mm(travel_mm)):
            return False
        seen = kinematics.facing_rad(kinematics.servos_rad(line, travel_mm)) + middle
        return abs(math.remainder(line.direction_rad - seen, 2 * math.pi)) <= view

    most = crossing_mm(line, workspace_radius_mm)
    travels = np.append(np.arange(0.0, most, _SAMPLE_MM), most)
    usable = [bool(good(float(travel))) for travel in travels]
    if not all(usable):
        travels = travels[: usable.index(False)]
    if len(travels) < 2:
        return None
    bodies = [body_of(kinematics, kinematics.servos_rad(line, float(travel)), spec) for travel in travels]
    links = [Body(body.start[:2], body.end[:2], body.half_width[:2]) for body in bodies]
    swept = capsules_of(links, between=True)
    tip = max(float(body.half_width[2]) for body in bodies)
    since = np.concatenate([[-1.0], travels[:-1]])
    home = math.atan2(spec.base_mm[1], spec.base_mm[0])
    return ApproachPath(
        finger_index,
        line,
        float(travels[-1]),
        abs(math.remainder(aim_rad - home, 2 * math.pi)) * math.hypot(*start) / ARM_AIM_SPEED_MM_S,
        Capsules(
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
