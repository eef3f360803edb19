"""A recorded session: its inputs, and samples of its bytes.

Inputs are kept in its folder, so that the folder is enough to run it again. The copies of rig file and
calibration lie beside each other as the originals do, so that the folder's rig file can be given to any
command. Samples are what its bytes say of servos and taxels, beside its events, on one clock.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from datetime import datetime
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Any

from palpate.base.errors import DeviceError, InputError
from palpate.base.file_io import write_text
from palpate.base.geometry import ObjectModel
from palpate.config import (
    FingerConfig,
    FreeRunningArrayConfig,
    ObjectsFile,
    RigFile,
    RigOnBench,
    Scene,
    calibration_path,
    load_calibrated,
    load_objects,
    load_scene,
)
from palpate.config.wiring_record import ConfirmedWiring, load_confirmed, proof_path
from palpate.config.writers import file_text, keep_confirmed
from palpate.drivers.dynamixel import Model, StateTraffic, model_by_name
from palpate.drivers.kinematics import FingerKinematics, Turn
from palpate.drivers.tactile import ArrayDriver, TactileFrame
from palpate.drivers.transport import (
    Direction,
    PlaybackPort,
    PortBytes,
    RecordedBytes,
    RecordEntry,
    SessionEvent,
    VirtualClock,
)
from palpate.rig.arrays import array_of, connect_recorded
from palpate.rig.fingers import Stage
from palpate.rig.mechanisms import kinematics_of
from palpate.rig.session.log_reader import SessionFile

_RIG, _OBJECTS, _SCENE, _SCENE_OBJECTS = "rig.toml", "objects.json", "scene.json", "scene-objects"


def keep_inputs(folder: Path, on_bench: RigOnBench, objects: ObjectsFile, scene: Scene | None) -> None:
    """Keep the inputs of a run in its session's folder; InputError if one cannot be written.

    A scene whose objects come from files of their own gets those files' copies instead.
    """
    keep_rig(folder, on_bench)
    write_text(folder / _OBJECTS, file_text(objects))
    if scene is None:
        return
    several = scene.parts is not None

    def keep(source: str, number: int) -> str:
        name = f"{_SCENE_OBJECTS}-{number + 1}.json" if several else f"{_SCENE_OBJECTS}.json"
        write_text(folder / name, file_text(load_objects(source)))
        return name

    write_text(folder / _SCENE, file_text(scene.with_files(keep)))


def keep_rig(folder: Path, on_bench: RigOnBench) -> None:
    """Keep a rig file and the calibration that is in use; InputError if one cannot be written."""
    text = file_text(on_bench.described) if on_bench.is_changed else _text(on_bench.path)
    write_text(folder / _RIG, text)
    if on_bench.calibration_path is not None:
        write_text(calibration_path(folder / _RIG), _text(on_bench.calibration_path))
    if (confirmed := confirmed_of(on_bench.path)) is not None:
        keep_confirmed(folder / _RIG, confirmed)


def confirmed_of(rig: Path | Traversable) -> ConfirmedWiring | None:
    """Confirmed wiring beside a rig file; None if there is none. Raises InputError if it cannot be read."""
    beside = proof_path(rig) if isinstance(rig, Path) else None
    return load_confirmed(beside) if beside is not None and beside.exists() else None


def load_kept_inputs(
    folder: Path, *, scene: bool, calibration: bool
) -> tuple[RigOnBench, ObjectsFile, Scene | None]:
    """The inputs that a session's folder keeps; InputError if one is missing or cannot be read.

    `scene`, `calibration`: whether the session had one.
    """
    if not (folder / _RIG).is_file():
        raise InputError(
            f"{folder} cannot be replayed: it keeps no {_RIG}; "
            "sessions do so since palpate records them for replay"
        )
    on_bench = load_calibrated(folder / _RIG, calibration=calibration)
    if calibration and on_bench.calibration is None:
        missing = calibration_path(folder / _RIG).name
        raise InputError(f"{folder} cannot be replayed: its run used a calibration, but {missing} is missing")
    return (
        on_bench,
        load_objects(folder / _OBJECTS),
        load_scene(folder / _SCENE) if scene else None,
    )


def used_calibration(file: SessionFile) -> bool:
    """True if the run of a session used a calibration; InputError if its first line says neither."""
    value = file.header.get("calibration", False)
    if not isinstance(value, bool):
        raise InputError(f'{file.path}: line 1: "calibration" must be true or false')
    return value


def started_in(header: Mapping[str, Any]) -> datetime | None:
    """Time when a run began, UTC, as a log's first line says; None if it does not."""
    try:
        return datetime.fromisoformat(str(header.get("started")))
    except ValueError:
        return None


