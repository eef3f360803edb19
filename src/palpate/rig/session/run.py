"""A run from the first port to the answer: used by `identify` on devices and by `replay` on a recording.

Where an emulated part really was is an event of the log: an engine moves the part, and a replay has none.

*Replay.* A replay ends in one of three ways: as recorded, at the first difference, or where a log was cut
off.
"""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

from pydantic import BaseModel, ValidationError

from palpate.base.errors import InputError, PalpateError
from palpate.base.short_repr import ShortRepr
from palpate.base.vocabulary import Strategy
from palpate.config import CalibrationFile, RigFile
from palpate.config.fields import Number
from palpate.drivers.dynamixel import Instruction
from palpate.drivers.transport import RecordEnded, Replayer
from palpate.recognizer import Configuration
from palpate.rig.emulated.scene import Placement
from palpate.rig.identification.doubt import doubt_set_up
from palpate.rig.identification.events import Event, Observer, Observers, StageEvent
from palpate.rig.identification.identify import identify
from palpate.rig.identification.result import IdentificationJob, IdentificationRun, Truth, WiringProof
from palpate.rig.identification.rig_recognition import own_choice
from palpate.rig.motion.guarded_approach import GripPhase
from palpate.rig.motion.hand import Environment, Hand
from palpate.rig.motion.press import check_slips, slides_at_stops
from palpate.rig.session.calibration_drift import arrays_of, calibration_used, check_devices
from palpate.rig.session.log import SessionEvents, json_value
from palpate.rig.session.log_reader import SessionFile
from palpate.rig.workers import BackgroundCall

TRUTH_EVENT = "truth"


class _ConfigurationText(BaseModel):
    x_mm: Number
    y_mm: Number
    theta_rad: Number

    def value(self) -> Configuration:
        return Configuration(self.x_mm, self.y_mm, self.theta_rad)


class _PartTruthText(BaseModel):
    configuration: _ConfigurationText
    at_measurement: list[_ConfigurationText]


class _TruthText(_PartTruthText):
    others: list[_PartTruthText] = []


def recorded_truth(file: SessionFile, placements: Sequence[Placement]) -> Truth | None:
    """The truth that a session's log holds; None if it was recorded before logs held it.

    `placements`: what lay on the table and where it was put. Raises InputError for an event that palpate does
    not write.
    """
    events = file.told(TRUTH_EVENT)
    if not events:
        return None
    try:
        text = _TruthText.model_validate(events[-1])
    except ValidationError:
        raise InputError(
            f'{file.path}: the event "{TRUTH_EVENT}" must have a configuration and the list at_measurement'
        ) from None
    parts = [text, *text.others]
    if len(parts) != len(placements):
        raise InputError(
            f'{file.path}: the event "{TRUTH_EVENT}" has {len(parts)} parts; {len(placements)} were put there'
        )
    moved = tuple(
        replace(lies, x_mm=at.x_mm, y_mm=at.y_mm, theta_rad=at.theta_rad)
        for lies, at in zip(placements, (part.configuration for part in parts), strict=True)
    )
    return Truth(moved, [[item.value() for item in part.at_measurement] for part in parts])


@contextmanager
def prepared_hand(
    environment: Environment,
    rig: RigFile,
    calibration: CalibrationFile | None,
    proof: WiringProof | None,
    notice: Callable[[str], None],
) -> Iterator[Hand]:
    """A hand that is connected, found to be the one that was calibrated and proven, and ready for grips.

    Torque is off when the block is left, by whatever way. Raises what `identify` raises.
    """
    with environment.hand(rig, notice) as hand:
        check_devices(calibration, hand)
        if proof is not None and not hand.emulated:
            proof.check(arrays_of(hand))
        hand.prepare()
        at_stops = slides_at_stops(hand) if rig.search.check_slips else {}
        yield hand
        if at_stops:
            check_slips(hand, at_stops)


