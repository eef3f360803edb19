"""Examination of tactile arrays, untouched: identity, self-test, and the stream of frames.

An array that is silent is looked for at other baud rates and with other protocols. Each is left as after
`connect`, and stopped. What is judged for `doctor` is in `array_steps`; whether frames come often enough,
and whether too many get lost, is one criterion for `check`, `doctor` and the tests of a real rig.
"""

from collections.abc import Collection, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import cast

from serial.serialutil import SerialBase

from palpate.base.errors import DeviceError, PalpateError, quantity
from palpate.config import FingerConfig, RigFile
from palpate.config.diagnosis_results import ArrayCheckOut
from palpate.config.rig_fingers import PALPATE_PROTOCOL, SHIPPED_PROTOCOLS, ArrayConfig
from palpate.drivers.tactile import (
    ArrayCounters,
    ArrayDriver,
    ArrayExchange,
    BadTaxel,
    ContactExtractor,
    Describe,
    Description,
    Hello,
    Port,
    SelfTestReport,
    SelfTestResult,
    TactileArray,
    TactileFrame,
)
from palpate.drivers.transport import Clock, has_baudrate, latency_timer_s
from palpate.rig.arrays import (
    array_of,
    array_plugin,
    calibration_of,
    doubt_warning,
    pad_problem,
    shape_warning,
    threshold_problem,
)
from palpate.rig.diagnostics.host_ports import timer_warnings
from palpate.rig.diagnostics.steps import DiagnosisCase
from palpate.rig.motion.hand import OpenPort

_MIN_RATE_SHARE = 0.95  # of the wanted rate: arrays have clocks of their own
_MAX_LOST_SHARE = 0.005


def frame_rate_hz(frames: Sequence[TactileFrame]) -> float:
    """Frames that arrive in a second of the array's own clock; 0 for fewer than two."""
    if len(frames) < 2:
        return 0.0
    span_s = frames[-1].device_time_s - frames[0].device_time_s
    return (len(frames) - 1) / span_s if span_s > 0 else 0.0


def is_rate_too_low(rate_hz: float, wanted_hz: float) -> bool:
    """Whether that is less than 95 % of what was asked for."""
    return rate_hz < _MIN_RATE_SHARE * wanted_hz


def lost_frames(begin: ArrayCounters, end: ArrayCounters) -> int:
    """Frames that never came, or came damaged, from `begin` on: not what boards send while they start."""
    return (end.lost - begin.lost) + (end.faults - begin.faults) + (end.misshapen - begin.misshapen)


def is_loss_too_high(gone: int, came: int) -> bool:
    """Whether more than 0.5 % of the frames are gone, and more than one."""
    return gone > 1 and gone > _MAX_LOST_SHARE * (came + gone)


_CHECK_LISTEN_S = 1.0
_POLL_S = 0.02
_MAX_TAXELS_NAMED = 6


def check_array(rig: RigFile, spec: FingerConfig, clock: Clock, open_port: OpenPort) -> ArrayCheckOut:
    """Run the self-test of a finger's array, if it has one, and judge rate and noise of a second's frames."""
    timer = latency_timer_s(spec.array.port)
    blank = ArrayCheckOut(
        finger=spec.name,
        port=spec.array.port,
        protocol=spec.array.protocol,
        answers=False,
        wanted_hz=rig.closing.sample_rate_hz,
        latency_timer_ms=None if timer is None else timer * 1e3,
        warnings=tuple(timer_warnings(spec.array.port, timer)),
    )
    try:
        port = open_port(spec.array.port, spec.array.baudrate_bps)
    except DeviceError as error:
        return _with_problems(blank, str(error))
    array = array_of(spec, port, clock)
    try:
        description = array.connect()
        found = _with_self_test(_with_description(blank, description), array, _known_bad_taxels(spec))
        before = array.counters
        frames = _stream_frames(found, array, clock)
        found = _with_rate(found, frames, lost_frames(before, array.counters))
        if frames and not found.problems:
            extractor = ContactExtractor(description, calibration_of(rig, spec, description))
            extractor.tare(frames)
            wrong = pad_problem(spec, description) or threshold_problem(extractor, rig.closing, spec.tip)
            found = found if wrong is None else _with_problems(found, wrong)
            for warning in (shape_warning(spec, description), doubt_warning(rig, spec, extractor)):
                if warning is not None:
                    found = found.model_copy(update={"warnings": (*found.warnings, warning)})
    except DeviceError as error:
        return _with_problems(blank, str(error))
    finally:
        port.close()
    return found


def _with_description(out: ArrayCheckOut, description: Description) -> ArrayCheckOut:
    return out.model_copy(
        update={
            "answers": True,
            "firmware": description.firmware,
            "unique_id": description.unique_id.hex(),
            "emulated": description.emulated,
            "shape": description.shape.name.lower(),
            "rows": description.rows,
            "columns": description.cols,
        }
    )


def _with_self_test(
    out: ArrayCheckOut, array: ArrayDriver, known: Collection[tuple[int, int]]
) -> ArrayCheckOut:
    """With what the array finds in itself; as it was if it cannot examine anything.

    `known`: taxels (row, column) that calibration has left out already.
    """
    if not isinstance(array, TactileArray):
        return out
    try:
        report = array.self_test_if_known()
    except DeviceError as error:
        return _with_problems(out, str(error))
    if report is None:
        return out
    found = out.model_copy(update={"bad_taxels": report.bad_count})
    if 0 < report.bad_count == len(report.bad) and all((bad.row, bad.col) in known for bad in report.bad):
        taxels = quantity(report.bad_count, "bad taxel", "bad taxels")
        left_out = f"{taxels}, known to its calibration and left out"
        found = found.model_copy(update={"warnings": (*found.warnings, left_out)})
        return _with_problems(found, *_self_test_problems(report, taxels=False))
    return _with_problems(found, *_self_test_problems(report, taxels=True))


