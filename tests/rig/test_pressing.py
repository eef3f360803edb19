"""Presses and stops of fingers on the emulated bench, against where they really touch."""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import pytest
from probed_rig import ProbedRig, probed_rig

from palpate.calibration.measured import FREE, IN, OUT, Press, Stop
from palpate.calibration.prober import Probe
from palpate.errors import DeviceError

FINGERS = 2
SPEED_MM_S = 20.0
HARD_N = 8.0  # of the rig file
# 0.05 Nm of friction of a motor with 4.1 Nm at 2.3 A (e-Manual).
FRICTION_A = 0.05 * 2.3 / 4.1


@dataclass(frozen=True, eq=False)
class Done:
    """What one press and one stop of every finger gave."""

    rig: ProbedRig
    contacts: list[Probe]
    presses: list[Press]
    pressed_n: float
    waited: tuple[bool, bool]
    stops: list[Stop]
    stopped_n: float


@pytest.fixture(scope="module")
def done() -> Iterator[Done]:
    with probed_rig(FINGERS) as rig:
        rig.put_disc()
        contacts = rig.head_on()
        presses = rig.prober.press(contacts, 4)
        pressed_n, pressed = rig.hardest_n(), rig.waits()
        rig.forget_forces()
        stops = rig.prober.stop(contacts, SPEED_MM_S)
        result = Done(rig, contacts, presses, pressed_n, (pressed, rig.waits()), stops, rig.hardest_n())
    yield result  # noqa: PT022 - what is tested begins when the rig is closed


def test_every_finger_presses_and_goes_back(done: Done) -> None:
    assert [press.finger for press in done.presses] == ["f1", "f2"]
    for press, contact in zip(done.presses, done.contacts, strict=True):
        assert press.placing == 4
        assert press.aim_rad == pytest.approx(done.rig.prober.approaches[contact.approach].aim_rad, abs=0.01)
        assert set(press.leg) == {FREE, IN, OUT}
        assert (np.diff(press.leg) >= 0).all()
        assert press.counts.shape == (len(press.leg), 8, 20)


def test_counts_grow_with_the_dent_and_end_where_they_began(done: Done) -> None:
    for press in done.presses:
        felt = press.counts.sum(axis=(1, 2))
        noise = felt[press.leg == FREE].std()
        going_in = felt[press.leg == IN]
        assert (np.diff(going_in) > -6 * noise).all()
        assert going_in[-1] > 100 * noise
        assert abs(felt[press.leg == OUT][-10:].mean()) < 3 * noise


def test_contacts_begin_where_they_really_are(done: Done) -> None:
    for press, contact in zip(done.presses, done.contacts, strict=True):
        truth = done.rig.truth(done.rig.prober.approaches[contact.approach].finger)
        first = press.slide_rad[press.leg == IN][0]
        # A few tenths of a newton are felt, and the slide goes on between two looks.
        assert 0.0 < (first - contact.end_rad) * truth.mm_per_rad < 0.4
        last = press.slide_rad[-1]
        assert (contact.end_rad - last) * truth.mm_per_rad > 2.0


def test_currents_push_out_going_in_and_pull_going_back(done: Done) -> None:
    for press in done.presses:
        free = press.current_a[press.leg == FREE]
        assert np.median(free) == pytest.approx(FRICTION_A, rel=0.15)
        assert press.current_a[press.leg == IN].max() > 1.3 * FRICTION_A
        assert np.median(press.current_a[press.leg == OUT][-30:]) == pytest.approx(-FRICTION_A, rel=0.15)


def test_nothing_presses_harder_than_it_may(done: Done) -> None:
    assert 1.5 < done.pressed_n <= HARD_N
    assert 0.3 < done.stopped_n <= HARD_N


def test_fingers_wait_outside_and_end_without_torque(done: Done) -> None:
    assert done.waited == (True, True)
    assert not any(done.rig.session.torque().values())
    assert done.rig.session.rest(0.5) < 0.01


def test_stops_end_beyond_the_contact_and_soon(done: Done) -> None:
    assert [(stop.finger, stop.speed_mm_s) for stop in done.stops] == [("f1", SPEED_MM_S), ("f2", SPEED_MM_S)]
    for stop, contact in zip(done.stops, done.contacts, strict=True):
        truth = done.rig.truth(done.rig.prober.approaches[contact.approach].finger)
        assert stop.contact_rad == pytest.approx(contact.end_rad)
        assert stop.samples_s == pytest.approx(1 / 250)
        beyond = [(angle - stop.contact_rad) * truth.mm_per_rad for angle in (stop.felt_rad, stop.stood_rad)]
        assert 0.0 < beyond[0] <= beyond[1] < SPEED_MM_S * 0.05


def test_an_array_that_falls_silent_ends_a_press() -> None:
    """Its cable is cut as soon as it touches."""
    with pytest.raises(DeviceError, match=r"tactile array f1 .* has sent nothing for 0.3 s while its finger"):
        with probed_rig(1) as rig:
            rig.put_disc()
            contacts = rig.head_on()
            cable, finger = rig.session.cables["mock://f1"], rig.session.bench.fingers[0]

            def cut() -> None:
                cable.cut = cable.cut or finger.press is not None

            rig.session.clock.on_tick = cut
            rig.prober.press(contacts, 0)
    assert not any(rig.session.torque().values())
    assert rig.hardest_n() <= HARD_N


def test_a_reference_that_is_gone_ends_a_stop() -> None:
    with pytest.raises(DeviceError, match="finger f1 felt nothing where it had touched the reference before"):
        with probed_rig(1) as rig:
            rig.put_disc()
            contacts = rig.head_on()
            rig.prober.clear()
            rig.prober.stop(contacts, SPEED_MM_S)
    assert not any(rig.session.torque().values())
    assert math.isclose(rig.hardest_n(), 0.0)
