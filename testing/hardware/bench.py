"""What tests of a rig look at: its bus, its arrays' streams, its hand. Whatever is opened is closed again."""

from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass

import numpy as np

from palpate.config import FingerConfig, RigFile
from palpate.drivers.dynamixel.bus import Bus, Ping
from palpate.drivers.tactile.description import Description
from palpate.drivers.tactile.frames import ArrayCounters, ArrayDriver, TactileFrame
from palpate.drivers.transport.clock import MonotonicClock
from palpate.drivers.transport.port import open_port
from palpate.errors import DeviceError
from palpate.geometry import Bools, Floats
from palpate.rig.arrays import array_of
from palpate.rig.bus_latency import bus_latency_s
from palpate.rig.diagnostics.bus_selection import RigServo, list_servos

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
_LEAST_NOISE_COUNTS = 0.2  # an array quieter than that does not tell its dead taxels by their rest


@dataclass(frozen=True, eq=False)
class Recording:
    """Frames of one array over `LISTEN_S`, while all others stream, too; nothing touches."""

    description: Description
    frames: tuple[TactileFrame, ...]
    counters: ArrayCounters

    @property
    def rate_hz(self) -> float:
        """Frames a second of the array's own clock, also those that were lost."""
        first, last = self.frames[0], self.frames[-1]
        return (last.sequence - first.sequence) / (last.device_time_s - first.device_time_s)

    def noise_counts(self) -> float:
        """Median over the taxels of their standard deviation."""
        return float(np.median(self._spread()))

    def stuck(self) -> Bools | None:
        """Taxels (rows, cols) that never change, or are always at an end of their range.

        None if the array is too quiet to tell them by their rest.
        """
        counts = np.stack([frame.counts for frame in self.frames])
        ends = (counts == self.description.max_count).all(axis=0)
        if self.noise_counts() < _LEAST_NOISE_COUNTS:
            return ends if ends.any() else None
        result: Bools = ends | (self._spread() == 0.0)
        return result

    def _spread(self) -> Floats:
        spread: Floats = np.stack([frame.counts for frame in self.frames]).std(axis=0)
        return spread


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
                counters = array.counters
                array.stop()
                found[name] = Recording(array.description, tuple(frames[name]), counters)
    return found


def _opened(spec: FingerConfig, clock: MonotonicClock, ports: ExitStack) -> ArrayDriver:
    port = open_port(spec.array.port, spec.array.baudrate_bps)
    ports.callback(port.close)
    return array_of(spec, port, clock)
