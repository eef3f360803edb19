"""Where emulated fingers stand when they are switched on: as a person has put them, or anywhere.

Anywhere: joints and the stage within their ranges, slides within their travel, drawn again while fingers
would cross, or one would stand in the part or in an obstacle.
"""

import math
from collections.abc import Sequence

import numpy as np
import shapely

from palpate.base.errors import InputError
from palpate.config import ArmFingerConfig, FingerConfig, RigFile, SlideFingerConfig
from palpate.drivers.finger import Body, Servos, Turn
from palpate.rig.conversion import kinematics_of, slide_kinematics
from palpate.rig.emulated.emulated_truth import start_angles_rad
from palpate.rig.emulated.scene import Placement, shape_of
from palpate.rig.reach.swept_volume import is_apart

__all__ = ["start_postures", "start_stage_rad"]

_TRIES = 10_000
_APART_MM = 3.0  # more than the truth may differ from the description, on any rig that is used
_OFF_STOP_MM = 0.5


def start_stage_rad(rig: RigFile, rng: np.random.Generator) -> float:
    """Angle at which the stage stands at first; 0 without one, or where nothing starts anywhere."""
    if rig.stage is None or rig.emulation is None or rig.emulation.start == "waiting":
        return 0.0
    return math.radians(rng.uniform(*rig.stage.range_deg))


def start_postures(
    rig: RigFile, placement: Placement | None, stage_rad: float, rng: np.random.Generator
) -> list[Servos]:
    """Shaft angles (rad) of each finger's servos, turns counted, with the stage at an angle.

    Raises InputError if no posture is found in which fingers are apart.
    """
    if rig.emulation is None or rig.emulation.start == "waiting":
        return [start_angles_rad(finger, rig) for finger in rig.fingers]
    turn = Turn((0.0, 0.0) if rig.stage is None else rig.stage.centre_mm, stage_rad)
    parts = [] if placement is None else [shape_of(placement, part) for part in placement.state.sections]
    posts: list[shapely.Geometry] = [shapely.Polygon(item.outline_mm) for item in rig.obstacles]
    for _ in range(_TRIES):
        drawn = [_anywhere(finger, rng) for finger in rig.fingers]
        if _is_free(rig.fingers, drawn, turn, parts, posts):
            return drawn
    raise InputError(
        'emulation.start: is "anywhere", and no posture was found in which fingers stand apart; '
        'let it be "waiting"'
    )


def _anywhere(finger: FingerConfig, rng: np.random.Generator) -> Servos:
    if isinstance(finger, ArmFingerConfig):
        shoulder, elbow = (
            math.radians(joint.zero_deg + joint.gear_ratio * rng.uniform(*joint.range_deg)) - math.pi
            for joint in (finger.shoulder, finger.elbow)
        )
        return shoulder, elbow
    return _anywhere_on_slide(finger, rng)


def _anywhere_on_slide(finger: SlideFingerConfig, rng: np.random.Generator) -> Servos:
    kinematics, slide = slide_kinematics(finger), finger.slide
    lo, hi = slide.range_mm
    if slide.stops_mm is not None:
        lo, hi = (stop + inward * _OFF_STOP_MM for stop, inward in zip(slide.stops_mm, (1, -1), strict=True))
    off = max(slide.off_mm(lo), slide.off_mm(hi))
    lo, hi = lo + off, hi - off
    aim = math.radians(rng.uniform(*finger.aim.range_deg))
    return kinematics.aim_servo_rad(aim), kinematics.slide_servo_rad(rng.uniform(lo, hi))


def _is_free(
    fingers: Sequence[FingerConfig],
    postures: Sequence[Servos],
    turn: Turn,
    parts: Sequence[shapely.Geometry],
    posts: Sequence[shapely.Geometry],
) -> bool:
    """Whether fingers are apart, and clear of the part, above which links of arms pass, and of posts."""
    bodies = [
        kinematics_of(finger).body(angles, finger.tip.radius_mm)
        for finger, angles in zip(fingers, postures, strict=True)
    ]
    apart = all(is_apart(one, two, _APART_MM) for k, one in enumerate(bodies) for two in bodies[:k])
    return (
        apart
        and all(
            _clear_mm(body, k, turn, part) > _APART_MM
            for finger, body in zip(fingers, bodies, strict=True)
            for k in (range(len(body.start)) if finger.type == "slide" else (len(body.start) - 1,))
            for part in parts
        )
        and all(
            _clear_mm(body, k, turn, post) > _APART_MM
            for body in bodies
            for k in range(len(body.start))
            for post in posts
        )
    )


def _clear_mm(body: Body, piece: int, turn: Turn, part: shapely.Geometry) -> float:
    ends = [turn.point_mm((float(x), float(y))) for x, y in (body.start[piece], body.end[piece])]
    return float(shapely.LineString(ends).distance(part) - body.half_width[piece])
