"""Checks of friction and hold, and touching references again."""

import json
import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rich.console import Console

import palpate
from palpate.base.errors import InputError
from palpate.base.geometry import Floats
from palpate.calibration.consistency_checks import contact_uncertainties
from palpate.calibration.measurements import Probe, Reference, ReferenceDisc, TouchMeasurement
from palpate.config import (
    RigFile,
    SlideFingerConfig,
    apply_calibration,
    calibration_path,
    calibration_toml,
    load_rig,
)
from palpate.config.diagnosis_results import (
    CalibrationCheckOut,
    Cause,
    HoldCheckOut,
    Severity,
)
from palpate.config.emulation import EmulatedPartConfig
from palpate.config.schema import schema_text
from palpate.drivers.dynamixel.models import specification
from palpate.drivers.emulators.finger import EmulatedFinger
from palpate.drivers.emulators.mechanics import FingerTruth
from palpate.rig.bench import connect
from palpate.rig.diagnostics.calibration_check import Retouch, judge_friction, judge_touch, retouch, touch_out
from palpate.rig.diagnostics.motion_checks import check_hold, least_threshold_n, with_light_touch
from palpate.rig.diagnostics.servo_bus import endpoint_of_rig
from palpate.rig.motion.creep import is_sliding
from palpate.views.check_table import show_check
from support.benches.calibration_files import bench_calibration, truth_calibration
from support.benches.doctor import checked
from support.benches.rigs import firm_rig, quick_rig, small_objects, small_rig
from support.benches.session import EmulatedSession, emulated_session
from support.benches.simulated_rig import SimulatedProber, SimulatedRig
from support.campaign.sampling import sample
from support.commands.command import Here, violations

# ----------------------------------------------------------------------------------------------------
# Friction check: what a slide that runs more easily or harder than the rig file says means for touches.

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
    assert judge_friction(with_friction_allowed(0.02), {"f1": 0.02}) == []
    assert judge_friction(with_friction_allowed(0.02), {"f1": 0.03}) == []
    assert judge_friction(with_friction_allowed(0.02), {}) == []


def test_a_slide_that_runs_more_easily_lets_its_tip_press_harder() -> None:
    rig = with_friction_allowed(0.05)
    finger = rig.fingers[0]
    assert isinstance(finger, SlideFingerConfig)
    (warning,) = judge_friction(rig, {"f1": 0.0304})
    assert "moves freely with 0.030 A, and 0.050 A are allowed" in warning.saw
    said_n = float(warning.saw.split("may press with ")[1].split(" N")[0])
    assert force_n(finger, 0.05 - 0.0304) <= said_n < force_n(finger, 0.05 - 0.0304) + 0.1001
    assert warning.next.endswith("slide.friction_a at most 0.03")


def test_a_slide_that_runs_hard_has_too_little_left_to_touch_with() -> None:
    finger = RIG.fingers[0]
    assert isinstance(finger, SlideFingerConfig)
    per_n = 1 / force_n(finger, 1.0)
    closing = RIG.closing
    enough_a = (closing.max_force_n - 2 * closing.contact_force_n) * per_n
    rig = with_friction_allowed(0.0)
    assert judge_friction(rig, {"f1": enough_a - 1e-3}) == []
    (warning,) = judge_friction(rig, {"f1": enough_a + 1e-3})
    assert "N of max_force_n are left to touch with" in warning.saw


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


# ----------------------------------------------------------------------------------------------------
# What force a part holds, measured by pushing it: never more than it does, gently, and torque off.

SOFT_N_PER_MM = 2.4


def bench_with(
    seed: int, *, engine: str = "quasi-static", empty: bool = False, **part: float
) -> EmulatedSession:
    """Two fingers of the small bench and a part that slides, unless it is "still"."""
    rig = small_rig()
    assert rig.emulation is not None
    closing = rig.closing.model_copy(update={"approach_speed_mm_s": 30.0, "sample_rate_hz": 125.0})
    slides = EmulatedPartConfig.model_validate({"engine": engine, **part})
    emulation = rig.emulation.model_copy(update={"part": slides})
    changes = {"closing": closing, "emulation": emulation, "fingers": rig.fingers[:2]}
    rig = rig.model_copy(update=changes)
    return emulated_session(seed=seed, rig=rig, objects=small_objects(), empty=empty)


