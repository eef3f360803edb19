"""Examination of tactile arrays, untouched: identity, self-test, and the stream of frames.

An array that is silent is looked for at other baud rates and with other protocols. Each is left as after
`connect`, and stopped.
"""

import math
from collections.abc import Callable, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field
from functools import partial
from typing import cast

import numpy as np
from serial.serialutil import SerialBase

from palpate.base.errors import DeviceError, PalpateError
from palpate.base.geometry import Bools, Floats
from palpate.config import FingerConfig
from palpate.config.rig_fingers import PALPATE_PROTOCOL, SHIPPED_PROTOCOLS, ArrayConfig
from palpate.drivers.tactile import (
    ArrayCounters,
    ArrayDriver,
    ArrayExchange,
    Describe,
    Description,
    Disturbances,
    Hello,
    Port,
    Repeats,
    SelfTestReport,
    TactileArray,
    TactileFrame,
    count_repeats,
    find_disturbances,
)
from palpate.drivers.transport import has_baudrate
from palpate.rig.arrays import array_of, array_plugin
from palpate.rig.diagnostics.steps import DiagnosisCase, NamedDevice, name_array

_MIN_RATE_SHARE = 0.95  # of the wanted rate: arrays have clocks of their own
_MAX_LOST_SHARE = 0.005


def frame_rate_hz(frames: Sequence[TactileFrame]) -> float:
    """Frames that arrive in a second of the array's own clock; 0 for fewer than two."""
    if len(frames) < 2:
        return 0.0
    span_s = frames[-1].device_time_s - frames[0].device_time_s
    return (len(frames) - 1) / span_s if span_s > 0 else 0.0


def is_rate_too_low(rate_hz: float, wanted_hz: float) -> bool:
    """Return whether that is less than 95 % of what was asked for."""
    return rate_hz < _MIN_RATE_SHARE * wanted_hz


def count_lost_frames(counters: ArrayCounters) -> int:
    """Frames that never came, or came damaged, so far: also what boards send while they start."""
    return counters.lost + counters.faults + counters.misshapen


def is_loss_too_high(gone: int, came: int) -> bool:
    """Return whether more than 0.5 % of the frames are gone, and more than one."""
    return gone > 1 and gone > _MAX_LOST_SHARE * (came + gone)


_POLL_S = 0.02
_BAUDRATES_TO_TRY = (115_200, 230_400, 460_800, 500_000, 921_600, 1_000_000, 2_000_000, 3_000_000)
_HELLO_TIMEOUT_S = 0.3
_HELLO_TRIES = 2


@dataclass(frozen=True, eq=False)
class ExaminedArray:
    """An array: what it says of itself, and its frames while nothing touched it.

    `description` is None if it did not introduce itself: `failure` says why, `other_rate` or `other_protocol`
    how it does answer, `noisy` that bytes come which are no message, `answered` that it does answer, with
    something that cannot be used. `broken` says what failed after that.
    """

    spec: FingerConfig
    description: Description | None = None
    failure: str | None = None
    other_rate: int | None = None
    other_protocol: str | None = None
    noisy: bool = False
    answered: bool = False
    report: SelfTestReport | None = None
    frames: tuple[TactileFrame, ...] = ()
    lost: int = 0
    broken: str | None = None

    @property
    def device(self) -> NamedDevice:
        """The array as findings call it."""
        return name_array(self.spec)


def examine_arrays(case: DiagnosisCase, usable: frozenset[str]) -> tuple[ExaminedArray, ...]:
    """Look at the arrays whose ports are usable; then all of them stream at once, as in a run."""
    with ExitStack() as ports:
        found = [_introduce(case, spec, ports) for spec in case.rig.fingers if spec.array.port in usable]
        _stream_all(case, [item for item in found if isinstance(item, _Stream)])
        return tuple(item.result() if isinstance(item, _Stream) else item for item in found)


@dataclass(eq=False)
class _Stream:
    """An array that has introduced itself. `broken`: what failed after that; then it is left alone."""

    spec: FingerConfig
    array: ArrayDriver
    report: SelfTestReport | None = None
    frames: list[TactileFrame] = field(default_factory=list)
    lost_before: int = 0
    broken: str | None = None

    def attempt(self, deed: Callable[[], None]) -> None:
        """Do something with the array, unless it has failed before."""
        if self.broken is not None:
            return
        try:
            deed()
        except DeviceError as error:
            self.broken = str(error)

    def test(self) -> None:
        """Let it test itself, if it can."""
        if isinstance(self.array, TactileArray):
            self.report = self.array.self_test_if_known()

    def listen(self) -> None:
        """Take the frames that have arrived."""
        self.frames += self.array.frames()

    def result(self) -> ExaminedArray:
        """The array as it was seen."""
        return ExaminedArray(
            self.spec,
            self.array.description,
            report=self.report,
            frames=tuple(self.frames),
            lost=count_lost_frames(self.array.counters) - self.lost_before,
            broken=self.broken,
        )


