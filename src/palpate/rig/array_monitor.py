"""Array monitor: what each finger's array reads, from streaming devices or from a recorded session.

Every frame is counted, but only the newest few are evaluated, because evaluation takes longer than a sample
period. The servo bus is not used, so nothing can move.

*Playback.* A session's arrays are read through the same drivers, with a clock that can be slowed to real
time.
"""

import math
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, fields
from enum import Enum
from pathlib import Path

import numpy as np
from serial.serialutil import SerialBase

from palpate.base.errors import DeviceError, InputError
from palpate.base.geometry import Bools, Counts, Floats
from palpate.base.short_repr import ShortRepr
from palpate.config import FingerConfig, RigFile
from palpate.drivers.tactile import (
    ArrayCounters,
    ArrayDriver,
    ContactExtractor,
    ContactPatch,
    Description,
    TactileFrame,
)
from palpate.drivers.transport import (
    Clock,
    MonotonicClock,
    PlaybackPort,
    PortBytes,
    PortSharing,
    PortTaken,
    RecordedBytes,
    Recorder,
    RecordSink,
    SessionEvent,
    VirtualClock,
    open_port,
)
from palpate.rig.arrays import array_of, connect_recorded, extractor_of
from palpate.rig.bench import set_up
from palpate.rig.session.log_file import session_of
from palpate.rig.session.log_reader import SessionFile, read_session
from palpate.rig.session.recorded_session import load_kept_inputs, used_calibration

_SILENT_AFTER_S = 0.5
"""An array whose last frame is older than this does not stream, for display."""

_NEWEST_FRAMES = 4  # frames that are looked at together
_TARE_FRAMES = 16
_RATE_WINDOW_S = 2.0


class TareState(Enum):
    """Knowledge of what the untouched array reads."""

    NONE = "not tared"
    UNDER_WAY = "taring"
    DONE = "tared"


@dataclass(frozen=True, eq=False, repr=False)
class FingerView(ShortRepr):
    """State of one finger's array at one instant. Arrays: shape (rows, cols), lowest row first.

    `counts` are those of the newest frame, None before the first one. `taxel_n`: force on each taxel
    over its reading at rest (N), from the newest few frames; `force_n` that of all above the noise, None
    if not tared. `saturated` taxels are at their largest count now; `dead` and `hot` ones gave nothing,
    or everything, with nothing touching. While the array is silent `taxel_n` is 0,
    `force_n` and `patch` are None. `age_s` is the time since the last frame, or since frames were first
    waited for. `counters` count from the last reset.
    """

    name: str
    port: str
    description: Description
    tare: TareState
    counts: Counts | None
    taxel_n: Floats
    saturated: Bools
    dead: Bools
    hot: Bools
    force_n: float | None
    patch: ContactPatch | None
    rate_hz: float
    age_s: float
    counters: ArrayCounters

    @property
    def silent(self) -> bool:
        """True if frames have stopped coming."""
        return self.age_s > _SILENT_AFTER_S


class MonitoredFinger:
    """An array that streams. Call `poll` often, `view` as often as it is displayed."""

    def __init__(
        self, name: str, port: str, array: ArrayDriver, extractor: ContactExtractor, clock: Clock
    ) -> None:
        self.name = name
        self.port = port
        self.array = array
        self._extractor = extractor
        self._clock = clock
        self._tare = TareState.NONE
        self._at_rest: list[TactileFrame] = []
        self._newest: deque[TactileFrame] = deque(maxlen=_NEWEST_FRAMES)
        self._last_s = clock.now()
        self._since = ArrayCounters(0, 0, 0, 0, 0)
        self._counted: deque[tuple[float, int]] = deque([(clock.now(), array.counters.frames)])

    @property
    def age_s(self) -> float:
        """Time since the last frame, or since frames were first waited for."""
        return self._clock.now() - self._last_s

    def poll(self) -> None:
        """Take the frames that have come; raises DeviceError if the array is gone."""
        frames = self.array.frames()
        now = self._clock.now()
        if frames:
            self._last_s = frames[-1].host_time_s
            self._newest.extend(frames[-_NEWEST_FRAMES:])
            self._extractor.follow(frames)
            self._go_on_taring(frames)
        self._counted.append((now, self.array.counters.frames))
        while self._counted[1][0] <= now - _RATE_WINDOW_S:
            self._counted.popleft()

    def tare(self) -> None:
        """Take the next few frames as those of an untouched tip."""
        self._tare = TareState.UNDER_WAY
        self._at_rest.clear()

    def reset_counters(self) -> None:
        """Count from now on."""
        self._since = self.array.counters

    def view(self) -> FingerView:
        """The state now."""
        description = self.array.description
        shape = (description.rows, description.cols)
        blank = np.zeros(shape, dtype=bool)
        counts = self._newest[-1].counts if self._newest else None
        baseline = self._extractor.baseline
        # The extractor's baseline is nothing before the first tare: then maps show all that taxels read.
        recent = [frame.counts for frame in self._newest]
        mean = np.mean(recent, axis=0) if recent else baseline.mean
        tared, fresh = self._tare is TareState.DONE, counts is not None and self.age_s <= _SILENT_AFTER_S
        hot = ~baseline.usable & (baseline.mean >= 0.5 * description.max_count) if tared else blank
        return FingerView(
            name=self.name,
            port=self.port,
            description=description,
            tare=self._tare,
            counts=counts,
            taxel_n=(mean - baseline.mean) / description.counts_per_n if fresh else np.zeros(shape),
            saturated=counts >= description.max_count if counts is not None and fresh else blank,
            dead=~baseline.usable & ~hot if tared else blank,
            hot=hot,
            force_n=self._force_n() if tared and fresh else None,
            patch=self._extractor.extract(tuple(self._newest)) if tared and fresh else None,
            rate_hz=self._rate_hz(),
            age_s=self.age_s,
            counters=_counter_difference(self.array.counters, self._since),
        )

    def _go_on_taring(self, frames: list[TactileFrame]) -> None:
        if self._tare is not TareState.UNDER_WAY:
            return
        self._at_rest += frames
        if len(self._at_rest) >= _TARE_FRAMES:
            self._extractor.tare(self._at_rest)
            self._tare = TareState.DONE
            self._at_rest.clear()

    def _force_n(self) -> float:
        return float(np.mean([self._extractor.force_n(frame) for frame in self._newest]))

    def _rate_hz(self) -> float:
        (first_s, first), (last_s, last) = self._counted[0], self._counted[-1]
        return (last - first) / (last_s - first_s) if last_s > first_s else 0.0


