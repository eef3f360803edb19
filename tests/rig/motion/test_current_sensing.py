"""Benches without arrays: what currents say beyond friction, by forces, friction and gains that are given."""

import math
from collections.abc import Mapping
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest
from hypothesis import given
from hypothesis import strategies as st

import palpate
from palpate.base.errors import DeviceError, InputError
from palpate.config import CurrentSensingConfig, load_rig
from palpate.config.rig_file import change_tables
from palpate.drivers.dynamixel import Servo, ServoState, StateSampler, model_by_name
from palpate.drivers.tactile import TactileFrame
from palpate.rig.motion.current_sensing import MOST, SENSED, CurrentSensor
from support.commands.repository import EXAMPLES

CURRENT_RIG = EXAMPLES / "current-rig.toml"
RIG = load_rig(CURRENT_RIG)
FINGER = RIG.fingers[0]
BOUNDS = cast("CurrentSensingConfig", FINGER.array)
LOW_N, HIGH_N = BOUNDS.friction_n
STEP_A = 1e-3
PERIOD_S = 1 / RIG.closing.sample_rate_hz
MM_PER_RAD = 62.83 / (2 * math.pi)
GEAR_RATIO = 3.0


class Driven:
    """A sensor whose servos' states are given."""

    def __init__(self) -> None:
        self.aim, self.slide = (model_by_name(FINGER.servos[name].model) for name in ("aim", "slide"))
        servos = [
            cast("Servo", SimpleNamespace(model=model, dxl_id=k))
            for k, model in enumerate((self.aim, self.slide))
        ]
        self.sensor = CurrentSensor(RIG, FINGER, (servos[0], servos[1]), cast("StateSampler", Sampled()))
        self.now, self.at_rad = 0.0, 0.0

    def go(self, mm_s: float, seconds: float, along_n: float = 0.0, turning_nmm: float = 0.0) -> TactileFrame:
        """Move for a while with currents that stand for these; the last frame."""
        along_a = along_n * MM_PER_RAD / 1e3 / self.slide.known_torque.nm_per_a
        turning_a = turning_nmm / 1e3 / GEAR_RATIO / self.aim.known_torque.nm_per_a
        states = [ServoState(0.0, 0.0, STEP_A * round(value / STEP_A)) for value in (turning_a, along_a)]
        for _ in range(round(seconds / PERIOD_S)):
            self.now += PERIOD_S
            self.at_rad += mm_s / MM_PER_RAD * PERIOD_S
            slide = states[1]._replace(position_rad=self.at_rad)
            self.sensor.note({0: states[0], 1: slide}, self.now - 1e-3, self.now)
        return self.sensor.frames()[-1]

    @property
    def lever_mm(self) -> float:
        """Distance of the tip from the aim's axis."""
        return FINGER.slide.zero_mm + MM_PER_RAD * (self.at_rad + math.pi)


class Sampled:
    """A sampler for which nothing is ever due."""

    def sample_if_due(self) -> None:
        """Do nothing."""


def force_n(frame: TactileFrame, column: int) -> float:
    return float(frame.counts[0, column]) / 1000


shares = st.floats(0.0, 1.0)


@given(
    shares,
    st.floats(-1, 1),
    st.floats(1 - BOUNDS.gain_spread, 1 + BOUNDS.gain_spread),
    st.floats(0.0, 8.0),
    st.floats(-math.pi / 2, math.pi / 2),
)
def test_what_is_sensed_bounds_any_force_and_friction_alone_is_no_contact(
    share: float, side: float, gain: float, pressing_n: float, angle_rad: float
) -> None:
    driven = Driven()
    driven.go(1.0, 2.0)
    along_n, across_n = pressing_n * math.cos(angle_rad), pressing_n * math.sin(angle_rad)
    step_n = 1e3 * STEP_A * driven.slide.known_torque.nm_per_a / MM_PER_RAD
    step_nmm = 1e3 * STEP_A * driven.aim.known_torque.nm_per_a * GEAR_RATIO
    turns_nmm = across_n * driven.lever_mm / gain + side * (BOUNDS.aim_friction_nmm - step_nmm)
    low, high = LOW_N + step_n, HIGH_N - step_n

    moving = driven.go(1.0, 0.05, along_n / gain + low + share * (high - low), turns_nmm)
    sensed = force_n(moving, SENSED)
    if sensed:
        assert pressing_n > 0
        assert sensed >= pressing_n
        assert sensed > RIG.closing.contact_force_n
    else:
        assert pressing_n <= 2 * RIG.closing.contact_force_n

    resting = driven.go(0.0, 0.5, along_n / gain + side * high, turns_nmm)
    assert force_n(resting, MOST) >= pressing_n
    assert not force_n(resting, SENSED) or pressing_n > 0


def test_what_speeds_a_finger_up_is_no_contact_and_what_lasts_is() -> None:
    driven = Driven()
    driven.go(-10.0, 2.0)
    assert force_n(driven.go(8.0, 0.3, 5.0), SENSED) == 0
    assert force_n(driven.go(8.0, 1.0, 5.0), SENSED) >= 5.0 - HIGH_N


@pytest.mark.parametrize(("along_n", "turning_nmm"), [(-HIGH_N - 0.1, 0.0), (0.0, 80.0)])
def test_more_in_free_space_than_declared_is_an_error_that_names_it(
    along_n: float, turning_nmm: float
) -> None:
    driven = Driven()
    driven.go(-10.0, 2.0, 0.1 - HIGH_N, 70.0)
    with pytest.raises(DeviceError, match=r"finger f1: its (slide|aim) needs .* beyond the declared"):
        driven.go(-10.0, 0.1, along_n, turning_nmm)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"search": {"part_holds_n": 0.3}}, "clamp them"),
        ({"closing": {"contact_force_n": 1.0}}, "contact_force_n must be half of that"),
        ({"fingers": {"f1": {"array": {"friction_n": [2.0, 1.0]}}}}, "lower bound above"),
    ],
)
def test_a_rig_file_that_currents_say_too_little_for_is_refused(
    changes: Mapping[str, Any], words: str
) -> None:
    with pytest.raises(InputError, match=words):
        change_tables(RIG, changes, "rig")


def test_a_part_that_is_held_is_identified_without_arrays_and_replayed(tmp_path: Path) -> None:
    with palpate.open_rig(CURRENT_RIG, seed=1) as rig:
        found = rig.identify(sessions=tmp_path)
        assert all(contact.normal is None for grip in found.grips for contact in grip)
    assert found.verdict == "identified"
    assert found.result.truth is not None
    assert found.result.truth.inside_bounds
    (session,) = tmp_path.iterdir()
    assert palpate.open_session(session).replay().difference is None


def test_friction_beyond_the_declared_ends_the_run(tmp_path: Path) -> None:
    more = {"mechanics": {"friction": [1.8, 1.9], "cogging": [0.5, 0.6]}}
    rig = palpate.open_rig(CURRENT_RIG, seed=2).with_(emulation=more)
    with rig, pytest.raises(DeviceError, match="beyond the declared"):
        rig.identify(sessions=tmp_path)
