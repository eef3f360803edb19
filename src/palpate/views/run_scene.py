"""Scene of a run at an instant, from its log: workspace, tips, contacts, hypotheses as shapes in W."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from functools import reduce
from typing import Any, Self

import numpy as np
import shapely

from palpate.base.geometry import Floats, ObjectModel, State
from palpate.base.geometry.plane import rotation_matrix
from palpate.config import RigFile
from palpate.recognizer import Configuration
from palpate.rig.session.logged_values import (
    LoggedHypothesis,
    LoggedPlacement,
    LoggedTouch,
    by_part,
    hypotheses_in,
    placements_in,
    sort_by_weight,
    touches_in,
)
from palpate.rig.session.recorded_session import EventSample, Sample, TipSample


@dataclass(frozen=True)
class LogClock:
    """Clock of a log in Unix time; `begin_ns`: when the rig's clock was 0."""

    begin_ns: int

    @classmethod
    def of(cls, started: datetime | None) -> Self:
        """Return the clock of a run that began at an instant; 1970 where it is not known."""
        return cls(0 if started is None else round(started.timestamp()) * 10**9)

    def ns(self, t_s: float) -> int:
        """Return the Unix time of an instant on the rig's clock."""
        return self.begin_ns + round(t_s * 1e9)


class RunScene:
    """Knowledge of parts during a run: touches since one was moved, hypotheses by weight, and the truths.

    `divisions`: that are left of the touches among several parts; None until one is known, and for one part.
    """

    def __init__(self) -> None:
        self.touches: list[LoggedTouch] = []
        self.hypotheses: list[LoggedHypothesis] = []
        self.truths: tuple[LoggedPlacement, ...] = ()
        self.verdict: str | None = None
        self.divisions: int | None = None

    def take(self, kind: str, values: Mapping[str, Any]) -> bool:
        """Take an event; return whether it changes anything."""
        match kind:
            case "moved":
                self.touches = []
            case "touches":
                self.touches += touches_in(values)
            case "recognised" | "result":
                self.hypotheses = sort_by_weight(hypotheses_in(kind, values))
                known = values if kind == "recognised" else values["result"]
                self.verdict = known["verdict"]
                self.divisions = (known.get("table") or known).get("divisions")
            case "truth":
                self.truths = placements_in(values)
            case _:
                return False
        return True


