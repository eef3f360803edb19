"""Homing against simulated hard stops: what was put in comes out, and what is wrong is refused."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from servo_console import Console
from touched_references import SPECS

from palpate.base.errors import InputError
from palpate.calibration.actuator_estimators import Backlash, Homing, StopStalls, fit_homing
from palpate.drivers.kinematics import TICK_RAD

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
        InputError, match=r"slide \(ID \d+\) moves (101\.9|102\.0)\d\d mm per turn .* 100\.000 mm ± 1 %"
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