def run_identification(
    job: IdentificationJob,
    environment: Environment,
    record: Observer | None = None,
    observers: Sequence[Observer] = (),
    notice: Callable[[str], None] = lambda _: None,
    placements_now: Callable[[], tuple[Placement, ...]] | None = None,
) -> IdentificationRun:
    """Connect, identify, disconnect. `notice` is told what the operator should do now.

    `record` is told on this thread, in step with ports and clock; `observers` and `notice` beside it.
    `placements_now`: how parts on an emulated table lie now, in the answer's frame; None: as they were put.
    Raises what `identify` raises; torque is off then, too.
    """
    lie = placements_now or (lambda: job.placements)
    at_measurement: list[list[Configuration]] = [[] for _ in job.placements]

    def in_step(event: Event) -> None:
        if isinstance(event, StageEvent) and event.stage is GripPhase.RETRACTING:
            for trace, placement in zip(at_measurement, lie(), strict=True):
                trace.append(placement.configuration)
        if record is not None:
            record(event)

    with (
        Observers(observers, in_step) as observed,
        BackgroundCall("the display", notice) as notice_beside,
        prepared_hand(environment, job.rig, job.calibration, job.proof, notice_beside) as hand,
    ):
        chosen = job.strategy
        own = None if isinstance(chosen, Strategy) else own_choice(chosen)
        named = chosen if isinstance(chosen, Strategy) else Strategy.PLANNED
        result = identify(
            hand, job.catalogue, observed, strategy=named, seed=job.seed, own=own, parts=job.parts
        )
        emulated, noted = hand.emulated, hand.checks.noted
    notices = tuple(noted)
    late = observed.late_failure or notice_beside.late_failure
    placements = lie()
    truth = Truth(placements, at_measurement if placements_now else None) if placements else None
    used = None
    if job.calibration is not None and job.started is not None and result.table is None:
        used = calibration_used(result, job.rig, job.calibration, job.started)
    doubts = doubt_set_up(job.rig, job.catalogue, result) if result.table is None else ()
    return IdentificationRun(
        job, result, emulated, environment.clock.now(), truth, used, late, doubts, notices
    )


_PACKET_HEADER = b"\xff\xff\xfd\x00"
_RESULT_TOLERANCE = (
    2e-6  # results are rounded to 1e-6, and another machine may round the last digit the other way
)
_NOT_COMPARED = ("wall_seconds", "session")
_RENAMED_KEYS = {"foretold": "predicted", "unnoticed_shift": "detectable_shift"}  # keys of older results
_LATER_KEYS = frozenset(
    {
        "loads",
        "touch_records",
        "motion_bounds",
        "assumed_holds_n",
        "hold_contradicted",
        "stranger_probability",
        "points",
        "pressed_mm",
        "loaded_mm",
        "setup_doubts",
        "notices",
        "goal_met",
        "limit",
        "contradictions",
        "altered_probability",
        "narrower_without",
        "parts",
        "table",
    }
)  # not written by older versions


@dataclass(frozen=True, eq=False, repr=False)
class Replayed(ShortRepr):
    """Result of a replay. `difference` is None if all was as recorded; `run` if it gave no answer."""

    lines: int
    sent_bytes: int
    received_bytes: int
    difference: str | None
    complete: bool
    run: IdentificationRun | None


def replay(file: SessionFile, job: IdentificationJob, latency_s: float) -> Replayed:
    """Run an `identify` again; `latency_s` is what the bus's adapter was allowed then.

    Raises only what comes from outside of the recording, a new interrupt, and InputError for a recorded truth
    that palpate does not write.
    """
    truth = recorded_truth(file, job.placements) if job.placements else None

    def again(replayer: Replayer, events: SessionEvents) -> IdentificationRun:
        run = run_identification(job, Environment(replayer.clock, replayer.open, latency_s), events)
        if truth is not None:
            events.event(TRUTH_EVENT, **file.told(TRUTH_EVENT)[-1])
            run = replace(run, truth=truth)
        out = run.out(wall_seconds=0.0, session=None)
        events.event("result", result=out.model_dump(mode="json"))
        return run

    return replay_with(file, job.rig.bus.port, again)


def replay_with(
    file: SessionFile, bus: str, again: Callable[[Replayer, SessionEvents], IdentificationRun | None]
) -> Replayed:
    """Run `again` against a recording and compare how it ends; `bus` is the port that speaks Dynamixel."""
    replayer = Replayer(file.entries, lambda port, data: _packet_in_words(data) if port == bus else "")
    run, how, message = None, "done", None
    try:
        run = again(replayer, _Compared(replayer))
    except BaseException as error:
        if not isinstance(error, Exception) and error is not replayer.interrupt:
            raise  # somebody wants this replay to end
        how, message = type(error).__name__, str(error)
    if replayer.failure is None:
        _compare_ends(replayer, how, message)
    failure = replayer.failure
    differs = failure is not None and not isinstance(failure, RecordEnded)
    return Replayed(
        lines=replayer.lines,
        sent_bytes=replayer.sent_bytes,
        received_bytes=replayer.received_bytes,
        difference=str(failure) if differs else None,
        complete=failure is None,
        run=run,
    )


