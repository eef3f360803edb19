"""Playback of a session's arrays through the same drivers, by a clock that may be held to the wall's pace."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from palpate.base.errors import DeviceError, InputError
from palpate.config import RigFile
from palpate.drivers.transport import (
    Clock,
    MonotonicClock,
    PlaybackPort,
    PortBytes,
    RecordedBytes,
    SessionEvent,
    VirtualClock,
)
from palpate.rig.array_monitor import MonitoredFinger, monitor_finger, select_fingers
from palpate.rig.arrays import array_of
from palpate.rig.session.log_file import session_of
from palpate.rig.session.log_reader import SessionFile, read_session
from palpate.rig.session.recorded_session import load_kept_inputs, used_calibration


@dataclass(frozen=True, eq=False)
class RecordedArrays:
    """The arrays of a session, played by `clock`, which starts with the session's own time 0.

    `changed_line`: the first line of the log that is not as it was written, None if all are.
    """

    folder: Path
    rig: RigFile
    clock: VirtualClock
    fingers: tuple[MonitoredFinger, ...]
    end_s: float
    changed_line: int | None
    _ports: tuple[PlaybackPort, ...]
    _stages: tuple[tuple[float, str], ...]
    _writes: dict[int, int]

    @property
    def ended(self) -> bool:
        """True if nothing more was recorded of these arrays."""
        return all(port.ended for port in self._ports)

    @property
    def doing(self) -> str:
        """Activity of the run at this time, in words; "" before its first grip."""
        now = self.clock.now()
        return next((words for t_s, words in reversed(self._stages) if t_s <= now), "")

    def tare_when_started(self) -> None:
        """Tare an array that the run has just started, as the run does: with nothing touching."""
        for k, (finger, port) in enumerate(zip(self.fingers, self._ports, strict=True)):
            if port.writes != self._writes.get(k, 0):  # START was said, or STOP before the next START
                self._writes[k] = port.writes
                finger.tare()


def open_recorded_arrays(session: Path, names: Sequence[str]) -> RecordedArrays:
    """The arrays of the session in a folder.

    Raises InputError if there is no session, or it does not hold what an array of these fingers is.
    """
    folder = session_of(session)
    file = read_session(folder)
    on_bench, _, _ = load_kept_inputs(folder, scene=False, calibration=used_calibration(file))
    rig = on_bench.rig
    clock = VirtualClock()
    ports, fingers = [], []
    for spec in select_fingers(rig, names):
        port = PlaybackPort(spec.array.port, _pieces(file, spec.array.port), clock)
        array = array_of(spec, port, clock)
        try:
            array.connect()
        except DeviceError:
            raise InputError(
                f"{file.path}: array {spec.name} on {spec.array.port} never says what it is; choose "
                "other fingers, or another session"
            ) from None
        port.play()
        ports.append(port)
        fingers.append(monitor_finger(rig, spec, array, clock))
    writes = {k: port.writes for k, port in enumerate(ports)}
    end_s = file.entries[-1].t_s
    return RecordedArrays(
        folder, rig, clock, tuple(fingers), end_s, file.changed_line, tuple(ports), _stages(file), writes
    )


def _pieces(file: SessionFile, port: str) -> list[RecordedBytes]:
    pairs = ((entry.t_s, entry.what) for entry in file.entries)
    return [
        RecordedBytes(t_s, what.direction, what.data)
        for t_s, what in pairs
        if isinstance(what, PortBytes) and what.port == port
    ]


def _stages(file: SessionFile) -> tuple[tuple[float, str], ...]:
    """Begin and name of each stage of the run."""
    pairs = ((entry.t_s, entry.what) for entry in file.entries)
    begun = ((t_s, what) for t_s, what in pairs if isinstance(what, SessionEvent) and what.kind == "stage")
    return tuple((t_s, f"grip {what.values.get('grip')}, {what.values.get('stage')}") for t_s, what in begun)


_MAX_LATE_S = 0.25


class PacedClock:
    """`clock`, whose sleeps take `speed` times less on `wall`. What was missed by much stays missed."""

    def __init__(self, clock: Clock, wall: Clock, speed: float = 1.0) -> None:
        self._clock = clock
        self._wall = wall
        self._speed = speed
        self._begin()

    def now(self) -> float:
        """The clock's own time, s."""
        return self._clock.now()

    def sleep(self, seconds: float) -> None:
        """Sleep on the clock, then on the wall until it has come as far."""
        self._clock.sleep(seconds)
        due = self._wall_start + (self._clock.now() - self._start) / self._speed
        late = self._wall.now() - due
        if late < 0:
            self._wall.sleep(-late)
        elif late > _MAX_LATE_S:
            self._begin()

    def _begin(self) -> None:
        self._start, self._wall_start = self._clock.now(), self._wall.now()


def pace_clock(clock: Clock, speed: float | None, wall: Clock | None = None) -> Clock:
    """`clock`, held back to `speed` of its seconds in one of the wall's; None: as fast as it is computed."""
    if speed is None:
        return clock
    if not 0 < speed < math.inf:
        raise InputError(f"speed is {speed:g}; it must be above 0")
    return PacedClock(clock, wall or MonotonicClock(), speed)
