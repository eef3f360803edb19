"""Fits of simulated presses of emulated arrays whose gains, phase, stiffness and crosstalk are known."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import pytest
from simulated_presses import (
    BEARINGS_DEG,
    DESCRIPTION,
    DISC_MM,
    MM_PER_RAD,
    PressingFinger,
    Truth,
    presses_of,
)

from palpate.calibration.gains import GainFit, GainPriors, PressAtBearing, gains_of
from palpate.calibration.idle import IdleFit, idle_of
from palpate.drivers.emulators.taxels import Taxels
from palpate.drivers.tactile.messages import Description, Shape
from palpate.errors import InputError

CROSSTALK = 0.06
EXPECTED = GainPriors(tip_radius_mm=5.0, mm_per_rad=MM_PER_RAD)
FEW_DEG = (-50.0, -30.0, -10.0, 15.0, 40.0)
SILENT = [(2, 9), (5, 12)]


@dataclass(frozen=True)
class Bench:
    """A finger, and what was recorded of it."""

    finger: PressingFinger
    idle: IdleFit
    presses: list[PressAtBearing]
    found: GainFit


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
    idle = idle_of([alive.idle()], description.max_count)
    finger = PressingFinger(truth, Taxels(description, seed=seed, **kind, dead=[(0, 8), *SILENT]), rng)
    presses = presses_of(finger, bearings_deg)
    return Bench(finger, idle, presses, gains_of(presses, description, idle, EXPECTED))


@pytest.mark.parametrize("seed", [11, 12, 13])
def test_finds_what_the_finger_is_like(seed: int) -> None:
    pressed = bench(seed)
    found, truth, gain = pressed.found, pressed.finger.truth, pressed.finger.taxels.gain
    off = np.abs(found.gain / gain - 1)
    well = found.pressed & (found.gain_bound < 0.15)
    assert well.sum() >= 11 * DESCRIPTION.rows - 3
    assert off[well].max() < 0.05
    assert (off <= found.gain_bound)[found.pressed].all()
    assert (np.abs(gain - 1) <= found.gain_bound)[~found.pressed].all()
    assert abs(found.phase_rad - truth.phase_rad) < 3 * found.phase_sigma_rad < math.radians(0.5)
    assert abs(found.stiffness_n_per_mm / truth.stiffness_n_per_mm - 1) < found.stiffness_bound < 0.05
    assert abs(found.crosstalk - CROSSTALK) < found.crosstalk_bound < 0.01
    assert found.friction_a == pytest.approx(np.full(11, truth.friction_a), abs=2e-3)
    assert found.residual_share < 0.015  # three samples a level: a part of an encoder step
    assert found.saturates_n is None
    assert pressed.idle.dead == ((0, 8),)
    assert found.unresponsive == tuple(SILENT)
    for place in ((0, 8), *SILENT):
        assert not found.pressed[place]
        assert (found.gain[place], found.gain_bound[place]) == (1.0, EXPECTED.gain_spread)


def test_an_uncertain_newton_makes_all_bounds_wider() -> None:
    finger = PressingFinger(Truth(), Taxels(DESCRIPTION, seed=1, offset_counts=20), np.random.default_rng(1))
    idle = idle_of([finger.idle()], DESCRIPTION.max_count)
    presses = [finger.press(bearing, DISC_MM, 2.0, 0.005) for bearing in (-0.2, 0.1)]
    exact = gains_of(presses, DESCRIPTION, idle, EXPECTED)
    unsure = gains_of(presses, DESCRIPTION, idle, replace(EXPECTED, force_bound=0.1))
    assert unsure.pressed.sum() > 4 * DESCRIPTION.rows
    assert (unsure.gain == exact.gain)[unsure.pressed].all()
    assert (unsure.gain_bound >= exact.gain_bound + 0.1)[unsure.pressed].all()
    assert unsure.stiffness_bound > exact.stiffness_bound + 0.1


def test_a_slope_of_gains_is_not_taken_for_a_turned_array() -> None:
    truth = Truth(phase_rad=math.radians(2.0))
    taxels = Taxels(DESCRIPTION, seed=1, offset_counts=20, crosstalk=CROSSTALK)
    finger = PressingFinger(truth, taxels, np.random.default_rng(1))
    idle = idle_of([finger.idle()], DESCRIPTION.max_count)
    slope = np.exp(np.linspace(-0.4, 0.4, DESCRIPTION.cols))
    presses = [
        replace(at, press=replace(at.press, counts=at.press.counts * slope))
        for at in presses_of(finger, FEW_DEG)
    ]
    found = gains_of(presses, DESCRIPTION, idle, replace(EXPECTED, gain_spread=0.5))
    assert math.degrees(found.phase_rad) == pytest.approx(2.0, abs=0.35)
    well = found.gain_bound < 0.15
    assert found.gain[well] == pytest.approx(np.broadcast_to(slope, well.shape)[well], rel=0.05)


def test_saturated_samples_are_left_out_and_told() -> None:
    shallow = replace(DESCRIPTION, bit_depth=8)  # full at 255 counts: 0.118 N on a taxel of gain 1
    recorded = bench(14, shallow, FEW_DEG)
    found = recorded.found
    gain = recorded.finger.taxels.gain
    well = found.pressed & (found.gain_bound < 0.15)
    assert well.sum() > 8 * DESCRIPTION.rows
    assert np.abs(found.gain / gain - 1)[well].max() < 0.05
    assert found.saturates_n is not None
    assert 1.0 < found.saturates_n < 3.5


def test_presses_that_say_nothing_are_errors() -> None:
    finger = PressingFinger(Truth(), Taxels(DESCRIPTION, seed=1, offset_counts=20), np.random.default_rng(1))
    idle = idle_of([finger.idle()], DESCRIPTION.max_count)
    good = finger.press(0.0, DISC_MM, 1.0, 0.005)
    light = replace(good, press=replace(good.press, counts=np.zeros_like(good.press.counts)))
    with pytest.raises(InputError, match="no presses"):
        gains_of([], DESCRIPTION, idle, EXPECTED)
    with pytest.raises(InputError, match="press harder"):
        gains_of([light], DESCRIPTION, idle, EXPECTED)
    flat = replace(DESCRIPTION, shape=Shape.FLAT)
    with pytest.raises(InputError, match="cylindrical"):
        gains_of([good], flat, idle, EXPECTED)


def test_a_press_that_met_nothing_is_left_out() -> None:
    pressed = bench(11)
    first = pressed.presses[0]
    missed = replace(first, press=replace(first.press, counts=np.zeros_like(first.press.counts)))
    found = gains_of([*pressed.presses, missed], DESCRIPTION, pressed.idle, EXPECTED)
    assert found.gain == pytest.approx(pressed.found.gain)
    assert len(found.friction_a) == len(pressed.presses)
