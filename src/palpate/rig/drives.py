"""Drives: the goals of a finger's servos, and when each is due.

A `Drive` is given a path; a mover asks it every sample for the goals to write then (`goals`), and at the end
where its servos should stand (`targets`). A slide has one goal for a whole way, with the servo's own
speed profile. Limits are written before torque goes on.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

from palpate.drivers.dynamixel.control_table import OperatingMode
from palpate.drivers.dynamixel.guarded import ServoGoals
from palpate.drivers.dynamixel.servo import Servo
from palpate.drivers.finger import TICK_RAD, Line, Servos
from palpate.drivers.slide_finger import SlideKinematics

__all__ = [
    "ACCELERATION_RAD_S2",
    "AIM_CURRENT_A",
    "AIM_SPEED_RAD_S",
    "AIM_TOLERANCE_RAD",
    "ARM_AIM_SPEED_MM_S",
    "STREAM_TOLERANCE_RAD",
    "Drive",
    "Limits",
    "SlideDrive",
]

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
class Limits:
    """What a servo's EEPROM must say before torque goes on: runs write it, set-up and check know it."""

    mode: OperatingMode
    current_a: float

    def write(self, servo: Servo) -> None:
        """Write what differs, with torque off, and read it back."""
        servo.prepare(self.mode, self.current_a)

    def eeprom(self, servo: Servo) -> dict[str, int]:
        """The items and their values. Raises ValueError for a current that the model cannot keep."""
        return servo.eeprom(self.mode, self.current_a)


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

    def limits(self) -> Mapping[Servo, Limits]:
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

    def limits(self) -> Mapping[Servo, Limits]:
        """The slide's current allows the largest force at the tip."""
        return {
            self._aim: Limits(OperatingMode.POSITION, AIM_CURRENT_A),
            self._slide: Limits(OperatingMode.CURRENT_BASED_POSITION, self._current_a()),
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
