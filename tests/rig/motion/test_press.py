"""Presses of two fingers at once on the emulated bench, against where they really touch."""

import math
from collections.abc import Iterator

import numpy as np
import pytest
from probed_rig import FRICTION_A, HARD_N, ProbedRig, probed_rig

from palpate.base.errors import DeviceError, SafetyStop
from palpate.calibration.measurements import LEG_FREE, LEG_IN, LEG_OUT, PressMeasurement


def test_two_fingers_press_at_once() -> None:
    """In one test, because a press takes seconds: what comes of it is looked at from all sides."""
    with probed_rig(2) as rig:
        rig.put_disc()
        contacts = rig.head_on()
        presses = rig.prober.press(contacts, 4)
        assert rig.waits()
    assert [press.finger for press in presses] == ["f1", "f2"]
    for press, contact in zip(presses, contacts, strict=True):
        assert press.placing == 4
        check_legs(press)
        check_counts(press)
        check_currents(press)
        check_places(press, contact.end_mm)
    assert 1.5 < rig.hardest_n() <= HARD_N
    assert not any(rig.session.torque().values())
    assert rig.session.rest(0.5) < 0.01


def check_legs(press: PressMeasurement) -> None:
    assert set(press.leg) == {LEG_FREE, LEG_IN, LEG_OUT}
    assert (np.diff(press.leg) >= 0).all()
    assert press.counts.shape == (len(press.leg), 8, 20)
    assert press.travel_mm.shape == press.push_n.shape == press.leg.shape


def check_counts(press: PressMeasurement) -> None:
    """They grow with the dent, and end where they began."""
    felt = press.counts.sum(axis=(1, 2))
    noise = felt[press.leg == LEG_FREE][:50].std()
    going_in = felt[press.leg == LEG_IN]
    assert (np.diff(going_in) > -6 * noise).all()
    assert going_in[-1] > 50 * noise
    assert abs(felt[press.leg == LEG_OUT][-10:].mean()) < 3 * noise


def check_currents(press: PressMeasurement) -> None:
    """They push out going in, and pull going back."""
    current = press.push_n / press.newton_per_a[1]
    assert np.median(current[press.leg == LEG_FREE]) == pytest.approx(FRICTION_A, rel=0.15)
    assert press.free_a[1] == pytest.approx(FRICTION_A, rel=0.15)
    assert math.isnan(press.free_a[0]), "the aim stands"
    assert current[press.leg == LEG_IN].max() > 1.3 * FRICTION_A
    assert np.median(current[press.leg == LEG_OUT][-30:]) == pytest.approx(-FRICTION_A, rel=0.15)
    # 4.1 N·m at 2.3 A (e-Manual), and 100 mm a turn.
    assert press.newton_per_a == pytest.approx((0.0, 4.1 / 2.3 * 2 * math.pi / 0.1))


def check_places(press: PressMeasurement, contact_mm: float) -> None:
    """The contact is felt where it really is: a few tenths of a newton late, and between two looks."""
    first = press.travel_mm[press.leg == LEG_IN][0]
    assert 0.0 < first - contact_mm < 0.4
    assert contact_mm - press.travel_mm[-1] > 1.5


@pytest.fixture
def alone() -> Iterator[ProbedRig]:
    with probed_rig(1) as rig:
        rig.put_disc()
        yield rig


def test_an_array_that_falls_silent_ends_a_press(alone: ProbedRig) -> None:
    """Its cable is cut as soon as it touches."""
    contacts = alone.head_on()
    cable, finger = alone.session.cables["mock://f1"], alone.session.bench.fingers[0]

    def cut() -> None:
        cable.cut = cable.cut or finger.press is not None

    alone.session.clock.on_tick = cut
    with pytest.raises(
        DeviceError, match=r"tactile array f1 .* has sent nothing for 0.15 s while fingers moved"
    ):
        alone.prober.press(contacts, 0)
    alone.hand.close()
    assert not any(alone.session.torque().values())
    assert alone.hardest_n() <= HARD_N


def push_aside_once_it_touches(rig: ProbedRig) -> None:
    """From the first contact on, the first finger's aim is pushed harder than its current can hold."""
    finger = rig.session.bench.fingers[0]
    aim, touched = finger.servos[0], [False]

    def push(_rad: float, rad_s: float) -> float:
        touched[0] = touched[0] or finger.press is not None
        return 2.0 - 0.5 * rad_s if touched[0] else 0.0

    aim.hold(push)


def test_a_press_that_leaves_its_line_is_stopped(alone: ProbedRig) -> None:
    contacts = alone.head_on()
    push_aside_once_it_touches(alone)
    with pytest.raises(SafetyStop, match=r"finger f1 is \d\.\d mm off"):
        alone.prober.press(contacts, 0)
    alone.hand.close()
    assert not any(alone.session.torque().values())
    assert alone.hardest_n() <= HARD_N
