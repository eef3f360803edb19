"""Friction check: what a slide that runs more easily or harder than the rig file says means for touches."""

from pathlib import Path

from firm_rig import firm_rig
from quick_rig import quick_rig
from truth_calibration import bench_calibration

import palpate
from palpate.config import RigFile, SlideFingerConfig, calibration_path, calibration_toml, load_rig
from palpate.drivers.dynamixel.models import specification
from palpate.rig.diagnostics.calibration_check import friction_warnings

RIG = load_rig(firm_rig())


def force_n(spec: SlideFingerConfig, current_a: float) -> float:
    """By the lever, as a mechanic computes it: torque over the pinion's radius."""
    motor = specification(spec.slide.model).motor
    torque_nm = current_a * motor.stall_torque_nm / motor.stall_current_a
    return torque_nm / (abs(spec.slide.mm_per_turn) / 1e3 / 6.283185307)


def with_friction_allowed(current_a: float) -> RigFile:
    finger = RIG.fingers[0]
    assert isinstance(finger, SlideFingerConfig)
    slide = finger.slide.model_copy(update={"friction_a": current_a})
    return RIG.model_copy(update={"fingers": [finger.model_copy(update={"slide": slide}), *RIG.fingers[1:]]})


def test_friction_as_allowed_for_is_no_warning() -> None:
    assert friction_warnings(with_friction_allowed(0.02), {"f1": 0.02}) == []
    assert friction_warnings(with_friction_allowed(0.02), {"f1": 0.03}) == []
    assert friction_warnings(with_friction_allowed(0.02), {}) == []


def test_a_slide_that_runs_more_easily_lets_its_tip_press_harder() -> None:
    rig = with_friction_allowed(0.05)
    finger = rig.fingers[0]
    assert isinstance(finger, SlideFingerConfig)
    (warning,) = friction_warnings(rig, {"f1": 0.0304})
    assert "moves freely with 0.030 A, and 0.050 A are allowed" in warning
    said_n = float(warning.split("may press with ")[1].split(" N")[0])
    assert force_n(finger, 0.05 - 0.0304) <= said_n < force_n(finger, 0.05 - 0.0304) + 0.1001
    assert warning.endswith("slide.friction_a at most 0.03")


def test_a_slide_that_runs_hard_has_too_little_left_to_touch_with() -> None:
    finger = RIG.fingers[0]
    assert isinstance(finger, SlideFingerConfig)
    per_n = 1 / force_n(finger, 1.0)
    closing = RIG.closing
    enough_a = (closing.max_force_n - 2 * closing.contact_force_n) * per_n
    rig = with_friction_allowed(0.0)
    assert friction_warnings(rig, {"f1": enough_a - 1e-3}) == []
    (warning,) = friction_warnings(rig, {"f1": enough_a + 1e-3})
    assert "N of max_force_n are left to touch with; clean and grease it" in warning


def test_check_notices_on_the_bench_that_slides_run_more_easily_than_allowed_for(tmp_path: Path) -> None:
    rig = quick_rig(tmp_path / "rig.toml")
    text = rig.read_text(encoding="utf-8")
    rig.write_text(
        text.replace("[fingers.slide]\n", "[fingers.slide]\nfriction_a = 0.06\n"), encoding="utf-8"
    )
    calibration_path(rig).write_text(calibration_toml(bench_calibration(load_rig(rig), 3)))
    with palpate.open_rig(rig, seed=3) as opened:
        answer = opened.check(touch=True)
    assert answer.well
    found = [warning for warning in answer.warnings if "more than max_force_n" in warning]
    assert [warning.split(":")[0] for warning in found] == ["finger f1", "finger f2"]
    assert all("A, and 0.060 A are allowed for its friction" in warning for warning in found)
