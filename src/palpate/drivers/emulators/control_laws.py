"""What drives an emulated servo's motor outside plain proportional position control, one step at a time.

Current, Velocity and PWM Control Mode, and what the I and D gains add to the position loop. Each law gives
the duty (−1…1) of the next step; `servo_motion` turns it into current and torque and keeps the limits.
Gains convert as the e-Manual says ("Velocity PI Gain", "Position PID Gain"). How often the firmware's loops
run it does not say: a period of 1 ms is a guess. The feedforward gains have no effect.
"""

import math
from collections.abc import Callable

__all__ = ["LOOP_S", "Law", "PositionTerms", "VelocityLaw", "current_law", "duty_law"]

LOOP_S = 1e-3
"""Period of the firmware's control loops in s; a guess."""


Law = Callable[[float, float, float, float, float], float]
"""A control law: the duty of the next step, from its length (s), the velocity (rad/s), the duty at which no
current flows, the current (A) at full duty and standstill, and the largest duty."""


def _within(value: float, limit: float) -> float:
    return limit if value > limit else -limit if value < -limit else value


def current_law(goal_a: float) -> Law:
    """Current Control Mode: the duty that lets `goal_a` flow, as far as there is voltage for it."""
    return lambda _dt, _velocity, back_emf, drive_a, limit: _within(goal_a / drive_a + back_emf, limit)


def duty_law(goal: float) -> Law:
    """PWM Control Mode: the duty as it is asked for."""
    return lambda _dt, _velocity, _back_emf, _drive_a, limit: _within(goal, limit)


class VelocityLaw:
    """Velocity Control Mode: a ramp towards the goal, and a PI loop that follows it.

    `p` and `i`: duty per rad/s of error, and duty per rad/s and s. `reference_rad_s` is where the ramp is.
    """

    def __init__(self, p: float, i: float) -> None:
        self.p = p
        self.i = i
        self.goal_rad_s = 0.0
        self.reference_rad_s = 0.0
        self._rate = math.inf
        self._integral = 0.0

    def go(self, goal_rad_s: float, rate_rad_s2: float) -> None:
        """Ramp to a velocity from where the ramp is now; an infinite rate is a step."""
        self.goal_rad_s = goal_rad_s
        self._rate = rate_rad_s2

    def stop(self) -> None:
        """Want to stand still, at once."""
        self.goal_rad_s = self.reference_rad_s = 0.0

    def __call__(
        self, dt: float, velocity: float, _back_emf: float, _drive_a: float, limit: float, /
    ) -> float:
        """Duty of the next step, as of any `Law`."""
        self.reference_rad_s += _within(self.goal_rad_s - self.reference_rad_s, self._rate * dt)
        error = self.reference_rad_s - velocity
        integral = self._integral + self.i * error * dt
        wanted = self.p * error + integral
        held = _within(wanted, limit)
        if wanted == held or (wanted - held) * error < 0.0:  # no windup while the limit holds
            self._integral = integral
        return held


class PositionTerms:
    """What I and D gains add to the position loop: duty per rad and s, and duty per rad/s."""

    def __init__(self, i: float, d: float) -> None:
        self.i = i
        self.d = d
        self._integral = 0.0

    def duty(self, dt: float, error: float, error_rate: float, limit: float) -> float:
        """Duty to add in a step of `dt` s, at an error in rad that changes by `error_rate` rad/s."""
        self._integral = _within(self._integral + self.i * error * dt, limit)
        return self._integral + self.d * error_rate
