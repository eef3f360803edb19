"""Loads on the part by touches: what the meter makes of forces and travels, and what a run reports."""

import math

import pytest

from palpate.rig.motion.contact_load import LoadMeter, TouchStage

STIFFNESS = 3.0
PERIOD_S = 0.004


def pressed(meter: LoadMeter, begun_s: float, depth_mm: float, force_n: float | None = None) -> float:
    """In at 5 mm/s from 1 mm before the part, and out again; reads 20 ms apart. Returns when it is over."""
    turn_s = (1 + depth_mm) / 5
    count = math.ceil(2 * turn_s / PERIOD_S) + 1
    for k in range(count):
        t = k * PERIOD_S
        travel = 5 * min(t, 2 * turn_s - t)
        if k % 5 == 0 or k == count - 1:
            meter.see(travel, begun_s + t)
        spring = STIFFNESS * max(travel - 1, 0.0)
        meter.feel(spring if force_n is None else min(spring, force_n), begun_s + t + PERIOD_S)
    return begun_s + count * PERIOD_S


def test_a_press_and_release_has_its_peak_its_travel_and_its_work() -> None:
    meter = LoadMeter(0.3, PERIOD_S)
    meter.begin(TouchStage.QUICK, 0.0)
    pressed(meter, 0.0, 0.5)
    (load,) = meter.loads()
    assert load.stage is TouchStage.QUICK
    assert load.peak_force_n == pytest.approx(1.5, rel=0.05)
    assert load.travel_mm == pytest.approx(0.5, abs=0.05)
    assert load.work_mj == pytest.approx(STIFFNESS * 0.5**2 / 2, rel=0.1)
    assert (load.begun_s, load.ended_s) == pytest.approx((0.2, 0.4), abs=2 * PERIOD_S)


def test_a_part_that_slides_gets_more_work_than_its_peak_force_lets_expect() -> None:
    meter = LoadMeter(0.3, PERIOD_S)
    meter.begin(TouchStage.QUICK, 0.0)
    pressed(meter, 0.0, 2.0, force_n=0.4)
    (load,) = meter.loads()
    assert load.peak_force_n == pytest.approx(0.4)
    assert load.travel_mm == pytest.approx(2.0, abs=0.05)
    assert load.work_mj == pytest.approx(0.4 * 2.0, rel=0.1)


def test_every_touch_is_a_load_of_its_own_and_what_is_not_felt_is_none() -> None:
    meter = LoadMeter(0.3, PERIOD_S)
    meter.begin(TouchStage.QUICK, 0.0)
    end = pressed(meter, 0.0, 0.5)
    meter.begin(TouchStage.SLOW, end + PERIOD_S)
    end = pressed(meter, end + PERIOD_S, 0.02)  # 0.06 N: below half of what counts as a contact
    meter.begin(TouchStage.SLOW, end + PERIOD_S)
    pressed(meter, end + PERIOD_S, 0.1)
    assert [load.stage for load in meter.loads()] == [TouchStage.QUICK, TouchStage.SLOW]
    assert meter.loads()[1].peak_force_n == pytest.approx(0.3, rel=0.1)
    assert not LoadMeter(0.3, PERIOD_S).loads()
