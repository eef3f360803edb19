"""Operating modes of emulated servos and motion of their shafts."""

import math

import numpy as np
import pytest

from palpate.drivers.dynamixel.models import MotorConstants, specification
from palpate.drivers.dynamixel.packet import StatusErrorCode
from palpate.drivers.emulators.servo_motion import ShaftMotion
from support.devices.servo_wire import Console

# ----------------------------------------------------------------------------------------------------
# Operating Modes, profiles and Drive Mode of the emulated servos, on the shaft.

CURRENT, VELOCITY, POSITION, EXTENDED, CURRENT_BASED, PWM = 0, 1, 3, 4, 5, 16
RPM = 2 * math.pi / 60
UNIT = 0.229 * RPM  # of Goal Velocity and Profile Velocity, rad/s
RATE = 214.577 * 2 * math.pi / 3600  # of Profile Acceleration, rad/s²
REVERSE, TIME_BASED, TORQUE_ON_BY_GOAL = 1, 4, 8


# -- modes ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("goal", [300, -300])
def test_current_mode_holds_a_current(goal: int) -> None:
    console = Console()
    console.start(CURRENT)
    assert console.write(102, goal, 2) == 0
    torque = goal * 2.69e-3 * 4.1 / 2.3
    console.run(1.0, load_nm=-torque)  # what the motor gives is balanced: the shaft stays
    assert console.read(126, 2) == pytest.approx(goal, abs=1)
    assert abs(console.servo.shaft_rad) < 1e-6
    console.run(0.2)
    assert math.copysign(1, goal) * console.servo.shaft_rad_s > 1.0


def test_current_mode_runs_out_of_voltage() -> None:
    console = Console()
    console.start(CURRENT)
    console.write(102, 500, 2)
    console.run(3.0)
    assert console.servo.shaft_rad_s == pytest.approx(46 * RPM, rel=0.02)
    assert console.read(124, 2) == 885
    assert console.read(126, 2) < 50


def test_goal_pwm_limits_other_modes() -> None:
    console = Console()
    console.start(CURRENT)
    console.write(100, 200, 2)
    console.write(102, 500, 2)
    console.run(3.0)
    assert console.servo.shaft_rad_s == pytest.approx(200 / 885 * 46 * RPM, rel=0.06)


@pytest.mark.parametrize("goal", [100, -50])
def test_velocity_mode_reaches_its_goal(goal: int) -> None:
    console = Console()
    console.start(VELOCITY)
    console.write(104, goal, 4)
    console.run(3.0)
    assert console.read(128, 4) == goal
    assert console.servo.shaft_rad_s == pytest.approx(goal * UNIT, rel=0.01)
    console.run(2.0, load_nm=-0.5)
    assert console.read(128, 4) == pytest.approx(goal, abs=1)  # the I gain makes up for a load


def test_velocity_goals_have_a_limit() -> None:
    console = Console()
    assert console.write(104, 200, 4) == 0
    assert console.write(104, 201, 4) == StatusErrorCode.DATA_LIMIT_ERROR


def test_velocity_mode_follows_profile_acceleration() -> None:
    console = Console()
    console.start(VELOCITY, acceleration=10)
    console.write(104, 100, 4)
    rise_s = 64 * 100 / 10 / 1000  # the manual's formula, which counts in ms
    assert rise_s == pytest.approx(100 * UNIT / (10 * RATE), rel=0.01)
    console.run(rise_s / 2)
    assert console.read(136, 4) == pytest.approx(50, abs=1)  # Velocity Trajectory
    console.run(rise_s / 2 + 0.01)
    assert console.read(136, 4) == 100


def test_velocity_mode_can_ramp_in_a_given_time() -> None:
    console = Console()
    console.write(10, TIME_BASED, 1)
    console.start(VELOCITY, acceleration=400)  # ms
    console.write(104, 100, 4)
    console.run(0.2)
    assert console.read(136, 4) == pytest.approx(50, abs=1)


