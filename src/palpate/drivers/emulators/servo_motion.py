"""Motion of an emulated servo's shaft: profile, control loops, motor and gear, one step at a time.

A DC motor behind its gear, seen at the output shaft, with the firmware's position loop on the motor's voltage
(PWM), and the laws of Current, Velocity and PWM Control Mode. Each law gives the duty (−1…1) of the next
step; `ShaftMotion` turns it into current and torque and keeps the limits. Gains convert as the e-Manual says
("Velocity PI Gain", "Position PID Gain"). The velocity-based profile is the e-Manual's: no Profile Velocity
is a step, no Profile Acceleration a rectangle, both a trapezoid.
"""

import math
from collections.abc import Callable

from palpate.drivers.dynamixel.models import MotorConstants

LOOP_PERIOD_S = 1e-3
"""Period of the firmware's control loops in s; a guess."""


Law = Callable[[float, float, float, float, float], float]
"""A control law: the duty of the next step, from its length (s), the velocity (rad/s), the duty at which no
current flows, the current (A) at full duty and standstill, and the largest duty."""


def _clamp(value: float, limit: float) -> float:
    return limit if value > limit else -limit if value < -limit else value


def current_law(goal_a: float) -> Law:
    """Current Control Mode: the duty that lets `goal_a` flow, as far as there is voltage for it."""
    return lambda _dt, _velocity, back_emf, drive_a, limit: _clamp(goal_a / drive_a + back_emf, limit)


def duty_law(goal: float) -> Law:
    """PWM Control Mode: the duty as it is asked for."""
    return lambda _dt, _velocity, _back_emf, _drive_a, limit: _clamp(goal, limit)


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
        self.reference_rad_s += _clamp(self.goal_rad_s - self.reference_rad_s, self._rate * dt)
        error = self.reference_rad_s - velocity
        integral = self._integral + self.i * error * dt
        wanted = self.p * error + integral
        held = _clamp(wanted, limit)
        if wanted == held or (wanted - held) * error < 0.0:  # no windup while the limit holds
            self._integral = integral
        return held


class PositionTerms:
    """Terms that I, D and Feedforward 1st gains add to the position loop: duty per rad s, and per rad/s."""

    def __init__(self, i: float, d: float, forward: float) -> None:
        self.i = i
        self.d = d
        self.forward = forward
        self._integral = 0.0

    def duty(self, dt: float, error: float, error_rate: float, limit: float) -> float:
        """Duty to add in a step of `dt` s, at an error in rad that changes by `error_rate` rad/s."""
        self._integral = _clamp(self._integral + self.i * error * dt, limit)
        return self._integral + self.d * error_rate


_MAX_STEP_S = 1e-3  # the position loop is stiff; longer steps are split