def held(session: EmulatedSession) -> HoldCheckOut:
    with connect(session.bench_rig) as hand:
        hand.prepare()
        quietest_n = least_threshold_n(hand)
    rig = with_light_touch(session.rig, quietest_n)
    with connect(replace(session.bench_rig, rig=rig)) as hand:
        hand.prepare()
        return check_hold(hand)


@pytest.mark.parametrize(
    ("seed", "part"),
    [
        pytest.param(0, {"mass_kg": 0.15, "friction": 0.3, "tip_friction": 0.3}, id="150 g"),
        pytest.param(
            1,
            {"mass_kg": 0.7, "friction": 0.25, "tip_friction": 0.6},
            id="700 g",
            marks=pytest.mark.campaign,
        ),
        pytest.param(
            2, {"mass_kg": 0.06, "friction": 0.2, "tip_friction": 0.0}, id="60 g", marks=pytest.mark.campaign
        ),
    ],
)
def test_a_part_holds_what_is_said_and_is_hardly_moved(seed: int, part: dict[str, float]) -> None:
    session = bench_with(seed, **part)
    out = held(session)
    slip_n = part["mass_kg"] * part["friction"] * 9.80665
    assert 0.25 * slip_n < out.part_holds_n < slip_n
    assert out.least_n <= out.part_holds_n
    assert out.slid
    assert [item.finger for item in out.fingers] == ["f1", "f2"]
    assert all(item.moved_mm < 1.0 for item in out.fingers)
    moved = session.bench.parts.displacements[0]
    assert np.hypot(*moved.shift_mm) < out.moved_mm + 0.2
    assert max(finger.hardest_n for finger in session.bench.fingers) < 1.1 * slip_n
    assert not any(session.torque().values())


@pytest.mark.campaign
def test_a_part_that_stands_is_pushed_no_harder_than_is_said() -> None:
    session = bench_with(3, engine="still")
    out = held(session)
    assert not out.slid
    assert 2.0 < out.part_holds_n <= out.largest_n == 3.0
    assert max(finger.hardest_n for finger in session.bench.fingers) < 1.3 * out.largest_n


@pytest.mark.campaign
def test_the_command_on_the_shipped_bench(tmp_path: Path) -> None:
    part = '[emulation.part]\nengine = "quasi-static"\nmass_kg = 0.15\nfriction = 0.3\n\n[[fingers]]'
    text = firm_rig().read_text(encoding="utf-8").replace("[[fingers]]", part, 1)
    rig = tmp_path / "rig.toml"
    rig.write_text(text, encoding="utf-8")
    said: list[str] = []
    found = palpate.open_rig(rig, seed=7).check(hold=True, progress=said.append)
    assert found.well
    assert found.result.hold is not None
    assert 0.2 < found.result.hold.part_holds_n < 0.44
    assert violations(json.loads(found.to_json()), json.loads(schema_text("check"))) == []
    assert said[-4:] == ["  looking for the part", *(f"  pushing with finger f{k}" for k in (1, 2, 3))]


@pytest.mark.campaign
def test_an_empty_table_is_one_line() -> None:
    session = bench_with(0, empty=True)
    with pytest.raises(InputError, match="no part was found that is 20 mm wide") as said:
        held(session)
    assert "\n" not in str(said.value)
    assert not any(session.torque().values())


@settings(max_examples=50)
@given(
    stiffness=st.floats(SOFT_N_PER_MM, 4.0),
    holds_n=st.floats(0.05, 2.0),
    play_mm=st.floats(0.0, 0.1),
    seed=st.integers(0, 1000),
)
def test_sliding_is_seen_once_the_force_stays_and_not_before(
    stiffness: float, holds_n: float, play_mm: float, seed: int
) -> None:
    """A skin behind a little play, read in steps of an encoder, with noise."""
    travel = np.arange(0.0, 2.0, 0.008)
    noise = np.random.default_rng(seed).normal(0.0, 0.01, len(travel))
    read: Floats = np.round(travel / 0.024) * 0.024
    force = np.minimum(0.06 + stiffness * np.maximum(travel - play_mm, 0.0), holds_n) + noise
    seen = [n for n in range(1, len(travel)) if is_sliding(read[:n], force[:n], SOFT_N_PER_MM)]
    slides_mm = play_mm + max(holds_n - 0.06, 0.0) / stiffness
    assert travel[seen[0]] > slides_mm
    assert travel[seen[0]] < slides_mm + 0.6


