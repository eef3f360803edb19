"""Scene of a run at an instant, from its log: workspace, tips, contacts, hypotheses as shapes in W."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Any, Self

import numpy as np

from palpate.base.geometry import Floats, ObjectModel
from palpate.base.geometry.plane import rotation_matrix
from palpate.base.tips import tip_of
from palpate.config import RigFile
from palpate.rig.session.recorded_session import EventSample, Sample, TipSample


@dataclass(frozen=True)
class LogClock:
    """`begin_ns`: when the rig's clock was 0."""

    begin_ns: int

    @classmethod
    def of(cls, started: datetime | None) -> Self:
        """For a run that began at an instant; 1970 where it is not known."""
        return cls(0 if started is None else round(started.timestamp()) * 10**9)

    def ns(self, t_s: float) -> int:
        """Of an instant on the rig's clock."""
        return self.begin_ns + round(t_s * 1e9)


_ROUNDING_RAD = 1e-5  # of numbers in a result


def sort_by_weight(hypotheses: Sequence[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    """Hypotheses by weight, the largest first; one without a weight is last."""
    return sorted(hypotheses, key=lambda item: -(item["weight"] or 0.0))


def result_hypotheses(result: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """The answer and its alternatives, of the event `result`, in the form of those of `recognised`.

    They are of the part as it lies when the fingers have left it, so they may be wider than the last ones of
    `recognised`, and lie beside them. Empty if no hypothesis was left. `verified` is None: results do not
    keep it.
    """
    if result.get("configuration") is None:
        return []
    others = result["alternatives"]
    first = {**result, "weight": max(0.0, 1.0 - sum(item["weight"] or 0.0 for item in others))}
    return [_as_logged(item) for item in (first, *others)]


def _as_logged(item: Mapping[str, Any]) -> Mapping[str, Any]:
    at, bounds = item["configuration"], item["bounds"]
    lo, hi = bounds["theta"]
    return {
        "object": item["object"],
        "state": item["state"],
        "configuration": {"x_mm": at["x"], "y_mm": at["y"], "theta_rad": at["theta"]},
        "bounds": {"x_mm": bounds["x"], "y_mm": bounds["y"], "theta_rad": bounds["theta"]},
        "weight": item["weight"],
        "verified": None,
        "symmetry_order": item.get("symmetry_order", 0 if hi - lo >= math.tau - _ROUNDING_RAD else 1),
    }


def outlines_in_w(
    item: Mapping[str, Any],
    models: Mapping[str, ObjectModel],
    span_mm: tuple[float, float] | None = None,
) -> tuple[Floats, ...]:
    """Outlines (n, 2) mm, in W, of an object where it lies: those beside a tip, or of its lowest section.

    None of an object or state that the models lack.
    """
    model = models.get(item["object"])
    states = [] if model is None else [state for state in model.states if state.name == item["state"]]
    if not states:
        return ()
    lowest = min(states[0].sections, key=lambda part: part.z_mm[0])
    sections = [] if span_mm is None else states[0].sections_within(span_mm)
    at = item["configuration"]
    turn = rotation_matrix(at["theta_rad"]).T
    rings = (ring for section in sections or [lowest] for ring in section.rings)
    return tuple(ring @ turn + [at["x_mm"], at["y_mm"]] for ring in rings)


COLOURS: Mapping[str, tuple[float, float, float]] = {
    "workspace": (0.6, 0.65, 0.7),
    "hypothesis": (0.0, 0.45, 0.7),
    "truth": (0.9, 0.5, 0.1),
    "normal": (0.0, 0.5, 0.35),
}
"""Red, green and blue of each kind of outline, from 0 to 1."""

_CIRCLE_POINTS = 96
_MAX_HYPOTHESES = 12  # hypotheses, the heaviest
_NORMAL_LENGTH_MM = 12.0
_PERIOD_S = 0.05
"""Tips are drawn so often: 20 times a second is what eyes see."""


@dataclass(frozen=True, eq=False)
class Outline:
    """A closed or open line (n, 2) mm at a height; `kind`: "workspace", "hypothesis", "truth" or "normal"."""

    name: str
    kind: str
    points_mm: Floats
    height_mm: float
    is_closed: bool = True
    weight: float = 1.0


@dataclass(frozen=True)
class TipPosition:
    """A finger's tip."""

    finger: str
    at_mm: tuple[float, float]
    radius_mm: float
    height_mm: float


@dataclass(frozen=True, eq=False)
class SceneSnapshot:
    """Everything that is there from `t_s` on, until the next one."""

    t_s: float
    outlines: tuple[Outline, ...]
    tips: tuple[TipPosition, ...]


def scene_changes(
    samples: Sequence[Sample] | Iterator[Sample], rig: RigFile, objects: Sequence[ObjectModel]
) -> Iterator[SceneSnapshot]:
    """Scenes of a run, one for each event that changes it and for each 50 ms of motion."""
    drawn = _Drawn(rig, objects)
    next_s = 0.0
    for sample in samples:
        if isinstance(sample, TipSample):
            drawn.move(sample)
            if sample.t_s < next_s:
                continue
        elif not (isinstance(sample, EventSample) and drawn.take(sample)):
            continue
        next_s = sample.t_s + _PERIOD_S
        yield drawn.scene(sample.t_s)


class _Drawn:
    def __init__(self, rig: RigFile, objects: Sequence[ObjectModel]) -> None:
        self._fingers = {finger.name: finger for finger in rig.fingers}
        self._models = {model.name: model for model in objects}
        radius = rig.workspace.radius_mm
        self._table = Outline("workspace", "workspace", _circle((0.0, 0.0), radius), 0.0)
        self._tips: dict[str, tuple[float, float]] = {}
        self._hypotheses: tuple[Outline, ...] = ()
        self._contacts: tuple[Outline, ...] = ()
        self._truth: tuple[Outline, ...] = ()

    def move(self, sample: TipSample) -> None:
        self._tips[sample.finger] = (sample.x_mm, sample.y_mm)

    def take(self, sample: EventSample) -> bool:
        """Whether an event changes what is drawn."""
        values = sample.values
        if sample.kind == "session":
            return True
        if sample.kind == "moved":
            self._contacts = ()
        elif sample.kind == "touches":
            new = (_contact(values["grip"], touch) for touch in values["touches"])
            self._contacts += tuple(item for item in new if item is not None)
        elif sample.kind == "recognised":
            self._show(values["hypotheses"])
        elif sample.kind == "result":
            self._show(result_hypotheses(values["result"]))
        elif sample.kind == "truth":
            self._truth = tuple(self._rings(values, None))
        else:
            return False
        return True

    def _show(self, hypotheses: Sequence[Mapping[str, Any]]) -> None:
        heaviest = sort_by_weight(hypotheses)[:_MAX_HYPOTHESES]
        self._hypotheses = tuple(
            ring for number, item in enumerate(heaviest) for ring in self._rings(item, number)
        )

    def scene(self, t_s: float) -> SceneSnapshot:
        tips = []
        for name, at in self._tips.items():
            finger = self._fingers[name]
            tips.append(TipPosition(name, at, finger.tip.radius_mm, finger.height_mm))
        return SceneSnapshot(
            t_s, (self._table, *self._truth, *self._hypotheses, *self._contacts), tuple(tips)
        )

    def _rings(self, item: Mapping[str, Any], number: int | None) -> Iterator[Outline]:
        """Outlines of an object where fingers meet it."""
        highest = max(self._fingers.values(), key=lambda finger: finger.height_mm)
        height = highest.height_mm
        kind = "truth" if number is None else "hypothesis"
        for k, points in enumerate(outlines_in_w(item, self._models, highest.span_mm)):
            name = f"{kind}-{number or 0}-{k}"
            yield Outline(name, kind, points, height, weight=float(item.get("weight") or 1.0))


def _contact(grip: int, touch: Mapping[str, Any]) -> Outline | None:
    """The middle of a contact's normal range, from the tip's centre inward to the touched place."""
    contact = touch["contact"]
    normal = contact.get("normal")
    if not contact["touched"] or normal is None:
        return None
    angle = (normal["lo_rad"] + normal["hi_rad"]) / 2
    end = np.array(contact["end_mm"], dtype=float)
    along = np.array([math.cos(angle), math.sin(angle)])
    finger = contact["finger"]
    radius = 0.0 if tip_of(finger.get("shape", "cylinder")).has_face else finger["tip_radius_mm"]
    points = np.array([end - radius * along, end + _NORMAL_LENGTH_MM * along])
    name = f"contact-{grip}-{contact['name']}"
    return Outline(name, "normal", points, contact["finger"]["height_mm"], is_closed=False)


def _circle(centre: tuple[float, float], radius: float) -> Floats:
    angle = np.linspace(0, 2 * np.pi, _CIRCLE_POINTS, endpoint=False)
    points: Floats = radius * np.column_stack([np.cos(angle), np.sin(angle)]) + centre
    return points
