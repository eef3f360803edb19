"""Standby geometry: where a tip waits outside of the workspace, and whether an arm is steady there."""

import math

import numpy as np

from palpate.config import ARM_MARGIN_MM, ArmFingerConfig, SlideFingerConfig
from palpate.drivers.arm_finger import ArmKinematics
from palpate.rig.conversion import slide_kinematics

__all__ = ["LEAST_FORCE_TRANSMISSION", "is_steady", "on_circle", "wait_distance_mm", "wait_radius_mm"]

_MARGIN_MM = 1.0
_END_RAD = math.radians(1.0)  # an arm keeps this far off its joints' ends
LEAST_FORCE_TRANSMISSION = 0.25
"""Least `ArmKinematics.force_transmission` of a posture: torques that a part can bear still move the arm."""


def wait_radius_mm(spec: ArmFingerConfig, workspace_radius_mm: float) -> float:
    """Distance from W's origin at which an arm's tip waits."""
    return workspace_radius_mm + spec.tip.radius_mm + ARM_MARGIN_MM


def on_circle(radius_mm: float, angle_rad: float) -> tuple[float, float]:
    """A place on the circle round W's origin."""
    return radius_mm * math.cos(angle_rad), radius_mm * math.sin(angle_rad)


def is_steady(kinematics: ArmKinematics, point_mm: tuple[float, float]) -> bool:
    """Whether an arm can hold its tip there, off its ends of range, and neither stretched nor folded."""
    servos = kinematics.servos_at(point_mm)
    if math.isnan(servos[0]) or math.isnan(servos[1]):
        return False
    angles = kinematics.shoulder.angle_rad(servos[0]), kinematics.elbow.angle_rad(servos[1])
    ranges = (kinematics.shoulder, kinematics.elbow)
    off_ends = all(
        joint.lo_rad + _END_RAD <= angle <= joint.hi_rad - _END_RAD
        for joint, angle in zip(ranges, angles, strict=True)
    )
    return off_ends and kinematics.force_transmission(servos) >= LEAST_FORCE_TRANSMISSION


def wait_distance_mm(spec: SlideFingerConfig, workspace_radius_mm: float) -> float:
    """Furthest distance from the base, coming from the retracted end, with the tip clear of the workspace."""
    kinematics = slide_kinematics(spec)
    lo, hi = spec.slide.range_mm
    clear = workspace_radius_mm + spec.tip.radius_mm
    distances = np.append(lo + _MARGIN_MM, np.arange(lo + _MARGIN_MM, hi, 1.0))
    angles = kinematics.heading_rad + np.radians(np.linspace(*spec.aim.range_deg, 15))
    x = kinematics.base_mm[0] + distances[:, None] * np.cos(angles)
    y = kinematics.base_mm[1] + distances[:, None] * np.sin(angles)
    outside = np.all(np.hypot(x, y) >= clear, axis=1)
    outside[0] = True
    first_inside = len(outside) if outside.all() else int(np.argmin(outside))
    return float(distances[first_inside - 1])
