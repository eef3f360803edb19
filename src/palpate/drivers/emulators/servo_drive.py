"""Drive of an emulated servo: joins control table and shaft, units to rad, ticks to turns, modes to laws.

Between `servo_firmware` (reads, writes, protection) and `servo_motion` (mechanics). Units and resets are
those of the e-Manual. Reverse Mode turns everything round that has a direction: ticks count from 2048 the
other way.
"""

import math
from enum import IntEnum

from palpate.drivers.dynamixel.control_table import GAINS, OperatingMode
from palpate.drivers.emulators.servo_motion import (
    LOOP_PERIOD_S,
    Law,
    PositionTerms,
    ShaftMotion,
    VelocityLaw,
    current_law,
    duty_law,
)
from palpate.drivers.emulators.servo_table import ControlTable

_POSITION_MODES = (
    OperatingMode.POSITION,
    OperatingMode.EXTENDED_POSITION,
    OperatingMode.CURRENT_BASED_POSITION,
)

GOAL_OF_MODE: dict[int, str] = {
    OperatingMode.CURRENT: "Goal Current",
    OperatingMode.VELOCITY: "Goal Velocity",
    OperatingMode.POSITION: "Goal Position",
    OperatingMode.EXTENDED_POSITION: "Goal Position",
    OperatingMode.CURRENT_BASED_POSITION: "Goal Position",
    OperatingMode.PWM: "Goal PWM",
}
"""By Operating Mode, the item whose update is a command; in other modes it may be a limit."""

REVERSE, TIME_BASED, TORQUE_ON_BY_GOAL = 0x01, 0x04, 0x08  # bits of Drive Mode

_TICKS = 4096
_ZERO_TICK = 2048
_RAD_PER_TICK = 2 * math.pi / _TICKS
_VELOCITY_UNIT = 0.229 * 2 * math.pi / 60  # rad/s
_ACCELERATION_UNIT = 214.577 * 2 * math.pi / 3600  # rad/s²
_FULL_DUTY = 885
_INVERSE_ROUNDS = 4  # errors of a few degrees are below a tick's hundredth then
_IN_POSITION_TICKS = 5  # the manual says "a predefined value"
_SINGLE_TURN_OFFSET = 1024  # largest Homing Offset that counts in Position Control Mode


class _ProfileType(IntEnum):
    """Profile Type, bits 4 and 5 of Moving Status."""

    NONE = 0
    RECTANGULAR = 1
    TRIANGULAR = 2
    TRAPEZOIDAL = 3


