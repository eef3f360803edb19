"""Replay of a recorded session: the same code runs against the recording.

A replay ends in one of three ways: as recorded, at the first difference, or where a log was cut off.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

from palpate.base.errors import PalpateError
from palpate.base.short_repr import ShortRepr
from palpate.drivers.dynamixel import Instruction
from palpate.drivers.transport import RecordEnded, Replayer
from palpate.rig.identification.result import IdentificationJob, IdentificationRun
from palpate.rig.motion.hand import Environment
from palpate.rig.session.log import SessionEvents, json_value
from palpate.rig.session.log_reader import SessionFile
from palpate.rig.session.run import TRUTH_EVENT, recorded_truth, run_identification

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
    truth = None if job.placement is None else recorded_truth(file, job.placement)

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
