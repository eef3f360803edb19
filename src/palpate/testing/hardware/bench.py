"""Bench of the hardware tests: a rig's bus, and motions of fingers in free air.

Whatever is opened is closed again. Each finger moves alone, some way in from where it waits.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager

from palpate.config import RigFile
from palpate.drivers.dynamixel import Bus, MoveEnd
from palpate.drivers.transport import MonotonicClock, open_port
from palpate.recognizer import FingerApproach
from palpate.rig.contact_peak import bus_latency_s
from palpate.rig.motion.finger_movers import TipMover
from palpate.rig.motion.guarded_approach import aim_fingers, move_along_lines, retract_all, turn_stage
from palpate.rig.motion.hand import Hand
from palpate.rig.motion.touch import ApproachState
from palpate.rig.reach.approaches import reach_of

Note = Callable[[str, object], None]
"""Notes a figure by name."""


@contextmanager
def open_bus(rig: RigFile) -> Iterator[Bus]:
    """The servos' bus. Raises DeviceError if its port is missing or taken."""
    port = open_port(rig.bus.port, rig.bus.baudrate_bps)
    bus = Bus(port, MonotonicClock(), rig.bus.baudrate_bps, latency_s=bus_latency_s(rig))
    with closing(bus):
        yield bus


_AIM_COUNT = 11
_MAX_PATH_MM = 25.0
_MOVING_AFTER_MM = 1.0

AirPaths = tuple[tuple[FingerApproach, FingerApproach, FingerApproach], ...]
"""Of each finger: at one end of its aims, in the middle, at the other end."""


def air_paths(rig: RigFile) -> AirPaths:
    """Ways of all fingers that go 25 mm into the workspace at most. InputError for one without room."""
    reach = reach_of(rig, aims=_AIM_COUNT)
    found = []
    for index in range(len(rig.fingers)):
        own = [reach.approaches[k] for k in reach.of_finger(index, reach.middle_rad)]
        first, middle, last = (
            way.up_to(min(way.travel_mm, _MAX_PATH_MM)) for way in (own[0], own[len(own) // 2], own[-1])
        )
        found.append((first, middle, last))
    return tuple(found)


def start_approaches(hand: Hand, ways: Sequence[FingerApproach]) -> list[ApproachState]:
    """Watchdogs armed, fingers back, turned to the starts of their ways."""
    hand.arm()
    retract_all(hand)
    turn = turn_stage(hand, {way.stage_rad for way in ways})
    runs = [ApproachState.of(hand.fingers[way.finger_index], way, turn) for way in ways]
    aim_fingers(hand, runs)
    return runs


class AirMover(TipMover):
    """A finger on its way through air: a contact ends it, as on any way. Keeps the largest force felt."""

    largest_n = 0.0

    def __init__(self, hand: Hand, run: ApproachState, speed_mm_s: float) -> None:
        super().__init__(hand, run, run.approach.travel_mm, speed_mm_s, hand.rig.closing.contact_force_n)

    def sense(self, now: float) -> MoveEnd | None:
        """Note the force, then sense as every way does."""
        self.largest_n = max(self.largest_n, self.hand.reading(self.finger).force_n)
        return super().sense(now)


class HalfWay(TipMover):
    """A guard that ends a way half-way."""

    def __init__(self, hand: Hand, run: ApproachState, speed_mm_s: float) -> None:
        super().__init__(hand, run, run.approach.travel_mm, speed_mm_s, math.inf)
        self.decided_s = self.decided_mm = math.nan

    def until(self, now: float) -> MoveEnd | None:
        """Enough at half of the way."""
        if self.run.travel_mm >= self.limit_mm / 2:
            self.decided_s, self.decided_mm = now, self.run.travel_mm
            return MoveEnd.ENOUGH
        return super().until(now)


class HostSilence(TipMover):
    """A host that hangs for `silence_s` as soon as the finger moves."""

    def __init__(self, hand: Hand, run: ApproachState, speed_mm_s: float, silence_s: float) -> None:
        super().__init__(hand, run, run.approach.travel_mm, speed_mm_s, math.inf)
        self._clock, self._silence_s = hand.clock, silence_s
        self.silent_mm = math.nan

    def until(self, now: float) -> MoveEnd | None:
        """Silence, once; the next read tells what became of it."""
        if math.isnan(self.silent_mm) and self.run.travel_mm >= _MOVING_AFTER_MM:
            self.silent_mm = self.run.travel_mm
            self._clock.sleep(self._silence_s)
            return None
        return super().until(now)


def return_fingers(hand: Hand, runs: Sequence[ApproachState]) -> None:
    """Back to where fingers wait; watchdogs off."""
    move_along_lines(hand, dict.fromkeys(runs, 0.0))
    hand.disarm()
