"""Frames of the live view: the data that its page draws, 20 times a second, from a log being written."""

import base64
import json
import math
from bisect import bisect_right
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import ValidationError

from palpate.base.errors import InputError
from palpate.base.geometry import Floats, ObjectModel
from palpate.config import RigFile, load_calibrated, load_objects
from palpate.config.recognition_results import IdentificationOut
from palpate.drivers.transport import SessionEvent
from palpate.rig.session.log_file import check_session
from palpate.rig.session.log_reader import LogTail
from palpate.rig.session.logged_values import LoggedHypothesis, LoggedPlacement, LoggedTouch, by_part
from palpate.rig.session.recorded_session import (
    EventSample,
    FrameSample,
    Sample,
    SampleDecoder,
    ServoSample,
    TipSample,
)
from palpate.views.answer import headline, rest_words
from palpate.views.run_scene import RunScene, heaviest, widest_place

_PERIOD_S = 0.05
_REST_FRAMES = 20  # frames of an array, at its start, that show it untouched
_MIN_SCALE_N = 0.02  # force on a taxel that is drawn at full strength, at least
_MAX_HYPOTHESES = 40  # hypotheses of a part, the heaviest
_MAX_FRAMES = 40_000  # frames kept: half an hour of rig time


class FrameStore:
    """Takes samples in order and keeps a frame, a JSON text, for each 50 ms of them."""

    def __init__(self) -> None:
        self.times_s: list[float] = []
        self.texts: list[str] = []
        self.dropped = 0
        """Frames that are not kept any more, the oldest ones."""
        self.is_ended = False
        self._taxels: dict[str, _Taxels] = {}
        self._scale_n = _MIN_SCALE_N
        self._run = RunScene()
        self._state: dict[str, Any] = {
            "t": 0.0,
            "grip": None,
            "stage": None,
            "doing": None,
            "verdict": None,
            "answer": None,
            "rest": None,
            "tips": {},
            "bodies": {},
            "torque": {},
            "contacts": [],
            "parts": [],
            "divisions": None,
            "plan": [],
            "truths": [],
            "frames": 0,
            "end": None,
        }

    def take(self, samples: Iterable[Sample]) -> None:
        """Bring the frames up to date."""
        for sample in samples:
            if self.times_s and sample.t_s >= self.times_s[-1] + _PERIOD_S:
                self._keep()
            self._state["t"] = round(max(sample.t_s, self._state["t"]), 4)
            match sample:
                case TipSample():
                    self._state["tips"][sample.finger] = [round(sample.x_mm, 3), round(sample.y_mm, 3)]
                    joints = [[round(x, 2), round(y, 2)] for x, y in sample.joints_mm]
                    self._state["bodies"][sample.finger] = {"joints": joints, "width": sample.link_width_mm}
                case ServoSample():
                    self._state["torque"][sample.joint] = sample.torque_on
                case FrameSample():
                    self._state["frames"] += 1
                    taxels = self._taxels.setdefault(sample.finger, _Taxels())
                    taxels.take(sample.frame.counts / sample.counts_per_n)
                    self._scale_n = max(self._scale_n, float(taxels.newest_n.max()))
                case EventSample():
                    self._event(sample.kind, sample.values)
                    self._keep()

    def at(self, t_s: float) -> str | None:
        """The frame that was shown at an instant, None before the first."""
        return self.texts[max(bisect_right(self.times_s, t_s) - 1, 0)] if self.texts else None

    @property
    def count(self) -> int:
        """Number of frames there have been."""
        return self.dropped + len(self.texts)

    def _keep(self) -> None:
        arrays = {name: taxels.shown(self._scale_n) for name, taxels in self._taxels.items()}
        shown = self._state | {"arrays": arrays, "scale_n": round(self._scale_n, 4)}
        # Texts first: another thread looks up times.
        self.texts.append(json.dumps(shown, separators=(",", ":")))
        self.times_s.append(self._state["t"])
        if len(self.texts) > _MAX_FRAMES:
            self.dropped += 1
            del self.times_s[0]
            del self.texts[0]

    def _event(self, kind: str, values: Mapping[str, Any]) -> None:
        state, run = self._state, self._run
        if run.take(kind, values):
            state |= {
                "verdict": run.verdict,
                "contacts": [_contact(touch) for touch in run.touches],
                "parts": _parts(run, values.get("result")),
                "divisions": run.divisions,
                "truths": [_place(item) for item in run.truths],
            }
        match kind:
            case "stage":
                state["grip"], state["stage"] = values["grip"], values["stage"]
                if values["stage"] == "retracting":
                    state["plan"] = []
            case "said":
                state["doing"] = values["words"]
            case "planned":
                state["plan"] = [_approach(item) for item in values["approaches"]]
            case "result":
                state |= {"plan": [], **_answer(values["result"])}
            case "end":
                state["plan"] = []
                state["end"] = {"how": values.get("how"), "message": values.get("message")}
                self.is_ended = True