def _counter_difference(now: ArrayCounters, then: ArrayCounters) -> ArrayCounters:
    names = (item.name for item in fields(ArrayCounters))
    return ArrayCounters(**{name: getattr(now, name) - getattr(then, name) for name in names})


@dataclass(frozen=True, eq=False)
class ArrayPorts:
    """Access to a rig's arrays: the clock, and how to open a port. It keeps `devices` alive."""

    clock: Clock
    open_port: Callable[[str, int], SerialBase]
    devices: object = None

    def recorded(self, sink: RecordSink) -> "ArrayPorts":
        """The same ports and clock, recorded to `sink`."""
        recorder = Recorder(self.clock, sink)

        def opened(port: str, baudrate: int) -> SerialBase:
            return recorder.open(port, lambda: self.open_port(port, baudrate))

        return ArrayPorts(recorder.clock, opened, self.devices)


def find_array_ports(rig: RigFile) -> ArrayPorts:
    """The ports of a rig; those of an emulated one are emulated from now on, with an empty table."""
    if not rig.emulated:
        return ArrayPorts(MonotonicClock(), PortSharing(open_port).open)
    bench = set_up(rig, (), 0)
    sharing = PortSharing(lambda port, baudrate: open_port(bench.urls(port), baudrate))
    return ArrayPorts(bench.clock, sharing.open, bench)


def select_fingers(rig: RigFile, names: Sequence[str]) -> tuple[FingerConfig, ...]:
    """The fingers of these names, all without any; InputError for a name that the rig does not have."""
    there = [finger.name for finger in rig.fingers]
    unknown = next((name for name in names if name not in there), None)
    rig.require_arrays()
    if unknown is not None:
        names_there = ", ".join(there)
        raise InputError(f'rig "{rig.name}" has no finger {unknown}; it has {names_there}')
    return tuple(finger for finger in rig.fingers if not names or finger.name in names)


@contextmanager
def stream_arrays(
    rig: RigFile, specs: Sequence[FingerConfig], place: ArrayPorts, clock: Clock, rate_hz: float
) -> Iterator[tuple[MonitoredFinger, ...]]:
    """The arrays of some fingers, streaming until the block is left, by whatever way.

    `clock` is the place's, perhaps paced. Raises PortTaken if another program uses a port, DeviceError
    if one does not exist, or an array does not answer or refuses the rate.
    """
    with ExitStack() as ways_out:
        fingers = []
        for spec in specs:
            port = _open(place, spec)
            ways_out.callback(port.close)
            array = array_of(spec, port, clock)
            array.connect()
            ways_out.callback(_stop, array)
            fingers.append(_monitor_finger(rig, spec, array, clock))
        for finger in fingers:
            finger.array.start(rate_hz)
        yield tuple(fingers)


def _monitor_finger(rig: RigFile, spec: FingerConfig, array: ArrayDriver, clock: Clock) -> MonitoredFinger:
    """A finger's array, connected, with its extractor."""
    extractor = extractor_of(rig, spec, array.description)
    return MonitoredFinger(spec.name, spec.array.port, array, extractor, clock)


def _open(place: ArrayPorts, spec: FingerConfig) -> SerialBase:
    try:
        return place.open_port(spec.array.port, spec.array.baudrate_bps)
    except PortTaken as error:
        raise PortTaken(
            f"port {spec.array.port} of array {spec.name} is in use: another program has it, perhaps a "
            "run, and a port serves one at a time; end that program, or watch the session that the run "
            "records, afterwards"
        ) from error


def _stop(array: ArrayDriver) -> None:
    with suppress(DeviceError):  # it is gone, or says so itself when it is opened next
        array.stop()


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
            if port.writes != self._writes.get(k):  # START was said, or STOP before the next START
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
            connect_recorded(array, port)
        except DeviceError:
            raise InputError(
                f"{file.path}: array {spec.name} on {spec.array.port} never says what it is; choose "
                "other fingers, or another session"
            ) from None
        ports.append(port)
        fingers.append(_monitor_finger(rig, spec, array, clock))
    writes = {k: port.writes for k, port in enumerate(ports) if port.writes}  # others are tared at once
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
