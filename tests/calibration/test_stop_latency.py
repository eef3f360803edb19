"""Latency and overshoot from simulated stops: distance is speed times what the closing loop takes."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from palpate.base.errors import InputError
from palpate.calibration.actuator_estimators import fit_latency
from palpate.calibration.measurements import StopMeasurement
from palpate.drivers.kinematics import TICK_RAD

MM_PER_RAD = 100 / (2 * np.pi)
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
    found = fit_latency(stops_of(fixed, [10.0, 20.0, 40.0], 4, seed, mm_per_rad), STEP_MM, TOUCH_MM_S, 0.999)
    assert found.latency_s == pytest.approx(fixed + WAIT_S / 2, abs=0.002)
    assert found.latency_bound_s >= fixed + WAIT_S
    assert found.latency_bound_s < fixed + 4 * WAIT_S
    for row in found.overshoots:
        assert row.bound_mm >= row.speed_mm_s * (fixed + WAIT_S)
        assert row.bound_mm >= row.largest_mm
    assert [row.speed_mm_s for row in found.overshoots] == [10.0, 20.0, 40.0]


def test_bounds_cover_further_stops() -> None:
    found = fit_latency(stops_of(0.006, [20.0], 8, 1), STEP_MM, TOUCH_MM_S, 0.999)
    later = fit_latency(stops_of(0.006, [20.0], 500, 2), STEP_MM, TOUCH_MM_S, 0.999)
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
    bounds = [fit_latency(stops, STEP_MM, TOUCH_MM_S, 0.999).latency_bound_s for stops in (calm, late)]
    assert bounds[1] > 2 * bounds[0]


def test_slow_stops_say_nothing() -> None:
    with pytest.raises(InputError, match="finger f1: 2 stops were faster"):
        fit_latency(stops_of(0.006, [5.0, 20.0], 2, 1), STEP_MM, TOUCH_MM_S, 0.999)
