"""Check of one tactile array: identity, self-test, and rate of frames.

The array is left as after `connect`, and stopped.
"""

from collections.abc import Collection, Sequence

from palpate.base.errors import DeviceError, counted
from palpate.config import FingerConfig, RigFile
from palpate.config.check_result import ArrayCheckOut
from palpate.drivers.tactile.array import TactileArray
from palpate.drivers.tactile.contact import ContactExtractor
from palpate.drivers.tactile.frames import ArrayDriver, TactileFrame
from palpate.drivers.tactile.messages import BadTaxel, Description, SelfTestReport, SelfTestResult
from palpate.drivers.transport.adapter import latency_timer_s
from palpate.drivers.transport.clock import Clock
from palpate.rig.arrays import (
    array_of,
    calibration_of,
    doubt_warning,
    pad_problem,
    shape_warning,
    threshold_problem,
)
from palpate.rig.diagnostics.frame_stream import comes_too_seldom, frame_rate_hz, frames_gone, loses_too_many
from palpate.rig.diagnostics.latency_timer import timer_warnings
from palpate.rig.motion.hand import OpenPort

__all__ = ["check_array", "listen"]

_LISTEN_S = 1.0
_POLL_S = 0.02
_TAXELS_NAMED = 6


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
        return _wrong(blank, str(error))
    array = array_of(spec, port, clock)
    try:
        description = array.connect()
        found = _examined(_introduced(blank, description), array, _left_out(spec))
        before = array.counters
        frames = _streamed(found, array, clock)
        found = _with_rate(found, frames, frames_gone(before, array.counters))
        if frames and not found.problems:
            extractor = ContactExtractor(description, calibration_of(rig, spec, description))
            extractor.tare(frames)
            wrong = pad_problem(spec, description) or threshold_problem(extractor, rig.closing, spec.tip)
            found = found if wrong is None else _wrong(found, wrong)
            for warning in (shape_warning(spec, description), doubt_warning(rig, spec, extractor)):
                if warning is not None:
                    found = found.model_copy(update={"warnings": (*found.warnings, warning)})
    except DeviceError as error:
        return _wrong(blank, str(error))
    finally:
        port.close()
    return found


def _introduced(out: ArrayCheckOut, description: Description) -> ArrayCheckOut:
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


def _examined(out: ArrayCheckOut, array: ArrayDriver, known: Collection[tuple[int, int]]) -> ArrayCheckOut:
    """With what the array finds in itself; as it was if it cannot examine anything.

    `known`: taxels (row, column) that calibration has left out already.
    """
    if not isinstance(array, TactileArray):
        return out
    try:
        report = array.self_test_if_known()
    except DeviceError as error:
        return _wrong(out, str(error))
    if report is None:
        return out
    found = out.model_copy(update={"bad_taxels": report.bad_count})
    if 0 < report.bad_count == len(report.bad) and all((bad.row, bad.col) in known for bad in report.bad):
        taxels = counted(report.bad_count, "bad taxel", "bad taxels")
        left_out = f"{taxels}, known to its calibration and left out"
        found = found.model_copy(update={"warnings": (*found.warnings, left_out)})
        return _wrong(found, *_complaints(report, taxels=False))
    return _wrong(found, *_complaints(report, taxels=True))


def _left_out(spec: FingerConfig) -> Collection[tuple[int, int]]:
    """Taxels that the calibration has left out."""
    return () if spec.array.taxels is None else spec.array.taxels.unusable


def _complaints(report: SelfTestReport, *, taxels: bool) -> list[str]:
    """What a self-test found, in words; of its taxels only if asked."""
    parts = [str(part.name).replace("_", " ").lower() for part in SelfTestResult if part in report.result]
    parts = [part for part in parts if part != "taxels"]
    if int(report.result) & ~sum(SelfTestResult):
        parts.append(f"what its maker calls {int(report.result):#06x}")
    said = []
    if parts:
        said.append(f"its self-test finds fault with its {' and '.join(parts)}; repair or replace it")
    if report.bad_count and taxels:
        named = ", ".join(map(_taxel, report.bad[:_TAXELS_NAMED]))
        more = "" if report.bad_count <= _TAXELS_NAMED else ", …"
        bad = counted(report.bad_count, "bad taxel", "bad taxels")
        said.append(f"its self-test finds {bad} ({named}{more}); repair or replace it")
    return said


def _taxel(bad: BadTaxel) -> str:
    return f"row {bad.row} column {bad.col} {bad.fault.name.replace('_', ' ').lower()}"


def _streamed(out: ArrayCheckOut, array: ArrayDriver, clock: Clock) -> list[TactileFrame]:
    """The frames of a second."""
    try:
        array.start(out.wanted_hz)
        return listen(array, clock, _LISTEN_S)
    finally:
        array.stop()


def _with_rate(out: ArrayCheckOut, frames: Sequence[TactileFrame], gone: int) -> ArrayCheckOut:
    """With the rate of a second's frames; `gone` ones are lost or damaged."""
    rate = frame_rate_hz(frames)
    heard = out.model_copy(update={"rate_hz": rate, "lost": gone})
    if not frames:
        return _wrong(heard, "it sends no frames; power it off and on, then check its firmware")
    if loses_too_many(gone, len(frames)):
        all_frames = f"{gone} of {gone + len(frames)} frames were lost or damaged"
        return _wrong(heard, f"{all_frames}; plug it into the computer directly, with another cable")
    if not comes_too_seldom(rate, out.wanted_hz):
        return heard
    slow = f"{rate:.0f} frames arrive in a second instead of {out.wanted_hz:g}; check its cable and port"
    return heard.model_copy(update={"warnings": (*heard.warnings, slow)})


def _wrong(out: ArrayCheckOut, *problems: str) -> ArrayCheckOut:
    return out.model_copy(update={"problems": (*out.problems, *problems)})


def listen(array: ArrayDriver, clock: Clock, seconds: float) -> list[TactileFrame]:
    """The frames that a streaming array sends in some seconds. Raises DeviceError if it goes away."""
    frames: list[TactileFrame] = []
    end = clock.now() + seconds
    while clock.now() < end:
        clock.sleep(_POLL_S)
        frames += array.frames()
    return frames
