"""Drives: the goals of a finger's servos, when each is due, and where the tip waits between approaches.

A `Drive` is given a path; a mover asks it every sample for the goals to write then (`goals`), and at the end
where its servos should stand (`targets`). Limits are written before torque goes on.

A slide has one goal for a whole way, with the servo's own speed profile. An arm's servos have no profile:
every sample period they get the place where the tip should be by then, on a straight line or on the circle
where tips wait, with a ramp at either end. Both servos lag behind their goals by the same time, so the lag
does not bend the way. No finger may press harder than max_force_n: an arm's Goal Currents are the largest
that cannot exceed it in any posture of the next stretch of the way (`ArmKinematics.largest_torques_nm`), set
before it begins.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from palpate.base.errors import InputError
from palpate.base.geometry import Floats
from palpate.config import ARM_MARGIN_MM, ArmFingerConfig, SlideFingerConfig
from palpate.drivers.arm_kinematics import ArmKinematics
from palpate.drivers.dynamixel import OperatingMode, Servo, ServoGoals
from palpate.drivers.kinematics import TICK_RAD, Line, Servos
from palpate.drivers.slide_kinematics import SlideKinematics
from palpate.rig.conversion import slide_kinematics

AIM_CURRENT_A = 0.6
AIM_TOLERANCE_RAD = 4 * TICK_RAD
"""How near to its goal an aiming servo must settle. Friction holds the emulated one 2 to 3 steps off."""

STREAM_TOLERANCE_RAD = 2 * TICK_RAD
"""How far a servo that is steered along a line is off it. 1.4 steps were seen on the emulated bench."""

AIM_SPEED_RAD_S = 3.0
ARM_AIM_SPEED_MM_S = 40.0
"""Speed of an arm's tip on the circle where it waits."""

ACCELERATION_RAD_S2 = 6.0


@dataclass(frozen=True, slots=True)
class ServoLimits:
    """What a servo's EEPROM must say before torque goes on: runs write it, set-up and check know it."""

    mode: OperatingMode
    current_a: float

    def write(self, servo: Servo) -> None:
        """Write what differs, with torque off, and read it back. Raises InputError as `eeprom`."""
        self.eeprom(servo)
        servo.prepare(self.mode, self.current_a)

    def eeprom(self, servo: Servo) -> dict[str, int]:
        """The items and their values. Raises InputError for limits that the model cannot keep."""
        try:
            wanted = servo.eeprom(self.mode, self.current_a)
        except ValueError as error:
            do = "lower max_force_n in the rig file, or take a stronger model"
            raise InputError(f"{error}; {do}") from error
        try:
            for name, value in wanted.items():
                servo.model.check(name, value)
        except ValueError as error:
            do = "correct zero or range of its joint in the rig file, or mount its horn turned"
            raise InputError(f"{error} (servo {servo.dxl_id}); {do}") from error
        return wanted


class Drive(Protocol):
    """What moves one finger.

    Parameters are given by position, so that a kind of drive may name those that it does not use `_…`.
    """

    @property
    def servos(self) -> tuple[Servo, Servo]:
        """Both servos, the one next to the base first."""
        ...

    @property
    def closing_servos(self) -> tuple[Servo, ...]:
        """Those that move while the finger closes."""
        ...

    @property
    def streams(self) -> bool:
        """Whether goals change with time, so that `goals` must be asked every sample."""
        ...

    def limits(self) -> Mapping[Servo, ServoLimits]:
        """What each servo may do."""
        ...

    def prepare(self) -> None:
        """Write modes and limits; torque is off."""
        ...

    def retract(self) -> ServoGoals:
        """Begin to go back to where the finger waits, if it may be elsewhere; what to write at once."""
        ...

    def aim(self, line: Line, present: Servos, now: float, /) -> ServoGoals:
        """Begin to go to where a line starts, from where the finger is; what to write at once."""
        ...

    def go(self, line: Line, from_mm: float, to_mm: float, speed_mm_s: float, now: float, /) -> ServoGoals:
        """Begin to go along a line, on which the finger is at `from_mm`; what to write at once."""
        ...

    def slow_down(self, speed_mm_s: float, now: float, /) -> ServoGoals:
        """Go on along the line more slowly, without a jerk; what to write at once."""
        ...

    def slowing_mm(self, from_mm_s: float, to_mm_s: float, /) -> float:
        """How far the tip goes while it changes from one speed to a lower one."""
        ...

    def goals(self, now: float, /) -> ServoGoals:
        """What to write now; empty if the servos know enough."""
        ...

    def under_way(self, now: float, /) -> bool:
        """Whether further goals will come."""
        ...

    def targets(self) -> ServoGoals:
        """Where the servos that move should stand at the end."""
        ...

    def reached_rad(self, servo: Servo, gap_mm: float, /) -> float:
        """By how much a servo may be off its target for the tip to be off by about `gap_mm`."""
        ...