class _Taxels:
    """Forces on an array's taxels (N) over what they were at the start."""

    def __init__(self) -> None:
        self._at_rest: list[Floats] = []
        self.newest_n: Floats = np.zeros((1, 1))

    def take(self, forces_n: Floats) -> None:
        if len(self._at_rest) < _REST_FRAMES:
            self._at_rest.append(forces_n)
        self.newest_n = forces_n - np.mean(self._at_rest, axis=0)

    def shown(self, scale_n: float) -> dict[str, object]:
        """Shape, strength of each taxel from 0 to 255 at `scale_n`, lowest row first, and the whole force."""
        strength = np.clip(255 * self.newest_n / scale_n, 0, 255).astype(np.uint8)
        rows, columns = strength.shape
        return {
            "rows": rows,
            "columns": columns,
            "heat": base64.b64encode(strength.tobytes()).decode(),
            "most": round(float(self.newest_n.max()), 4),
            "force": round(max(float(self.newest_n.sum()), 0.0), 3),
        }


def _contact(touch: LoggedTouch) -> dict[str, object]:
    contact = touch.contact
    normal = contact.normal
    return {
        "finger": contact.name,
        "grip": touch.grip,
        "touched": contact.touched,
        "start": contact.start_mm,
        "end": contact.end_mm,
        "radius": contact.finger.tip_radius_mm,
        "pad": contact.finger.tip.has_face,
        "places": [
            {"name": place.name, "at": place.end_mm, "bound": place.position_bound_mm}
            for place in touch.places
        ],
        "normal": None if normal is None else [normal.lo_rad, normal.hi_rad],
        "force": touch.force_n,
    }


def _place(item: LoggedPlacement) -> dict[str, object]:
    at = item.configuration
    return {
        "object": item.object,
        "state": item.state,
        "x": at.x_mm,
        "y": at.y_mm,
        "theta": at.theta_rad,
    }


def _parts(run: RunScene, result: Mapping[str, Any] | None) -> list[dict[str, object]]:
    """Each part with the heaviest of its hypotheses, the number of all, and, at the end, its own verdict."""
    answers = [] if result is None else result.get("parts") or []
    return [
        {
            "number": own[0].part,
            "hypotheses": [_hypothesis(item) for item in heaviest(own, _MAX_HYPOTHESES)],
            "left": len(own),
            "verdict": answers[own[0].part - 1]["verdict"] if answers else None,
        }
        for own in by_part(run.hypotheses)
    ]


def _answer(result: Mapping[str, Any]) -> dict[str, object]:
    """The answer in words, and what else may be on the table."""
    try:
        out = IdentificationOut.model_validate(result)
    except ValidationError:  # of another version
        return {"answer": result["verdict"]}
    return {"answer": headline(out), "rest": None if out.table is None else rest_words(out.table)}


