"""Taxels: idle, gains, pressure distribution, presses under load."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from palpate.base.errors import InputError
from palpate.base.tips import TipShape
from palpate.calibration.finger_fit import touch_loads
from palpate.calibration.idle_statistics import (
    IdleFit,
    PressAtBearing,
    analyse_idle,
    average_levels,
    least_contact_force_n,
)
from palpate.calibration.measurements import IdleMeasurement, Probe, ReferenceDisc, TouchMeasurement
from palpate.calibration.press_model import (
    PressureDistribution,
    dent_and_bearing,
    distribute_pressure,
    fit_presses,
)
from palpate.calibration.tactile_step import fit_gains
from palpate.config import RigFile, SlideFingerConfig, TactileCalibration, load_rig
from palpate.drivers.emulators.taxels import Taxels
from palpate.drivers.emulators.tip import tip_load
from palpate.drivers.tactile.description import Description, Shape
from support.benches.presses import (
    BEARINGS_DEG,
    COLS,
    DESCRIPTION,
    DISC_MM,
    MM_PER_RAD,
    PITCH,
    PressingFinger,
    Truth,
    by_column,
    disc,
    face,
    presses_of,
)
from support.benches.simulated_rig import SimulatedProber, SimulatedRig
from support.benches.touched_references import SPECS
from support.campaign.sampling import sample
from support.commands.repository import EXAMPLES

# ----------------------------------------------------------------------------------------------------
# Idle recordings of emulated arrays, whose noise, drift and faults are known.

SHAPE = (DESCRIPTION.rows, DESCRIPTION.cols)


def recorded(taxels: Taxels, start_s: float, frames: int = 1000, rate_hz: float = 100.0) -> IdleMeasurement:
    time_s = start_s + np.arange(frames) / rate_hz
    return IdleMeasurement("f1", taxels.counts(np.zeros((frames, *SHAPE)), time_s), time_s)


def fit(*idles: IdleMeasurement) -> IdleFit:
    return analyse_idle(idles, DESCRIPTION.max_count)


@pytest.mark.parametrize("noise", [0.0, 1.0, 4.0])
def test_noise_and_zeros(noise: float) -> None:
    taxels = Taxels(DESCRIPTION, seed=1, noise_counts=noise, offset_counts=40)
    found = fit(recorded(taxels, 0.0))
    assert found.noise_counts == pytest.approx(math.hypot(noise, 1 / math.sqrt(12)), rel=0.03)
    assert found.zero_counts == pytest.approx(np.full(SHAPE, 40.0), abs=0.5)


@pytest.mark.parametrize("drift", [0.2, 1.0])
def test_drift_is_bounded_and_not_exaggerated(drift: float) -> None:
    # Zeros wander by sines: the fastest of 160 comes near the largest speed within half a minute.
    taxels = Taxels(DESCRIPTION, seed=2, noise_counts=2.0, offset_counts=200, drift_counts_per_s=drift)
    found = fit(recorded(taxels, 0.0), recorded(taxels, 20.0))
    assert drift <= found.drift_counts_per_s <= 1.1 * drift + 0.15


def test_drift_of_a_still_array_is_what_noise_hides() -> None:
    taxels = Taxels(DESCRIPTION, seed=3, noise_counts=2.0, offset_counts=20)
    assert fit(recorded(taxels, 0.0)).drift_counts_per_s < 0.2


def test_drift_between_short_recordings_is_seen() -> None:
    counts = np.full((20, *SHAPE), 50) + np.random.default_rng(4).normal(0, 2, (2, 20, *SHAPE)).round()
    counts[1, :, 3, 4] += 30
    time_s = np.arange(20) * 0.01
    first, second = (
        IdleMeasurement("f1", c.astype(np.uint16), time_s + t) for c, t in zip(counts, (0, 60), strict=True)
    )
    assert 0.5 <= fit(second, first).drift_counts_per_s < 0.6  # 30 counts in a minute


def test_faults_are_told_from_live_taxels() -> None:
    dead, hot = [(0, 0), (3, 7)], [(7, 19)]
    taxels = Taxels(DESCRIPTION, seed=5, noise_counts=2.0, offset_counts=20, dead=dead, hot=hot)
    found = fit(recorded(taxels, 0.0), recorded(taxels, 30.0))
    assert found.dead == tuple(dead)
    assert found.hot == tuple(hot)
    assert np.argwhere(~found.live).tolist() == [list(place) for place in (*dead, *hot)]


def test_a_quiet_array_has_no_dead_taxels() -> None:
    assert fit(recorded(Taxels(DESCRIPTION, seed=6, noise_counts=0.0, offset_counts=9), 0.0)).dead == ()


def test_least_force_stands_out_of_the_sum_of_three_columns() -> None:
    taxels = Taxels(DESCRIPTION, seed=7, noise_counts=2.0, offset_counts=20)
    found = fit(recorded(taxels, 0.0))
    sums = recorded(taxels, 50.0).counts[:, :, 4:7].astype(float).sum(axis=(1, 2))
    least = least_contact_force_n(found, DESCRIPTION.counts_per_n)
    assert least == pytest.approx(4 * sums.std() / DESCRIPTION.counts_per_n, rel=0.08)


def test_recordings_that_say_nothing_are_errors() -> None:
    short = recorded(Taxels(DESCRIPTION, seed=8), 0.0, frames=4)
    with pytest.raises(InputError, match="few"):
        fit(short)
    with pytest.raises(InputError, match="alive"):
        fit(
            IdleMeasurement(
                "f1", np.full((20, *SHAPE), DESCRIPTION.max_count, dtype=np.uint16), np.arange(20.0)
            )
        )
    with pytest.raises(InputError, match="time"):
        fit(IdleMeasurement("f1", np.ones((20, *SHAPE), dtype=np.uint16), np.zeros(20)))


# ----------------------------------------------------------------------------------------------------
# Fits of simulated presses of emulated arrays whose gains, phase, stiffness and crosstalk are known.

CROSSTALK = 0.06


def described(gain_spread: float = 0.4) -> SlideFingerConfig:
    """A finger of the simulated presses, whose array may sit up to 5° off."""
    slide = SPECS[0].slide.model_copy(update={"mm_per_turn": 2 * math.pi * MM_PER_RAD, "model": "XM430-W350"})
    array = SPECS[0].array.model_copy(
        update={"heading_deg": 0.0, "heading_bound_deg": 5.0, "gain_spread": gain_spread}
    )
    tip = SPECS[0].tip.model_copy(update={"radius_mm": 5.0})
    bounds = SPECS[0].bounds.model_copy(update={"encoder_deg": 0.0})
    return SPECS[0].model_copy(update={"slide": slide, "array": array, "tip": tip, "bounds": bounds})


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
    ball = SPEC.model_copy(update={"tip": SPEC.tip.model_copy(update={"shape": TipShape.BALL})})
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


def rolled(presses: Sequence[PressAtBearing], cols: int) -> list[PressAtBearing]:
    """The same presses of an array that is turned by so many columns."""
    return [
        replace(at, press=replace(at.press, counts=np.roll(at.press.counts, cols, axis=2))) for at in presses
    ]


def test_an_array_that_looks_elsewhere_than_the_rig_file_allows_is_refused() -> None:
    pressed = bench(11, bearings_deg=FEW_DEG)
    with pytest.raises(InputError, match="middle of its array looks at"):
        fit_gains(rolled(pressed.presses, 1), DESCRIPTION, pressed.idle, SPEC)
    turned = SPEC.replace_in_tables(array={"heading_deg": -math.degrees(PITCH)})
    found = fit_gains(rolled(pressed.presses, 1), DESCRIPTION, pressed.idle, turned)
    assert found.phase_deg == pytest.approx(pressed.found.phase_deg - math.degrees(PITCH), abs=0.5)


def test_an_array_that_was_not_pressed_where_its_columns_are_is_refused() -> None:
    pressed = bench(11, bearings_deg=FEW_DEG)
    with pytest.raises(InputError, match="do not fit where the reference pressed"):
        fit_gains(rolled(pressed.presses, 8), DESCRIPTION, pressed.idle, SPEC)


@pytest.mark.parametrize("seeds", sample([2, 6], [2]))
def test_bounds_hold_where_travels_are_not_well_known(seeds: int) -> None:
    errors = []
    for seed in range(21, 21 + seeds):
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


@pytest.mark.parametrize("seed", sample([31, 32, 33], [31]))
def test_an_arm_that_gives_way_differently_in_each_press(seed: int) -> None:
    (arm, *_) = (spec for spec in load_rig(EXAMPLES / "fresh-arms.toml").fingers)
    bounds = arm.bounds.model_copy(update={"deflection_mm_per_n": 0.05})
    array, tip = SPEC.array, arm.tip.model_copy(update={"radius_mm": 5.0})
    spec = arm.model_copy(update={"bounds": bounds, "array": array, "tip": tip})
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


# ----------------------------------------------------------------------------------------------------
# Columns' shares of a press, against the emulated skin and what must hold of any.

COLUMNS = np.array(DESCRIPTION.columns)
RADIUS = 5.0
FEW = settings(max_examples=25)
angles = st.floats(-1.2, 1.2)
dents = st.floats(0.01, 0.4)
curvatures = st.floats(0.0, 1.0)


def one(towards: float, dent: float, curvature: float) -> PressureDistribution:
    return distribute_pressure(COLUMNS, PITCH, *(np.array([value]) for value in (towards, dent, curvature)))


@FEW
@given(angles, dents, curvatures)
def test_shares_of_a_patch_on_the_array_sum_to_one(towards: float, dent: float, curvature: float) -> None:
    found = one(towards, dent, curvature)
    assert found.share.sum() == pytest.approx(1.0, abs=1e-5)
    assert (found.share >= 0).all()
    assert 0 < found.lean[0] <= 1


@FEW
@given(angles, dents, curvatures)
def test_mirrored_contacts_have_mirrored_shares(towards: float, dent: float, curvature: float) -> None:
    left, right = one(towards, dent, curvature), one(-towards, dent, curvature)
    assert left.share[0] == pytest.approx(right.share[0, ::-1], abs=1e-12)


@FEW
@given(angles, dents, curvatures)
def test_a_turn_by_a_column_moves_shares_by_one(towards: float, dent: float, curvature: float) -> None:
    here, there = one(towards, dent, curvature), one(towards + PITCH, dent, curvature)
    assert here.share[0, :-1] == pytest.approx(there.share[0, 1:], abs=1e-9)


def test_what_is_beside_the_array_is_missing() -> None:
    edge = float(COLUMNS[-1]) + PITCH / 2
    assert one(edge, 0.2, 0.0).share.sum() == pytest.approx(0.5, abs=1e-6)
    assert one(math.pi, 0.1, 0.0).share.sum() == 0.0


@FEW
@given(angles, st.floats(0.05, 0.3), st.sampled_from([None, 8.0, 25.0, 60.0]))
def test_agrees_with_the_emulated_skin(towards: float, dent: float, disc_mm: float | None) -> None:
    away = RADIUS * (1 - dent)
    if disc_mm is None:
        outline, aim, centre = face(), 0.0, np.array([-away, 0.0])
    else:
        outline, aim = disc(disc_mm), towards
        centre = -(disc_mm + away) * np.array([math.cos(aim), math.sin(aim)])
    touch = tip_load(outline, centre, RADIUS, 3.0)
    assert touch is not None
    found = one(towards, dent, 0.0 if disc_mm is None else RADIUS / disc_mm)
    total = float(touch.by_ray_n.sum())
    felt = by_column(touch.angle, touch.by_ray_n, aim - towards) / total
    # Rays a quarter of a degree apart: a column's edge is off by half of that at most, in 13.5 degrees.
    assert found.share[0] == pytest.approx(felt, abs=0.01)
    push = float(np.hypot(*touch.force_n))
    assert push == pytest.approx(total * found.lean[0], rel=0.002)
    # The force on the axis is as on a flat wall: on a small disc, less of what taxels see cancels out.
    assert total == pytest.approx(3.0 * dent * RADIUS, rel=0.01 + dent / 16)
    assert felt.shape == (COLS,)


@FEW
@given(st.floats(0.0, 1.5), angles, st.sampled_from([0.0, 0.02, 0.04, 0.2]))
def test_approach_is_the_triangle_of_both_centres(travel: float, bearing: float, curvature: float) -> None:
    dent, turned = dent_and_bearing(np.array([travel]), np.array([bearing]), RADIUS, np.array([curvature]))
    reference = 1 / max(curvature, 1e-7)  # a face is a huge disc
    towards = (RADIUS + reference) * complex(math.cos(bearing), math.sin(bearing)) - travel
    assert dent[0] == pytest.approx(RADIUS + reference - abs(towards), abs=1e-4)
    assert turned[0] == pytest.approx(math.atan2(towards.imag, towards.real), abs=1e-6)


# ----------------------------------------------------------------------------------------------------
# Presses and touches of fingers that stick, give way and have their play taken up: what is made of them.

FRICTION = 0.4
DISC = ReferenceDisc("disc", 25.0)


def loaded_rig(**finger: Any) -> RigFile:
    """The fresh rig, without dead taxels, with forces that act on fingers, and that declares them."""
    data = load_rig(EXAMPLES / "fresh-rig.toml").model_dump(mode="json", exclude_unset=True)
    data["emulation"] |= {
        "dead_taxels": 0,
        "deflection_mm_per_n": 0.1,
        "play_holds_n": [0.1, 0.3],
        "part": {"engine": "still", "tip_friction": FRICTION},
    }
    for spec in data["fingers"]:
        spec["tip"] |= {"max_friction": 0.6}
        spec["aim"] |= {"backlash_holds_n": 0.0} | finger
        spec["bounds"] |= {"deflection_mm_per_n": 0.1, "deflection_deg_per_n": 0.03, "encoder_deg": 0.0}
    return RigFile.model_validate(data)


def pressed(rig: RigFile, seed: int) -> tuple[SimulatedRig, list[PressAtBearing]]:
    """Presses of the first finger on a disc near the middle, at the bearings at which it really meets it."""
    world = SimulatedRig(rig, seed)
    prober = SimulatedProber(world, rig)
    prober.put(DISC, (0.0, 0.0))
    found = []
    for number, item in enumerate(prober.approaches):
        if item.finger != 0 or number % 2:
            continue
        bearing = prober.bearing_rad(number)
        if bearing is None or abs(bearing) > math.radians(47):
            continue
        (press,) = prober.press([Probe(number, item.length_mm, int(np.sign(bearing)))], 0)
        found.append(PressAtBearing(press, bearing, math.radians(0.3), 1 / DISC.radius_mm))
    return world, found


def test_friction_and_softness_are_told_from_gains() -> None:
    rig = loaded_rig()
    world, presses = pressed(rig, 4)
    assert len(presses) >= 7
    spec, truth, taxels = rig.fingers[0], world.truth(0), world.fingers[0].array.taxels
    assert isinstance(spec, SlideFingerConfig)
    description = world.fingers[0].array.description
    idle = analyse_idle(SimulatedProber(world, rig).idle(2.0)[:1], description.max_count)
    full = description.max_count - 0.5 - idle.zero_counts
    levels = average_levels(presses, idle.live, full, idle.noise_counts)
    rows = np.full(description.cols, description.rows)
    found = fit_presses(
        presses, levels, levels.counts.mean(axis=1), rows, idle.noise_counts, description, spec
    )
    assert found.friction == pytest.approx(FRICTION, rel=0.08)
    assert truth.aim_yield is not None
    reach = math.dist(truth.base_mm, (0.0, 0.0)) - 30.0
    softness = truth.aim_yield.rad_per_nmm * reach**2 * truth.stiffness_n_per_mm
    assert abs(found.softness - softness) < 3 * found.softness_sigma < 0.15
    well = found.gain_log_sigma < 0.03
    assert well.sum() >= 8
    off = np.log(found.gain / taxels.gain.mean(axis=0))[well]
    assert np.abs(off).max() < 0.06
    assert (np.abs(off) < 4 * found.gain_log_sigma[well]).all()


def touch(bearing_deg: float, way: int = 1) -> TouchMeasurement:
    return TouchMeasurement("f1", 0, (0.0, 0.0), way, math.radians(bearing_deg), 0.05, 0.5, 0.05)


def test_loads_of_touches_by_their_rule() -> None:
    specs = [spec for spec in loaded_rig().fingers if isinstance(spec, SlideFingerConfig)]
    loads = touch_loads([touch(0.0), touch(45.0), touch(-45.0), touch(5.0)], specs)
    assert loads.side.tolist() == [0, 1, -1, 1]
    assert loads.pushes.tolist() == [[True, False]] * 4
    # Half of what is declared, and of the push what friction leaves: a third where it sticks, 0.4 at 45°.
    small = math.sin(math.radians(5)) ** 2
    assert loads.give_mm == pytest.approx(0.1 * 0.5 * np.array([0, 0.5 * 0.35, 0.5 * 0.35, small / 3]))
    # It slips at 45°, and sticks at 5°.
    slipping = 0.6 * 0.5 / (2 / 3 * 3.0) / 5.0
    assert loads.sheared_rad[1:3] == pytest.approx(np.full(2, slipping / 2))
    assert loads.sheared_rad[3] == pytest.approx(math.tan(math.radians(5)) * 0.5 / 3.0 / 5.0 / 2)
    assert loads.sheared_rad[0] == 0
    held = [replaced(spec) for spec in specs]
    assert not touch_loads([touch(45.0)], held).pushes.any()


def replaced(spec: SlideFingerConfig) -> SlideFingerConfig:
    """The same, with play that no force takes up."""
    return spec.model_copy(update={"aim": spec.aim.model_copy(update={"backlash_holds_n": None})})