class SlideDrive:
    """Aim in position mode, slide in current-based position mode, each with one goal at a time."""

    streams = False

    def __init__(
        self,
        aim: Servo,
        slide: Servo,
        kinematics: SlideKinematics,
        wait_mm: float,
        speed_mm_s: float,
        force_n: float,
        friction_a: float = 0.0,
    ) -> None:
        """`wait_mm`: distance from the base at which the tip waits; it goes back there at `speed_mm_s`.

        `force_n`: the tip never presses harder. `friction_a`: the slide's friction takes this at least.
        """
        self._aim = aim
        self._slide = slide
        self._kinematics = kinematics
        self._wait_mm = wait_mm
        self._speed_mm_s = speed_mm_s
        self._force_n = force_n
        self._friction_a = friction_a
        self._targets: ServoGoals = {}

    @property
    def servos(self) -> tuple[Servo, Servo]:
        """Aim and slide."""
        return self._aim, self._slide

    @property
    def closing_servos(self) -> tuple[Servo, ...]:
        """The slide alone."""
        return (self._slide,)

    def limits(self) -> Mapping[Servo, ServoLimits]:
        """The slide's current allows the largest force at the tip."""
        return {
            self._aim: ServoLimits(OperatingMode.POSITION, AIM_CURRENT_A),
            self._slide: ServoLimits(OperatingMode.CURRENT_BASED_POSITION, self._current_a()),
        }

    def prepare(self) -> None:
        """Write modes and limits, and speeds."""
        for servo, limits in self.limits().items():
            limits.write(servo)
        self._slide.set_goal_current_a(self._current_a())
        self._aim.set_profile(AIM_SPEED_RAD_S, ACCELERATION_RAD_S2)
        self._set_speed(self._speed_mm_s)

    def retract(self) -> ServoGoals:
        """Slide back; the aim stays."""
        self._set_speed(self._speed_mm_s)
        self._targets = {self._slide: self._kinematics.slide_servo_rad(self._wait_mm)}
        return self._targets

    def aim(self, line: Line, _present: Servos, _now: float) -> ServoGoals:
        """Turn; the slide stays where it waits."""
        self._targets = {self._aim: self._kinematics.servos_rad(line, 0.0)[0]}
        return self._targets

    def go(self, line: Line, _from_mm: float, to_mm: float, speed_mm_s: float, _now: float) -> ServoGoals:
        """Slide at a speed, from the next goal on."""
        self._set_speed(speed_mm_s)
        self._targets = {self._slide: self._kinematics.servos_rad(line, to_mm)[1]}
        return self._targets

    def slow_down(self, speed_mm_s: float, _now: float) -> ServoGoals:
        """The same goal again: the servo's profile changes its speed when a goal is written."""
        self._set_speed(speed_mm_s)
        return self._targets

    def slowing_mm(self, from_mm_s: float, to_mm_s: float) -> float:
        """At the profile's acceleration."""
        rate = ACCELERATION_RAD_S2 * abs(self._kinematics.mm_per_rad)
        return max(from_mm_s**2 - to_mm_s**2, 0.0) / 2 / rate

    def goals(self, _now: float) -> ServoGoals:
        """Nothing: one goal is enough."""
        return {}

    def under_way(self, _now: float) -> bool:
        """Never: one goal is enough."""
        return False

    def targets(self) -> ServoGoals:
        """The last goal."""
        return self._targets

    def reached_rad(self, _servo: Servo, gap_mm: float) -> float:
        """Only the slide's is asked for: the aim has a tolerance of its own."""
        return gap_mm / abs(self._kinematics.mm_per_rad)

    def _current_a(self) -> float:
        lever_m = abs(self._kinematics.mm_per_rad) / 1000
        return self._friction_a + self._force_n * lever_m / self._slide.model.known_torque.nm_per_a

    def _set_speed(self, speed_mm_s: float) -> None:
        self._slide.set_profile(speed_mm_s / abs(self._kinematics.mm_per_rad), ACCELERATION_RAD_S2)