def _introduce(case: DiagnosisCase, spec: FingerConfig, ports: ExitStack) -> _Stream | ExaminedArray:
    """An array that is asked who it is, and tests itself."""
    case.tell(f"array of finger {spec.name}")
    try:
        port = case.place.open_other(spec.array.port, spec.array.baudrate_bps)
    except DeviceError as error:
        return ExaminedArray(spec, failure=str(error))
    ports.callback(_close, port)
    array = array_of(spec, port, case.place.clock)
    try:
        array.connect()
    except DeviceError as error:
        return _unknown(case, spec, port, str(error))
    found = _Stream(spec, array)
    found.attempt(found.test)
    return found


def _close(port: SerialBase) -> None:
    with suppress(Exception):
        port.close()


def _stream_all(case: DiagnosisCase, streams: Sequence[_Stream]) -> None:
    """Let arrays that introduced themselves stream at once for a while."""
    clock, rate_hz = case.place.clock, case.rig.closing.sample_rate_hz
    case.tell("listening to all arrays")
    for item in streams:
        item.lost_before = count_lost_frames(item.array.counters)
        item.attempt(partial(item.array.start, rate_hz))
    end = clock.now() + (case.listen_s if streams else 0.0)
    while clock.now() < end:
        clock.sleep(_POLL_S)
        for item in streams:
            item.attempt(item.listen)
    for item in streams:
        with suppress(DeviceError):  # what ended the stream says more
            item.array.stop()


def _unknown(case: DiagnosisCase, spec: FingerConfig, port: SerialBase, failure: str) -> ExaminedArray:
    """An array that does not introduce itself: how else it may answer."""
    own = spec.array.baudrate_bps
    noisy = "is no message" in failure
    try:
        answers, heard = _hello(case, spec, port)
        noisy = noisy or heard
    except DeviceError:  # it answers something
        return ExaminedArray(spec, failure=failure, answered=spec.array.protocol == PALPATE_PROTOCOL)
    if answers and spec.array.protocol == PALPATE_PROTOCOL:
        return ExaminedArray(spec, failure=failure, answered=True)
    if answers:
        return ExaminedArray(spec, failure=failure, other_protocol=PALPATE_PROTOCOL)
    for rate in _BAUDRATES_TO_TRY if has_baudrate(spec.array.port) else ():
        if rate != own and spec.array.protocol == PALPATE_PROTOCOL:
            case.tell(f"array of finger {spec.name} at {rate} baud")
            port.baudrate = rate
            with suppress(DeviceError):
                if _hello(case, spec, port)[0]:
                    return ExaminedArray(spec, failure=failure, other_rate=rate)
    port.baudrate = own
    return ExaminedArray(spec, failure=failure, noisy=noisy, other_protocol=_other_protocol(case, spec, port))


def _hello(case: DiagnosisCase, spec: FingerConfig, port: SerialBase) -> tuple[bool, bool]:
    """Return whether palpate's own protocol is answered, and whether anything is heard; or DeviceError."""
    _drop_unread(port)
    exchange = ArrayExchange(port, case.place.clock, spec.name, lambda *_: None)
    answer = exchange.ask(Hello, Describe, _HELLO_TIMEOUT_S, _HELLO_TRIES)
    return isinstance(answer, Describe), bool(exchange.noise)


def _drop_unread(port: SerialBase) -> None:
    readable = cast("Port", port)
    readable.read(readable.in_waiting)


def _other_protocol(case: DiagnosisCase, spec: FingerConfig, port: SerialBase) -> str | None:
    """The first of the shipped protocols, but for the rig file's, in which the array introduces itself."""
    for name in SHIPPED_PROTOCOLS:
        if name == spec.array.protocol:
            continue
        case.tell(f"array of finger {spec.name} as {name}")
        table = {
            "port": spec.array.port,
            "baudrate_bps": spec.array.baudrate_bps,
            "protocol": name,
            "gain_spread": 0.0,
            "counts_per_n": 1.0,
        }
        with suppress(PalpateError, ValueError):
            config = ArrayConfig.model_validate(table)
            plugin = array_plugin(name)
            _drop_unread(port)
            plugin.driver(
                cast("Port", port), case.place.clock, spec.name, config, spec.tip.radius_mm
            ).connect()
            return name
    return None


_MIN_FRAMES = 16  # frames
_HOT_SHARE = 0.95  # of the largest count
_MAX_DEAD_CHANCE = 1e-6  # chance for a live taxel to read the same in every frame
_UNSTEADY_RATIO = 6.0  # times the median noise
_MIN_NOISE_COUNTS = 0.3  # counts: of a taxel whose noise is lost in rounding
_DRIFT_SIGMAS = 6.0  # above which a slope is no chance
_DRIFT_STRETCHES = 12