class _Compared(SessionEvents):
    """Compares events of the run with those of the recording."""

    def __init__(self, replayer: Replayer) -> None:
        self._replayer = replayer

    def event(self, kind: str, /, **values: object) -> None:
        """Raise ReplayDiffers if the recording has another event now, or other values in it."""
        recorded = self._replayer.session_event(kind)
        if kind == "result":
            recorded = {"result": _with_present_names(recorded.get("result"))}
        found = first_difference(_without_later_keys(json_value(values), recorded), recorded, "")
        if found is not None:
            self._replayer.differ(f'"{kind}" differs: {found}')


def _with_present_names(result: Any) -> Any:
    """A recorded result in the words of today's; `units` was not written by older versions."""
    if not isinstance(result, Mapping):
        return result
    return {"units": "mm, rad"} | {_RENAMED_KEYS.get(key, key): value for key, value in result.items()}


def _without_later_keys(found: Any, recorded: Any) -> Any:
    """The values of this run without those that an older recording does not have."""
    if isinstance(found, dict) and isinstance(recorded, Mapping):
        kept = {key: value for key, value in found.items() if key in recorded or key not in _LATER_KEYS}
        return {key: _without_later_keys(value, recorded.get(key)) for key, value in kept.items()}
    if isinstance(found, list) and isinstance(recorded, list) and len(found) == len(recorded):
        return [_without_later_keys(*pair) for pair in zip(found, recorded, strict=True)]
    return found


def _compare_ends(replayer: Replayer, how: str, message: str | None) -> None:
    try:
        recorded = replayer.ends()
        if (how, message) != (recorded["how"], recorded.get("message")):
            replayer.differ(
                f"the run ends {_end_in_words(how, message)}; "
                f"recorded: {_end_in_words(recorded['how'], recorded.get('message'))}"
            )
    except PalpateError:
        return  # the replayer keeps it


def _end_in_words(how: str, message: str | None) -> str:
    return f"as {how}" + (f" ({message})" if message else "")


def first_difference(found: Any, recorded: Any, place: str) -> str | None:
    """Say where two JSON values first differ; numbers may differ by 2e-6, absolutely or relatively."""
    if isinstance(found, dict) and isinstance(recorded, Mapping):
        keys = [key for key in (*found, *(set(recorded) - set(found))) if key not in _NOT_COMPARED]
        pairs = [(found.get(key), recorded.get(key), f"{place}.{key}" if place else key) for key in keys]
        return next((told for pair in pairs if (told := first_difference(*pair))), None)
    if isinstance(found, list) and isinstance(recorded, list):
        if len(found) != len(recorded):
            return f"{place} has {len(found)} values, recorded {len(recorded)}"
        rows = enumerate(zip(found, recorded, strict=True))
        return next((told for k, (a, b) in rows if (told := first_difference(a, b, f"{place}[{k}]"))), None)
    numbers = [isinstance(item, int | float) and not isinstance(item, bool) for item in (found, recorded)]
    if all(numbers) and isinstance(found, float) | isinstance(recorded, float):
        same = math.isclose(found, recorded, rel_tol=_RESULT_TOLERANCE, abs_tol=_RESULT_TOLERANCE)
    else:
        same = type(found) is type(recorded) and bool(found == recorded)
    return None if same else f"{place} is {found!r:.60}, recorded {recorded!r:.60}"


def _packet_in_words(data: bytes) -> str:
    """Instruction and id of a Dynamixel packet, also of a damaged one; "" if it is none."""
    if len(data) < 8 or not data.startswith(_PACKET_HEADER):
        return ""
    names = {int(item): item.name.replace("_", " ").lower() for item in Instruction}
    return f"{names.get(data[7], f'instruction 0x{data[7]:02x}')} to id {data[4]}"