@pytest.mark.parametrize("goal", [442, -442])
def test_pwm_mode_sets_the_voltage(goal: int) -> None:
    console = Console()
    console.write(38, 10, 2)  # Current Limit does not hold here
    console.start(PWM)
    console.write(100, goal, 2)
    console.run(2.0)
    assert console.read(124, 2) == goal
    assert console.servo.shaft_rad_s == pytest.approx(goal / 885 * 46 * RPM, rel=0.04)


@pytest.mark.parametrize(("mode", "address", "size"), [(CURRENT, 102, 2), (VELOCITY, 104, 4), (PWM, 100, 2)])
def test_switching_on_does_not_carry_out_an_old_goal(mode: int, address: int, size: int) -> None:
    console = Console()
    console.write(11, mode, 1)
    assert console.write(address, 100, size) == 0
    console.write(64, 1, 1)
    console.run(0.5)
    assert console.servo.shaft_rad == 0.0
    assert console.read(address, size) == 0


@pytest.mark.parametrize(("mode", "address", "size"), [(CURRENT, 102, 2), (VELOCITY, 104, 4), (PWM, 100, 2)])
def test_bus_watchdog_stops_every_mode(mode: int, address: int, size: int) -> None:
    console = Console()
    console.start(mode)
    console.write(98, 5, 1)
    console.write(address, 100, size)
    console.run(0.09)
    assert console.servo.shaft_rad_s > 0.0
    console.run(2.0)
    assert abs(console.servo.shaft_rad_s) < 1e-3
    assert (console.read(98, 1), console.read(64, 1)) == (-1, 1)
    assert console.write(address, 50, size) == StatusErrorCode.DATA_RANGE_ERROR
    console.write(98, 0, 1)
    console.run(0.2)
    assert abs(console.servo.shaft_rad_s) < 1e-3
    assert console.write(address, 50, size) == 0
    console.run(0.5)
    assert console.servo.shaft_rad_s > 0.0


def test_current_based_mode_resets_pwm_limit() -> None:
    console = Console()
    console.write(36, 400, 2)
    console.write(11, EXTENDED, 1)
    assert (console.read(36, 2), console.read(100, 2)) == (400, 400)
    console.write(11, CURRENT_BASED, 1)
    assert (console.read(36, 2), console.read(100, 2)) == (885, 885)


def test_position_i_gain_makes_up_for_a_load() -> None:
    console = Console()
    console.start(POSITION)
    console.run(1.0, load_nm=-1.0)
    assert console.read(132, 4) < 2048 - 10
    console.write(82, 2000, 2)
    console.run(3.0, load_nm=-1.0)
    assert console.read(132, 4) == pytest.approx(2048, abs=1)


# -- profiles ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("span", "rise"), [(1000, 0), (1000, 200), (1000, 500), (600, 900)])
def test_a_time_based_profile_takes_its_time(span: int, rise: int) -> None:
    console = Console()
    console.write(10, TIME_BASED, 1)
    console.start(POSITION, velocity=span, acceleration=rise)
    console.write(116, 3000, 4)
    elapsed = 0.0
    while console.read(123, 1) & 2:
        console.run(0.005)
        elapsed += 0.005
    assert elapsed == pytest.approx(span / 1000, abs=0.02)
    console.run(0.5)
    assert console.read(132, 4) == pytest.approx(3000, abs=3)


@pytest.mark.parametrize(
    ("velocity", "acceleration", "goal", "profile"),
    [(0, 0, 3000, 0), (100, 0, 3000, 1), (100, 10, 2200, 2), (100, 50, 4000, 3)],
)
def test_moving_status_names_the_profile(velocity: int, acceleration: int, goal: int, profile: int) -> None:
    console = Console()
    console.start(POSITION, velocity=velocity, acceleration=acceleration)
    console.write(116, goal, 4)
    assert console.read(123, 1) >> 4 & 3 == profile


