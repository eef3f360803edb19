"""Shafts of emulated servos: steps that are left out because nothing can change, against all of them taken.

The judge is a shaft that is told its settings anew before each step, so that it takes every one.
"""

import numpy as np
import pytest

from palpate.drivers.dynamixel.models import MotorConstants, specification
from palpate.drivers.emulators.servo_motion import ShaftMotion

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
