"""Measuring on the move, on the emulated bench: against where the shaft really was."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
import pytest
from probed_rig import HARD_N, ProbedRig, probed_rig

from palpate.base.errors import SafetyStop
from palpate.drivers.dynamixel.servo import Servo
from palpate.drivers.dynamixel.servo_state import ServoState
from palpate.drivers.tactile.patches import ContactPatch
from palpate.rig.motion.creep import measure_quasi_statically
from palpate.rig.motion.guarded_approach import carry_out_grip
from palpate.rig.motion.hand import Hand
from palpate.rig.motion.touch import ApproachState, Touch
from palpate.rig.reach.approaches import reach_of

TICK = 2 * math.pi / 4096
SLIDE = 12


@dataclass(eq=False)
class Watched:
    """A rig whose slide is watched while it creeps: where the shaft was (ticks) whenever the host looked."""

    rig: ProbedRig
    shaft: list[float] = field(default_factory=list)
    read: list[float] = field(default_factory=list)
    rested: float = math.nan

    def measure(
        self, hand: Hand, runs: Sequence[ApproachState]
    ) -> list[tuple[ApproachState, ContactPatch | None]]:
        self.shaft.clear()
        self.read.clear()
        self.rested = runs[0].servos[1] / TICK
        states = hand.states

        def watched(servos: Sequence[Servo]) -> dict[int, ServoState]:
            found = states(servos)
            self.shaft.append(self.rig.session.servos[SLIDE].shaft_rad / TICK)
            self.read.append(found[SLIDE].position_rad / TICK)
            return found

        hand.states = watched  # type: ignore[method-assign]
        try:
            return measure_quasi_statically(hand, runs)
        finally:
            hand.states = states  # type: ignore[method-assign]

    def touch(self, oblique: int) -> Touch:
        """Touch on an approach so many beside the one that meets the disc head-on."""
        rig, hand = self.rig, self.rig.hand
        (contact,) = rig.head_on()
        reach = reach_of(hand.rig, aims=81)
        number = reach.of_stage(reach.middle_rad)[contact.approach + oblique]
        (touch,) = carry_out_grip(hand, [reach.approaches[number]], lambda _: None, self.measure)
        return touch


@pytest.fixture(scope="module")
def watched() -> Iterator[Watched]:
    with probed_rig(1) as rig:
        rig.put_disc()
        yield Watched(rig)


@pytest.mark.parametrize("oblique", [0, 6, -9])
def test_rounding_averages_out(watched: Watched, oblique: int) -> None:
    """Eight steps count, from the third on; resting positions are off by up to half a step."""
    touch = watched.touch(oblique)
    gone = np.abs(np.round(np.array(watched.read) - watched.rested))
    counted = (gone >= 3) & (gone <= 10)
    assert counted.sum() > 30
    assert touch.servos[1] / TICK == pytest.approx(np.array(watched.shaft)[counted].mean(), abs=0.06)
    assert touch.patch is not None
    assert 0.3 < touch.patch.force_n < 1.5
    assert watched.rig.waits()


def test_a_slide_that_cannot_go_on_is_measured_where_it_rests(watched: Watched) -> None:
    """Its current is no more than friction needs."""
    rig = watched.rig
    allowed_a = rig.goal_current(SLIDE) * 2.69e-3  # unit of Goal Current (e-Manual)

    def weakened(
        hand: Hand, runs: Sequence[ApproachState]
    ) -> list[tuple[ApproachState, ContactPatch | None]]:
        slide = runs[0].finger.drive.closing_servos[0]
        slide.set_goal_current_a(0.02)
        try:
            return measure_quasi_statically(hand, runs)
        finally:
            slide.set_goal_current_a(allowed_a)

    watched.measure = weakened  # type: ignore[method-assign]
    try:
        touch = watched.touch(0)
    finally:
        del watched.measure
    assert touch.patch is not None
    contact = rig.prober.approaches[rig.head_on()[0].approach]
    assert touch.servos[1] == pytest.approx(rig.contact_rad(contact), abs=0.02)


def test_a_creep_that_presses_too_hard_stops_everything() -> None:
    with probed_rig(1) as rig:
        rig.put_disc()
        watched = Watched(rig)
        closing = rig.hand.rig.closing.model_copy(update={"max_force_n": 0.75})

        def careful(
            hand: Hand, runs: Sequence[ApproachState]
        ) -> list[tuple[ApproachState, ContactPatch | None]]:
            hand._array_guard._closing = closing
            return measure_quasi_statically(hand, runs)

        watched.measure = careful  # type: ignore[method-assign]
        with pytest.raises(SafetyStop, match=r"finger f1 felt 0\.\d N, above max_force_n = 0.75 N"):
            watched.touch(0)
        rig.hand.close()
        assert not any(rig.session.torque().values())
        assert rig.hardest_n() < HARD_N
