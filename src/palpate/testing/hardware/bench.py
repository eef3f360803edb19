"""What tests of a rig look at: its bus, its arrays' streams, its hand. Whatever is opened is closed again."""

from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass

import numpy as np

from palpate.base.errors import DeviceError
from palpate.config import FingerConfig, RigFile
from palpate.drivers.dynamixel.bus import Bus, Ping
from palpate.drivers.tactile.description import Description
from palpate.drivers.tactile.frames import ArrayDriver, TactileFrame
from palpate.drivers.transport.clock import MonotonicClock
from palpate.drivers.transport.port import open_port
from palpate.rig.arrays import array_of
from palpate.rig.bus_latency import bus_latency_s
from palpate.rig.diagnostics.bus_selection import RigServo, list_servos
from palpate.rig.diagnostics.frame_stream import frames_gone
from palpate.rig.diagnostics.untouched_frames import UntouchedFrames, untouched_frames

__all__ = [
    "LISTEN_S",
    "FoundArray",
    "FoundServo",
    "Note",
    "Recording",
    "open_bus",
    "ping_all",
    "record_arrays",
]

Note = Callable[[str, object], None]
"""Notes a figure by name."""


LISTEN_S = 5.0
"""How long all arrays stream at once."""

_POLL_S = 0.02


@dataclass(frozen=True, eq=False)
class Recording:
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
class FoundServo:
    """A servo of the rig file that answers."""

    wanted: RigServo
    ping: Ping


@dataclass(frozen=True, eq=False)
class FoundArray:
    """An array of the rig file that answers, and what it sent."""

    spec: FingerConfig
    recording: Recording

    def untouched(self) -> UntouchedFrames | None:
        """What its frames show of its taxels; None if they are too few."""
        found = self.recording
        return untouched_frames(found.frames, found.description.max_count, self.spec.array.drift_counts_per_s)


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


def record_arrays(rig: RigFile) -> Mapping[str, Recording | DeviceError]:
    """Let all arrays stream at once as in a run; by finger what came, or why nothing did."""
    clock = MonotonicClock()
    found: dict[str, Recording | DeviceError] = {}
    with ExitStack() as ports:
        arrays: dict[str, ArrayDriver] = {}
        for spec in rig.fingers:
            try:
                arrays[spec.name] = _opened(spec, clock, ports)
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
                gone = frames_gone(begin[name], array.counters)
                array.stop()
                found[name] = Recording(array.description, tuple(frames[name]), gone)
    return found


def _opened(spec: FingerConfig, clock: MonotonicClock, ports: ExitStack) -> ArrayDriver:
    port = open_port(spec.array.port, spec.array.baudrate_bps)
    ports.callback(port.close)
    return array_of(spec, port, clock)
