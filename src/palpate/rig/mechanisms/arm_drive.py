"""Drive of an arm: goals streamed to both servos, and currents that limit the force at the tip.

The servos have no profile: every sample period they get the place where the tip should be by then, on a
straight line or on the circle where tips wait, with a ramp at either end. Both servos lag behind their goals
by the same time, so the lag does not bend the way. No finger may press harder than max_force_n: an arm's
Goal Currents are the largest that cannot exceed it in any posture of the next stretch of the way
(`ArmKinematics.largest_torques_nm`), set before it begins.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from palpate.base.geometry import Floats
from palpate.drivers.arm_kinematics import ArmKinematics
from palpate.drivers.dynamixel import OperatingMode, Servo, ServoGoals
from palpate.drivers.kinematics import Line, Servos
from palpate.rig.mechanisms.mechanism import CIRCLE_SPEED_MM_S, ServoLimits

MIN_FORCE_TRANSMISSION = 0.25
"""Least `ArmKinematics.force_transmission` of a posture: torques that a part can bear still move the arm."""

_ACCELERATION_MM_S2 = 100.0
_CURRENT_STRETCH_MM = 8.0
_TRACKING_LAG_MM = 4.0
_POSTURES_PER_STRETCH = 4  # looked at in a stretch

Place = tuple[float, float]


def point_on_circle(radius_mm: float, angle_rad: float) -> Place:
    """Place on the circle round W's origin."""
    return radius_mm * math.cos(angle_rad), radius_mm * math.sin(angle_rad)


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
        first_s = (top - self.entry_mm_s) ** 2 / (2 * top * _ACCELERATION_MM_S2)
        first_s = math.copysign(first_s, top - self.entry_mm_s)
        return self.length_mm / top + top / 2 / _ACCELERATION_MM_S2 + first_s

    def travel_mm(self, now: float) -> float:
        """Travel that the tip should have made."""
        after = min(max(now - self.begun_s, 0.0), self.duration_s)
        left = self.duration_s - after
        top = self._top_mm_s
        change = top - self.entry_mm_s
        ramp = abs(change) / _ACCELERATION_MM_S2
        if after < ramp:
            return self.entry_mm_s * after + math.copysign(_ACCELERATION_MM_S2 * after**2 / 2, change)
        if left < top / _ACCELERATION_MM_S2:
            return self.length_mm - _ACCELERATION_MM_S2 * left**2 / 2
        return top * after - change * ramp / 2

    def slowed(self, speed_mm_s: float, now: float) -> "_TrapezoidalProfile":
        """The rest of the way at a lower speed; this one where it could not stop in time then."""
        gone, entry = self.travel_mm(now), self._speed_mm_s(now)
        left_mm = self.length_mm - gone
        if entry <= speed_mm_s or entry**2 / 2 / _ACCELERATION_MM_S2 >= left_mm:
            return self
        return _TrapezoidalProfile(
            lambda travel: self.posture(gone + travel), left_mm, speed_mm_s, now, entry
        )

    def _speed_mm_s(self, now: float) -> float:
        after = max(now - self.begun_s, 0.0)
        left = max(self.duration_s - after, 0.0)
        return min(self._top_mm_s, self.entry_mm_s + _ACCELERATION_MM_S2 * after, _ACCELERATION_MM_S2 * left)

    @property
    def _top_mm_s(self) -> float:
        return min(self.speed_mm_s, math.sqrt(_ACCELERATION_MM_S2 * self.length_mm))


class ArmDrive:
    """Both servos in current-based position mode, with streamed goals."""

    streams = True

    def __init__(
        self, servos: tuple[Servo, Servo], kinematics: ArmKinematics, wait_mm: float, force_n: float
    ) -> None:
        """`wait_mm`: radius of the circle where the tip waits; `force_n`: it never presses harder."""
        self._servos = servos
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
        """Write nothing: between approaches an arm is where it waits already."""
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

        return self._begin(self._motion_of(place, inward + arc, CIRCLE_SPEED_MM_S, now))

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
        """Slow down from the next goal on."""
        if self._motion is not None and (slower := self._motion.slowed(speed_mm_s, now)) is not self._motion:
            return self._begin(slower)
        return self.goals(now)

    def slowing_mm(self, from_mm_s: float, to_mm_s: float) -> float:
        """Travel on the ramp of the streamed goals, which the tip lags behind."""
        return max(from_mm_s**2 - to_mm_s**2, 0.0) / 2 / _ACCELERATION_MM_S2

    def goals(self, now: float) -> ServoGoals:
        """Goals of both servos now."""
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

    def tolerance_rad(self, servo: Servo, gap_mm: float) -> float:
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
