"""Slides against their hard stops and aims to and fro, on the emulated bench."""

from collections.abc import Iterator

import pytest
from probed_rig import ProbedRig, probed_rig

from palpate.errors import DeviceError

STOPS_MM = (43.0, 255.0)
SLIDE, AIM = 12, 11
# 0.05 Nm of friction of a motor with 4.1 Nm at 2.3 A (e-Manual).
FRICTION_A = 0.05 * 2.3 / 4.1


@pytest.fixture(scope="module")
def rig() -> Iterator[ProbedRig]:
    with probed_rig(1) as found:
        yield found


@pytest.mark.parametrize(("number", "side"), [(0, -1), (1, 1)])
def test_a_slide_stalls_where_its_stop_is(rig: ProbedRig, number: int, side: int) -> None:
    truth, allowed = rig.truth(0), rig.goal_current(SLIDE)
    at = rig.prober.home(0, STOPS_MM[number])
    # The carriage is at its stop, and the drive has gone on by the half play.
    drive = truth.zero_mm + truth.mm_per_rad * at
    assert drive == pytest.approx(STOPS_MM[number] + side * truth.slide_play_mm, abs=0.1)
    assert rig.goal_current(SLIDE) == allowed
    assert rig.waits()


def test_where_there_is_no_stop_this_is_said(rig: ProbedRig) -> None:
    with pytest.raises(DeviceError, match=r"slide \(servo 12\) passed 120 mm and met no hard stop; check"):
        rig.prober.home(0, 120.0)


def test_swinging_an_aim_shows_its_friction(rig: ProbedRig) -> None:
    before = rig.session.servos[AIM].shaft_rad
    (friction,) = rig.prober.swing()
    assert 0.5 < friction / FRICTION_A < 1.5
    assert rig.session.servos[AIM].shaft_rad == pytest.approx(before, abs=0.02)


def test_idle_arrays_are_read_as_they_are(rig: ProbedRig) -> None:
    (idle,) = rig.prober.idle(0.2)
    assert idle.finger == "f1"
    assert idle.counts.shape == (50, 8, 20)
    assert len(idle.time_s) == 50
    assert idle.time_s[-1] - idle.time_s[0] == pytest.approx(49 / 250, rel=0.02)
    # Untouched: nothing but zeros of about 20 counts and noise of 2, and two dead taxels.
    assert 5 < idle.counts.mean() < 35
    assert (idle.counts.std(axis=0) == 0).sum() == 2
