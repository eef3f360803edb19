"""Recorded arrays of a session, played back through the same drivers."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from palpate.base.errors import DeviceError, InputError
from palpate.config import RigFile
from palpate.drivers.transport.clock import VirtualClock
from palpate.drivers.transport.playback import Piece, PlaybackPort
from palpate.drivers.transport.recording import PortBytes, SessionEvent
from palpate.rig.arrays import array_of
from palpate.rig.monitor.arrays import monitor_finger, select_fingers
from palpate.rig.monitor.finger_monitor import MonitoredFinger
from palpate.rig.session.inputs import calibrated_run, kept_inputs
from palpate.rig.session.log_file import session_of
from palpate.rig.session.log_reader import SessionFile, read_session

__all__ = ["RecordedArrays", "open_recorded_arrays"]


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
            if port.writes != self._writes.get(k, 0):  # START was said, or STOP before the next START
                self._writes[k] = port.writes
                finger.tare()


def open_recorded_arrays(session: Path, names: Sequence[str]) -> RecordedArrays:
    """The arrays of the session in a folder.

    Raises InputError if there is no session, or it does not hold what an array of these fingers is.
    """
    folder = session_of(session)
    file = read_session(folder)
    on_bench, _, _ = kept_inputs(folder, scene=False, calibration=calibrated_run(file))
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


def _pieces(file: SessionFile, port: str) -> list[Piece]:
    pairs = ((entry.t_s, entry.what) for entry in file.entries)
    return [
        Piece(t_s, what.direction, what.data)
        for t_s, what in pairs
        if isinstance(what, PortBytes) and what.port == port
    ]


def _stages(file: SessionFile) -> tuple[tuple[float, str], ...]:
    """Begin and name of each stage of the run."""
    pairs = ((entry.t_s, entry.what) for entry in file.entries)
    begun = ((t_s, what) for t_s, what in pairs if isinstance(what, SessionEvent) and what.kind == "stage")
    return tuple((t_s, f"grip {what.values.get('grip')}, {what.values.get('stage')}") for t_s, what in begun)
