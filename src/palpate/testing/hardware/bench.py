"""Bench of the hardware tests: a rig's bus, its arrays' streams, and motions of fingers through air.

Whatever is opened is closed again. Each finger moves alone, some way in from where it waits.
"""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass

import numpy as np

from palpate.base.errors import DeviceError
from palpate.config import FingerConfig, RigFile
from palpate.drivers.dynamixel import Bus, MoveEnd, Ping, Servo
from palpate.drivers.tactile import ArrayDriver, Description, TactileFrame
from palpate.drivers.transport import MonotonicClock, open_port
from palpate.recognizer import FingerApproach
from palpate.rig.arrays import array_of
from palpate.rig.contact_peak import bus_latency_s
from palpate.rig.diagnostics.array_examination import lost_frames
from palpate.rig.diagnostics.servo_bus import RigServo, list_servos
from palpate.rig.diagnostics.taxel_steps import UntouchedStatistics, analyse_untouched
from palpate.rig.motion.finger_movers import TipMover
from palpate.rig.motion.guarded_approach import aim_fingers, move_along_lines, retract_all, turn_stage
from palpate.rig.motion.hand import Hand
from palpate.rig.motion.touch import ApproachState
from palpate.rig.reach.approaches import reach_of

Note = Callable[[str, object], None]
"""Notes a figure by name."""


LISTEN_S = 5.0
"""How long all arrays stream at once."""

_POLL_S = 0.02


@dataclass(frozen=True, eq=False)
class ArrayRecording:
    """Frames of one array over `LISTEN_S`, while all others stream, too; nothing touches.

    `gone`: how many never came, or came damaged.
    """

    description: Description
    frames: tuple[TactileFrame, ...]
    gone: int

    def noise_counts(self) -> float:
        """Median over the taxels of their standard deviation."""
        return float(np.median(np.stack([frame.counts for frame in self.frames]).std(axis=0)))


@dataclass(frozen=True)
class ServoUnderTest:
    """A servo of the rig file that answers."""

    wanted: RigServo
    ping: Ping


@dataclass(frozen=True, eq=False)
class ArrayUnderTest:
    """An array of the rig file that answers, and what it sent."""

    spec: FingerConfig
    recording: ArrayRecording

    def untouched(self) -> UntouchedStatistics | None:
        """What its frames show of its taxels; None if they are too few."""
        found = self.recording
        return analyse_untouched(
            found.frames, found.description.max_count, self.spec.array.drift_counts_per_s
        )


@contextmanager
def open_bus(rig: RigFile) -> Iterator[Bus]:
    """The servos' bus. Raises DeviceError if its port is missing or taken."""
    port = open_port(rig.bus.port, rig.bus.baudrate_bps)
    bus = Bus(port, MonotonicClock(), rig.bus.baudrate_bps, latency_s=bus_latency_s(rig))
    with closing(bus):
        yield bus


def ping_all(rig: RigFile) -> dict[int, Ping | DeviceError]:
    """What each servo of the rig file answers to a ping, or why it does not."""
    ids = [servo.dxl_id for servo in list_servos(rig)]
    found: dict[int, Ping | DeviceError] = {}
    try:
        with open_bus(rig) as bus:
            for dxl_id in ids:
                try:
                    found[dxl_id] = bus.ping(dxl_id)
                except DeviceError as error:
                    found[dxl_id] = error
    except DeviceError as error:
        found |= {dxl_id: error for dxl_id in ids if dxl_id not in found}
    return found


def record_arrays(rig: RigFile) -> Mapping[str, ArrayRecording | DeviceError]:
    """Let all arrays stream at once as in a run; by finger what came, or why nothing did."""
    clock = MonotonicClock()
    found: dict[str, ArrayRecording | DeviceError] = {}
    with ExitStack() as ports:
        arrays: dict[str, ArrayDriver] = {}
        for spec in rig.fingers:
            try:
                arrays[spec.name] = _open_array(spec, clock, ports)
            except DeviceError as error:
                found[spec.name] = error
        for name, array in list(arrays.items()):
            try:
                array.connect()
                array.start(rig.closing.sample_rate_hz)
            except DeviceError as error:
                found[name] = error
                del arrays[name]
        frames: dict[str, list[TactileFrame]] = {name: [] for name in arrays}
        begin = {name: array.counters for name, array in arrays.items()}
        end = clock.now() + (LISTEN_S if arrays else 0.0)
        while clock.now() < end:
            clock.sleep(_POLL_S)
            for name, array in arrays.items():
                if name not in found:
                    try:
                        frames[name] += array.frames()
                    except DeviceError as error:
                        found[name] = error
        for name, array in arrays.items():
            if name not in found:
                gone = lost_frames(begin[name], array.counters)
                array.stop()
                found[name] = ArrayRecording(array.description, tuple(frames[name]), gone)
    return found


def _open_array(spec: FingerConfig, clock: MonotonicClock, ports: ExitStack) -> ArrayDriver:
    port = open_port(spec.array.port, spec.array.baudrate_bps)
    ports.callback(port.close)
    return array_of(spec, port, clock)


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
        """As every way."""
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
        self._silence_s = silence_s
        self.silent_mm = math.nan

    def until(self, now: float) -> MoveEnd | None:
        """Silence, once; the next read tells what became of it."""
        if math.isnan(self.silent_mm) and self.run.travel_mm >= _MOVING_AFTER_MM:
            self.silent_mm = self.run.travel_mm
            self.hand.clock.sleep(self._silence_s)
            return None
        return super().until(now)


def return_fingers(hand: Hand, runs: Sequence[ApproachState]) -> None:
    """Back to where fingers wait; watchdogs off."""
    move_along_lines(hand, dict.fromkeys(runs, 0.0))
    hand.disarm()


def hand_servos(hand: Hand) -> list[Servo]:
    """All servos of a hand, the stage's first."""
    stage = [] if hand.stage is None else [hand.stage.servo]
    return stage + [servo for finger in hand.fingers for servo in finger.drive.servos]
