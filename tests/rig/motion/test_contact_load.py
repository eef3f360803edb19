"""Loads on the part by touches: what the meter makes of forces and travels, and what a run reports."""

import math

import numpy as np
import pytest

from palpate.rig.motion.load_meter import LoadMeter, TouchStage

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


def counts(rng: np.random.Generator, above: float = 0.0) -> np.ndarray:
    return np.round(rng.normal(100.0 + above, 2.0, (4, 6))).astype(np.uint16)


def test_a_finger_is_taken_to_go_forward_until_it_is_stopped_and_not_while_it_stands() -> None:
    meter = LoadMeter(0.3, PERIOD_S, unnoticed_n=0.05, touch_mm_s=5.0, step_mm=0.02)
    meter.begin(TouchStage.SLOW, 0.0)
    for k in range(200):
        t = k * PERIOD_S
        travel = 5 * min(t, 0.4)
        if k % 5 == 0:
            meter.see(round(travel / 0.02) * 0.02, t)
        meter.feel(STIFFNESS * max(travel - 1.8, 0.0), t + PERIOD_S)
        if k == 100:
            meter.stopped(t)
    meter.measured(0.7)
    trace = meter.trace()
    assert trace is not None
    assert trace.felt
    pressed = trace.force_n > 0
    # From 0.05 N on: what is left of 0.2 mm, as much faster as allowed, and what a tip takes to stand.
    assert 0.18 < trace.advance_mm[pressed].sum() < 0.27
    assert trace.advance_mm[-90:].sum() == 0.0
    assert trace.measured_s == 0.7


def test_a_frame_that_may_be_old_belongs_to_wherever_the_tip_may_have_been() -> None:
    """Frames that may be up to 80 ms old, on a way that is free for 1 mm."""
    traces = []
    for late_s in (0.0, 0.08):
        meter = LoadMeter(0.3, PERIOD_S, unnoticed_n=0.05, touch_mm_s=5.0)
        meter.late_by(late_s)
        meter.begin(TouchStage.SLOW, 0.0, free_mm=1.0, free_within_mm=0.5)
        for k in range(200):
            meter.see(5 * k * PERIOD_S, k * PERIOD_S)
            meter.feel(0.2 if k >= 150 else 0.0, (k + 1) * PERIOD_S)
        trace = meter.trace()
        assert trace is not None
        traces.append(trace)
    fresh, old = traces
    assert (fresh.time_bound_s, old.time_bound_s) == pytest.approx((PERIOD_S, 0.04))
    assert fresh.unfelt_mm - old.unfelt_mm == pytest.approx(5 * (0.08 - 2 * PERIOD_S), abs=5.1 * PERIOD_S)
    assert old.free_within_mm.sum() == pytest.approx(fresh.free_within_mm.sum(), abs=1.0)
    assert meter.may_touch(0.0)
    begins = LoadMeter(0.3, PERIOD_S)
    begins.begin(TouchStage.QUICK, 0.0, free_mm=10.0)
    for travel, at_s in ((12.0, 1.0), (5.0, 1.2), (4.0, 1.3)):
        begins.see(travel, at_s)
    assert not begins.may_touch(1.25)
    assert begins.may_touch(1.1), "frames of the time before are still to come"


def test_the_mean_of_quiet_frames_hides_less_and_a_free_way_is_known() -> None:
    meter = LoadMeter(0.3, PERIOD_S, unnoticed_n=0.05, touch_mm_s=5.0)
    meter.begin(TouchStage.SLOW, 0.0, free_mm=1.0, free_within_mm=0.5)
    for k in range(200):
        meter.see(5 * k * PERIOD_S, k * PERIOD_S)
        meter.feel(0.2 if k == 150 else 0.0, (k + 1) * PERIOD_S, 0.01 if k == 120 else 0.0)
    trace = meter.trace()
    assert trace is not None
    assert (trace.free_within_mm[:47] == 0.5).all()
    assert not trace.free_within_mm[53:].any()
    assert trace.unnoticed_n[60] == pytest.approx(0.05 / 8)
    assert trace.unnoticed_n[170] == pytest.approx(0.05 / 7)
    assert np.flatnonzero(trace.force_n).tolist() == [*range(57, 121), 150]
    assert trace.force_n[[57, 120, 150]] == pytest.approx([0.01, 0.01, 0.2])


