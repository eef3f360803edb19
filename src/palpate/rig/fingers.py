"""Fingers and turning stage as the host sees them: part of the rig file, servos, limits, kinematics.

The servos of each finger on the bus are limited to its ranges. Said here, too: what each servo's EEPROM must
hold before a run, for runs, `setup-motors` and `check` alike, and how far off touches may be. The stage turns
all fingers about a fixed centre; what it carries is computed in the ring's frame, and `Turn` leads from there
to W.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Self

from palpate.base.errors import InputError
from palpate.config import ClosingConfig, FingerConfig, RigFile
from palpate.config.rig_servos import ServoConfig
from palpate.drivers.dynamixel import Bus, OperatingMode, Servo, ServoState
from palpate.drivers.kinematics import TICK_RAD, FingerKinematics, Line, Turn
from palpate.drivers.tactile import ArrayDriver, ContactExtractor
from palpate.recognizer import Resolution
from palpate.rig.conversion import (
    array_bound_rad,
    deflection_mm,
    deflection_rad,
    largest_on_skin_n,
    measured_force_share,
    shear_rad,
    softest_n_per_mm,
    stiffest_n_per_mm,
    tip_bound_mm,
    undetected_dent_mm,
    undetected_force_n,
)
from palpate.rig.mechanisms import kinematics_of, mechanism_of
from palpate.rig.mechanisms.mechanism import AIM_TOLERANCE_RAD, Drive, Mechanism, ServoLimits


@dataclass(frozen=True, eq=False)
class HostFinger:
    """One finger as the host sees it: its mechanism and its devices.

    `home`: a way that starts where the finger stands when the stage turns.
    """

    mechanism: Mechanism
    drive: Drive
    home: Line
    array: ArrayDriver
    extractor: ContactExtractor

    @property
    def spec(self) -> FingerConfig:
        """Part of the rig file."""
        return self.mechanism.spec

    @property
    def kinematics(self) -> FingerKinematics:
        """Kinematics of its mechanism."""
        return self.mechanism.kinematics

    @property
    def name(self) -> str:
        """Name in the rig file."""
        return self.spec.name


def _servo(bus: Bus, spec: ServoConfig, ends: Sequence[float]) -> Servo:
    """Servo of a rig file, limited to what lies between both ends (rad)."""
    return Servo(
        bus,
        spec.dxl_id,
        spec.model,
        range_rad=(min(ends), max(ends)),
        homing_offset=spec.homing_offset,
    )


def drive_of(mechanism: Mechanism, rig: RigFile, bus: Bus) -> Drive:
    """Drive of a finger by its servos on a bus, limited to its ranges."""
    near, far = (
        _servo(bus, servo, ends)
        for servo, ends in zip(mechanism.spec.servos.values(), mechanism.ranges_rad, strict=True)
    )
    return mechanism.drive((near, far), rig)


_STAGE_SPEED_RAD_S = 2.0  # of the stage's servo
_STAGE_ACCELERATION_RAD_S2 = 3.0
_STAGE_CURRENT_A = 1.2  # the ring carries all fingers


@dataclass(frozen=True)
class Stage:
    """Turning stage of a rig; a rig without one has a stage that stands at 0, exactly."""

    centre_mm: tuple[float, float] = (0.0, 0.0)
    range_rad: tuple[float, float] = (0.0, 0.0)
    gear_ratio: float = 1.0
    zero_rad: float = 0.0
    angle_bound_rad: float = 0.0
    settling_rad: float = 0.0
    centre_bound_mm: float = 0.0

    @classmethod
    def of(cls, rig: RigFile) -> Self:
        """Stage of a rig file."""
        spec = rig.stage
        if spec is None:
            return cls()
        lo, hi = spec.range_deg
        ratio = abs(spec.gear_ratio)
        return cls(
            spec.centre_mm,
            (math.radians(lo), math.radians(hi)),
            spec.gear_ratio,
            math.radians(spec.zero_deg) - math.pi,
            math.radians(spec.backlash_deg + spec.bound_deg) + TICK_RAD / 2 / ratio,
            AIM_TOLERANCE_RAD / ratio,
            spec.centre_bound_mm,
        )

    @property
    def turns(self) -> bool:
        """True if there is a range in which it can turn."""
        return self.range_rad[0] < self.range_rad[1]

    def servo_rad(self, angle_rad: float) -> float:
        """Servo angle for a stage angle."""
        return self.zero_rad + self.gear_ratio * angle_rad

    def turn(self, servo_rad: float) -> Turn:
        """Turn of the ring for a servo angle."""
        angle = (servo_rad - self.servo_rad(0.0)) / self.gear_ratio
        return Turn(self.centre_mm, angle, self.angle_bound_rad, self.centre_bound_mm)

    def planned_turn(self, angle_rad: float) -> Turn:
        """Turn to an angle that it has been sent to: its bound holds wherever it settles."""
        bound = self.angle_bound_rad + self.settling_rad
        return Turn(self.centre_mm, angle_rad, bound, self.centre_bound_mm)

    def turning_s(self, angle_rad: float) -> float:
        """Rough time to turn from 0."""
        return abs(self.gear_ratio * angle_rad) / _STAGE_SPEED_RAD_S


@dataclass(frozen=True, eq=False)
class HostStage:
    """The stage and its servo; `servos` is empty without a stage."""

    stage: Stage
    servos: tuple[Servo, ...]

    @classmethod
    def of(cls, rig: RigFile, bus: Bus) -> Self:
        """Stage of a rig on its bus. Nothing is sent."""
        stage = Stage.of(rig)
        if rig.stage is None:
            return cls(stage, ())
        ends = [stage.servo_rad(angle) for angle in stage.range_rad]
        return cls(stage, (_servo(bus, rig.stage, ends),))

    def limits(self) -> dict[Servo, ServoLimits]:
        """Limits of its servo."""
        return {
            servo: ServoLimits(OperatingMode.POSITION, min(_STAGE_CURRENT_A, servo.model.largest_current_a))
            for servo in self.servos
        }

    def prepare(self) -> None:
        """Write mode and limits; torque is off."""
        for servo, limits in self.limits().items():
            limits.write(servo)
            servo.set_profile(_STAGE_SPEED_RAD_S, _STAGE_ACCELERATION_RAD_S2)

    def goals(self, angle_rad: float) -> dict[Servo, float]:
        """Servo angles for a stage angle."""
        return {servo: self.stage.servo_rad(angle_rad) for servo in self.servos}

    def turn(self, states: Mapping[int, ServoState]) -> Turn:
        """Turn of the ring, as its servo says."""
        for servo in self.servos:
            return self.stage.turn(states[servo.dxl_id].position_rad)
        return Turn()


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
    """A finger's mechanism and its servos, the one next to the base first."""

    mechanism: Mechanism
    servos: tuple[ServoSettings, ServoSettings]


