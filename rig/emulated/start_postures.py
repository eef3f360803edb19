"""Where emulated fingers stand when they are switched on: as a person has put them, or anywhere.

Anywhere: aims within their ranges, slides within their travel, drawn again while fingers would cross, or one
would stand in the part. Arms stand where they wait.
"""

import math
from collections.abc import Sequence

import numpy as np
import shapely

from palpate.config import FingerConfig, RigFile, SlideFingerConfig
from palpate.drivers.finger import Body, Servos
from palpate.errors import InputError
from palpate.rig.conversion import slide_kinematics
from palpate.rig.emulated.emulated_truth import start_angles_rad
from palpate.rig.emulated.scene import Placement, shape_of
from palpate.rig.reach.swept_volume import is_apart

__all__ = ["start_postures"]

_TRIES = 10_000
_APART_MM = 3.0  # more than the truth may differ from the description, on any rig that is used
_OFF_STOP_MM = 0.5


def start_postures(rig: RigFile, placement: Placement | None, rng: np.random.Generator) -> list[Servos]:
    """Shaft angles (rad) of each finger's servos, turns counted.

    Raises InputError if no posture is found in which fingers are apart.
    """
    waiting = [start_angles_rad(finger, rig) for finger in rig.fingers]
    if rig.emulation is None or rig.emulation.start == "waiting":
        return waiting
    parts = [] if placement is None else [shape_of(placement, part) for part in placement.state.sections]
    for _ in range(_TRIES):
        drawn = [
            _anywhere(finger, rng) if isinstance(finger, SlideFingerConfig) else angles
            for finger, angles in zip(rig.fingers, waiting, strict=True)
        ]
        if _is_free(rig.fingers, drawn, parts):
            return drawn
    raise InputError(
        'emulation.start: is "anywhere", and no posture was found in which fingers stand apart; '
        'let it be "waiting"'
    )


def _anywhere(finger: SlideFingerConfig, rng: np.random.Generator) -> Servos:
    kinematics, slide = slide_kinematics(finger), finger.slide
    lo, hi = slide.range_mm
    if slide.stops_mm is not None:
        lo, hi = (stop + inward * _OFF_STOP_MM for stop, inward in zip(slide.stops_mm, (1, -1), strict=True))
    off = max(slide.off_mm(lo), slide.off_mm(hi))
    lo, hi = lo + off, hi - off
    aim = math.radians(rng.uniform(*finger.aim.range_deg))
    return kinematics.aim_servo_rad(aim), kinematics.slide_servo_rad(rng.uniform(lo, hi))


def _is_free(
    fingers: Sequence[FingerConfig], postures: Sequence[Servos], parts: Sequence[shapely.Geometry]
) -> bool:
    bodies = [
        slide_kinematics(finger).body(angles, finger.tip.radius_mm)
        for finger, angles in zip(fingers, postures, strict=True)
        if isinstance(finger, SlideFingerConfig)
    ]
    apart = all(is_apart(one, two, _APART_MM) for k, one in enumerate(bodies) for two in bodies[:k])
    return apart and all(_clear_mm(body, part) > _APART_MM for body in bodies for part in parts)


def _clear_mm(body: Body, part: shapely.Geometry) -> float:
    axis = shapely.LineString([body.start[0], body.end[0]])
    return float(axis.distance(part) - body.half_width[0])
