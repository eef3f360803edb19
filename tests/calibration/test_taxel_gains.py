"""Fits of simulated presses of emulated arrays whose gains, phase, stiffness and crosstalk are known."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import pytest
from repository import EXAMPLES
from simulated_presses import (
    BEARINGS_DEG,
    DESCRIPTION,
    DISC_MM,
    MM_PER_RAD,
    PressingFinger,
    Truth,
    presses_of,
)
from touched_references import SPECS

from palpate.base.errors import InputError
from palpate.calibration.idle_statistics import IdleFit, analyse_idle
from palpate.calibration.press_levels import PressAtBearing
from palpate.calibration.tactile_step import fit_gains
from palpate.config import SlideFingerConfig, TactileCalibration, load_rig
from palpate.drivers.emulators.taxels import Taxels
from palpate.drivers.tactile.description import Description, Shape

CROSSTALK = 0.06


def described(gain_spread: float = 0.4) -> SlideFingerConfig:
    """A finger of the simulated presses, whose array may sit up to 5° off."""
    slide = SPECS[0].slide.model_copy(update={"mm_per_turn": 2 * math.pi * MM_PER_RAD, "model": "XM430-W350"})
    array = SPECS[0].array.model_copy(
        update={"heading_deg": 0.0, "heading_bound_deg": 5.0, "gain_spread": gain_spread}
    )
    tip = SPECS[0].tip.model_copy(update={"radius_mm": 5.0})
    return SPECS[0].model_copy(update={"slide": slide, "array": array, "tip": tip})


SPEC = described()
FEW_DEG = (-50.0, -30.0, -10.0, 15.0, 40.0)
SILENT = [(2, 9), (5, 12)]


@dataclass(frozen=True)
class Bench:
    """A finger, and what was recorded of it."""

    finger: PressingFinger
    idle: IdleFit
    presses: list[PressAtBearing]
    found: TactileCalibration


def bench(
    seed: int, description: Description = DESCRIPTION, bearings_deg: Sequence[float] = BEARINGS_DEG
) -> Bench:
    """A finger with a tip, stiffness, phase and gains of its own; two taxels die after the idling."""
    rng = np.random.default_rng(seed)
    truth = Truth(
        tip_radius_mm=5.0 + rng.uniform(-0.3, 0.3),
        stiffness_n_per_mm=3.0 * (1 + rng.uniform(-0.2, 0.2)),
        phase_rad=math.radians(rng.uniform(-3, 3)),
    )
    kind = {"noise_counts": 2.0, "gain_spread": 0.4, "offset_counts": 20.0, "crosstalk": CROSSTALK}
    alive = PressingFinger(truth, Taxels(description, seed=seed, **kind, dead=[(0, 8)]), rng)
    idle = analyse_idle([alive.idle()], description.max_count)
    finger = PressingFinger(truth, Taxels(description, seed=seed, **kind, dead=[(0, 8), *SILENT]), rng)
    presses = presses_of(finger, bearings_deg)
    return Bench(finger, idle, presses, fit_gains(presses, description, idle, SPEC))


@pytest.mark.parametrize("seed", [11, 12, 13])
def test_finds_what_the_finger_is_like(seed: int) -> None:
    pressed = bench(seed)
    found, truth, gain = pressed.found, pressed.finger.truth, pressed.finger.taxels.gain
    off, bound = np.abs(np.array(found.gain) / gain - 1), np.array(found.gain_bound)
    pressed_taxels = bound < SPEC.array.gain_spread
    well = bound < 0.15
    assert well.sum() >= 11 * DESCRIPTION.rows - 3
    assert off[well].max() < 0.05
    assert (off <= bound)[pressed_taxels].all()
    assert (np.abs(gain - 1) <= bound)[~pressed_taxels].all()
    assert abs(found.phase_deg - math.degrees(truth.phase_rad)) < 3 * found.phase_sigma_deg < 0.5
    assert abs(found.stiffness_n_per_mm / truth.stiffness_n_per_mm - 1) < found.stiffness_bound < 0.05
    assert abs(found.crosstalk - CROSSTALK) < found.crosstalk_bound < 0.01
    assert found.residual_share < 0.015  # three samples a level: a part of an encoder step
    assert found.saturates_n is None
    unusable = [((0, 8), "dead"), *((place, "unresponsive") for place in SILENT)]
    assert [((taxel.row, taxel.col), taxel.what) for taxel in found.unusable] == unusable
    for row, col in ((0, 8), *SILENT):
        assert (found.gain[row][col], found.gain_bound[row][col]) == (1.0, SPEC.array.gain_spread)


def test_a_slope_of_gains_is_not_taken_for_a_turned_array() -> None:
    truth = Truth(phase_rad=math.radians(2.0))
    taxels = Taxels(DESCRIPTION, seed=1, offset_counts=20, crosstalk=CROSSTALK)
    finger = PressingFinger(truth, taxels, np.random.default_rng(1))
    idle = analyse_idle([finger.idle()], DESCRIPTION.max_count)
    slope = np.exp(np.linspace(-0.4, 0.4, DESCRIPTION.cols))
    presses = [
        replace(at, press=replace(at.press, counts=at.press.counts * slope))
        for at in presses_of(finger, FEW_DEG)
    ]
    found = fit_gains(presses, DESCRIPTION, idle, described(gain_spread=0.5))
    assert found.phase_deg == pytest.approx(2.0, abs=0.35)
    well = np.array(found.gain_bound) < 0.15
    assert np.array(found.gain)[well] == pytest.approx(np.broadcast_to(slope, well.shape)[well], rel=0.05)


def test_saturated_samples_are_left_out_and_told() -> None:
    shallow = replace(DESCRIPTION, bit_depth=8)  # full at 255 counts: 0.118 N on a taxel of gain 1
    recorded = bench(14, shallow, FEW_DEG)
    found = recorded.found
    gain = recorded.finger.taxels.gain
    well = np.array(found.gain_bound) < 0.15
    assert well.sum() > 8 * DESCRIPTION.rows
    assert np.abs(np.array(found.gain) / gain - 1)[well].max() < 0.05
    assert found.saturates_n is not None
    assert 1.0 < found.saturates_n < 3.5


def test_presses_that_say_nothing_are_errors() -> None:
    finger = PressingFinger(Truth(), Taxels(DESCRIPTION, seed=1, offset_counts=20), np.random.default_rng(1))
    idle = analyse_idle([finger.idle()], DESCRIPTION.max_count)
    good = finger.press(0.0, DISC_MM, 1.0, 0.005)
    light = replace(good, press=replace(good.press, counts=np.zeros_like(good.press.counts)))
    with pytest.raises(InputError, match="no presses"):
        fit_gains([], DESCRIPTION, idle, SPEC)
    with pytest.raises(InputError, match="press harder"):
        fit_gains([light], DESCRIPTION, idle, SPEC)
    flat = replace(DESCRIPTION, shape=Shape.FLAT)
    with pytest.raises(InputError, match="cylindrical"):
        fit_gains([good], flat, idle, SPEC)
    ball = SPEC.model_copy(update={"tip": SPEC.tip.model_copy(update={"shape": "ball"})})
    with pytest.raises(InputError, match="on a ball"):
        fit_gains([good], replace(DESCRIPTION, emulated=False), idle, ball)


def test_a_press_that_met_nothing_is_left_out() -> None:
    pressed = bench(11)
    first = pressed.presses[0]
    missed = replace(first, press=replace(first.press, counts=np.zeros_like(first.press.counts)))
    found = fit_gains([*pressed.presses, missed], DESCRIPTION, pressed.idle, SPEC)
    assert np.array(found.gain) == pytest.approx(np.array(pressed.found.gain))


def test_a_press_that_no_place_explains_is_left_out() -> None:
    pressed = bench(11)
    first = pressed.presses[0]
    elsewhere = replace(first, press=replace(first.press, counts=np.roll(first.press.counts, 1, axis=2)))
    found = fit_gains([*pressed.presses, elsewhere], DESCRIPTION, pressed.idle, SPEC)
    assert found.presses == len(pressed.presses)
    assert np.array(found.gain) == pytest.approx(np.array(pressed.found.gain))


def test_bounds_hold_where_travels_are_not_well_known() -> None:
    errors = []
    for seed in range(21, 27):
        pressed, rng = bench(seed, bearings_deg=FEW_DEG), np.random.default_rng(seed)
        presses = [
            replace(
                at,
                press=replace(
                    at.press, travel_mm=at.press.travel_mm + rng.normal(0, 0.05, len(at.press.leg))
                ),
            )
            for at in pressed.presses
        ]
        found = fit_gains(presses, DESCRIPTION, pressed.idle, SPEC)
        bound = np.array(found.gain_bound)
        off, well = np.array(found.gain) / pressed.finger.taxels.gain - 1, bound < 0.15
        assert (np.abs(off) < bound)[well].all()
        errors.append(off[well] / bound[well] * 3.3)
    assert np.mean(np.concatenate(errors) ** 2) < 1.0


def test_an_arm_that_gives_way_differently_in_each_press() -> None:
    (arm, *_) = (spec for spec in load_rig(EXAMPLES / "fresh-arms.toml").fingers)
    bounds = arm.bounds.model_copy(update={"deflection_mm_per_n": 0.05})
    array, tip = SPEC.array, arm.tip.model_copy(update={"radius_mm": 5.0})
    spec = arm.model_copy(update={"bounds": bounds, "array": array, "tip": tip})
    for seed in (31, 32, 33):
        pressed, rng = bench(seed), np.random.default_rng(seed)
        firm, common = pressed.finger.truth.stiffness_n_per_mm, rng.uniform(0, 1)
        presses = []
        for at in pressed.presses:
            longer = 1 + 0.05 * firm * (common + rng.uniform(0, 1)) / 2
            presses.append(replace(at, press=replace(at.press, travel_mm=at.press.travel_mm * longer)))
        found = fit_gains(presses, DESCRIPTION, pressed.idle, spec)
        bound = np.array(found.gain_bound)
        off, well = np.abs(np.array(found.gain) / pressed.finger.taxels.gain - 1), bound < 0.15
        assert well.sum() > 10 * DESCRIPTION.rows
        assert (off < bound)[well].all()
        assert abs(found.stiffness_n_per_mm / firm - 1) < found.stiffness_bound < 0.2