def finger_settings(rig: RigFile, bus: Bus) -> list[FingerSettings]:
    """Every finger. Nothing is sent."""
    found = []
    for spec in rig.fingers:
        mechanism = mechanism_of(spec)
        limits = drive_of(mechanism, rig, bus).limits()
        near, far = (
            ServoSettings(f"{spec.name} {joint}", servo, limits[servo])
            for joint, servo in zip(spec.servos, limits, strict=True)
        )
        found.append(FingerSettings(mechanism, (near, far)))
    return found


def start_problems(
    rig: RigFile, fingers: Sequence[FingerSettings], states: Mapping[int, ServoState]
) -> dict[str, str | None]:
    """Reason why each finger must not start from where it stands, by name; None if it may.

    Fingers whose servos have not both told where they are are left out.
    """
    found = {}
    for finger in fingers:
        near, far = (item.servo.dxl_id for item in finger.servos)
        if near in states and far in states:
            at = states[near].position_rad, states[far].position_rad
            radius = rig.clear_radius_mm
            found[finger.mechanism.spec.name] = finger.mechanism.start_problem(
                radius, (near, far), at, is_homed=True
            )
    return found


def servo_settings(rig: RigFile, bus: Bus) -> list[ServoSettings]:
    """All of them, the stage's first. Nothing is sent."""
    stage = HostStage.of(rig, bus).limits().items()
    fingers = [servo for finger in finger_settings(rig, bus) for servo in finger.servos]
    return [*(ServoSettings("stage", servo, limits) for servo, limits in stage), *fingers]