class ShaftMotion:
    """State of the shaft and of the trajectory that it follows.

    `law` drives the shaft in place of the position loop; None for position.
    """

    __slots__ = (
        "_a_per_rad_s",
        "_drive_a",
        "_extras",
        "_fixed_s",
        "_friction_nm",
        "_gain_per_rad",
        "_inertia",
        "_max_current_a",
        "_nm_per_a",
        "_profile_a",
        "_profile_v",
        "_rest_nm",
        "_rest_share",
        "_stall_a",
        "_u_max",
        "current_a",
        "driven",
        "duty",
        "goal_rad",
        "law",
        "reference_rad",
        "reference_rad_s",
        "shaft_rad",
        "velocity_rad_s",
    )

    def __init__(self, constants: MotorConstants, start_rad: float) -> None:
        self._nm_per_a = constants.stall_torque_nm / constants.stall_current_a
        self._stall_a = constants.stall_current_a
        self._drive_a = constants.stall_current_a
        self._a_per_rad_s = constants.stall_current_a / constants.no_load_rad_s
        self._inertia = constants.inertia_kg_m2
        self._friction_nm = constants.friction_nm
        self._gain_per_rad = 0.0
        self._extras: PositionTerms | None = None
        self.law: Law | None = None
        self._u_max = 1.0
        self._max_current_a = constants.stall_current_a
        self._profile_v = 0.0
        self._profile_a = 0.0
        self._rest_nm = self._fixed_s = math.nan
        self._rest_share = 1.0
        self.shaft_rad = start_rad
        self.velocity_rad_s = 0.0
        self.current_a = 0.0
        self.duty = 0.0
        self.driven = False
        self.goal_rad = start_rad
        self.reference_rad = start_rad
        self.reference_rad_s = 0.0

    def configure(
        self,
        *,
        gain_per_rad: float,
        duty_limit: float,
        current_limit_a: float,
        extras: PositionTerms | None = None,
    ) -> None:
        """Set the position loop: duty per rad of error, largest duty (0…1), largest current in A.

        `extras`: what the loop's I and D gains add, None if both are 0. The limits hold for every law.
        """
        self._disturb()
        self._gain_per_rad = gain_per_rad
        self._u_max = duty_limit
        self._max_current_a = current_limit_a
        self._extras = extras

    def set_supply(self, ratio: float) -> None:
        """Set the supply as a multiple of the voltage that the motor's constants hold for."""
        self._disturb()
        self._drive_a = self._stall_a * ratio

    def set_mechanics(self, friction: float, rest_share: float, torque_share: float) -> None:
        """Change the motor: friction, and torque for a current, times the present ones.

        `rest_share`: friction at rest, times that in motion; at least 1.
        """
        self._disturb()
        self._friction_nm *= friction
        self._rest_share = max(1.0, rest_share)
        self._nm_per_a *= torque_share

    @property
    def friction_nm(self) -> float:
        """Friction in motion."""
        return self._friction_nm

    def set_profile(self, velocity_rad_s: float, acceleration_rad_s2: float) -> None:
        """Set the profile of the next goals; 0 means unlimited."""
        self._profile_v = velocity_rad_s
        self._profile_a = acceleration_rad_s2

    def engage(self) -> None:
        """Switch the drive on, holding where the shaft is."""
        self._disturb()
        self.driven = True
        self.hold()

    def release(self) -> None:
        """Switch the drive off: only the load and friction act on the shaft."""
        self.driven = False
        self.current_a = 0.0
        self.duty = 0.0
        self.hold()

    def hold(self) -> None:
        """Make the present position the goal, without a profile."""
        self._disturb()
        self.goal_rad = self.reference_rad = self.shaft_rad
        self.reference_rad_s = 0.0

    def move_to(self, goal_rad: float) -> None:
        """Start a profile towards a goal, from wherever the trajectory is now."""
        self._disturb()
        self.goal_rad = goal_rad
        if self._profile_v == 0.0:
            self.reference_rad = goal_rad
            self.reference_rad_s = 0.0

    @property
    def state(self) -> tuple[float, ...]:
        """All that changes as time passes."""
        return (
            self.shaft_rad,
            self.velocity_rad_s,
            self.current_a,
            self.duty,
            self.goal_rad,
            self.reference_rad,
            self.reference_rad_s,
        )

    @property
    def profile_ongoing(self) -> bool:
        """True while the trajectory has not reached the goal."""
        return self.reference_rad != self.goal_rad

    def step(self, dt_s: float, load_nm: float) -> None:
        """Integrate over `dt_s` with a constant outside torque; positive pushes towards +position."""
        if load_nm == self._rest_nm or (load_nm == 0.0 and self._stands(dt_s)):
            return  # friction has held the shaft against this torque, and nothing has changed since
        self._disturb()
        while dt_s > _MAX_STEP_S * 1.001:
            self._step(_MAX_STEP_S, load_nm)
            dt_s -= _MAX_STEP_S
        self._step(dt_s, load_nm)

    def reach_rad(self, dt_s: float, steps: int) -> float:
        """The furthest that so many steps of `dt_s` may turn an unloaded shaft; may be infinite."""
        if self._stands(dt_s):
            return 0.0
        push = self._max_current_a * self._nm_per_a / self._inertia if self.driven else 0.0
        return dt_s * steps * (abs(self.velocity_rad_s) + push * dt_s * (steps + 1) / 2)

    def run(self, dt_s: float, steps: int) -> tuple[list[float], list[float]]:
        """Take up to so many steps of `dt_s` without a load, to where friction holds the shaft.

        Returns the angle (rad) after each step that was taken and the current (A) in it; what is left of the
        steps changes neither. The same as so many times `step`, quicker.
        """
        if self._stands(dt_s):
            return [], []
        self._disturb()
        if self.driven and self.law is None and self._extras is None:
            return self._run_to_goal(dt_s, steps)
        angles: list[float] = []
        currents: list[float] = []
        for _ in range(steps):
            self._step(dt_s, 0.0)
            angles.append(self.shaft_rad)
            currents.append(self.current_a)
            if self._rest_nm == 0.0:
                break
        return angles, currents

    def _run_to_goal(self, dt: float, steps: int) -> tuple[list[float], list[float]]:
        """`_step` in a loop, for the position loop alone: the same arithmetic in the same order."""
        gain, most_duty, drive_a = self._gain_per_rad, self._u_max, self._drive_a
        most_a, a_per_rad_s, nm_per_a = self._max_current_a, self._a_per_rad_s, self._nm_per_a
        inertia, slowed = self._inertia, self._friction_nm * dt / self._inertia
        rest = slowed * self._rest_share
        velocity, shaft, goal = self.velocity_rad_s, self.shaft_rad, self.goal_rad
        duty, current, reference = self.duty, self.current_a, self.reference_rad
        travel, far = self._cruise(dt)
        angles: list[float] = []
        currents: list[float] = []
        for _ in range(steps):
            before, at = velocity, shaft
            settled = reference == goal
            if (goal - reference if travel > 0.0 else reference - goal) > far:
                reference += travel
            elif not settled:
                self.reference_rad = reference
                self._advance_reference(dt)
                reference = self.reference_rad
            duty = (reference - shaft) * gain
            duty = most_duty if duty > most_duty else -most_duty if duty < -most_duty else duty
            current = duty * drive_a - velocity * a_per_rad_s
            current = most_a if current > most_a else -most_a if current < -most_a else current
            holds = rest if velocity == 0.0 else slowed
            velocity += current * nm_per_a * dt / inertia
            if velocity > holds:
                velocity -= slowed
            elif velocity < -holds:
                velocity += slowed
            else:
                velocity = 0.0
            shaft += velocity * dt
            angles.append(shaft)
            currents.append(current)
            if settled and velocity == before and shaft == at:
                # It creeps towards where friction holds it, by less than a number can say, or is held there.
                if velocity == 0.0:
                    self._rest_nm = 0.0
                self._fixed_s = dt
                break
        self.velocity_rad_s, self.shaft_rad, self.duty, self.current_a = velocity, shaft, duty, current
        self.reference_rad = reference
        return angles, currents

    def _cruise(self, dt: float) -> tuple[float, float]:
        """Travel of a step at the profile's velocity; further than this from the goal steps are all alike.

        The distance is twice that of braking and a few steps; infinite at any other velocity.
        """
        speed, rate = self._profile_v, self._profile_a
        if speed == 0.0 or abs(self.reference_rad_s) != speed:
            return 0.0, math.inf
        braking = 0.0 if rate == 0.0 else speed * speed / (2.0 * rate)
        return self.reference_rad_s * dt, 2.0 * (braking + 2.0 * speed * dt + rate * dt * dt)

    def _stands(self, dt_s: float) -> bool:
        """True if steps of `dt_s` without a load are known to change nothing."""
        return self._rest_nm == 0.0 or dt_s == self._fixed_s

    def _disturb(self) -> None:
        """Note that what turns the shaft may have changed: it may not stand still any more."""
        self._rest_nm = self._fixed_s = math.nan

    def _step(self, dt: float, load_nm: float) -> None:
        velocity = self.velocity_rad_s
        held = velocity == 0.0 and self.law is None and self._extras is None
        held = held and self.reference_rad == self.goal_rad
        if self.driven:
            if self.reference_rad != self.goal_rad:
                self._advance_reference(dt)
            limit = self._u_max
            if self.law is None:
                error = self.reference_rad - self.shaft_rad
                duty = error * self._gain_per_rad
                if (extras := self._extras) is not None:
                    duty += extras.duty(dt, error, self.reference_rad_s - velocity, limit)
                    duty += extras.forward * self.reference_rad_s
                duty = limit if duty > limit else -limit if duty < -limit else duty
            else:
                back_emf = velocity * self._a_per_rad_s / self._drive_a
                duty = self.law(dt, velocity, back_emf, self._drive_a, limit)
            current = duty * self._drive_a - velocity * self._a_per_rad_s
            limit = self._max_current_a
            current = limit if current > limit else -limit if current < -limit else current
            self.duty = duty
            self.current_a = current
            torque = current * self._nm_per_a + load_nm
        else:
            torque = load_nm
        slowed = self._friction_nm * dt / self._inertia
        holds = slowed * self._rest_share if velocity == 0.0 else slowed
        velocity += torque * dt / self._inertia
        if velocity > holds:
            velocity -= slowed
        elif velocity < -holds:
            velocity += slowed
        else:
            velocity = 0.0
            if held:
                self._rest_nm = load_nm
        self.velocity_rad_s = velocity
        self.shaft_rad += velocity * dt

    def _advance_reference(self, dt: float) -> None:
        distance = self.goal_rad - self.reference_rad
        sign = 1.0 if distance > 0 else -1.0
        wanted = self._profile_v or math.inf
        rate = self._profile_a
        if rate > 0.0:
            # fastest speed from which the steps of this length can still stop at the goal
            half = 0.5 * rate * dt
            wanted = min(wanted, math.sqrt(half * half + 2.0 * rate * abs(distance)) - half)
            change = sign * wanted - self.reference_rad_s
            bound = rate * dt
            speed = self.reference_rad_s + (
                bound if change > bound else -bound if change < -bound else change
            )
        else:
            speed = sign * wanted
        travel = speed * dt
        near = abs(distance) <= abs(travel) or (rate > 0.0 and abs(distance) < rate * dt * dt)
        if near and travel * distance >= 0.0 and (rate == 0.0 or abs(speed) <= 2.0 * rate * dt):
            self.reference_rad = self.goal_rad
            self.reference_rad_s = 0.0
            return
        self.reference_rad += travel
        self.reference_rad_s = speed
