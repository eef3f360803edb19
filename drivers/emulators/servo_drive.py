"""The drive of an emulated servo: joins control table and shaft, units to rad, ticks to turns.

Between `servo` (instructions, protection) and `servo_motion` (mechanics). Units and resets are those of the
e-Manual, page XM430-W350.
"""

import math

from palpate.drivers.emulators.servo_motion import ShaftMotion
from palpate.drivers.emulators.servo_table import ControlTable

__all__ = ["CURRENT_BASED_MODE", "POSITION_MODE", "ServoDrive"]

POSITION_MODE = 3
CURRENT_BASED_MODE = 5

_TICKS = 4096
_ZERO_TICK = 2048
_RAD_PER_TICK = 2 * math.pi / _TICKS
_VELOCITY_UNIT = 0.229 * 2 * math.pi / 60  # rad/s
_ACCELERATION_UNIT = 214.577 * 2 * math.pi / 3600  # rad/s²
_CURRENT_UNIT = 2.69e-3  # A
_FULL_DUTY = 885
_IN_POSITION_TICKS = 5  # the manual says "a predefined value"


class ServoDrive:
    """Settings from the table to the shaft, measurements from the shaft to the table."""

    def __init__(self, table: ControlTable, motion: ShaftMotion) -> None:
        self._table = table
        self._motion = motion
        self._turn_ticks = 0

    def reset_for_mode(self) -> None:
        """Do what the manual says a change of Operating Mode does."""
        table = self._table
        table.set("Position P Gain", 800)
        table.set("Profile Velocity", 0)
        table.set("Profile Acceleration", 0)
        table.set("Goal PWM", table.get("PWM Limit"))
        table.set("Goal Current", table.get("Current Limit"))
        self.forget_turns()
        table.set("Goal Position", self.present_tick())
        self.configure()

    def configure(self) -> None:
        """Hand the drive settings of the table to the motion."""
        table = self._table
        current = table.get("Current Limit")
        if table.get("Operating Mode") == CURRENT_BASED_MODE:
            current = min(current, abs(table.get("Goal Current")))
        self._motion.configure(
            gain_per_rad=table.get("Position P Gain") / 128 / _FULL_DUTY / _RAD_PER_TICK,
            duty_limit=min(table.get("PWM Limit"), abs(table.get("Goal PWM"))) / _FULL_DUTY,
            current_limit_a=current * _CURRENT_UNIT,
        )
        velocity = min(table.get("Profile Velocity"), table.get("Velocity Limit"))
        acceleration = min(table.get("Profile Acceleration"), table.get("Acceleration Limit"))
        self._motion.set_profile(velocity * _VELOCITY_UNIT, acceleration * _ACCELERATION_UNIT)

    def engage(self) -> None:
        """Switch torque on where the shaft is."""
        if self._motion.driven:
            return
        if self._table.get("Operating Mode") == POSITION_MODE:
            self.forget_turns()
        self.configure()
        self._motion.engage()
        # not in the manual: the goal starts where the shaft is, so that switching on does not jump
        self._table.set("Goal Position", self.present_tick())

    def stop(self) -> None:
        """Hold where the shaft is, as Bus Watchdog does when it trips: profile items go to 0."""
        self._motion.hold()
        self._table.set("Profile Velocity", 0)
        self._table.set("Profile Acceleration", 0)
        self._table.set("Goal Position", self.present_tick())
        self.configure()

    def move_to(self, tick: int) -> None:
        """Go to a Goal Position, if torque is on."""
        self.configure()
        if self._motion.driven:
            absolute = tick - self._table.get("Homing Offset") + self._turn_ticks
            self._motion.move_to((absolute - _ZERO_TICK) * _RAD_PER_TICK)

    def forget_turns(self) -> None:
        """Take the present angle for one within the turn 0…4095."""
        self._turn_ticks = self._encoder() // _TICKS * _TICKS

    def present_tick(self) -> int:
        """Present Position."""
        return self._encoder() - self._turn_ticks + self._table.get("Homing Offset")

    def refresh(self) -> None:
        """Bring the items that report the shaft up to date."""
        table, motion = self._table, self._motion
        velocity = round(motion.velocity_rad_s / _VELOCITY_UNIT)
        fast = abs(velocity) > table.get("Moving Threshold")
        goal_error = abs(motion.goal_rad - motion.shaft_rad) / _RAD_PER_TICK
        shape = 0 if not table.get("Profile Velocity") else 1 if not table.get("Profile Acceleration") else 3
        table.set("Moving", int(fast or motion.profile_ongoing))
        table.set(
            "Moving Status",
            int(goal_error <= _IN_POSITION_TICKS) | int(motion.profile_ongoing) << 1 | shape << 4,
        )
        table.set("Present PWM", round(motion.duty * _FULL_DUTY))
        table.set("Present Current", round(motion.current_a / _CURRENT_UNIT))
        table.set("Present Velocity", velocity)
        table.set("Present Position", self.present_tick())
        table.set("Velocity Trajectory", round(motion.reference_rad_s / _VELOCITY_UNIT))
        shift = _ZERO_TICK - self._turn_ticks + table.get("Homing Offset")
        table.set("Position Trajectory", round(motion.reference_rad / _RAD_PER_TICK) + shift)

    def _encoder(self) -> int:
        return round(self._motion.shaft_rad / _RAD_PER_TICK) + _ZERO_TICK