class ServoDrive:
    """Settings from the table to the shaft, measurements from the shaft to the table."""

    def __init__(self, table: ControlTable, motion: ShaftMotion, current_unit_a: float) -> None:
        self._table = table
        self._motion = motion
        self._current_unit_a = current_unit_a
        self._turn_ticks = 0
        self._sign = 1
        self._profile = _ProfileType.NONE
        self._velocity = VelocityLaw(0.0, 0.0)
        self._extras = PositionTerms(0.0, 0.0, 0.0)
        self._reported: tuple[float, ...] = ()
        self.zero_tick = _ZERO_TICK
        """What the encoder counts at shaft angle 0."""
        self._encoder_waves: tuple[tuple[float, float], ...] = ()

    def set_encoder(self, *waves: tuple[float, float]) -> None:
        """Let the encoder be off by sines of one, two … periods a turn: amplitudes and phases (rad).

        Loop and items see its reading. A profile runs evenly in the shaft's angle.
        """
        self._encoder_waves = waves
        self._reported = ()

    def power_up(self) -> None:
        """Begin with the table as it is after a start: turns are lost, nothing moves."""
        self._reset()
        self.forget_turns()
        self._hold_here()

    def change_mode(self) -> None:
        """Do what the manual says a change of Operating Mode does."""
        self._reset()
        mode = self._mode()
        if mode == OperatingMode.CURRENT_BASED_POSITION:
            # the manual resets it "properly" for this mode and gives no value
            self._table.reset("PWM Limit")
            self._table.set("Goal PWM", self._table.get("PWM Limit"))
        if mode == OperatingMode.POSITION:
            self.forget_turns()
        self._hold_here()

    def change_direction(self) -> None:
        """Take over Reverse Mode; the angle is known within one turn again."""
        self.forget_turns()
        self._hold_here()

    def configure(self) -> None:
        """Hand the drive settings of the table to the motion."""
        table, mode = self._table, self._mode()
        current = table.get("Current Limit")
        if mode == OperatingMode.CURRENT_BASED_POSITION:
            current = min(current, abs(table.get("Goal Current")))
        pwm = table.get("PWM Limit")
        if mode != OperatingMode.PWM:
            pwm = min(pwm, abs(table.get("Goal PWM")))
        self._motion.configure(
            gain_per_rad=table.get("Position P Gain") / 128 / _FULL_DUTY / _RAD_PER_TICK,
            duty_limit=pwm / _FULL_DUTY,
            # voltage is all that PWM Control Mode controls
            current_limit_a=math.inf if mode == OperatingMode.PWM else current * self._current_unit_a,
            extras=self._position_extras(),
        )
        self._motion.law = self._law(mode)
        if not self._drive_mode() & TIME_BASED:
            self._motion.set_profile(*self._rates())

    def engage(self) -> None:
        """Switch torque on where the shaft is.

        Not in the manual: a goal from before does not move the shaft. Goal Position becomes the present one,
        and what the mode commands otherwise becomes 0, so that switching on never jumps.
        """
        if self._motion.driven:
            return
        mode = self._mode()
        if mode == OperatingMode.POSITION:
            self.forget_turns()
        if mode not in _POSITION_MODES:
            self._table.set(GOAL_OF_MODE[mode], 0)
        self._velocity = VelocityLaw(0.0, 0.0)
        self.configure()
        self._motion.engage()
        self._profile = _ProfileType.NONE
        self._table.set("Goal Position", self.present_tick())

    def stop(self) -> None:
        """Stop as Bus Watchdog does when it trips: goal and profile items go to 0, a position is held."""
        table, mode = self._table, self._mode()
        self._motion.hold()
        table.set("Profile Velocity", 0)
        table.set("Profile Acceleration", 0)
        if mode not in _POSITION_MODES:
            table.set(GOAL_OF_MODE[mode], 0)
        self._velocity.stop()
        self._hold_here()

    def command(self) -> None:
        """Carry out the goal item of the present mode, if torque is on."""
        self.configure()
        if not self._motion.driven:
            return
        mode = self._mode()
        if mode in _POSITION_MODES:
            self._move_to(self._table.get("Goal Position"))
        elif mode == OperatingMode.VELOCITY:
            goal = self._table.get("Goal Velocity") * _VELOCITY_UNIT * self._sign
            self._velocity.go(goal, self._ramp(goal))

    def clear_turns(self) -> None:
        """Do what Clear does to the turns; a shaft that is held stays where it is."""
        self.forget_turns()
        self._table.set("Goal Position", self.present_tick())

    def forget_turns(self) -> None:
        """Take the present angle for one within the turn 0…4095."""
        self._sign = -1 if self._drive_mode() & REVERSE else 1
        self._turn_ticks = self._encoder() // _TICKS * _TICKS

    def present_tick(self) -> int:
        """Present Position."""
        return self._encoder() - self._turn_ticks + self._homing_offset()

    @property
    def moving(self) -> bool:
        """True if item Moving reads 1."""
        speed = abs(round(self._motion.velocity_rad_s / _VELOCITY_UNIT))
        return speed > self._table.get("Moving Threshold") or self._motion.profile_ongoing

    def refresh(self) -> None:
        """Bring the items that report the shaft up to date."""
        table, motion, sign = self._table, self._motion, self._sign
        seen = (table.changes, *motion.state, self._velocity.reference_rad_s, self._turn_ticks, self._profile)
        if seen == self._reported:
            return
        following = self._velocity.reference_rad_s if motion.law is self._velocity else motion.reference_rad_s
        shift = self.zero_tick - self._turn_ticks + self._homing_offset()
        table.show(
            {
                "Moving": int(self.moving),
                "Moving Status": self._moving_status(),
                "Present PWM": sign * round(motion.duty * _FULL_DUTY),
                "Present Current": sign * round(motion.current_a / self._current_unit_a),
                "Present Velocity": sign * round(motion.velocity_rad_s / _VELOCITY_UNIT),
                "Present Position": round(sign * self.read_rad(motion.shaft_rad) / _RAD_PER_TICK) + shift,
                "Velocity Trajectory": sign * round(following / _VELOCITY_UNIT),
                "Position Trajectory": round(sign * self.read_rad(motion.reference_rad) / _RAD_PER_TICK)
                + shift,
            }
        )
        self._reported = seen

    def _moving_status(self) -> int:
        motion = self._motion
        status = int(motion.profile_ongoing) << 1 | self._profile << 4
        if self._mode() in _POSITION_MODES:
            status |= int(abs(motion.goal_rad - motion.shaft_rad) / _RAD_PER_TICK <= _IN_POSITION_TICKS)
            # the manual gives no number: this is where the loop has no more voltage to give
            lag = abs(motion.reference_rad - motion.shaft_rad) / _RAD_PER_TICK
            status |= int(lag * self._table.get("Position P Gain") / 128 > _FULL_DUTY) << 3
        return status

    def _mode(self) -> int:
        return self._table.get("Operating Mode")

    def _reset(self) -> None:
        """The part of a change of mode that a start has too."""
        table = self._table
        for name in GAINS:
            table.reset(name)
        table.set("Profile Velocity", 0)
        table.set("Profile Acceleration", 0)
        table.set("Goal PWM", table.get("PWM Limit"))
        table.set("Goal Current", table.get("Current Limit"))
        table.set("Goal Velocity", 0)
        self._velocity.stop()

    def _hold_here(self) -> None:
        self._table.set("Goal Position", self.present_tick())
        self._profile = _ProfileType.NONE
        self.configure()

    def _law(self, mode: int) -> Law | None:
        table, sign = self._table, self._sign
        if mode == OperatingMode.CURRENT:
            return current_law(sign * table.get("Goal Current") * self._current_unit_a)
        if mode == OperatingMode.PWM:
            return duty_law(sign * table.get("Goal PWM") / _FULL_DUTY)
        if mode == OperatingMode.VELOCITY:
            per_unit = 1.0 / _FULL_DUTY / _VELOCITY_UNIT
            self._velocity.p = table.get("Velocity P Gain") / 128 * per_unit
            self._velocity.i = table.get("Velocity I Gain") / 65536 / LOOP_PERIOD_S * per_unit
            return self._velocity
        return None

    def _position_extras(self) -> PositionTerms | None:
        table, per_rad = self._table, 1.0 / _FULL_DUTY / _RAD_PER_TICK
        i, d = table.get("Position I Gain"), table.get("Position D Gain")
        forward = table.get("Feedforward 1st Gain")
        if i == d == forward == 0:
            return None
        per_rate = LOOP_PERIOD_S * per_rad
        wanted = i / 65536 / LOOP_PERIOD_S * per_rad, d / 16 * per_rate, forward / 4 * per_rate
        if (self._extras.i, self._extras.d, self._extras.forward) != wanted:
            self._extras = PositionTerms(*wanted)
        return self._extras

    def _move_to(self, tick: int) -> None:
        absolute = tick - self._homing_offset() + self._turn_ticks
        goal = self.angle_rad((absolute - self.zero_tick) * _RAD_PER_TICK * self._sign)
        distance = abs(goal - self._motion.reference_rad)
        velocity, acceleration = self._rates()
        if self._drive_mode() & TIME_BASED:
            span, rise = self._table.get("Profile Velocity"), self._table.get("Profile Acceleration")
            velocity, acceleration = _timed_profile(span * 1e-3, rise * 1e-3, distance)
            self._motion.set_profile(velocity, acceleration)
        self._profile = _profile_shape(velocity, acceleration, distance)
        self._motion.move_to(goal)

    def _rates(self) -> tuple[float, float]:
        """Profile Velocity in rad/s and Profile Acceleration in rad/s²."""
        table = self._table
        velocity = min(table.get("Profile Velocity"), table.get("Velocity Limit"))
        return velocity * _VELOCITY_UNIT, table.get("Profile Acceleration") * _ACCELERATION_UNIT

    def _ramp(self, goal_rad_s: float) -> float:
        """Acceleration (rad/s²) towards a Goal Velocity; infinite without Profile Acceleration."""
        rate = self._table.get("Profile Acceleration")
        if rate == 0:
            return math.inf
        if self._drive_mode() & TIME_BASED:
            return abs(goal_rad_s - self._velocity.reference_rad_s) / (rate * 1e-3)
        return rate * _ACCELERATION_UNIT

    def _drive_mode(self) -> int:
        return self._table.get("Drive Mode") if "Drive Mode" in self._table else 0

    def _homing_offset(self) -> int:
        offset = self._table.get("Homing Offset")
        if self._mode() == OperatingMode.POSITION and abs(offset) > _SINGLE_TURN_OFFSET:
            return 0
        return offset

    def _encoder(self) -> int:
        return round(self._sign * self.read_rad(self._motion.shaft_rad) / _RAD_PER_TICK) + self.zero_tick

    def read_rad(self, shaft_rad: float) -> float:
        """Angle that the encoder says of the shaft."""
        waves = enumerate(self._encoder_waves, start=1)
        return shaft_rad + sum(size * math.sin(k * shaft_rad + phase) for k, (size, phase) in waves)

    def angle_rad(self, read_rad: float) -> float:
        """Angle of the shaft of which the encoder says `read_rad`."""
        shaft = read_rad
        for _ in range(_INVERSE_ROUNDS if self._encoder_waves else 0):
            shaft += read_rad - self.read_rad(shaft)
        return shaft