# ----------------------------------------------------------------------------------------------------
# A disc touched again: it agrees with a right calibration, and not with one of a rig that has changed.

DISC = ReferenceDisc("disc", 25.0)


def touched(
    seed: int,
    off_mm: dict[str, tuple[float, float]] | None = None,
    disc: ReferenceDisc = DISC,
    spoil: Callable[[Reference, int], Reference] = lambda item, _: item,
) -> Retouch:
    """A re-touch of a simulated rig whose calibration has bases of fingers off by so much."""
    world = SimulatedRig(RIG, seed, spoil)
    file = truth_calibration(RIG, world.fingers, off_mm=off_mm)
    uncertainties = contact_uncertainties(file, at_rest=False)
    assert uncertainties is not None
    rig = apply_calibration(RIG, file)
    with world.connect(rig, moving=True) as there:
        return retouch(rig, there.prober, disc, uncertainties)


def test_a_rig_that_is_as_it_was_agrees() -> None:
    for seed in range(2):
        found = touched(seed)
        assert not found.agreement.drifted, seed
        assert [item.touches for item in found.fingers] == [5, 5, 5]
        assert max(abs(item.offset_mm) for item in found.fingers) < 0.03


@pytest.mark.parametrize(
    "off",
    [
        pytest.param((1.0, 0.0), marks=pytest.mark.campaign),
        pytest.param((0.0, -1.0), marks=pytest.mark.campaign),
        (0.6, 0.8),
    ],
)
def test_a_finger_that_moved_by_a_millimetre_does_not(off: tuple[float, float]) -> None:
    found = touched(1, {"f2": off})
    assert found.agreement.drifted
    assert found.agreement.rms_mm > 5 * found.agreement.expected_rms_mm


def test_a_finger_that_moved_by_little_is_mostly_noticed() -> None:
    assert sum(touched(seed, {"f2": (0.13, 0.075)}).agreement.drifted for seed in range(4)) >= 3


def test_another_disc_than_said_does_not_agree_unless_its_tolerance_explains_it() -> None:
    def larger(item: Reference, _: int) -> Reference:
        assert isinstance(item, ReferenceDisc)
        return replace(item, radius_mm=item.radius_mm + 0.15)

    assert touched(0, spoil=larger).agreement.drifted
    assert not touched(0, disc=replace(DISC, tolerance_mm=0.2), spoil=larger).agreement.drifted


class Empty(SimulatedProber):
    """Of a table with nothing on it."""

    def touch(self, grip: Sequence[Probe], placing: int) -> list[TouchMeasurement | None]:
        del placing
        return [None for _ in grip]


def test_no_disc_is_said() -> None:
    world = SimulatedRig(RIG, 0)
    uncertainties = contact_uncertainties(truth_calibration(RIG, world.fingers), at_rest=False)
    assert uncertainties is not None
    with pytest.raises(InputError, match=r"the disc was not found near \(0, 0\) mm"):
        retouch(RIG, Empty(world, RIG), DISC, uncertainties)