_NORMAL_HALF_RAD = math.radians(12.5)  # 99 of 100 touches of the emulated bench are no blunter than 11.5°
_SERVO_STOP_S = 0.010  # from the goal that stops a servo to its standing still


def dent_allowance_mm(finger: FingerConfig, closing: ClosingConfig) -> float:
    """Allowance for what an ordinary slow touch adds to the kinematics' bound of its contact and its path.

    The tip presses with the threshold's force and what comes on top until it stands: two sample periods and
    the servo's own stop. The force is known to within the gains' spread and the crosstalk. In a notch the
    dent may be along a normal that is not known, so the whole dent counts sideways.
    """
    tip = finger.tip
    late_s = 2 / closing.sample_rate_hz + _SERVO_STOP_S
    stiffest = stiffest_n_per_mm(tip)
    force = min(
        closing.contact_force_n + stiffest * closing.touch_speed_mm_s * late_s,
        largest_on_skin_n(tip, closing),
    )
    unsure = measured_force_share(finger) * force
    deepest = (force + unsure) / softest_n_per_mm(tip)
    shallowest = max(force - unsure, 0.0) / stiffest
    bent = deflection_mm(finger, max(force + unsure, undetected_force_n(closing)))
    if tip.kind.has_face:
        return _pad_place_bound_mm(finger, deepest) + undetected_dent_mm(finger, closing) + bent
    return (deepest - shallowest) / 2 + deepest + undetected_dent_mm(finger, closing) + bent


def _pad_place_bound_mm(finger: FingerConfig, deepest_mm: float) -> float:
    """Distance of what presses on a pad's skin from the middle of a column and of the dent, at most.

    And what the place of a column is off by where the face does not look as it should, and that of an edge.
    """
    tilt = kinematics_of(finger).direction_bound_rad + array_bound_rad(finger)
    return math.hypot((finger.array.pitch_mm or 0.0) / 2, deepest_mm / 2) + (
        tilt * finger.tip.radius_mm + finger.tip.radius_bound_mm
    )


def resolution_of(rig: RigFile) -> Resolution:
    """Resolution of the rig, for planning: by how much two measurements of one thing may differ."""
    bounds = []
    for finger in rig.fingers:
        # A measured contact adds its dent's uncertainty, at the threshold's force, to the kinematics' bound.
        dent = rig.closing.contact_force_n / (finger.tip.stiffness_n_per_mm * finger.tip.least_share)
        if finger.tip.kind.has_face:
            dent = _pad_place_bound_mm(finger, dent)
        bent = deflection_mm(finger, rig.closing.contact_force_n)
        bounds.append(mechanism_of(finger).middle_bound_mm + dent + bent + tip_bound_mm(finger))
    # An arm that does not get to the middle has no bound there.
    bounds = [bound for bound in bounds if math.isfinite(bound)] or [0.0]
    turned = max(_normal_error_rad(finger, rig.closing.contact_force_n) for finger in rig.fingers)
    return Resolution(distance_mm=2 * max(bounds), normal_half_rad=min(_NORMAL_HALF_RAD + turned, math.pi))


def _normal_error_rad(finger: FingerConfig, force_n: float) -> float:
    """Error of a normal besides what the array shows, at a force."""
    if not finger.array.has_device:
        return math.pi
    return array_bound_rad(finger) + shear_rad(finger.tip, force_n) + deflection_rad(finger, force_n)
