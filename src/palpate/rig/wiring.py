"""Drives of a rig: the servos of each finger on the bus, limited to its ranges, and how they are moved.

Also why a finger must not move from where it stands when it is switched on.
"""

import math

from palpate.config import ArmFingerConfig, FingerConfig, RigFile
from palpate.drivers.dynamixel.bus import Bus
from palpate.drivers.dynamixel.servo import Servo
from palpate.drivers.finger import Servos
from palpate.rig.arm_drive import ArmDrive
from palpate.rig.conversion import arm_kinematics, slide_kinematics
from palpate.rig.drives import Drive, SlideDrive
from palpate.rig.standby_geometry import is_steady, on_circle, wait_distance_mm, wait_radius_mm

__all__ = ["drive_of", "start_problem"]

_START_MM = 15.0  # an arm's tip may stand this far from where tips wait when it is switched on
_JOINT_SLACK_DEG = 0.1  # an encoder step of a joint that stands at its end


def drive_of(spec: FingerConfig, rig: RigFile, bus: Bus) -> Drive:
    """The servos of a finger, limited to its ranges, and what moves them."""
    closing, radius = rig.closing, rig.clear_radius_mm
    near, far = (
        Servo(bus, servo.dxl_id, servo.model, range_rad=(min(ends), max(ends)))
        for servo, ends in zip(spec.servos.values(), _ends(spec), strict=True)
    )
    if isinstance(spec, ArmFingerConfig):
        wait = wait_radius_mm(spec, radius)
        return ArmDrive(near, far, arm_kinematics(spec), wait, closing.max_force_n)
    wait = wait_distance_mm(spec, radius)
    speed, force = closing.approach_speed_mm_s, closing.max_force_n
    return SlideDrive(near, far, slide_kinematics(spec), wait, speed, force, spec.slide.friction_a)


def start_problem(
    spec: FingerConfig,
    rig: RigFile,
    servos: tuple[Servo, Servo],
    angles_rad: Servos,
    *,
    is_homed: bool = True,
) -> str | None:
    """Why a finger must not start from where it stands; None if it may.

    A slide must be retracted, because its servo knows its angle within one turn only; one whose stops are
    known may stand anywhere if it `is_homed` before it moves otherwise. An arm's joints must be within their
    ranges; if it does not come to standby first (not `is_homed`), its tip must be beside the workspace.
    """
    if isinstance(spec, ArmFingerConfig) and is_homed:
        return _joint_problem(spec, servos, angles_rad)
    if isinstance(spec, ArmFingerConfig):
        x, y = arm_kinematics(spec).centre_mm(angles_rad)
        radius = wait_radius_mm(spec, rig.clear_radius_mm)
        home = on_circle(radius, math.atan2(spec.base_mm[1], spec.base_mm[0]))
        beside = on_circle(radius, math.atan2(y, x))
        if math.dist(beside, (x, y)) <= _START_MM and is_steady(arm_kinematics(spec), beside):
            return None
        return (
            f"its tip (servos {servos[0].dxl_id} and {servos[1].dxl_id}) stands at ({x:.1f}, {y:.1f}) mm; "
            f"with torque off, push it by hand to within {_START_MM:g} mm of ({home[0]:.1f}, {home[1]:.1f}), "
            "then start again"
        )
    if is_homed and spec.slide.stops_mm is not None:
        return None
    distance = slide_kinematics(spec).distance_mm(angles_rad[1])
    lo, hi = spec.slide.range_mm
    play = spec.slide.backlash_mm
    if lo - play <= distance <= hi + play:
        return None
    return (
        f"its slide (servo {servos[1].dxl_id}) stands at {distance:.1f} mm, outside its range "
        f"{lo:g} … {hi:g} mm; with torque off, push the finger back by hand until it is retracted within the "
        "servo's first turn, then start again"
    )


def _joint_problem(spec: ArmFingerConfig, servos: tuple[Servo, Servo], angles_rad: Servos) -> str | None:
    """Why an arm cannot be moved: its servos' turn is only known where its joints are within their ranges."""
    arm = arm_kinematics(spec)
    joints = zip(spec.servos.items(), (arm.shoulder, arm.elbow), servos, angles_rad, strict=True)
    for (key, config), joint, servo, angle in joints:
        at = math.degrees(joint.angle_rad(angle))
        lo, hi = config.range_deg
        slack = config.backlash_deg + _JOINT_SLACK_DEG
        if not lo - slack <= at <= hi + slack:
            return (
                f"its {key} (servo {servo.dxl_id}) stands at {at:.1f}°, outside its range {lo:g} … {hi:g}°; "
                "with torque off, turn it back by hand, then start again"
            )
    return None


def _ends(spec: FingerConfig) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Servo angles at the ends of both ranges."""
    if isinstance(spec, ArmFingerConfig):
        arm = arm_kinematics(spec)
        shoulder, elbow = (
            tuple(joint.servo_rad(angle) for angle in (joint.lo_rad, joint.hi_rad))
            for joint in (arm.shoulder, arm.elbow)
        )
        return shoulder, elbow
    slide = slide_kinematics(spec)
    aims = tuple(slide.aim_servo_rad(math.radians(value)) for value in spec.aim.range_deg)
    return aims, tuple(slide.slide_servo_rad(value) for value in spec.slide.range_mm)