def _hypothesis(item: LoggedHypothesis) -> dict[str, object]:
    return _place(item) | {
        "weight": item.weight,
        "round": item.symmetry_order == 0,
        "bounds": vars(item.bounds),
    }


def _approach(item: Mapping[str, Any]) -> dict[str, object]:
    approach = item["approach"]
    return {
        "finger": item["finger_index"],
        "start": approach["start_mm"],
        "direction": approach["direction_rad"],
        "travel": item["travel_mm"],
        "radius": approach["finger"]["tip_radius_mm"],
        "stops": [[prediction["earliest_mm"], prediction["latest_mm"]] for prediction in item["predictions"]],
    }


def setting_of(rig: RigFile, objects: Iterable[ObjectModel]) -> dict[str, object]:
    """Setting of a run: fingers, workspace, outlines of states where fingers meet them, their middles."""
    span = max((finger.span_mm for finger in rig.fingers), key=lambda item: item[1])
    outlines: dict[str, list[list[list[float]]]] = {}
    middles: dict[str, tuple[float, float]] = {}
    for model in objects:
        for state in model.states:
            sections = state.sections_within(span) or state.sections[:1]
            rings = [ring.round(3).tolist() for section in sections for ring in section.rings]
            outlines[f"{model.name}/{state.name}"] = rings
            middles[f"{model.name}/{state.name}"] = widest_place(sections[0].rings)
    fingers = [
        {
            "name": finger.name,
            "base": list(finger.base_mm),
            "heading": math.radians(finger.heading_deg),
            "radius": finger.tip.radius_mm,
            "pad": finger.tip.kind.has_face,
        }
        for finger in rig.fingers
    ]
    return {
        "rig": rig.name,
        "fingers": fingers,
        "workspace": rig.workspace.radius_mm,
        "goal": [rig.search.goal_position_mm, rig.search.goal_orientation_deg],
        "outlines": outlines,
        "middles": middles,
    }


class SessionTail:
    """Samples of a session, as far as it is recorded; `is_ended` when no more will come."""

    def __init__(self, folder: Path) -> None:
        """Raises InputError for a folder without a log, or without the rig file of its run."""
        check_session(folder)
        self.is_ended = False
        self._folder, self._log = folder, LogTail(folder)
        self._decoder: SampleDecoder | None = None
        path = folder / "objects.json"
        self.objects = load_objects(path).objects if path.exists() else ()
        self.rig = self._rig(calibration=False)

    @property
    def is_written(self) -> bool:
        """True if a process is recording it now."""
        return self._log.is_written

    def read(self) -> Iterator[Sample]:
        """Samples of what was written since. A log that cannot be read any further ends, and says why."""
        was_written = self.is_written
        try:
            for entry in self._log.read():
                what = entry.what
                if isinstance(what, SessionEvent) and what.kind == "session":
                    self.rig = self._rig(calibration=what.values.get("calibration") is True)
                    self._decoder = SampleDecoder(self.rig)
                    yield EventSample(0.0, what.kind, what.values)
                elif self._decoder is not None:
                    yield from self._decoder.feed(entry)
        except InputError as error:
            yield EventSample(0.0, "end", {"how": "unreadable", "message": str(error)})
            self.is_ended = True
        # What was written before it was given up has been read.
        self.is_ended = self.is_ended or not was_written

    def _rig(self, *, calibration: bool) -> RigFile:
        return load_calibrated(self._folder / "rig.toml", calibration=calibration).rig


class SessionFeed:
    """Brings a frame store up to date with a session, as far as it is recorded."""

    def __init__(self, folder: Path) -> None:
        """Raises InputError as `SessionTail`."""
        self.store = FrameStore()
        self._tail = SessionTail(folder)
        self.setting: Mapping[str, object] = setting_of(self._tail.rig, self._tail.objects)

    def update(self) -> None:
        """Take what was written since."""
        if not self.store.is_ended:
            self.store.take(self._tail.read())
            self.store.is_ended = self.store.is_ended or self._tail.is_ended
