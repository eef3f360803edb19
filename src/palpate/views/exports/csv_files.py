"""CSV export of a session: one file for each topic, a line for each sample, time first."""

import csv
import json
import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any, TextIO

from palpate.base.errors import InputError, OutputError
from palpate.recognizer import Contact, NormalRange
from palpate.rig.session.logged_values import LoggedHypothesis, LoggedTouch, hypotheses_in, touches_in
from palpate.rig.session.recorded_session import (
    EventSample,
    FrameSample,
    Sample,
    ServoSample,
    SessionSamples,
    TipSample,
)

_Row = list[object]

_SERVOS = (
    "t_s",
    "joint",
    "dxl_id",
    "position_rad",
    "velocity_rad_s",
    "current_a",
    "torque_on",
    "hardware_error",
)
_TIPS = ("t_s", "finger", "x_mm", "y_mm")
_EVENTS = ("t_s", "event", "values_json")
_CONTACTS = (
    "t_s",
    "grip",
    "finger",
    "touched",
    "x_mm",
    "y_mm",
    "position_bound_mm",
    "normal_lo_rad",
    "normal_hi_rad",
    "force_n",
)
_HYPOTHESES = (
    "t_s",
    "grip",
    "verdict",
    "object",
    "state",
    "weight",
    "verified",
    "x_mm",
    "y_mm",
    "theta_rad",
    "x_lo_mm",
    "x_hi_mm",
    "y_lo_mm",
    "y_hi_mm",
    "theta_lo_rad",
    "theta_hi_rad",
    "part",
)


def write_csv(samples: SessionSamples, folder: Path) -> dict[str, int]:
    """Write every topic into `folder`, which is made; the number of lines of each file, without its header.

    Raises InputError if there is something in the folder, OutputError if it cannot be written.
    """
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise InputError(f"{folder} is there already: choose another folder, or remove it")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with ExitStack() as stack:
            files = _Files(folder, stack)
            for sample in samples:
                for topic, header, row in _rows(sample):
                    files.write(topic, header, row)
            return files.counts
    except OSError as error:
        raise OutputError(f"{folder} cannot be written: {error.strerror}") from error


class _Files:
    """Opens a file with the first row of its topic."""

    def __init__(self, folder: Path, stack: ExitStack) -> None:
        self.counts: dict[str, int] = {}
        self._folder, self._stack = folder, stack
        self._writers: dict[str, Callable[[Iterable[object]], object]] = {}

    def write(self, topic: str, header: Callable[[], Iterable[str]], row: _Row) -> None:
        name = f"{topic}.csv"
        if name not in self._writers:
            file: TextIO = (self._folder / name).open("w", newline="", encoding="utf-8")
            self._writers[name] = csv.writer(self._stack.enter_context(file), lineterminator="\n").writerow
            self._writers[name](header())
            self.counts[name] = 0
        self._writers[name](row)
        self.counts[name] += 1


def _rows(sample: Sample) -> Iterator[tuple[str, Callable[[], Iterable[str]], _Row]]:
    match sample:
        case ServoSample():
            yield "servos", lambda: _SERVOS, [getattr(sample, name) for name in _SERVOS]
        case TipSample():
            yield "tips", lambda: _TIPS, [getattr(sample, name) for name in _TIPS]
        case FrameSample():
            frame = sample.frame
            row: _Row = [sample.t_s, frame.sequence, frame.device_time_s, *frame.counts.ravel().tolist()]
            yield f"array-{sample.finger}", lambda: _taxel_names(sample), row
        case EventSample(t_s, kind, values):
            yield "events", lambda: _EVENTS, [t_s, kind, json.dumps(_drop_traces(values))]
            if kind == "touches":
                for touch in touches_in(values):
                    for place in touch.places:
                        yield "contacts", lambda: _CONTACTS, _contact(t_s, touch, place)
            if kind in ("recognised", "result"):
                answer = values if kind == "recognised" else values["result"]
                start = [t_s, values.get("grip"), answer["verdict"]]
                for item in hypotheses_in(kind, values):
                    yield "hypotheses", lambda: _HYPOTHESES, [*start, *_hypothesis(item)]


def _drop_traces(values: Mapping[str, Any]) -> Mapping[str, Any]:
    """Loads over time, thousands of numbers, are more than readers of CSV take in one field."""
    if "touches" not in values:
        return values
    touches = [{name: item for name, item in touch.items() if name != "trace"} for touch in values["touches"]]
    return {**values, "touches": touches}


def _taxel_names(sample: FrameSample) -> list[str]:
    rows, columns = sample.frame.counts.shape
    taxels = [f"taxel_{row}_{column}" for row in range(rows) for column in range(columns)]
    return ["t_s", "sequence", "device_time_s", *taxels]


def _contact(t_s: float, touch: LoggedTouch, contact: Contact) -> _Row:
    """A row for one of the places that were touched; the force is all of the touch's strongest patch."""
    return [
        t_s,
        touch.grip,
        contact.name,
        contact.touched,
        *contact.end_mm,
        contact.position_bound_mm,
        *_directions(contact.normal),
        touch.force_n,
    ]


def _directions(normal: NormalRange | None) -> tuple[float | None, float | None]:
    """The ends of a range of normals; the middle between −π and π."""
    if normal is None:
        return None, None
    turns = math.tau * round((normal.lo_rad + normal.hi_rad) / 2 / math.tau)
    return normal.lo_rad - turns, normal.hi_rad - turns


def _hypothesis(item: LoggedHypothesis) -> _Row:
    at, bounds = item.configuration, item.bounds
    return [
        item.object,
        item.state,
        item.weight,
        item.verified,
        *(at.x_mm, at.y_mm, at.theta_rad),
        *(*bounds.x_mm, *bounds.y_mm, *bounds.theta_rad),
        item.part,
    ]
