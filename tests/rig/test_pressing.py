"""Presses of two fingers at once on the emulated bench, against where they really touch."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import pytest
from probed_rig import FRICTION_A, HARD_N, ProbedRig, probed_rig

from palpate.calibration.measured import FREE, IN, OUT, Press
from palpate.calibration.prober import Probe
from palpate.errors import DeviceError


@dataclass(frozen=True, eq=False)
class Done:
    """A press of every finger, after which the rig was closed; `waited`: whether tips were outside then."""

    rig: ProbedRig
    contacts: list[Probe]
    presses: list[Press]
    waited: bool


@pytest.fixture(scope="module")
def done() -> Done:
    with probed_rig(2) as rig:
        rig.put_disc()
        contacts = rig.head_on()
        presses = rig.prober.press(contacts, 4)
        waited = rig.waits()
    return Done(rig, contacts, presses, waited)


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
        noise = felt[press.leg == FREE][:50].std()
        going_in = felt[press.leg == IN]
        assert (np.diff(going_in) > -6 * noise).all()
        assert going_in[-1] > 50 * noise
        assert abs(felt[press.leg == OUT][-10:].mean()) < 3 * noise


def test_contacts_begin_where_they_really_are(done: Done) -> None:
    for press, contact in zip(done.presses, done.contacts, strict=True):
        truth = done.rig.truth(done.rig.prober.approaches[contact.approach].finger)
        first = press.slide_rad[press.leg == IN][0]
        # A few tenths of a newton are felt, and the slide goes on between two looks.
        assert 0.0 < (first - contact.end_rad) * truth.mm_per_rad < 0.4
        assert (contact.end_rad - press.slide_rad[-1]) * truth.mm_per_rad > 2.0


def test_currents_push_out_going_in_and_pull_going_back(done: Done) -> None:
    for press in done.presses:
        free = press.current_a[press.leg == FREE]
        assert np.median(free) == pytest.approx(FRICTION_A, rel=0.15)
        assert press.current_a[press.leg == IN].max() > 1.3 * FRICTION_A
        assert np.median(press.current_a[press.leg == OUT][-30:]) == pytest.approx(-FRICTION_A, rel=0.15)


def test_nothing_presses_harder_than_it_may(done: Done) -> None:
    assert 1.5 < done.rig.hardest_n() <= HARD_N


def test_fingers_wait_outside_and_end_without_torque(done: Done) -> None:
    assert done.waited
    assert not any(done.rig.session.torque().values())
    assert done.rig.session.rest(0.5) < 0.01


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
    with pytest.raises(DeviceError, match=r"tactile array f1 .* has sent nothing for 0.3 s while its finger"):
        alone.prober.press(contacts, 0)
    alone.hand.close()
    assert not any(alone.session.torque().values())
    assert alone.hardest_n() <= HARD_N