def test_a_held_shaft_is_a_following_error() -> None:
    console = Console()
    console.start(POSITION, velocity=100)
    console.write(116, 3000, 4)
    for _ in range(800):
        console.servo.step(1e-3, -4.0 if console.servo.shaft_rad > 0.1 else 0.0)
    assert console.read(123, 1) & 0x08
    assert not console.read(123, 1) & 0x01


def test_moving_follows_its_threshold() -> None:
    console = Console()
    console.start(VELOCITY)
    console.write(104, 20, 4)
    console.run(2)
    assert console.read(122, 1) == 1
    console.write(104, 9, 4)
    console.run(2)
    assert console.read(122, 1) == 0


# -- Drive Mode, Homing Offset ------------------------------------------------------------------------


def test_reverse_mode_turns_everything_round() -> None:
    normal, reverse = Console(start_rad=0.5), Console(start_rad=0.5)
    assert reverse.write(10, REVERSE, 1) == 0
    assert reverse.read(132, 4) == 4096 - normal.read(132, 4)
    for console in (normal, reverse):
        console.start(EXTENDED, velocity=50)
        console.write(116, 3000, 4)
        console.run(0.3)
        assert console.read(128, 4) == pytest.approx(50, abs=2)
        assert console.read(126, 2) > 0
        console.run(3)
        assert console.read(132, 4) == pytest.approx(3000, abs=3)
    assert normal.servo.shaft_rad == pytest.approx(-reverse.servo.shaft_rad, abs=0.02)


@pytest.mark.parametrize(("mode", "address", "size"), [(CURRENT, 102, 2), (VELOCITY, 104, 4), (PWM, 100, 2)])
def test_reverse_mode_turns_all_goals_round(mode: int, address: int, size: int) -> None:
    console = Console()
    console.write(10, REVERSE, 1)
    console.start(mode)
    console.write(address, 100, size)
    console.run(0.5)
    assert console.servo.shaft_rad_s < -0.1
    assert console.read(128, 4) > 0
    assert console.read(address, size) == 100


@pytest.mark.parametrize("reverse", [0, 1])
def test_homing_offset_is_added_in_both_directions(reverse: int) -> None:
    console = Console()
    console.write(10, reverse, 1)
    assert console.write(20, 1000, 4) == 0
    assert console.read(132, 4) == 2048 + 1000
    console.start(EXTENDED)
    console.write(116, 3500, 4)
    console.run(1)
    assert console.read(132, 4) == pytest.approx(3500, abs=3)
    ticks = console.servo.shaft_rad / (2 * math.pi) * 4096
    assert abs(ticks) == pytest.approx(3500 - 1000 - 2048, abs=3)


def test_a_large_homing_offset_counts_beyond_one_turn_only() -> None:
    console = Console()
    console.write(20, 5000, 4)
    assert console.read(132, 4) == 2048  # Position Control Mode ignores it
    console.write(11, EXTENDED, 1)
    assert console.read(132, 4) == 7048


@pytest.mark.parametrize(
    ("model", "firmware", "value", "accepted"),
    [
        ("XM430-W350", 41, TIME_BASED, False),
        ("XM430-W350", 42, TIME_BASED | REVERSE, True),
        ("XM430-W350", 44, TORQUE_ON_BY_GOAL, False),
        ("XM430-W350", 45, TORQUE_ON_BY_GOAL, True),
        ("XL330-M288", 46, TORQUE_ON_BY_GOAL, True),
        ("XL330-M288", 46, 2, False),
        ("XL330-M288", 46, 16, False),
    ],
)
def test_drive_mode_bits_come_with_their_firmware(
    model: str, firmware: int, value: int, accepted: bool
) -> None:
    answer = Console(model=model, firmware=firmware).write(10, value, 1)
    assert answer == (0 if accepted else StatusErrorCode.DATA_RANGE_ERROR)