_SLIDE_END_MARGIN_MM = 1.0
_JOINT_END_MARGIN_RAD = math.radians(1.0)  # an arm keeps this far off its joints' ends
MIN_FORCE_TRANSMISSION = 0.25
"""Least `ArmKinematics.force_transmission` of a posture: torques that a part can bear still move the arm."""


def wait_radius_mm(spec: ArmFingerConfig, workspace_radius_mm: float) -> float:
    """Distance from W's origin at which an arm's tip waits."""
    return workspace_radius_mm + spec.tip.radius_mm + ARM_MARGIN_MM


def point_on_circle(radius_mm: float, angle_rad: float) -> tuple[float, float]:
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
        joint.lo_rad + _JOINT_END_MARGIN_RAD <= angle <= joint.hi_rad - _JOINT_END_MARGIN_RAD
        for joint, angle in zip(ranges, angles, strict=True)
    )
    return off_ends and kinematics.force_transmission(servos) >= MIN_FORCE_TRANSMISSION


def wait_distance_mm(spec: SlideFingerConfig, workspace_radius_mm: float) -> float:
    """Furthest distance from the base, coming from the retracted end, with the tip clear of the workspace."""
    kinematics = slide_kinematics(spec)
    lo, hi = spec.slide.range_mm
    clear = workspace_radius_mm + spec.tip.radius_mm
    distances = np.append(lo + _SLIDE_END_MARGIN_MM, np.arange(lo + _SLIDE_END_MARGIN_MM, hi, 1.0))
    angles = kinematics.heading_rad + np.radians(np.linspace(*spec.aim.range_deg, 15))
    x = kinematics.base_mm[0] + distances[:, None] * np.cos(angles)
    y = kinematics.base_mm[1] + distances[:, None] * np.sin(angles)
    outside = np.all(np.hypot(x, y) >= clear, axis=1)
    outside[0] = True
    first_inside = len(outside) if outside.all() else int(np.argmin(outside))
    return float(distances[first_inside - 1])


_ARM_ACCELERATION_MM_S2 = 100.0
_CURRENT_STRETCH_MM = 8.0
_TRACKING_LAG_MM = 4.0
_POSTURES_PER_STRETCH = 4  # looked at in a stretch

Place = tuple[float, float]


@dataclass(frozen=True)
class _TrapezoidalProfile:
    """A way of some length: `posture` by travel, begun at `begun_s`, with a ramp up and down.

    `entry_mm_s`: speed at its begin, from which it slows down; 0 from standing still.
    """

    posture: Callable[[float], Servos]
    length_mm: float
    speed_mm_s: float
    begun_s: float
    entry_mm_s: float = 0.0

    @property
    def duration_s(self) -> float:
        """Time until it stands still."""
        top = self._top_mm_s
        if top <= 0:
            return 0.0
        # What the first ramp lasts longer or shorter than at top speed.
        first_s = (top - self.entry_mm_s) ** 2 / (2 * top * _ARM_ACCELERATION_MM_S2)
        first_s = math.copysign(first_s, top - self.entry_mm_s)
        return self.length_mm / top + top / 2 / _ARM_ACCELERATION_MM_S2 + first_s

    def travel_mm(self, now: float) -> float:
        """How far the tip should be."""
        after = min(max(now - self.begun_s, 0.0), self.duration_s)
        left = self.duration_s - after
        top = self._top_mm_s
        change = top - self.entry_mm_s
        ramp = abs(change) / _ARM_ACCELERATION_MM_S2
        if after < ramp:
            return self.entry_mm_s * after + math.copysign(_ARM_ACCELERATION_MM_S2 * after**2 / 2, change)
        if left < top / _ARM_ACCELERATION_MM_S2:
            return self.length_mm - _ARM_ACCELERATION_MM_S2 * left**2 / 2
        return top * after - change * ramp / 2

    def slowed(self, speed_mm_s: float, now: float) -> "_TrapezoidalProfile":
        """The rest of the way at a lower speed; this one where it could not stop in time then."""
        gone, entry = self.travel_mm(now), self._speed_mm_s(now)
        left_mm = self.length_mm - gone
        if entry <= speed_mm_s or entry**2 / 2 / _ARM_ACCELERATION_MM_S2 >= left_mm:
            return self
        return _TrapezoidalProfile(
            lambda travel: self.posture(gone + travel), left_mm, speed_mm_s, now, entry
        )

    def _speed_mm_s(self, now: float) -> float:
        after = max(now - self.begun_s, 0.0)
        left = max(self.duration_s - after, 0.0)
        return min(
            self._top_mm_s, self.entry_mm_s + _ARM_ACCELERATION_MM_S2 * after, _ARM_ACCELERATION_MM_S2 * left
        )

    @property
    def _top_mm_s(self) -> float:
        return min(self.speed_mm_s, math.sqrt(_ARM_ACCELERATION_MM_S2 * self.length_mm))


