"""Motions of the tests through air: each finger alone, some way in from where it waits."""

import math
from collections.abc import Sequence

from palpate.config import RigFile
from palpate.drivers.dynamixel.guarded import End
from palpate.drivers.dynamixel.servo import Servo
from palpate.recognizer import FingerApproach
from palpate.rig.motion.approach_state import ApproachState
from palpate.rig.motion.finger_movers import TipMover
from palpate.rig.motion.guarded_approach import aim, go_to, retract_all, turn_stage
from palpate.rig.motion.hand import Hand
from palpate.rig.reach.approaches import reach_of

__all__ = ["AirMover", "HalfWay", "HostSilence", "Ways", "aimed", "back", "servos_of", "ways_in_air"]

_AIMS = 11
_WAY_MM = 25.0
_MOVING_MM = 1.0

Ways = tuple[tuple[FingerApproach, FingerApproach, FingerApproach], ...]
"""Of each finger: at one end of its aims, in the middle, at the other end."""


def ways_in_air(rig: RigFile) -> Ways:
    """Ways of all fingers that go 25 mm into the workspace at most. InputError for one without room."""
    reach = reach_of(rig, aims=_AIMS)
    found = []
    for index in range(len(rig.fingers)):
        own = [reach.approaches[k] for k in reach.of_finger(index, reach.middle_rad)]
        first, middle, last = (
            way.up_to(min(way.travel_mm, _WAY_MM)) for way in (own[0], own[len(own) // 2], own[-1])
        )
        found.append((first, middle, last))
    return tuple(found)


def aimed(hand: Hand, ways: Sequence[FingerApproach]) -> list[ApproachState]:
    """Watchdogs armed, fingers back, turned to the starts of their ways."""
    hand.arm()
    retract_all(hand)
    turn = turn_stage(hand, {way.stage_rad for way in ways})
    runs = [ApproachState.of(hand.fingers[way.finger_index], way, turn) for way in ways]
    aim(hand, runs)
    return runs


class AirMover(TipMover):
    """A finger on its way through air: a contact ends it, as on any way. Keeps the largest force felt."""

    largest_n = 0.0

    def __init__(self, hand: Hand, run: ApproachState, speed_mm_s: float) -> None:
        super().__init__(hand, run, run.approach.travel_mm, speed_mm_s, hand.rig.closing.contact_force_n)

    def sense(self, now: float) -> End | None:
        """As every way."""
        self.largest_n = max(self.largest_n, self.hand.reading(self.finger).force_n)
        return super().sense(now)


class HalfWay(TipMover):
    """A guard that ends a way half-way."""

    def __init__(self, hand: Hand, run: ApproachState, speed_mm_s: float) -> None:
        super().__init__(hand, run, run.approach.travel_mm, speed_mm_s, math.inf)
        self.decided_s = self.decided_mm = math.nan

    def until(self, now: float) -> End | None:
        """Enough at half of the way."""
        if self.run.travel_mm >= self.limit_mm / 2:
            self.decided_s, self.decided_mm = now, self.run.travel_mm
            return End.ENOUGH
        return super().until(now)


class HostSilence(TipMover):
    """A host that hangs for `silence_s` as soon as the finger moves."""

    def __init__(self, hand: Hand, run: ApproachState, speed_mm_s: float, silence_s: float) -> None:
        super().__init__(hand, run, run.approach.travel_mm, speed_mm_s, math.inf)
        self._silence_s = silence_s
        self.silent_mm = math.nan

    def until(self, now: float) -> End | None:
        """Silence, once; the next read tells what became of it."""
        if math.isnan(self.silent_mm) and self.run.travel_mm >= _MOVING_MM:
            self.silent_mm = self.run.travel_mm
            self.hand.clock.sleep(self._silence_s)
            return None
        return super().until(now)


def back(hand: Hand, runs: Sequence[ApproachState]) -> None:
    """Back to where fingers wait; watchdogs off."""
    go_to(hand, dict.fromkeys(runs, 0.0))
    hand.disarm()


def servos_of(hand: Hand) -> list[Servo]:
    """All servos of a hand, the stage's first."""
    stage = [] if hand.stage is None else [hand.stage.servo]
    return stage + [servo for finger in hand.fingers for servo in finger.drive.servos]