def test_means_of_counts_are_of_the_newest_quiet_frames() -> None:
    rng = np.random.default_rng(4)
    meter = LoadMeter(0.3, PERIOD_S, unnoticed_n=0.05)
    frames: list[np.ndarray] = []
    for k in range(300):
        frame = counts(rng)
        if k in (40, 41, 200):
            assert meter.quiet_mean(frame, 0.06) is None
            frames = []
            continue
        frames = [*frames, frame][-64:]
        found = meter.quiet_mean(frame, 0.04)
        assert found is not None
        assert found[1] == len(frames)
        assert found[0] == pytest.approx(np.mean(frames, axis=0))


@pytest.mark.parametrize("late_s", [0.004, 0.01, 0.018])
def test_all_of_the_way_back_counts_from_where_a_tip_turns_after_the_order_to_stop(late_s: float) -> None:
    """At 20 mm/s it goes on for up to 0.4 mm, and the part is still pressed while it comes back as far."""
    step_mm, stop_s = 0.0244, 0.2
    turn_s = stop_s + late_s

    def travel(t: float) -> float:
        return 20 * min(t, turn_s) - min(max(95 * (t - turn_s), 0.0) * (t - turn_s) / 2, 3.0)

    meter = LoadMeter(0.3, PERIOD_S, unnoticed_n=0.05, touch_mm_s=20.0, step_mm=step_mm)
    meter.begin(TouchStage.QUICK, 0.0)
    for k in range(200):
        t = k * PERIOD_S
        if k % 5 == 0:
            meter.see(round(travel(t) / step_mm) * step_mm, t)
        meter.feel(0.5 if travel(t) > 3.9 else 0.0, t + PERIOD_S)
    meter.stopped(stop_s)
    trace = meter.trace()
    assert trace is not None
    assert 3.0 - step_mm / 2 < trace.retreat_mm.sum() < 3.0 + 2 * step_mm


@pytest.mark.parametrize(("step_mm", "every"), [(0.0244, 5), (0.153, 1)])
@pytest.mark.parametrize("faster", [0.0, 2.0, 5.0])
def test_a_finger_that_is_faster_than_its_touch_has_gone_as_far_as_it_is_seen(
    faster: float, step_mm: float, every: int
) -> None:
    """Where servos tell places by large steps, each is more than it goes from read to read."""
    meter = LoadMeter(0.3, PERIOD_S, unnoticed_n=0.05, touch_mm_s=4.0, step_mm=step_mm)
    meter.begin(TouchStage.QUICK, 0.0)
    for k in range(250):
        t = k * PERIOD_S
        if k % every == 0 or k == 249:
            meter.see(round(4 * faster * t / step_mm) * step_mm, t)
        meter.feel(0.5, t + PERIOD_S)
    trace = meter.trace()
    assert trace is not None
    gone_mm = 4 * max(faster, 1.1) * (trace.time_s[-1] - trace.time_s[0])
    assert -2 * step_mm < trace.advance_mm.sum() - gone_mm < step_mm


def test_a_tip_that_is_steered_sideways_drags_the_part_with_all_that_presses() -> None:
    """An arm wanders by half a step of its joints as it stands and goes back."""
    meter = LoadMeter(0.3, PERIOD_S, unnoticed_n=0.05, touch_mm_s=5.0, step_mm=0.15)
    meter.begin(TouchStage.SLOW, 0.0)
    meter.stopped(0.0)
    for k in range(100):
        meter.see(2.0, k * PERIOD_S, 0.1 * math.sin(k / 5))
        meter.feel(0.5, (k + 1) * PERIOD_S)
    trace = meter.trace()
    assert trace is not None
    true_mm = np.abs(np.diff(0.1 * np.sin(np.arange(100) / 5))).sum()
    assert trace.advance_mm[5:].sum() == pytest.approx(true_mm, rel=0.1)