def _profile_shape(velocity: float, acceleration: float, distance: float) -> _ProfileType:
    """Shape of a profile over `distance` from standstill: e-Manual, "What is the Profile".

    0 velocity means none, 0 acceleration infinite. All three in units that belong together.
    """
    if velocity == 0.0:
        return _ProfileType.NONE
    if acceleration == 0.0:
        return _ProfileType.RECTANGULAR
    return (
        _ProfileType.TRIANGULAR if distance * acceleration < velocity * velocity else _ProfileType.TRAPEZOIDAL
    )


def _timed_profile(span_s: float, rise_s: float, distance: float) -> tuple[float, float]:
    """Velocity and acceleration that cover `distance` in `span_s`, speeding up for `rise_s`.

    The rise is at most half the span. (0, 0), a step, for a span of 0; acceleration 0 is an infinite one.
    A profile that begins in motion takes longer or shorter: the manual reckons from standstill.
    """
    if span_s <= 0.0 or distance <= 0.0:
        return 0.0, 0.0
    rise_s = min(rise_s, span_s / 2)
    velocity = distance / (span_s - rise_s)
    if rise_s <= 0.0:
        return velocity, 0.0
    # a trace above what is exact, so that rounding does not turn half the span into a triangle cut short
    return velocity, math.nextafter(velocity / rise_s, math.inf)