def heaviest(hypotheses: Sequence[LoggedHypothesis], most: int) -> list[LoggedHypothesis]:
    """The heaviest of sorted hypotheses, as many of each part, one at least, and `most` together."""
    parts = by_part(hypotheses)
    return [item for own in parts for item in own[: max(most // len(parts), 1)]]


def placed_rings(
    state: State, at: Configuration, span_mm: tuple[float, float] | None = None
) -> tuple[Floats, ...]:
    """Outlines (n, 2) mm, in W, of a state: those beside a tip, or of its lowest section."""
    sections = [] if span_mm is None else state.sections_within(span_mm)
    turn = rotation_matrix(at.theta_rad).T
    lowest = min(state.sections, key=lambda part: part.z_mm[0])
    rings = (ring for section in sections or [lowest] for ring in section.rings)
    return tuple(ring @ turn + [at.x_mm, at.y_mm] for ring in rings)


def outlines_in_w(
    item: LoggedPlacement,
    models: Mapping[str, ObjectModel],
    span_mm: tuple[float, float] | None = None,
) -> tuple[Floats, ...]:
    """Outlines as of `placed_rings`; none of an object or state that the models lack."""
    states = models[item.object].states if item.object in models else ()
    found = [state for state in states if state.name == item.state]
    return placed_rings(found[0], item.configuration, span_mm) if found else ()


def widest_place(rings: Sequence[Floats]) -> tuple[float, float]:
    """Middle of the largest circle within outlines (n, 2): a place for a name."""
    shape = reduce(shapely.symmetric_difference, map(shapely.Polygon, rings))
    circle = shapely.maximum_inscribed_circle(shape, math.sqrt(shape.area) / 50)
    x, y = circle.coords[0]
    return x, y


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
    """Everything that is there from `t_s` on, until the next; `parts`: the heaviest hypothesis of each."""

    t_s: float
    outlines: tuple[Outline, ...]
    tips: tuple[TipPosition, ...]
    parts: tuple[LoggedHypothesis, ...]
    touches: tuple[LoggedTouch, ...]


def frame_of(item: LoggedHypothesis) -> str:
    """Name of the frame of a part: `part` of the only one, or the first."""
    return "part" if item.part == 1 else f"part-{item.part}"


class SceneFeed:
    """Makes scenes of a run, one for each event that changes it and for each 50 ms of motion."""

    def __init__(self, rig: RigFile, objects: Sequence[ObjectModel]) -> None:
        self._run, self._shapes = RunScene(), _SceneShapes(rig, objects)
        self._tips: dict[str, TipPosition] = {}
        self._outlines = self._shapes.of(self._run)
        self._next_s = 0.0

    def take(self, sample: Sample) -> SceneSnapshot | None:
        """Take a sample; return the scene if it is a new one."""
        if isinstance(sample, TipSample):
            self._tips[sample.finger] = self._shapes.tip(sample)
            if sample.t_s < self._next_s:
                return None
        elif not isinstance(sample, EventSample):
            return None
        elif self._run.take(sample.kind, sample.values):
            self._outlines = self._shapes.of(self._run)
        elif sample.kind != "session":
            return None
        self._next_s = sample.t_s + _PERIOD_S
        parts = tuple(own[0] for own in by_part(self._run.hypotheses))
        tips, touches = tuple(self._tips.values()), tuple(self._run.touches)
        return SceneSnapshot(sample.t_s, self._outlines, tips, parts, touches)


class _SceneShapes:
    """Shapes of what a run knows, at the height of its highest finger."""

    def __init__(self, rig: RigFile, objects: Sequence[ObjectModel]) -> None:
        self._fingers = {finger.name: finger for finger in rig.fingers}
        self._highest = max(rig.fingers, key=lambda finger: finger.height_mm)
        self._models = {model.name: model for model in objects}
        angle = np.linspace(0, 2 * np.pi, _CIRCLE_POINTS, endpoint=False)
        circle = rig.workspace.radius_mm * np.column_stack([np.cos(angle), np.sin(angle)])
        self._table = Outline("workspace", "workspace", circle, 0.0)

    def tip(self, sample: TipSample) -> TipPosition:
        finger = self._fingers[sample.finger]
        return TipPosition(finger.name, (sample.x_mm, sample.y_mm), finger.tip.radius_mm, finger.height_mm)

    def of(self, run: RunScene) -> tuple[Outline, ...]:
        truths = (
            ring for number, item in enumerate(run.truths) for ring in self._rings(f"truth-{number}", item)
        )
        hypotheses = (
            ring
            for number, item in enumerate(heaviest(run.hypotheses, _MAX_HYPOTHESES))
            for ring in self._rings(f"hypothesis-{number}", item, item.weight or 1.0)
        )
        contacts = (line for touch in run.touches if (line := _normal_line(touch)) is not None)
        return (self._table, *truths, *hypotheses, *contacts)

    def _rings(self, name: str, item: LoggedPlacement, weight: float = 1.0) -> Iterator[Outline]:
        """Outlines of an object where fingers meet it."""
        kind = name.partition("-")[0]
        for k, points in enumerate(outlines_in_w(item, self._models, self._highest.span_mm)):
            yield Outline(f"{name}-{k}", kind, points, self._highest.height_mm, weight=weight)


def _normal_line(touch: LoggedTouch) -> Outline | None:
    """The middle of a contact's normal range, from the tip's centre inward to the touched place."""
    contact = touch.contact
    if not contact.touched or contact.normal is None:
        return None
    angle = (contact.normal.lo_rad + contact.normal.hi_rad) / 2
    end, along = np.array(contact.end_mm), np.array([math.cos(angle), math.sin(angle)])
    points = np.array([end - contact.finger.tip_radius_mm * along, end + _NORMAL_LENGTH_MM * along])
    name = f"contact-{touch.grip}-{contact.name}"
    return Outline(name, "normal", points, contact.finger.height_mm, is_closed=False)
