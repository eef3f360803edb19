"""Samples of a recorded session: what its bytes say of servos and taxels, beside its events, on one clock."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

from palpate.base.errors import DeviceError
from palpate.base.geometry import ObjectModel
from palpate.config import FingerConfig, RigFile
from palpate.drivers.dynamixel.models import Model, model_named
from palpate.drivers.dynamixel.state_traffic import StateTraffic
from palpate.drivers.finger import FingerKinematics, Turn
from palpate.drivers.tactile.frames import ArrayDriver, TactileFrame
from palpate.drivers.transport.clock import VirtualClock
from palpate.drivers.transport.playback import Piece, PlaybackPort
from palpate.drivers.transport.recording import Direction, Entry, PortBytes, SessionEvent
from palpate.rig.arrays import array_of
from palpate.rig.conversion import kinematics_of
from palpate.rig.session.inputs import calibrated_run, kept_inputs
from palpate.rig.session.log_reader import SessionFile

__all__ = [
    "EventSample",
    "FrameSample",
    "Sample",
    "SampleDecoder",
    "ServoSample",
    "SessionSamples",
    "TipSample",
    "open_samples",
]


@dataclass(frozen=True, slots=True)
class ServoSample:
    """One servo's state; `joint` is its name in the rig file, with its finger's before it."""

    t_s: float
    joint: str
    dxl_id: int
    position_rad: float
    velocity_rad_s: float
    current_a: float
    torque_on: bool
    hardware_error: int


@dataclass(frozen=True, slots=True)
class TipSample:
    """Centre of a finger's tip in W, computed from both of its servos."""

    t_s: float
    finger: str
    x_mm: float
    y_mm: float


@dataclass(frozen=True, slots=True, eq=False)
class FrameSample:
    """One frame of a finger's array."""

    t_s: float
    finger: str
    frame: TactileFrame


@dataclass(frozen=True, slots=True, eq=False)
class EventSample:
    """One event of the log but its bytes, as it stands there (docs/session-log.md)."""

    t_s: float
    kind: str
    values: Mapping[str, Any]


Sample = ServoSample | TipSample | FrameSample | EventSample


@dataclass(frozen=True, eq=False)
class SessionSamples:
    """A session with what is needed to read its samples, which are iterated over in order of time."""

    file: SessionFile
    rig: RigFile
    objects: tuple[ObjectModel, ...]

    @property
    def started(self) -> datetime | None:
        """When the run began, UTC; None if the log does not say."""
        try:
            return datetime.fromisoformat(str(self.file.header.get("started")))
        except ValueError:
            return None

    def __iter__(self) -> Iterator[Sample]:
        yield EventSample(0.0, "session", self.file.header)
        decoder = SampleDecoder(self.rig)
        for entry in self.file.entries:
            yield from decoder.feed(entry)


class SampleDecoder:
    """Makes samples of a log's entries, one after the other, while it is being written or later."""

    def __init__(self, rig: RigFile) -> None:
        self._joints = _joints(rig)
        self._bus_port = rig.bus.port
        self._traffic = StateTraffic({dxl_id: model for dxl_id, (_, model) in self._joints.items()})
        self._tips = _Tips(rig)
        self._arrays = {finger.array.port: _Array(finger) for finger in rig.fingers}

    def feed(self, entry: Entry) -> Iterator[Sample]:
        """The samples that an entry completes."""
        what = entry.what
        if isinstance(what, SessionEvent):
            yield EventSample(entry.t_s, what.kind, what.values)
        elif isinstance(what, PortBytes) and what.port == self._bus_port:
            yield from self._servos(entry.t_s, what)
        elif isinstance(what, PortBytes) and what.port in self._arrays:
            yield from self._arrays[what.port].feed(Piece(entry.t_s, what.direction, what.data))

    def _servos(self, t_s: float, what: PortBytes) -> Iterator[ServoSample | TipSample]:
        if what.direction is Direction.SENT:
            self._traffic.sent(what.data)
            return
        for dxl_id, state in self._traffic.received(what.data):
            yield ServoSample(
                t_s,
                self._joints[dxl_id][0],
                dxl_id,
                state.position_rad,
                state.velocity_rad_s,
                state.current_a,
                state.torque_on,
                int(state.hardware_error),
            )
            yield from self._tips.after(t_s, dxl_id, state.position_rad)


class _Array:
    """An array's own driver, which reads what was recorded; silent until the recording says what it is."""

    def __init__(self, finger: FingerConfig) -> None:
        self._finger = finger
        self._clock = VirtualClock()
        self._before: list[Piece] = []
        self._driver: tuple[PlaybackPort, ArrayDriver] | None = None

    def feed(self, piece: Piece) -> Iterator[FrameSample]:
        if self._driver is None:
            if piece.direction is Direction.SENT and self._before:
                self._driver = self._connected()
            self._before.append(piece)
            if self._driver is None:
                return
            self._before.clear()
        port, array = self._driver
        port.extend([piece])
        self._clock.advance_to(piece.t_s)
        try:
            for frame in array.frames():
                yield FrameSample(frame.host_time_s, self._finger.name, frame)
        except DeviceError:  # as the run's own driver may have raised
            self._driver, self._before = None, [piece]

    def _connected(self) -> tuple[PlaybackPort, ArrayDriver] | None:
        """A driver that has met what was said so far; None if the array has not described itself yet."""
        port = PlaybackPort(self._finger.array.port, self._before, self._clock)
        array = array_of(self._finger, port, self._clock)
        try:
            array.connect()
        except DeviceError:
            return None
        port.play()
        return port, array


def open_samples(file: SessionFile, folder: Path) -> SessionSamples:
    """Samples of a session in its folder; InputError if the folder lacks its rig or objects file."""
    on_bench, objects, _ = kept_inputs(folder, scene=False, calibration=calibrated_run(file))
    return SessionSamples(file, on_bench.rig, tuple(objects.objects))


def _joints(rig: RigFile) -> dict[int, tuple[str, Model]]:
    """Name and model of each servo, by ID."""
    found = {}
    for finger in rig.fingers:
        for joint, servo in finger.servos.items():
            found[servo.dxl_id] = f"{finger.name}_{joint}", model_named(servo.model)
    if rig.stage is not None:
        found[rig.stage.dxl_id] = "stage", model_named(rig.stage.model)
    return found


class _Tips:
    """Where tips are, from the last known angles of their servos and of the stage."""

    def __init__(self, rig: RigFile) -> None:
        self._stage = rig.stage
        self._turn = Turn()
        self._angles: dict[int, float] = {}
        self._fingers: dict[int, tuple[str, FingerKinematics, tuple[int, ...]]] = {}
        for finger in rig.fingers:
            ids = tuple(servo.dxl_id for servo in finger.servos.values())
            for dxl_id in ids:
                self._fingers[dxl_id] = finger.name, kinematics_of(finger), ids

    def after(self, t_s: float, dxl_id: int, position_rad: float) -> Iterator[TipSample]:
        """The tip that a servo's new angle places; none while the other angle is not known."""
        self._angles[dxl_id] = position_rad
        stage = self._stage
        if stage is not None and dxl_id == stage.dxl_id:
            zero = math.radians(stage.zero_deg) - math.pi
            self._turn = Turn(stage.centre_mm, (position_rad - zero) / stage.gear_ratio)
        if dxl_id not in self._fingers:
            return
        name, kinematics, (near, far) = self._fingers[dxl_id]
        if dxl_id == far and near in self._angles:
            x, y = self._turn.point_mm(kinematics.centre_mm((self._angles[near], self._angles[far])))
            yield TipSample(t_s, name, x, y)