def _text(source: Path | Traversable) -> str:
    try:
        return source.read_bytes().decode("utf-8-sig")
    except (OSError, ValueError) as error:  # it was read a moment ago
        raise InputError(f"{source} cannot be read any more: {error}") from error


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
    """Centre of a finger's tip in W, computed from both of its servos, and of the joints behind it.

    `joints_mm`: the base, and an arm's elbow; `link_width_mm`: of what joins them and the tip.
    """

    t_s: float
    finger: str
    x_mm: float
    y_mm: float
    joints_mm: tuple[tuple[float, float], ...]
    link_width_mm: float


@dataclass(frozen=True, slots=True, eq=False)
class FrameSample:
    """One frame of a finger's array."""

    t_s: float
    finger: str
    frame: TactileFrame
    counts_per_n: float


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
        """Time when the run began, UTC; None if the log does not say."""
        return started_in(self.file.header)

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

    def feed(self, entry: RecordEntry) -> Iterator[Sample]:
        """The samples that an entry completes."""
        what = entry.what
        if isinstance(what, SessionEvent):
            yield EventSample(entry.t_s, what.kind, what.values)
        elif isinstance(what, PortBytes) and what.port == self._bus_port:
            yield from self._servos(entry.t_s, what)
        elif isinstance(what, PortBytes) and what.port in self._arrays:
            yield from self._arrays[what.port].feed(RecordedBytes(entry.t_s, what.direction, what.data))

    def _servos(self, t_s: float, what: PortBytes) -> Iterator[ServoSample | TipSample]:
        if what.direction is Direction.SENT:
            self._traffic.take_sent(what.data)
            return
        for dxl_id, state in self._traffic.take_received(what.data):
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
        self._before: list[RecordedBytes] = []
        self._driver: tuple[PlaybackPort, ArrayDriver] | None = None

    def feed(self, piece: RecordedBytes) -> Iterator[FrameSample]:
        if self._driver is None:
            asked = piece.direction is Direction.SENT and bool(self._before)
            if asked or isinstance(self._finger.array, FreeRunningArrayConfig):
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
                yield FrameSample(frame.host_time_s, self._finger.name, frame, array.description.counts_per_n)
        except DeviceError:  # as the run's own driver may have raised
            self._driver, self._before = None, [piece]

    def _connected(self) -> tuple[PlaybackPort, ArrayDriver] | None:
        """A driver that has met what was said so far; None if the array has not described itself yet."""
        port = PlaybackPort(self._finger.array.port, self._before, self._clock)
        array = array_of(self._finger, port, self._clock)
        try:
            connect_recorded(array, port)
        except DeviceError:
            return None
        return port, array


def open_samples(file: SessionFile, folder: Path) -> SessionSamples:
    """Samples of a session in its folder; InputError if the folder lacks its rig or objects file."""
    on_bench, objects, _ = load_kept_inputs(folder, scene=False, calibration=used_calibration(file))
    return SessionSamples(file, on_bench.rig, tuple(objects.objects))


def _joints(rig: RigFile) -> dict[int, tuple[str, Model]]:
    """Name and model of each servo, by ID."""
    return {servo.dxl_id: (servo.name, model_by_name(servo.model)) for servo in rig.servos}


class _Tips:
    """Places of tips, from the last known angles of their servos and of the stage."""

    def __init__(self, rig: RigFile) -> None:
        self._stage = Stage.of(rig)
        self._stage_ids = {servo.dxl_id for servo in rig.servos if servo.finger is None}
        self._turn = Turn()
        self._angles: dict[int, float] = {}
        self._fingers: dict[int, tuple[FingerConfig, FingerKinematics, tuple[int, ...]]] = {}
        for finger in rig.fingers:
            ids = tuple(servo.dxl_id for servo in finger.servos.values())
            for dxl_id in ids:
                self._fingers[dxl_id] = finger, kinematics_of(finger), ids

    def after(self, t_s: float, dxl_id: int, position_rad: float) -> Iterator[TipSample]:
        """The tip that a servo's new angle places; none while the other angle is not known."""
        self._angles[dxl_id] = position_rad
        if dxl_id in self._stage_ids:
            self._turn = self._stage.turn(position_rad)
        if dxl_id not in self._fingers:
            return
        finger, kinematics, (near, far) = self._fingers[dxl_id]
        if dxl_id == far and near in self._angles:
            servos = self._angles[near], self._angles[far]
            body, tip = kinematics.body(servos, finger.tip.half_width_mm), kinematics.centre_mm(servos)
            joints = tuple(self._turn.point_mm((x, y)) for x, y in body.start.tolist() if (x, y) != tip)
            x, y = self._turn.point_mm(tip)
            yield TipSample(t_s, finger.name, x, y, joints, 2 * float(body.half_width[0]))
