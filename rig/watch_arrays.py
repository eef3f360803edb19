"""Which arrays `palpate watch` looks at, and how they are opened: those of a rig, or of a recorded session.

Nothing here knows the servos' bus: nothing can move.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from serial.serialutil import SerialBase

from palpate.config import AnyFinger, RigFile
from palpate.drivers.tactile.array import TactileArray
from palpate.drivers.tactile.contact import ContactExtractor, TipCalibration
from palpate.drivers.tactile.frames import ArrayDriver
from palpate.drivers.tactile.messages import Description
from palpate.drivers.tactile.stream import Port
from palpate.drivers.transport.clock import Clock, MonotonicClock, VirtualClock
from palpate.drivers.transport.playback import Piece, PlaybackPort
from palpate.drivers.transport.port import PortTaken, open_port
from palpate.drivers.transport.recording import Passed, Told
from palpate.errors import DeviceError, InputError
from palpate.rig.bench import set_up
from palpate.rig.session import LOG_NAME
from palpate.rig.session_file import SessionFile, read_session
from palpate.rig.session_inputs import kept_inputs
from palpate.rig.watched import WatchedFinger

__all__ = ["Place", "Recorded", "chosen", "extractor_of", "place_of", "recorded", "streaming"]


@dataclass(frozen=True, eq=False)
class Place:
    """Where a rig's arrays are: the clock, and how to open a port. `devices` live as long as this does."""

    clock: Clock
    open_port: Callable[[str, int], SerialBase]
    devices: object = None


def place_of(rig: RigFile) -> Place:
    """The ports of a rig; those of an emulated one are emulated from now on, with nothing on the table."""
    if not rig.emulated:
        return Place(MonotonicClock(), open_port)
    bench = set_up(rig, None, 0)
    return Place(bench.clock, lambda port, baudrate: open_port(bench.urls(port), baudrate), bench)


def chosen(rig: RigFile, names: Sequence[str]) -> tuple[AnyFinger, ...]:
    """The fingers of these names, all without any; InputError for a name that the rig does not have."""
    there = [finger.name for finger in rig.fingers]
    unknown = next((name for name in names if name not in there), None)
    if unknown is not None:
        raise InputError(f'--finger {unknown}: rig "{rig.name}" has no such finger, but {", ".join(there)}')
    return tuple(finger for finger in rig.fingers if not names or finger.name in names)


@contextmanager
def streaming(
    rig: RigFile, specs: Sequence[AnyFinger], place: Place, clock: Clock, rate_hz: float
) -> Iterator[tuple[WatchedFinger, ...]]:
    """The arrays of some fingers, streaming until the block is left, by whatever way.

    `clock` is the place's, perhaps paced. Raises PortTaken if another program uses a port, DeviceError if
    one does not exist, or an array does not answer or refuses the rate.
    """
    with ExitStack() as ways_out:
        fingers = []
        for spec in specs:
            port = _open(place, spec)
            ways_out.callback(port.close)
            array = open_array_of(spec, port, clock)
            array.connect()
            ways_out.callback(_stop, array)
            fingers.append(_watched(rig, spec, array, clock))
        for finger in fingers:
            finger.array.start(rate_hz)
        yield tuple(fingers)


def open_array_of(spec: AnyFinger, port: SerialBase | Port, clock: Clock) -> ArrayDriver:
    """The driver of a finger's array on its open port."""
    return TactileArray(port, clock, spec.name)


def extractor_of(rig: RigFile, spec: AnyFinger, description: Description) -> ContactExtractor:
    """The extractor that a run on this rig would use."""
    calibration = TipCalibration(
        gain=np.ones((description.rows, description.cols)),
        gain_spread=spec.array.gain_spread,
        contact_force_n=rig.closing.contact_force_n / 2,
        stiffness_n_per_mm=spec.tip.stiffness_n_per_mm,
        stiffness_bound=spec.tip.stiffness_spread,
    )
    return ContactExtractor(description, calibration)


def _watched(rig: RigFile, spec: AnyFinger, array: ArrayDriver, clock: Clock) -> WatchedFinger:
    extractor = extractor_of(rig, spec, array.description)
    return WatchedFinger(spec.name, spec.array.port, array, extractor, clock)


def _open(place: Place, spec: AnyFinger) -> SerialBase:
    try:
        return place.open_port(spec.array.port, spec.array.baudrate_bps)
    except PortTaken as error:
        raise PortTaken(
            f"port {spec.array.port} of array {spec.name} is in use: another program has it, perhaps a run, "
            "and a port serves one at a time; end that program, or watch the run afterwards with --session"
        ) from error


def _stop(array: ArrayDriver) -> None:
    with suppress(DeviceError):  # it is gone, or says so itself when it is opened next
        array.stop()


@dataclass(frozen=True, eq=False)
class Recorded:
    """The arrays of a session, ready to be played by `clock`, which starts with the session's own time 0."""

    folder: Path
    rig: RigFile
    clock: VirtualClock
    fingers: tuple[WatchedFinger, ...]
    end_s: float
    _ports: tuple[PlaybackPort, ...]
    _stages: tuple[tuple[float, str], ...]
    _writes: dict[int, int]

    @property
    def ended(self) -> bool:
        """Whether nothing more was recorded of these arrays."""
        return all(port.ended for port in self._ports)

    @property
    def doing(self) -> str:
        """What the run was doing at this time, in words; "" before its first grip."""
        now = self.clock.now()
        return next((words for t_s, words in reversed(self._stages) if t_s <= now), "")

    def tare_when_started(self) -> None:
        """Tare an array that the run has just started, as the run does: with nothing touching."""
        for k, (finger, port) in enumerate(zip(self.fingers, self._ports, strict=True)):
            if port.writes != self._writes.get(k, 0):  # what was said was START, or STOP before the next one
                self._writes[k] = port.writes
                finger.tare()


def recorded(session: Path, names: Sequence[str]) -> Recorded:
    """The arrays of the session in a folder.

    Raises InputError if there is no session, or it does not hold what an array of these fingers is.
    """
    folder = session.parent if session.name == LOG_NAME and session.is_file() else session
    file = read_session(folder)
    rig, _, _ = kept_inputs(folder, scene=False)
    clock = VirtualClock()
    ports, fingers = [], []
    for spec in chosen(rig, names):
        port = PlaybackPort(spec.array.port, _pieces(file, spec.array.port), clock)
        array = open_array_of(spec, port, clock)
        try:
            array.connect()
        except DeviceError:
            raise InputError(
                f"{file.path}: array {spec.name} on {spec.array.port} never says what it is; choose other "
                "fingers with --finger, or another session"
            ) from None
        port.play()
        ports.append(port)
        fingers.append(_watched(rig, spec, array, clock))
    writes = {k: port.writes for k, port in enumerate(ports)}
    end_s = file.entries[-1].t_s
    return Recorded(folder, rig, clock, tuple(fingers), end_s, tuple(ports), _stages(file), writes)


def _pieces(file: SessionFile, port: str) -> list[Piece]:
    pairs = ((entry.t_s, entry.what) for entry in file.entries)
    return [
        Piece(t_s, what.direction, what.data)
        for t_s, what in pairs
        if isinstance(what, Passed) and what.port == port
    ]


def _stages(file: SessionFile) -> tuple[tuple[float, str], ...]:
    """When the run began what, in words."""
    pairs = ((entry.t_s, entry.what) for entry in file.entries)
    told = ((t_s, what.values) for t_s, what in pairs if isinstance(what, Told) and what.kind == "stage")
    return tuple((t_s, f"grip {values.get('grip')}, {values.get('stage')}") for t_s, values in told)