@dataclass(frozen=True, eq=False)
class UntouchedStatistics:
    """Statistics of an untouched array's frames, by taxel (rows, cols).

    `dead` never change, which is certain only where there is noise enough (`tells_dead`); `at_zero` of them
    read 0, as one does whose zero has drifted below what can be read. `noise_counts`: median of the live
    taxels' standard deviations. `drift_counts_per_s`: the fastest drift that is certain, in absolute value, 0
    if none is; `drifting`: how many taxels' is beyond what was allowed.
    `repeats`: frames that carry no new reading; `disturbed`: those that something else has moved.
    """

    dead: Bools
    at_zero: Bools
    hot: Bools
    unsteady: Bools
    noise_counts: float
    drift_counts_per_s: float
    drifting: int
    tells_dead: bool
    repeats: Repeats
    disturbed: Disturbances


def analyse_untouched(
    frames: Sequence[TactileFrame], max_count: int, allowed_drift: float, known_noise: float = 0.0
) -> UntouchedStatistics | None:
    """Look at frames of an array that nothing touches; None if they are too few.

    `known_noise` (counts): as it was calibrated, 0 if it was not.

    A taxel drifts for certain if a straight line through the means of a dozen stretches is steeper than
    `allowed_drift` (counts/s) by six times its error. The error comes from how far the means lie off the
    line, of this taxel or in the median, which noise of any colour moves.
    """
    if len(frames) < _MIN_FRAMES:
        return None
    counts = np.stack([frame.counts for frame in frames]).astype(float)
    times = np.array([frame.device_time_s for frame in frames])
    mean, spread = counts.mean(axis=0), counts.std(axis=0)
    hot = mean >= _HOT_SHARE * max_count
    moving = spread > 0
    noise = float(np.median(spread[moving & ~hot])) if (moving & ~hot).any() else 0.0
    still = ~moving & ~hot
    certain = noise > 0 and math.erf(0.5 / (noise * math.sqrt(2))) ** len(frames) < _MAX_DEAD_CHANCE
    low = still & (mean == 0)
    dead = (still & certain & ~low) | (
        low & (np.median(mean) > 4 * max(noise, 1.0))
    )  # others rest well above
    live = ~(dead | hot)
    slope, error = _slopes(counts, times, max(noise, _MIN_NOISE_COUNTS))
    unsteady = live & (_frame_noise(counts) > _UNSTEADY_RATIO * max(noise, _MIN_NOISE_COUNTS))
    beyond = live & ~unsteady & (np.abs(slope) - allowed_drift > _DRIFT_SIGMAS * error)
    fastest = float(np.abs(slope)[beyond].max()) if beyond.any() else 0.0
    return UntouchedStatistics(
        dead,
        dead & low,
        hot,
        unsteady,
        noise,
        fastest,
        int(beyond.sum()),
        certain,
        count_repeats(frames, known_noise),
        find_disturbances(counts, live, max_count),
    )


def _frame_noise(counts: Floats) -> Floats:
    """Noise from one frame to the next, which drift does not move: (rows, cols) standard deviation."""
    result: Floats = np.diff(counts, axis=0).std(axis=0) / math.sqrt(2)
    return result


def _slopes(counts: Floats, times: Floats, noise: float) -> tuple[Floats, Floats]:
    """Slope of each taxel (counts/s) and its standard error, by the means of stretches."""
    parts = np.array_split(np.arange(len(times)), _DRIFT_STRETCHES)
    means = np.stack([counts[part].mean(axis=0) for part in parts])
    at = np.array([times[part].mean() for part in parts])
    off = at - at.mean()
    along = float((off**2).sum())
    slope: Floats = np.tensordot(off, means, axes=1) / along
    rest = means - means.mean(axis=0) - off[:, None, None] * slope
    variance = (rest**2).sum(axis=0) / (_DRIFT_STRETCHES - 2)
    # A taxel's own ten degrees of freedom are too few: in one of ten thousand chance makes them too small.
    least = max(noise**2 * _DRIFT_STRETCHES / len(times), float(np.median(variance)))
    error: Floats = np.sqrt(np.maximum(variance, least) / along)
    return slope, error


@dataclass(frozen=True, eq=False)
class UntouchedArray:
    """An array that fits the rig file, and what its frames show."""

    seen: ExaminedArray
    shown: UntouchedStatistics | None
    known_bad: frozenset[tuple[int, int]]


def look_at_untouched(item: ExaminedArray) -> UntouchedArray:
    """Look at an array that introduced itself, and was listened to."""
    assert item.description is not None, "it introduced itself"
    taxels = item.spec.array.taxels
    known = frozenset() if taxels is None else frozenset(taxels.unusable)
    noise = 0.0 if taxels is None else taxels.noise_counts
    drift = item.spec.array.drift_counts_per_s
    shown = analyse_untouched(item.frames, item.description.max_count, drift, noise)
    return UntouchedArray(item, shown, known)
