"""Fingers and turning stage as the host sees them: part of the rig file, servos, limits, kinematics.

The servos of each finger on the bus are limited to its ranges. Said here, too: why a finger or the stage
must not move from where it stands when it is switched on, and what each servo's EEPROM must hold before a
run, for runs, `setup-motors` and `check` alike. The stage turns all fingers about a fixed centre; what it
carries is computed in the ring's frame, and `Turn` leads from there to W.
"""

import math
from dataclasses import dataclass
from typing import Self

from palpate.base.errors import InputError
from palpate.config import ArmFingerConfig, FingerConfig, RigFile, StageConfig
from palpate.drivers.dynamixel import Bus, OperatingMode, Servo
from palpate.drivers.kinematics import TICK_RAD, FingerKinematics, Line, Servos, Turn
from palpate.drivers.tactile import ArrayDriver, ContactExtractor
from palpate.rig.conversion import arm_kinematics, slide_kinematics
from palpate.rig.drives import (
    AIM_TOLERANCE_RAD,
    ArmDrive,
    Drive,
    ServoLimits,
    SlideDrive,
    is_steady,
    point_on_circle,
    wait_distance_mm,
    wait_radius_mm,
)


@dataclass(frozen=True, eq=False)
class HostFinger:
    """One finger as the host sees it: its part of the rig file, its devices and its kinematics.

    `home`: a way that starts where the finger stands when the stage turns.
    """

    spec: FingerConfig
    kinematics: FingerKinematics
    drive: Drive
    home: Line
    array: ArrayDriver
    extractor: ContactExtractor

    @property
    def name(self) -> str:
        """The rig file's name of the finger."""
        return self.spec.name


_START_MM = 15.0  # an arm's tip may stand this far from where tips wait when it is switched on
_JOINT_SLACK_DEG = 0.1  # an encoder step of a joint that stands at its end


def drive_of(spec: FingerConfig, rig: RigFile, bus: Bus) -> Drive:
    """The servos of a finger, limited to its ranges, and what moves them."""
    closing, radius = rig.closing, rig.clear_radius_mm
    near, far = (
        Servo(bus, servo.dxl_id, servo.model, range_rad=(min(ends), max(ends)))
        for servo, ends in zip(spec.servos.values(), _servo_ranges_rad(spec), strict=True)
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
        home = point_on_circle(radius, math.atan2(spec.base_mm[1], spec.base_mm[0]))
        beside = point_on_circle(radius, math.atan2(y, x))
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


def _servo_ranges_rad(spec: FingerConfig) -> tuple[tuple[float, ...], tuple[float, ...]]:
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


STAGE_SPEED_RAD_S = 2.0
"""Speed of the stage's servo."""

_STAGE_ACCELERATION_RAD_S2 = 3.0
_STAGE_CURRENT_A = 1.2  # the ring carries all fingers


def planned_turn(spec: StageConfig | None, angle_rad: float) -> Turn:
    """The stage at an angle that it has been sent to: its bound holds wherever it settles."""
    if spec is None:
        return Turn()
    settled = AIM_TOLERANCE_RAD / abs(spec.gear_ratio)
    return Turn(spec.centre_mm, angle_rad, _stage_bound_rad(spec) + settled, spec.centre_bound_mm)


@dataclass(frozen=True, eq=False)
class HostStage:
    """The stage's part of the rig file and its servo."""

    spec: StageConfig
    servo: Servo

    @classmethod
    def of(cls, rig: RigFile, bus: Bus) -> Self | None:
        """The rig's stage, None if it has none."""
        if rig.stage is None:
            return None
        ends = [_stage_servo_rad(rig.stage, math.radians(angle)) for angle in rig.stage.range_deg]
        servo = Servo(bus, rig.stage.dxl_id, rig.stage.model, range_rad=(min(ends), max(ends)))
        return cls(rig.stage, servo)

    def limits(self) -> ServoLimits:
        """What the stage's servo may do."""
        return ServoLimits(OperatingMode.POSITION, min(_STAGE_CURRENT_A, self.servo.model.largest_current_a))

    def prepare(self) -> None:
        """Write mode and limits; torque is off."""
        self.limits().write(self.servo)
        self.servo.set_profile(STAGE_SPEED_RAD_S, _STAGE_ACCELERATION_RAD_S2)

    def goal_rad(self, angle_rad: float) -> float:
        """Servo angle for a stage angle."""
        return _stage_servo_rad(self.spec, angle_rad)

    def turn(self, servo_rad: float) -> Turn:
        """Where the ring stands for a servo angle."""
        angle = (servo_rad - _stage_servo_rad(self.spec, 0.0)) / self.spec.gear_ratio
        return Turn(self.spec.centre_mm, angle, _stage_bound_rad(self.spec), self.spec.centre_bound_mm)

    def start_problem(self, servo_rad: float) -> str | None:
        """Why the stage must not start from where it stands; None if it may."""
        angle = math.degrees(self.turn(servo_rad).angle_rad)
        lo, hi = self.spec.range_deg
        play = self.spec.backlash_deg + self.spec.bound_deg
        if lo - play <= angle <= hi + play:
            return None
        return (
            f"the stage (servo {self.servo.dxl_id}) stands at {angle:.1f}°, outside {lo:g} … {hi:g}°; "
            "with torque off, turn it by hand to about 0, then start again"
        )


def _stage_servo_rad(spec: StageConfig, angle_rad: float) -> float:
    return math.radians(spec.zero_deg) - math.pi + spec.gear_ratio * angle_rad


def _stage_bound_rad(spec: StageConfig) -> float:
    return math.radians(spec.backlash_deg + spec.bound_deg) + TICK_RAD / 2 / abs(spec.gear_ratio)


@dataclass(frozen=True, eq=False)
class ServoSettings:
    """A servo on the bus, what people call it, and its limits."""

    owner: str
    servo: Servo
    limits: ServoLimits

    def eeprom(self) -> dict[str, int]:
        """Items and values. Raises InputError for limits that the model cannot keep."""
        try:
            return self.limits.eeprom(self.servo)
        except InputError as error:
            raise InputError(f"{self.owner}: {error}") from error


@dataclass(frozen=True, eq=False)
class FingerSettings:
    """A finger's part of the rig file and its servos, the one next to the base first."""

    spec: FingerConfig
    servos: tuple[ServoSettings, ServoSettings]


def finger_settings(rig: RigFile, bus: Bus) -> list[FingerSettings]:
    """Every finger. Nothing is sent."""
    found = []
    for spec in rig.fingers:
        limits = drive_of(spec, rig, bus).limits()
        near, far = (
            ServoSettings(f"{spec.name} {joint}", servo, limits[servo])
            for joint, servo in zip(spec.servos, limits, strict=True)
        )
        found.append(FingerSettings(spec, (near, far)))
    return found


def stage_settings(rig: RigFile, bus: Bus) -> ServoSettings | None:
    """The stage's servo, None if there is none. Nothing is sent."""
    stage = HostStage.of(rig, bus)
    return None if stage is None else ServoSettings("stage", stage.servo, stage.limits())


def servo_settings(rig: RigFile, bus: Bus) -> list[ServoSettings]:
    """All of them, the stage's first. Nothing is sent."""
    stage = stage_settings(rig, bus)
    fingers = [servo for finger in finger_settings(rig, bus) for servo in finger.servos]
    return fingers if stage is None else [stage, *fingers]
