"""A watched finger: every frame is counted, taring finds bad taxels, silence and the loop's end."""

import numpy as np
import pytest

from palpate.base.errors import DeviceError
from palpate.cli.watch_display import handle_keys
from palpate.drivers.transport.clock import VirtualClock
from palpate.jobs.files import load_rig
from palpate.jobs.monitor import Monitor, check_streaming
from palpate.rig.array_monitor import PacedClock, TareState
from support.devices.array_tips import COLS, DESCRIPTION, ROWS, WatchedTip


def monitor_of(tip: WatchedTip) -> Monitor:
    def goes_on() -> bool:
        check_streaming([tip.finger], 200.0)
        return True

    return Monitor(load_rig(), None, [tip.finger], tip.clock, goes_on, lambda: "", ())


def test_what_a_touch_looks_like() -> None:
    tip = WatchedTip()
    tip.finger.tare()
    tip.pass_time(0.2)
    free = tip.finger.view()
    assert (free.tare, free.patch, free.silent) == (TareState.DONE, None, False)
    assert np.abs(free.taxel_n).max() < 0.005
    tip.press(6, 1.0)
    tip.pass_time(0.1)
    touched = tip.finger.view()
    assert touched.patch is not None
    assert abs(touched.patch.angle_rad - DESCRIPTION.columns[6]) < touched.patch.angle_half_range_rad
    assert touched.taxel_n.sum(axis=0).argmax() == 6
    assert touched.taxel_n.sum() == pytest.approx(1.0, abs=0.15)
    assert touched.force_n == pytest.approx(1.0, abs=0.15)


def test_every_frame_is_counted_and_a_reset_begins_anew() -> None:
    tip = WatchedTip(rate_hz=250.0)
    tip.pass_time(3.0)
    view = tip.finger.view()
    assert 745 <= view.counters.frames <= 755
    assert view.rate_hz == pytest.approx(250.0, abs=2.0)
    assert (view.counters.lost, view.counters.faults, view.counters.dropped) == (0, 0, 0)
    assert handle_keys("r", [tip.finger])
    tip.pass_time(1.0)
    assert 245 <= tip.finger.view().counters.frames <= 255


def test_nothing_is_felt_before_the_array_is_tared() -> None:
    tip = WatchedTip()
    tip.pass_time(0.2)
    view = tip.finger.view()
    assert (view.tare, view.force_n, view.patch) == (TareState.NONE, None, None)
    assert view.taxel_n.mean() == pytest.approx(20 / DESCRIPTION.counts_per_n, rel=0.1), "the offset"
    assert not view.dead.any()
    assert handle_keys("T", [tip.finger])
    assert tip.finger.view().tare is TareState.UNDER_WAY
    tip.pass_time(0.2)
    assert tip.finger.view().tare is TareState.DONE


def test_dead_hot_and_saturated_taxels_are_told_apart() -> None:
    tip = WatchedTip(dead=[(1, 2)], hot=[(7, 19)])
    tip.finger.tare()
    tip.pass_time(0.2)
    tip.taxels_n[3, 10] = 5.0
    tip.pass_time(0.1)
    view = tip.finger.view()
    found = {name: np.argwhere(getattr(view, name)).tolist() for name in ("dead", "hot", "saturated")}
    assert found == {"dead": [[1, 2]], "hot": [[7, 19]], "saturated": [[3, 10], [7, 19]]}


def test_a_silent_array_feels_nothing_and_ends_the_watch() -> None:
    tip = WatchedTip()
    tip.finger.tare()
    tip.pass_time(0.5)
    tip.press(10, 1.0)
    tip.pass_time(0.5)
    assert tip.finger.view().patch is not None
    tip.silent_from_s = 1.0
    tip.pass_time(1.0)
    view = tip.finger.view()
    assert view.silent
    assert (view.force_n, view.patch, view.taxel_n.max()) == (None, None, 0.0)
    check_streaming([tip.finger], 200.0)
    with pytest.raises(DeviceError, match=r"array tip on mock://\S+ sent no frame for 3 s; check"):
        list(monitor_of(tip).updates())
    assert tip.clock.now() == pytest.approx(4.0, abs=0.1)


def test_a_slow_array_may_take_its_time() -> None:
    tip = WatchedTip(rate_hz=0.5)
    tip.pass_time(3.9)
    check_streaming([tip.finger], 0.5)


def test_shown_twenty_times_a_second_at_most_whatever_showing_takes() -> None:
    tip = WatchedTip()
    seen: list[float] = []
    for views in monitor_of(tip).updates(0.05, seconds=3.0):
        seen.append(tip.clock.now())
        tip.clock.sleep(0.2 if 1.0 < tip.clock.now() < 1.5 else 0.0)
        assert views[0].counts is not None
    assert np.diff(seen[:-1]).min() > 0.035, "late by a poll, and in time again"
    assert 50 <= len(seen) <= 58
    assert tip.finger.view().counters.lost == 0
    assert tip.finger.view().counters.frames >= 595


def test_q_ends_what_was_typed_before_it_still_counts() -> None:
    tip = WatchedTip()
    assert not handle_keys("tq", [tip.finger])
    assert tip.finger.view().tare is TareState.UNDER_WAY


def test_a_paced_clock_keeps_the_walls_time_and_forgives_a_pause() -> None:
    clock, wall = VirtualClock(), VirtualClock()
    paced = PacedClock(clock, wall, speed=2.0)
    for _ in range(100):
        paced.sleep(0.01)
        wall.sleep(0.001)  # what computing takes
    assert clock.now() == paced.now() == pytest.approx(1.0)
    assert wall.now() == pytest.approx(0.5, abs=0.002)
    wall.sleep(60.0)
    paced.sleep(0.01)
    before = wall.now()
    paced.sleep(1.0)
    assert wall.now() - before == pytest.approx(0.5)


def test_shapes_of_a_view() -> None:
    view = WatchedTip().finger.view()
    assert view.counts is None
    assert view.taxel_n.shape == view.dead.shape == view.saturated.shape == (ROWS, COLS)
