"""Motions of the tests that need no clear table: outside of the workspace, each finger on lines that are free."""

import math
from collections.abc import Sequence

from palpate.config import RigFile
from palpate.drivers.dynamixel.guarded import End
from palpate.drivers.dynamixel.servo import Servo
from palpate.errors import InputError
from palpate.recognizer import FingerApproach
from palpate.rig.identification.exploration import outside_fast
from palpate.rig.motion.approach_state import ApproachState
from palpate.rig.motion.finger_movers import TipMover
from palpate.rig.motion.guarded_approach import aim, go_to, retract_all, turn_stage
from palpate.rig.motion.hand import Hand
from palpate.rig.reach.approaches import reach_of

__all__ = ["AirMover", "HalfWay", "HostSilence", "Ways", "aimed", "back", "servos_of", "ways_outside"]

_AIMS = 11
_LEAST_MM = 8.0
_MOVING_MM = 1.0
_INSIDE_MM = 1.0  # how far before the workspace they end: more than a finger runs on

Ways = tuple[tuple[FingerApproach, FingerApproach, FingerApproach], ...]
"""Of each finger: at one end of its aims, in the middle, at the other end."""


def ways_outside(rig: RigFile) -> Ways:
    """Ways of all fingers that end before the workspace. Raises InputError where a finger has no room."""
    reach = reach_of(rig, aims=_AIMS)
    found = []
    for index, spec in enumerate(rig.fingers):
        own = [
            _up_to_workspace(reach.approaches[k], rig) for k in reach.of_finger(index, reach.middle_rad)
        ]
        long = [way for way in own if way.travel_mm >= _LEAST_MM]
        if not long:
            most = max((way.travel_mm for way in own), default=0.0)
            raise InputError(
                f"finger {spec.name} has {most:.1f} mm outside of the workspace, and these tests need "
                f"{_LEAST_MM:g} mm"
            )
        found.append((long[0], long[len(long) // 2], long[-1]))
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

    def __init__(self, hand: Hand, run: ApproachState, speed_mm_s: float, others: Sequence[ApproachState]) -> None:
        super().__init__(
            hand, run, run.approach.travel_mm, speed_mm_s, hand.rig.closing.contact_force_n, others
        )

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


def _up_to_workspace(approach: FingerApproach, rig: RigFile) -> FingerApproach:
    free = outside_fast(approach, rig.workspace.radius_mm).fast_mm
    return approach.up_to(max(free - _INSIDE_MM, 0.0))


def back(hand: Hand, runs: Sequence[ApproachState]) -> None:
    """Back to where fingers wait; watchdogs off."""
    go_to(hand, dict.fromkeys(runs, 0.0))
    hand.disarm()


def servos_of(hand: Hand) -> list[Servo]:
    """All servos of a hand, the stage's first."""
    stage = [] if hand.stage is None else [hand.stage.servo]
    return stage + [servo for finger in hand.fingers for servo in finger.drive.servos]
