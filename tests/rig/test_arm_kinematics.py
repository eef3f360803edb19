"""Two-link arms: what the host computes, against mechanics that are written apart from it."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from repository import EXAMPLES

from palpate.config import ArmFingerConfig, load_rig
from palpate.drivers.arm_kinematics import ArmKinematics
from palpate.drivers.emulators.mechanics import ArmMechanics, ArmTruth, JointTruth
from palpate.drivers.emulators.servo import EmulatedServo
from palpate.drivers.kinematics import TICK_RAD, Line
from palpate.rig.conversion import arm_kinematics

ARMS = load_rig(EXAMPLES / "two-link-rig.toml")


def arm() -> tuple[ArmFingerConfig, ArmKinematics]:
    spec = ARMS.fingers[0]
    assert isinstance(spec, ArmFingerConfig)
    return spec, arm_kinematics(spec)


@given(st.floats(25.0, 141.0), st.floats(-58.0, 58.0))
def test_servo_angles_lead_back_to_the_place(elbow_deg: float, shoulder_deg: float) -> None:
    _, k = arm()
    servos = (k.shoulder.servo_rad(math.radians(shoulder_deg)), k.elbow.servo_rad(math.radians(elbow_deg)))
    assert k.servos_at(k.centre_mm(servos)) == pytest.approx(servos, abs=1e-9)


def test_places_out_of_reach_have_no_posture() -> None:
    _, k = arm()
    for point in ((0.0, 230.0 - 301.0), (0.0, 240.0), (0.0, 400.0), (200.0, 230.0)):
        assert any(math.isnan(angle) for angle in k.servos_at(point))
    assert not any(math.isnan(angle) for angle in k.servos_rad(Line((0.0, 110.0), -math.pi / 2), 100.0))


def test_the_true_tip_is_within_the_bound() -> None:
    """Truth drawn to the ends of the bounds, angles read as the encoders step."""
    spec, k = arm()
    rng = np.random.default_rng(3)
    closest = 0.0
    for _ in range(500):
        ends = rng.choice([-1.0, 1.0], 8)
        angle = rng.uniform(0, 2 * math.pi)
        truth = ArmTruth(
            base_mm=(
                spec.base_mm[0] + spec.bounds.base_mm * math.cos(angle),
                spec.base_mm[1] + spec.bounds.base_mm * math.sin(angle),
            ),
            heading_rad=k.heading_rad + ends[0] * k.heading_bound_rad,
            height_mm=10.0,
            upper_mm=k.upper_mm + ends[1] * k.length_bound_mm,
            fore_mm=k.fore_mm + ends[2] * k.length_bound_mm,
            shoulder=JointTruth(3.0, k.shoulder.zero_rad + ends[3] * 3.0 * k.shoulder.play_rad, 0.0),
            elbow=JointTruth(3.0, k.elbow.zero_rad + ends[4] * 3.0 * k.elbow.play_rad, 0.0),
            tip_radius_mm=5.0,
            stiffness_n_per_mm=3.0,
            array_heading_rad=0.0,
        )
        ticks = (rng.integers(-2000, 2000), rng.integers(-1900, 1900))
        shafts = [(tick + 0.499 * end) * TICK_RAD for tick, end in zip(ticks, ends[5:7], strict=True)]
        servos = (float(ticks[0] * TICK_RAD), float(ticks[1] * TICK_RAD))
        mechanics = ArmMechanics(
            truth,
            EmulatedServo(1, start_rad=float(shafts[0])),
            EmulatedServo(2, start_rad=float(shafts[1])),
        )
        off = math.dist(mechanics.centre_mm, k.centre_mm(servos))
        assert off <= k.position_bound_mm(servos)
        turned = math.remainder(mechanics.facing_rad - k.facing_rad(servos), 2 * math.pi)
        assert abs(turned) <= k.direction_bound_rad
        closest = max(closest, off / k.position_bound_mm(servos))
    assert closest > 0.7, "the bound is not far too wide either"


def test_torques_within_the_limits_never_press_harder() -> None:
    """The tip is held; whatever force balances the torques (Jᵀ F = τ) is no larger than the limit."""
    _, k = arm()
    rng = np.random.default_rng(4)
    hardest = 0.0
    for _ in range(300):
        servos = (
            k.shoulder.servo_rad(math.radians(rng.uniform(-58, 58))),
            k.elbow.servo_rad(math.radians(rng.uniform(25, 141))),
        )
        limits = k.largest_torques_nm(servos, 8.0)
        tip = np.array(k.centre_mm(servos))
        levers = [(tip - np.array(axis)) / 1000 for axis in (k.base_mm, k.elbow_mm(servos))]
        transpose = np.array([[-lever[1], lever[0]] for lever in levers])
        for one in (-1, 1):
            torque = np.array([one * limits[0], limits[1]])
            force = float(np.hypot(*np.linalg.solve(transpose, torque)))
            hardest = max(hardest, force)
            assert force <= 8.0 * (1 + 1e-9)
    assert hardest > 7.9