def test_check_touches_a_disc(here: Here, tmp_path: Path) -> None:
    rig = quick_rig(tmp_path / "rig.toml")
    none = here("check", "--touch", "--rig", rig, "--yes")
    assert (none.code, none.out) == (2, "")
    assert f"make it with `palpate calibrate --rig {rig}`" in none.err
    calibration_path(rig).write_text(calibration_toml(bench_calibration(load_rig(rig), 3)))

    other = here("check", "--touch", "--rig", rig, "--seed", 4, "--yes", "--json")
    assert other.code == 1  # another device, none that is missing
    assert "nothing was touched: first put right what is wrong" in other.json["warnings"]
    assert other.json["calibration"]["touch"] is None

    done = here("check", "--touch", "--rig", rig, "--seed", 3, "--yes", "--json")
    assert done.code == 0, done.err
    assert violations(done.json, json.loads(schema_text("check"))) == []
    touch = done.json["calibration"]["touch"]
    assert touch["agrees"]
    assert [item["touches"] for item in touch["fingers"]] == [5, 5]
    assert touch["residual_rms_mm"] < 0.03
    assert [0.02 < item["friction_a"] < 0.04 for item in touch["fingers"]] == [True, True]
    assert "agrees with 10 touches (f1 " in done.err
    assert "; slides need 0.0" in done.err


def changed_truth(finger: EmulatedFinger, **changes: float) -> None:
    """Let a simulated finger be built otherwise from now on."""
    truth = replace(finger.truth, **changes)
    for holder in (finger, finger._mechanics):
        for name in [key for key, value in vars(holder).items() if value is finger.truth]:
            setattr(holder, name, truth)
    assert finger.truth is truth


@pytest.mark.parametrize(
    ("joint", "what"),
    sample(
        [("slide", "zero"), ("aim", "zero"), ("aim", "play"), ("slide", "encoder")],
        [("slide", "zero"), ("aim", "play")],
    ),
)
def test_what_one_joint_has_changed_by_is_named(joint: str, what: str) -> None:
    world = SimulatedRig(RIG, 1)
    file = truth_calibration(RIG, world.fingers)
    truth = world.fingers[1].truth
    assert isinstance(truth, FingerTruth)
    amount = {"slide": 0.5, "aim": 1.0}[joint] if what == "zero" else 0.3
    if what == "encoder":
        world.fingers[1].servos[1].set_encoder((math.radians(1.2), 1.0))
    elif what == "play":
        changed_truth(world.fingers[1], aim_play_rad=truth.aim_play_rad + math.radians(amount))
    elif joint == "aim":
        changed_truth(world.fingers[1], heading_rad=truth.heading_rad + math.radians(amount))
    else:
        changed_truth(world.fingers[1], zero_mm=truth.zero_mm + amount)
    uncertainties = contact_uncertainties(file, at_rest=False)
    assert uncertainties is not None
    rig = apply_calibration(RIG, file)
    with world.connect(rig, moving=True) as there:
        found = retouch(rig, there.prober, DISC, uncertainties)
    (change,) = found.changes
    assert (change.finger, change.joint, change.what) == ("f2", joint, what)
    if what != "encoder":
        assert change.amount == pytest.approx(amount, rel=0.15)
    ((problem),) = judge_touch(RIG, found)[1]
    assert change.words in problem.means


def test_nobody_moves_fingers_unasked(here: Here, tmp_path: Path) -> None:
    rig = quick_rig(tmp_path / "rig.toml")
    calibration_path(rig).write_text(calibration_toml(bench_calibration(load_rig(rig), 0)))
    unasked = here("check", "--touch", "--rig", rig)
    assert (unasked.code, unasked.out) == (2, "")
    assert "say --yes if they may" in unasked.err


def test_a_rig_that_does_not_agree_is_not_well(capsys: pytest.CaptureFixture[str]) -> None:
    found = touched(0, {"f2": (1.0, 0.0)})
    saw, (problem,) = judge_touch(RIG, found)
    assert "15 touches" in saw
    assert (problem.cause, problem.severity) == (Cause.TOUCH_DISAGREES, Severity.WRONG)
    assert "mm (in the mean f1 " in problem.saw
    calibration = CalibrationCheckOut(
        file="rig.calibration.toml",
        made="2026-05-04T12:30:00Z",
        age_days=3,
        coverage=0.999,
        position_mm=0.2,
        direction_deg=0.5,
        devices_match=True,
        touch=touch_out(found),
    )
    out = checked(RIG, endpoint_of_rig(RIG)).model_copy(update={"calibration": calibration})
    show_check(out, Console(width=200, soft_wrap=True))
    assert "does not agree with 15 touches (f1 " in capsys.readouterr().out
    assert judge_touch(RIG, touched(0))[1] == []