class ArmDrive:
    """Both servos in current-based position mode, with streamed goals."""

    streams = True

    def __init__(
        self, shoulder: Servo, elbow: Servo, kinematics: ArmKinematics, wait_mm: float, force_n: float
    ) -> None:
        """`wait_mm`: radius of the circle where the tip waits; `force_n`: it never presses harder."""
        self._servos = (shoulder, elbow)
        self._kinematics = kinematics
        self._wait_mm = wait_mm
        self._force_n = force_n
        self._motion: _TrapezoidalProfile | None = None
        self._limited_mm = 0.0

    @property
    def servos(self) -> tuple[Servo, Servo]:
        """Shoulder and elbow."""
        return self._servos

    @property
    def closing_servos(self) -> tuple[Servo, ...]:
        """Both."""
        return self._servos

    def limits(self) -> Mapping[Servo, ServoLimits]:
        """Currents for the largest force at the tip of a stretched arm."""
        k = self._kinematics
        levers = k.upper_mm + k.fore_mm, k.fore_mm
        joints = k.shoulder, k.elbow
        found = {}
        for servo, joint, lever in zip(self._servos, joints, levers, strict=True):
            torque = self._force_n * lever / 1000 / abs(joint.gear_ratio)
            current = min(torque / servo.model.known_torque.nm_per_a, servo.model.largest_current_a)
            found[servo] = ServoLimits(OperatingMode.CURRENT_BASED_POSITION, current)
        return found

    def prepare(self) -> None:
        """Write modes and limits; until a way begins, currents are those for where the arm must start."""
        for servo, limits in self.limits().items():
            limits.write(servo)
            servo.clear_profile()
        k = self._kinematics
        angle = math.atan2(k.base_mm[1], k.base_mm[0])
        self._limit([k.servos_at(point_on_circle(self._wait_mm, angle))])

    def retract(self) -> ServoGoals:
        """Nothing: between approaches an arm is where it waits already."""
        return {}

    def aim(self, line: Line, present: Servos, now: float) -> ServoGoals:
        """Go straight to the circle, if it is a little off, then along it to where the line starts."""
        x, y = self._kinematics.centre_mm(present)
        away, angle = math.hypot(x, y), math.atan2(y, x)
        turn = math.remainder(math.atan2(line.start_mm[1], line.start_mm[0]) - angle, 2 * math.pi)
        inward = abs(away - self._wait_mm)
        arc = abs(turn) * self._wait_mm

        def place(travel_mm: float) -> Place:
            if travel_mm < inward:
                return point_on_circle(away + math.copysign(travel_mm, self._wait_mm - away), angle)
            share = (travel_mm - inward) / arc if arc > 0 else 1.0
            return point_on_circle(self._wait_mm, angle + turn * min(share, 1.0))

        return self._begin(self._motion_of(place, inward + arc, ARM_AIM_SPEED_MM_S, now))

    def go(self, line: Line, from_mm: float, to_mm: float, speed_mm_s: float, now: float) -> ServoGoals:
        """Go along the line, forward or back."""
        sign = math.copysign(1.0, to_mm - from_mm)

        def place(travel_mm: float) -> Place:
            return line.point_mm(from_mm + sign * travel_mm)

        return self._begin(self._motion_of(place, abs(to_mm - from_mm), speed_mm_s, now))

    def follow(self, postures_rad: Floats, travel_mm: Floats, speed_mm_s: float, now: float) -> ServoGoals:
        """Go through postures (m, 2), at travels (m,) of the tip that ascend from 0; even in between."""
        near, far = postures_rad.T

        def posture(travel: float) -> Servos:
            return float(np.interp(travel, travel_mm, near)), float(np.interp(travel, travel_mm, far))

        return self._begin(_TrapezoidalProfile(posture, float(travel_mm[-1]), speed_mm_s, now))

    def slow_down(self, speed_mm_s: float, now: float) -> ServoGoals:
        """From the next goal on."""
        if self._motion is not None and (slower := self._motion.slowed(speed_mm_s, now)) is not self._motion:
            return self._begin(slower)
        return self.goals(now)

    def slowing_mm(self, from_mm_s: float, to_mm_s: float) -> float:
        """By the ramp of the streamed goals, which the tip lags behind."""
        return max(from_mm_s**2 - to_mm_s**2, 0.0) / 2 / _ARM_ACCELERATION_MM_S2

    def goals(self, now: float) -> ServoGoals:
        """Where both servos should be now."""
        if self._motion is None:
            return {}
        travel = self._motion.travel_mm(now)
        if travel > self._limited_mm:
            self._limit_from(self._motion, travel)
        return self._angles(self._motion.posture(travel))

    def under_way(self, now: float) -> bool:
        """Until the last goal is due."""
        return self._motion is not None and now < self._motion.begun_s + self._motion.duration_s

    def targets(self) -> ServoGoals:
        """Angles at the end of the way."""
        return {} if self._motion is None else self._angles(self._motion.posture(self._motion.length_mm))

    def reached_rad(self, servo: Servo, gap_mm: float) -> float:
        """Each servo may use half of the gap."""
        k = self._kinematics
        joint, lever = (
            (k.shoulder, k.upper_mm + k.fore_mm) if servo is self._servos[0] else (k.elbow, k.fore_mm)
        )
        return gap_mm / 2 / lever * abs(joint.gear_ratio)

    def _begin(self, motion: _TrapezoidalProfile) -> ServoGoals:
        self._motion = motion
        self._limit_from(motion, 0.0)
        return self.goals(motion.begun_s)

    def _limit_from(self, motion: _TrapezoidalProfile, travel_mm: float) -> None:
        """Set currents for the next stretch of a way, and a little before it, because the tip lags behind."""
        self._limited_mm = travel_mm + _CURRENT_STRETCH_MM
        first, last = (
            max(travel_mm - _TRACKING_LAG_MM, 0.0),
            min(self._limited_mm + _TRACKING_LAG_MM, motion.length_mm),
        )
        self._limit([motion.posture(float(at)) for at in np.linspace(first, last, _POSTURES_PER_STRETCH)])

    def _motion_of(
        self, place: Callable[[float], Place], length_mm: float, speed_mm_s: float, now: float
    ) -> _TrapezoidalProfile:
        """Motion of the tip through places."""
        return _TrapezoidalProfile(
            lambda travel: self._kinematics.servos_at(place(travel)), length_mm, speed_mm_s, now
        )

    def _limit(self, postures: list[Servos]) -> None:
        k = self._kinematics
        torques = [k.largest_torques_nm(servos, self._force_n, MIN_FORCE_TRANSMISSION) for servos in postures]
        joints = k.shoulder, k.elbow
        for index, (servo, joint) in enumerate(zip(self._servos, joints, strict=True)):
            torque = min(pair[index] for pair in torques) / abs(joint.gear_ratio)
            current = min(torque / servo.model.known_torque.nm_per_a, servo.model.largest_current_a)
            servo.set_goal_current_a(current)

    def _angles(self, posture: Servos) -> ServoGoals:
        return dict(zip(self._servos, posture, strict=True))