def _known_bad_taxels(spec: FingerConfig) -> Collection[tuple[int, int]]:
    """Taxels that the calibration has left out."""
    return () if spec.array.taxels is None else spec.array.taxels.unusable


def _self_test_problems(report: SelfTestReport, *, taxels: bool) -> list[str]:
    """What a self-test found, in words; of its taxels only if asked."""
    parts = [str(part.name).replace("_", " ").lower() for part in SelfTestResult if part in report.result]
    parts = [part for part in parts if part != "taxels"]
    if int(report.result) & ~sum(SelfTestResult):
        parts.append(f"what its maker calls {int(report.result):#06x}")
    said = []
    if parts:
        said.append(f"its self-test finds fault with its {' and '.join(parts)}; repair or replace it")
    if report.bad_count and taxels:
        named = ", ".join(map(_taxel, report.bad[:_MAX_TAXELS_NAMED]))
        more = "" if report.bad_count <= _MAX_TAXELS_NAMED else ", …"
        bad = quantity(report.bad_count, "bad taxel", "bad taxels")
        said.append(f"its self-test finds {bad} ({named}{more}); repair or replace it")
    return said


def _taxel(bad: BadTaxel) -> str:
    return f"row {bad.row} column {bad.col} {bad.fault.name.replace('_', ' ').lower()}"


def _stream_frames(out: ArrayCheckOut, array: ArrayDriver, clock: Clock) -> list[TactileFrame]:
    """The frames of a second."""
    try:
        array.start(out.wanted_hz)
        return record_frames(array, clock, _CHECK_LISTEN_S)
    finally:
        array.stop()


def _with_rate(out: ArrayCheckOut, frames: Sequence[TactileFrame], gone: int) -> ArrayCheckOut:
    """With the rate of a second's frames; `gone` ones are lost or damaged."""
    rate = frame_rate_hz(frames)
    heard = out.model_copy(update={"rate_hz": rate, "lost": gone})
    if not frames:
        return _with_problems(heard, "it sends no frames; power it off and on, then check its firmware")
    if is_loss_too_high(gone, len(frames)):
        all_frames = f"{gone} of {gone + len(frames)} frames were lost or damaged"
        return _with_problems(heard, f"{all_frames}; plug it into the computer directly, with another cable")
    if not is_rate_too_low(rate, out.wanted_hz):
        return heard
    slow = f"{rate:.0f} frames arrive in a second instead of {out.wanted_hz:g}; check its cable and port"
    return heard.model_copy(update={"warnings": (*heard.warnings, slow)})


def _with_problems(out: ArrayCheckOut, *problems: str) -> ArrayCheckOut:
    return out.model_copy(update={"problems": (*out.problems, *problems)})


def record_frames(array: ArrayDriver, clock: Clock, seconds: float) -> list[TactileFrame]:
    """The frames that a streaming array sends in some seconds. Raises DeviceError if it goes away."""
    frames: list[TactileFrame] = []
    end = clock.now() + seconds
    while clock.now() < end:
        clock.sleep(_POLL_S)
        frames += array.frames()
    return frames


LISTEN_S = 3.0
"""How long an array is listened to, untouched."""

_BAUDRATES_TO_TRY = (115_200, 230_400, 460_800, 500_000, 921_600, 1_000_000, 2_000_000, 3_000_000)
_HELLO_TIMEOUT_S = 0.3
_HELLO_TRIES = 2


@dataclass(frozen=True, eq=False)
class ExaminedArray:
    """An array: what it says of itself, and its frames of `LISTEN_S`.

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
    def name(self) -> str:
        """How findings call it."""
        return f"array {self.spec.name}"


def examine_arrays(case: DiagnosisCase, usable: frozenset[str]) -> list[ExaminedArray]:
    """Look at the arrays whose ports are usable, one after the other."""
    return [_examine_array(case, spec) for spec in case.rig.fingers if spec.array.port in usable]


def _examine_array(case: DiagnosisCase, spec: FingerConfig) -> ExaminedArray:
    case.tell(f"array of finger {spec.name}")
    clock = case.place.clock
    try:
        port = case.place.open_other(spec.array.port, spec.array.baudrate_bps)
    except DeviceError as error:
        return ExaminedArray(spec, failure=str(error))
    try:
        array = array_of(spec, port, clock)
        try:
            description = array.connect()
        except DeviceError as error:
            return _unknown(case, spec, port, str(error))
        return _listen_untouched(case, spec, array, description)
    finally:
        with suppress(Exception):
            port.close()


def _listen_untouched(
    case: DiagnosisCase, spec: FingerConfig, array: ArrayDriver, description: Description
) -> ExaminedArray:
    """An array that has introduced itself, listened to."""
    report, frames, broken, before = None, [], None, array.counters
    try:
        report = array.self_test_if_known() if isinstance(array, TactileArray) else None
        case.tell(f"listening to array of finger {spec.name}")
        before = array.counters
        frames = _stream(case, array)
    except DeviceError as error:
        broken = str(error)
    return ExaminedArray(
        spec,
        description,
        report=report,
        frames=tuple(frames),
        lost=lost_frames(before, array.counters),
        broken=broken,
    )


def _stream(case: DiagnosisCase, array: ArrayDriver) -> list[TactileFrame]:
    try:
        array.start(case.rig.closing.sample_rate_hz)
        return record_frames(array, case.place.clock, LISTEN_S)
    finally:
        with suppress(DeviceError):  # what ended the stream says more
            array.stop()


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
    """Whether palpate's own protocol is answered, and whether anything is heard. Raises DeviceError."""
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