@pytest.mark.parametrize(
    ("mode", "address", "size"), [(CURRENT, 102, 2), (VELOCITY, 104, 4), (EXTENDED, 116, 4), (PWM, 100, 2)]
)
def test_torque_on_by_goal_update(mode: int, address: int, size: int) -> None:
    console = Console(firmware=45)
    console.write(10, TORQUE_ON_BY_GOAL, 1)
    console.write(11, mode, 1)
    assert console.write(address, 100, size) == 0
    assert console.read(64, 1) == 1
    console.run(0.5)
    assert abs(console.servo.shaft_rad) > 0.1
    console.servo.report_hardware_error(4)
    console.servo.report_hardware_error(0x20)
    assert console.read(64, 1) == 0
    assert console.write(address, 50, size) == 0x80 | StatusErrorCode.RESULT_FAIL


def test_a_goal_that_is_only_a_limit_does_not_switch_on() -> None:
    console = Console(firmware=45)
    console.write(10, TORQUE_ON_BY_GOAL, 1)
    console.write(11, CURRENT_BASED, 1)
    console.write(102, 100, 2)
    assert console.read(64, 1) == 0


# ----------------------------------------------------------------------------------------------------
# Shafts of emulated servos: steps that are left out because nothing can change, against all of them taken.
#
# The judge is a shaft that is told its settings anew before each step, so that it takes every one.

MOTOR = specification("XM430-W350").motor
STEP_S = 1e-3


class Shaft:
    """A shaft that is driven to goals; `forgets`: it takes every step."""

    def __init__(self, motor: MotorConstants, gain: float, *, forgets: bool) -> None:
        self.motion = ShaftMotion(motor, 0.0)
        self._gain, self._forgets = gain, forgets
        self.configure()
        self.motion.engage()

    def configure(self) -> None:
        self.motion.configure(gain_per_rad=self._gain, duty_limit=1.0, current_limit_a=1.0)

    def step(self, load_nm: float) -> None:
        if self._forgets:
            self.configure()
        self.motion.step(STEP_S, load_nm)

    def run(self, steps: int) -> None:
        if self._forgets:
            for _ in range(steps):
                self.step(0.0)
        else:
            self.motion.run(STEP_S, steps)


@pytest.mark.parametrize("seed", range(8))
def test_steps_that_change_nothing_are_left_out(seed: int) -> None:
    rng = np.random.default_rng(seed)
    gain = float(rng.uniform(0.5, 8.0))
    shafts = [Shaft(MOTOR, gain, forgets=forgets) for forgets in (False, True)]
    stood = 0
    for _ in range(40):
        goal, speed, pushed = rng.uniform(-3, 3), rng.uniform(0.5, 4), rng.uniform() < 0.4
        load, steps, pushes = rng.uniform(-2, 2), int(rng.integers(1, 4000)), int(rng.integers(1, 60))
        speed, acceleration = (float(rng.choice(values)) for values in ((speed, speed, 0.0), (20.0, 0.0)))
        for shaft in shafts:
            shaft.motion.set_profile(speed, acceleration)
            if not pushed:
                shaft.motion.move_to(float(goal))
            for _ in range(pushes if pushed else 0):
                shaft.step(float(load))
            shaft.run(steps)
        assert shafts[0].motion.state == shafts[1].motion.state
        stood += shafts[0].motion.reach_rad(STEP_S, 1) == 0.0
    assert stood > 0, "too few of them came to rest to tell"


def test_a_shaft_at_rest_comes_back_after_a_push() -> None:
    shaft = Shaft(MOTOR, 5.0, forgets=False)
    shaft.run(50)
    for _ in range(100):
        shaft.step(2.0)
    assert abs(shaft.motion.shaft_rad) > 0.1
    for _ in range(1000):
        shaft.step(0.0)
    assert abs(shaft.motion.shaft_rad) < 0.01
