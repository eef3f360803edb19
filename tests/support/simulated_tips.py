"""Where the tips of a simulated rig really are: its truth, with plays taken up, and what forces bend."""

import cmath
import math

import numpy as np
from simulated_load import bends_of_arm

from palpate.base.geometry import Floats
from palpate.calibration.measurements import ServoPath
from palpate.drivers.emulators.mechanics import ArmTruth, FingerTruth
from palpate.drivers.emulators.tip import PartSection
from palpate.drivers.kinematics import TICK_RAD, Servos

__all__ = [
    "Truth",
    "Ways",
    "direction_to",
    "gives_way",
    "link_directions_rad",
    "pushed_tip",
    "servos_stood",
    "slide_distance_mm",
    "travel_direction_rad",
    "true_tip",
    "whole_step_rad",
]

Truth = FingerTruth | ArmTruth
Ways = tuple[float, float]
"""From which side each joint came, 1 from below, -1 from above: that end of its play it is at."""


def whole_step_rad(angle_rad: float) -> float:
    return round(angle_rad / TICK_RAD) * TICK_RAD


def servos_stood(truth: Truth, item: ServoPath, travel: float) -> Servos:
    """Servo angles after a travel; an aim stands at a whole step."""
    near, far = item.servos_at(np.array([travel]))[0].tolist()
    return (whole_step_rad(near) if isinstance(truth, FingerTruth) else near), far


def slide_distance_mm(truth: FingerTruth, slide_rad: float) -> float:
    """From the base to the tip's centre, with the play taken up as in a touch."""
    return truth.zero_mm + truth.mm_per_rad * slide_rad - truth.slide_play_mm


def gives_way(truth: Truth) -> bool:
    return isinstance(truth, ArmTruth) and truth.elbow.yields is not None


def pushed_tip(
    truth: Truth, servos: Servos, ways: Ways, outline: PartSection | None, force_n: float
) -> tuple[Floats, float]:
    """As `true_tip`, with an arm pushed back from what is nearest with a force."""
    bends = (0.0, 0.0)
    for _ in range(3 if force_n and gives_way(truth) else 0):
        assert isinstance(truth, ArmTruth)
        towards = direction_to(outline, true_tip(truth, servos, ways, bends)[0])
        back = -force_n * np.array([math.cos(towards), math.sin(towards)])
        bends = bends_of_arm(truth, link_directions_rad(truth, servos, ways), back)
    return true_tip(truth, servos, ways, bends)


def link_directions_rad(
    truth: ArmTruth, servos: Servos, ways: Ways, bends: Ways = (0.0, 0.0)
) -> tuple[float, float]:
    """Directions of both links."""
    first, bend = (
        (servo - joint.zero_rad) / joint.gear_ratio - way * joint.play_rad + bent
        for servo, joint, way, bent in zip(servos, (truth.shoulder, truth.elbow), ways, bends, strict=True)
    )
    return truth.heading_rad + first, truth.heading_rad + first + bend


def true_tip(truth: Truth, servos: Servos, ways: Ways, bends: Ways = (0.0, 0.0)) -> tuple[Floats, float]:
    """True centre (2,) with the play taken up as in a touch, and where the finger faces.

    `bends`: by how much a force has turned an arm's joints.
    """
    base = complex(*truth.base_mm)
    if isinstance(truth, FingerTruth):
        facing = truth.heading_rad + (servos[0] - truth.aim_zero_rad) / truth.gear_ratio
        facing -= ways[0] * truth.aim_play_rad
        tip = base + cmath.rect(slide_distance_mm(truth, servos[1]), facing)
    else:
        first, facing = link_directions_rad(truth, servos, ways, bends)
        tip = base + cmath.rect(truth.upper_mm, first) + cmath.rect(truth.fore_mm, facing)
    return np.array([tip.real, tip.imag]), facing


def travel_direction_rad(truth: Truth, item: ServoPath, ways: Ways, travel: float) -> float:
    """True direction of travel there."""
    near, far = (true_tip(truth, servos_stood(truth, item, travel + by), ways)[0] for by in (-2.0, 2.0))
    return math.atan2(far[1] - near[1], far[0] - near[0])


def direction_to(outline: PartSection | None, centre: Floats) -> float:
    """Direction from a point to the nearest point of an outline."""
    assert outline is not None
    rel = centre - outline.start
    share = np.clip(np.einsum("ij,ij->i", rel, outline.along) / outline.square, 0.0, 1.0)
    away = rel - share[:, None] * outline.along
    nearest = away[np.einsum("ij,ij->i", away, away).argmin()]
    return math.atan2(-nearest[1], -nearest[0])
