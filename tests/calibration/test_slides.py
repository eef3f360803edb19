"""Homing, backlash, friction and stop latency of slides."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from palpate.base.errors import InputError
from palpate.base.geometry import Floats, Ints
from palpate.calibration.actuator_estimators import (
    Backlash,
    Homing,
    StopStalls,
    combine_backlash,
    estimate_backlash,
    estimate_friction,
    fit_homing,
    fit_stops,
)
from palpate.calibration.measurements import LEG_FREE, LEG_IN, LEG_OUT, PressMeasurement, StopMeasurement
from palpate.drivers.emulators.mechanics import FingerTruth, SlideMechanics
from palpate.drivers.emulators.servo import EmulatedServo
from palpate.drivers.kinematics import TICK_RAD
from support.benches.presses import slide_press
from support.benches.touched_references import SPECS
from support.devices.servo_wire import Console

# ----------------------------------------------------------------------------------------------------
# Homing against simulated hard stops: what was put in comes out, and what is wrong is refused.

MM_PER_RAD = 100 / (2 * np.pi)
STOPS = (40.0, 255.0)


def homed(
    back: np.ndarray[tuple[int], np.dtype[np.float64]],
    front: np.ndarray[tuple[int], np.dtype[np.float64]],
    backlash: Backlash,
    scale: float = MM_PER_RAD,
) -> Homing:
    described = SPECS[0].slide.model_copy(
        update={"mm_per_turn": 2 * np.pi * scale, "mm_per_turn_spread": 0.01}
    )
    return fit_homing(
        SPECS[0].model_copy(update={"slide": described}), StopStalls(STOPS, back, front), backlash
    )


def stalls(
    scale: float, zero: float, half: float, sigma_rad: float, seed: int, count: int = 5
) -> list[np.ndarray[tuple[int], np.dtype[np.float64]]]:
    """Servo angles where a drive stands that has pressed a carriage with play against each stop."""
    rng = np.random.default_rng(seed)
    drives = (STOPS[0] - half, STOPS[1] + half)
    angles = [(drive - zero) / scale + rng.normal(0, sigma_rad, count) for drive in drives]
    return [np.round(angle / TICK_RAD) * TICK_RAD for angle in angles]


@settings(max_examples=40)
@given(
    share=st.floats(-0.009, 0.009),
    sign=st.sampled_from([1.0, -1.0]),
    zero=st.floats(80.0, 100.0),
    half=st.floats(0.0, 0.2),
    seed=st.integers(0, 1000),
)
def test_scale_and_zero_come_back(share: float, sign: float, zero: float, half: float, seed: int) -> None:
    scale = sign * MM_PER_RAD * (1 + share)
    back, front = stalls(scale, zero, half, 0.5 * TICK_RAD, seed)
    found = homed(back, front, Backlash(half, 0.005), sign * MM_PER_RAD)
    assert abs(found.mm_per_rad - scale) < 4 * found.mm_per_rad_sigma
    assert abs(found.zero_mm - zero) < 4 * found.zero_sigma_mm
    assert found.zero_sigma_mm < 0.03


def test_play_belongs_to_the_scale() -> None:
    back, front = stalls(MM_PER_RAD, 90.0, 0.2, 0.0, 0)
    right = homed(back, front, Backlash(0.2, 0.0))
    blind = homed(back, front, Backlash(0.0, 0.0))
    # 215 mm apart; 0.4 mm of play in it make the scale smaller by as much
    assert right.mm_per_rad == pytest.approx(MM_PER_RAD, rel=1e-4)
    assert blind.mm_per_rad / right.mm_per_rad == pytest.approx(215 / 215.4, rel=1e-6)


def test_sigmas_hold_in_many_trials() -> None:
    rng = np.random.default_rng(7)
    off = []
    for seed in range(300):
        half = 0.08 + rng.normal(0, 0.02)
        back, front = stalls(MM_PER_RAD, 90.0, half, TICK_RAD, seed)
        found = homed(back, front, Backlash(0.08, 0.02))
        off.append(
            (
                (found.mm_per_rad - MM_PER_RAD) / found.mm_per_rad_sigma,
                (found.zero_mm - 90) / found.zero_sigma_mm,
            )
        )
    scale, zero = np.std(off, axis=0)
    assert 0.7 < scale < 1.2
    assert 0.7 < zero < 1.2


def test_another_scale_is_refused() -> None:
    back, front = stalls(1.02 * MM_PER_RAD, 90.0, 0.05, 0.0, 0)
    with pytest.raises(
        InputError, match=r"slide \(ID \d+\) moves (101\.9|102\.0)\d\d mm per turn .* 100\.000 mm ± 1\.\d %"
    ):
        homed(back, front, Backlash(0.05, 0.01))


def test_stops_the_wrong_way_round_are_refused() -> None:
    back, front = stalls(-MM_PER_RAD, 90.0, 0.05, 0.0, 0)
    with pytest.raises(InputError, match="turns the other way"):
        homed(back, front, Backlash(0.05, 0.01))


def test_a_stop_that_was_not_tried_is_refused() -> None:
    back, _ = stalls(MM_PER_RAD, 90.0, 0.05, 0.0, 0)
    with pytest.raises(InputError, match="5 times at its back and 0 times at its front"):
        homed(back, np.empty(0), Backlash(0.05, 0.01))


def test_emulated_servo_stalls() -> None:
    """An emulated servo in current-based position mode, pushed back by stiff stops behind its play."""
    zero, half, yields_mm = 90.0, 0.1, 1e-3
    console = Console()
    console.start(5, current=60, velocity=120)
    found = []
    for goal in (-4000, 9000):
        angles = []
        for _ in range(2):
            console.write(116, 2048, 4)
            console.run(2.0, dt=2e-3)
            console.write(116, goal, 4)
            for _ in range(4500):
                drive = zero + MM_PER_RAD * console.servo.shaft_rad
                past = max(0.0, drive - half - STOPS[1]) + min(0.0, drive + half - STOPS[0])
                held = float(np.clip(past / yields_mm, -1, 1)) * 0.5
                console.servo.step(1e-3, -held)
            angles.append((console.read(132, 4) - 2048) * TICK_RAD)
        found.append(np.array(angles))
    homing = homed(found[0], found[1], Backlash(half, 0.005))
    assert homing.mm_per_rad == pytest.approx(MM_PER_RAD, abs=3 * homing.mm_per_rad_sigma)
    assert homing.zero_mm == pytest.approx(zero, abs=3 * homing.zero_sigma_mm)


# ----------------------------------------------------------------------------------------------------
# Play and friction from simulated presses: closed forms, and the emulated servo with its mechanics.

TOUCH_MM = 60.0  # where a tip without play begins to be dented
STIFFNESS = 3.0
DENT_MM = 1.2


def press_of(drive_mm: Floats, leg: Ints, mm_per_rad: float, current_a: Floats) -> PressMeasurement:
    """The press that a servo with encoder steps reports for a drive at `drive_mm`."""
    slide = np.round(drive_mm / mm_per_rad / TICK_RAD) * TICK_RAD
    return slide_press(slide, mm_per_rad, current_a, leg)


def simulated(
    half_mm: float,
    seed: int,
    *,
    noise_n: float = 0.05,
    mm_per_rad: float = MM_PER_RAD,
    power: float = 1.0,
    out_speed: float = 1.0,
) -> tuple[PressMeasurement, Floats]:
    """A press by the definition of play: the tip is behind the drive, half of it on either flank.

    Force grows with the dent's `power`. The way back has `out_speed` times the samples, unevenly spread.
    """
    rng = np.random.default_rng(seed)
    top = TOUCH_MM + half_mm + DENT_MM
    goes_in = np.arange(TOUCH_MM - 2, top, 0.008) + rng.uniform(0, 0.008)
    back = np.sort(rng.uniform(TOUCH_MM - 2, top, int(400 * out_speed)))[::-1]
    drive = np.concatenate([goes_in, np.full(40, top), back])
    tip_in, tip_out = goes_in - half_mm, np.minimum(back + half_mm, top - half_mm)
    tip = np.concatenate([tip_in, np.full(40, top - half_mm), tip_out])
    dent = np.maximum(0.0, tip - TOUCH_MM)
    leg = np.concatenate(
        [np.where(tip_in < TOUCH_MM, LEG_FREE, LEG_IN), np.full(40, LEG_IN), np.full(len(back), LEG_OUT)]
    )
    force = STIFFNESS * DENT_MM * (dent / DENT_MM) ** power + rng.normal(0, noise_n, len(dent))
    return press_of(drive, leg, mm_per_rad, np.full(len(leg), 0.03)), force


@settings(max_examples=25)
@given(
    half=st.floats(0.02, 0.2),
    power=st.floats(0.7, 1.6),
    out_speed=st.floats(0.3, 3.0),
    noise=st.floats(0.0, 0.1),
    mm_per_rad=st.sampled_from([MM_PER_RAD, -MM_PER_RAD, MM_PER_RAD / 2]),
    seed=st.integers(0, 1000),
)
def test_half_play_within_a_hundredth(
    half: float, power: float, out_speed: float, noise: float, mm_per_rad: float, seed: int
) -> None:
    plays = []
    for trial in range(3):
        press, force = simulated(
            half, seed + trial, power=power, out_speed=out_speed, noise_n=noise, mm_per_rad=mm_per_rad
        )
        plays.append(estimate_backlash(press, force))
    assert combine_backlash(plays).half_mm == pytest.approx(half, abs=0.01)
    assert all(abs(play.half_mm - half) < max(5 * play.sigma_mm, 0.005) for play in plays)


def test_no_play_is_nearly_none() -> None:
    press, force = simulated(0.0, 1)
    assert estimate_backlash(press, force).half_mm < 0.01


def test_a_force_that_is_older_than_the_angle_is_no_play() -> None:
    press, force = simulated(0.05, 4)
    older = np.concatenate(
        [force[:1], (force[1:] + force[:-1]) / 2]
    )  # as if averaged since the sample before
    speed_mm = 0.008  # a sample, going in
    naive = estimate_backlash(press, older).half_mm
    assert estimate_backlash(press, older, 0.5).half_mm == pytest.approx(0.05, abs=0.002)
    assert naive - 0.05 == pytest.approx(speed_mm / 2, abs=0.002)


def test_a_drive_that_winds_up_counts_as_lost_motion() -> None:
    press, force = simulated(0.05, 2)
    wound = np.select([press.leg == LEG_IN, press.leg == LEG_OUT], [0.02, -0.02]) / MM_PER_RAD
    wound_up = replace(press, travel_mm=press.travel_mm + MM_PER_RAD * wound)
    assert estimate_backlash(wound_up, force).half_mm == pytest.approx(0.05 + 0.02, abs=0.005)


def test_a_skin_with_hysteresis_hides_play_and_widens_the_deviation() -> None:
    press, force = simulated(0.1, 2)
    full = force.max()
    lost = np.where(
        press.leg == LEG_OUT, 0.15 * 4 * force * (full - force) / full**2, 0.0
    )  # N, none at the ends
    plain, hidden = (estimate_backlash(press, each) for each in (force, force - lost))
    # on average over the slices 0.12 N less going back, at 3 N/mm
    assert plain.half_mm - hidden.half_mm == pytest.approx(0.02, abs=0.005)
    assert hidden.sigma_mm > plain.sigma_mm


def test_a_press_without_a_way_back_is_refused() -> None:
    press, force = simulated(0.05, 3)
    cut = press.leg != LEG_OUT
    slide = press.travel_mm[cut] / MM_PER_RAD
    short = slide_press(slide, MM_PER_RAD, press.push_n[cut], press.leg[cut], placing=4)
    with pytest.raises(InputError, match=r"finger f1, placing 4: .* press harder or more slowly"):
        estimate_backlash(short, force[cut])


def test_a_press_that_felt_nothing_is_refused() -> None:
    press, _ = simulated(0.05, 3)
    with pytest.raises(InputError, match="too few"):
        estimate_backlash(press, np.zeros(len(press.leg)))


def test_one_bad_press_does_not_carry_the_day() -> None:
    presses = [
        Backlash(0.05, 0.003),
        Backlash(0.054, 0.003),
        Backlash(0.4, 0.003),
        Backlash(0.051, 0.003),
        Backlash(0.053, 0.003),
    ]
    found = combine_backlash(presses)
    assert found.half_mm == 0.053
    assert 0.002 < found.sigma_mm < 0.006
    with pytest.raises(ValueError, match="at least one"):
        combine_backlash([])


def emulated_press(half_mm: float) -> tuple[PressMeasurement, Floats]:
    """A press at 4 mm/s by an emulated servo, its play and a springy tip, sampled every 4 ms."""
    console = Console()
    truth = FingerTruth((0.0, 0.0), 0.0, 10.0, 5.0, 0.0, 0.0, MM_PER_RAD, 50.0, half_mm, 5.0, STIFFNESS, 0.0)
    mechanics = SlideMechanics(truth, EmulatedServo(2), console.servo)
    console.start(5, current=400, velocity=11)  # current-based position; 0.229 rpm a unit
    leg, slide, current, force = [], [], [], []
    for goal, way in ((2048 + 470, LEG_IN), (2048, LEG_OUT)):
        console.write(116, goal, 4)
        for _ in range(700):
            for _ in range(4):
                push = STIFFNESS * max(0.0, float(mechanics.centre_mm[0]) - TOUCH_MM)
                mechanics.step(1e-3, np.array([-push, 0.0]))
            leg.append(LEG_FREE if way == LEG_IN and push == 0 else way)
            slide.append((console.read(132, 4) - 2048) * TICK_RAD)
            current.append(console.read(126, 2) * 2.69e-3)
            force.append(push)
    legs = np.array(leg)
    press = slide_press(np.array(slide), MM_PER_RAD, np.array(current), legs)
    return press, np.array(force)


def test_emulated_servo_and_mechanics() -> None:
    press, force = emulated_press(0.08)
    assert force.max() > 2.0
    assert estimate_backlash(press, force).half_mm == pytest.approx(0.08, abs=0.01)
    friction = estimate_friction([press])
    # gear friction of the emulated motor by its torque constant: 0.05 N·m / (4.1 N·m / 2.3 A)
    assert friction.push_n == pytest.approx(0.05 * 2.3 / 4.1, abs=0.006)
    assert friction.direction == 1


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_friction_of_moving_samples_only(sign: float) -> None:
    rng = np.random.default_rng(5)
    drive = np.concatenate([np.zeros(100), np.linspace(0, 3, 200), np.full(100, 3.0)])
    current = np.where((drive > 0) & (drive < 3), 0.05, 0.4) + rng.normal(0, 0.01, 400)
    press = press_of(drive, np.full(400, LEG_FREE), sign * MM_PER_RAD, current)
    found = estimate_friction([press])
    assert found.push_n == pytest.approx(0.05, abs=0.005)
    assert found.direction == 1
    assert estimate_friction([press_of(drive, np.full(400, LEG_FREE), MM_PER_RAD, -current)]).direction == -1


def test_friction_needs_motion() -> None:
    press = press_of(np.zeros(100), np.full(100, LEG_FREE), MM_PER_RAD, np.zeros(100))
    with pytest.raises(InputError, match=r"finger f1: .* in 0 samples only"):
        estimate_friction([press])


# ----------------------------------------------------------------------------------------------------
# Latency and overshoot from simulated stops: distance is speed times what the closing loop takes.

STEP_MM = MM_PER_RAD * TICK_RAD
TOUCH_MM_S = 5.0
WAIT_S = 0.004


def stops_of(
    fixed_s: float, speeds: list[float], each: int, seed: int, mm_per_rad: float = MM_PER_RAD
) -> list[StopMeasurement]:
    """Stops `fixed_s` and a wait between looks after the contact; dents that are felt cost 0.1 mm."""
    rng = np.random.default_rng(seed)

    def stands(speed: float) -> float:
        place = 60.1 + speed * (fixed_s + rng.uniform(0, WAIT_S))
        return float(np.round(place / mm_per_rad / TICK_RAD) * TICK_RAD * mm_per_rad)

    return [
        StopMeasurement("f1", speed, 0.0, stands(speed), stands(TOUCH_MM_S), WAIT_S)
        for speed in speeds
        for _ in range(each)
    ]


@settings(max_examples=30)
@given(
    fixed=st.floats(0.0, 0.02),
    seed=st.integers(0, 10_000),
    mm_per_rad=st.sampled_from([MM_PER_RAD, -MM_PER_RAD]),
)
def test_latency_and_its_bound(fixed: float, seed: int, mm_per_rad: float) -> None:
    found = fit_stops(stops_of(fixed, [10.0, 20.0, 40.0], 4, seed, mm_per_rad), STEP_MM, TOUCH_MM_S, 0.999)
    assert found.latency_s == pytest.approx(fixed + WAIT_S / 2, abs=0.002)
    assert found.latency_bound_s >= fixed + WAIT_S
    assert found.latency_bound_s < fixed + 4 * WAIT_S
    for row in found.overshoots:
        assert row.bound_mm >= row.speed_mm_s * (fixed + WAIT_S)
        assert row.bound_mm >= row.largest_mm
    assert [row.speed_mm_s for row in found.overshoots] == [10.0, 20.0, 40.0]


def test_bounds_cover_further_stops() -> None:
    found = fit_stops(stops_of(0.006, [20.0], 8, 1), STEP_MM, TOUCH_MM_S, 0.999)
    later = fit_stops(stops_of(0.006, [20.0], 500, 2), STEP_MM, TOUCH_MM_S, 0.999)
    assert later.overshoots[0].largest_mm <= found.overshoots[0].bound_mm


def test_scatter_beyond_the_wait_widens_the_bound() -> None:
    rng = np.random.default_rng(3)
    calm = stops_of(0.006, [20.0, 40.0], 6, 4)
    late = [
        StopMeasurement(
            "f1",
            s.speed_mm_s,
            0.0,
            s.stood_mm + s.speed_mm_s * rng.exponential(0.01),
            s.contact_mm,
            WAIT_S,
        )
        for s in calm
    ]
    bounds = [fit_stops(stops, STEP_MM, TOUCH_MM_S, 0.999).latency_bound_s for stops in (calm, late)]
    assert bounds[1] > 2 * bounds[0]


def test_slow_stops_say_nothing() -> None:
    with pytest.raises(InputError, match="finger f1: 2 stops were faster"):
        fit_stops(stops_of(0.006, [5.0, 20.0], 2, 1), STEP_MM, TOUCH_MM_S, 0.999)
