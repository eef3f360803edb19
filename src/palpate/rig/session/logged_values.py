"""Events of a session log as values: hypotheses, touches and grips of a run, for display."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from itertools import groupby
from typing import Any

from palpate.recognizer import Bounds, Configuration, Contact, Finger, NormalRange
from palpate.rig.session.log_reader import SessionFile

_ROUNDING_RAD = 1e-5  # of numbers in a result


@dataclass(frozen=True)
class LoggedPlacement:
    """An object in a state, and where it lies in W."""

    object: str
    state: str
    configuration: Configuration

    @property
    def name(self) -> str:
        """Object and state."""
        return f"{self.object}, {self.state}"


@dataclass(frozen=True)
class LoggedHypothesis(LoggedPlacement):
    """A hypothesis; `verified` is None for those of a result, which does not keep it.

    `part`: number of the part, from 1, where several were sought.
    """

    bounds: Bounds
    weight: float
    verified: bool | None
    symmetry_order: int
    part: int = 1


@dataclass(frozen=True, eq=False)
class LoggedTouch:
    """A touch, or miss, of a grip: the contact, those of a pad's points, and the force (N) on its patch."""

    grip: int
    contact: Contact
    points: tuple[Contact, ...]
    force_n: float | None

    @property
    def evidence(self) -> tuple[Contact, ...]:
        """Contacts that the recogniser was given."""
        return self.points or (self.contact,)

    @property
    def touched_points(self) -> tuple[Contact, ...]:
        """Touched points of a pad's face, without normals: it measures none."""
        return tuple(replace(point, normal=None) for point in self.points if point.touched)

    @property
    def places(self) -> tuple[Contact, ...]:
        """Contacts by which the touch is shown, each a place with its own bound."""
        return self.touched_points or (self.contact,)


def placement_in(values: Mapping[str, Any]) -> LoggedPlacement:
    """Placement of the part that an event such as `truth` holds."""
    return LoggedPlacement(values["object"], values["state"], Configuration(**values["configuration"]))


def placements_in(values: Mapping[str, Any]) -> tuple[LoggedPlacement, ...]:
    """Placements of all parts that the event `truth` holds."""
    return tuple(map(placement_in, (values, *values.get("others", ()))))


def hypotheses_in(kind: str, values: Mapping[str, Any]) -> list[LoggedHypothesis]:
    """Hypotheses of the event `recognised`, or the answer and its alternatives of the event `result`.

    The latter are of the part as it lies when the fingers have left it, so they may be wider than the last
    ones of `recognised`, and lie beside them. Empty if no hypothesis was left. Parts are numbered after each
    grip as the leading division of its touches has them.
    """
    if kind == "recognised":
        return [
            LoggedHypothesis(
                **vars(placement_in(item)),
                bounds=Bounds(*(tuple(item["bounds"][name]) for name in ("x_mm", "y_mm", "theta_rad"))),
                weight=item["weight"],
                verified=item["verified"],
                symmetry_order=item["symmetry_order"],
                part=item.get("part", 1),
            )
            for item in values["hypotheses"]
        ]
    result = values["result"]
    answers = result.get("parts") or [result]
    return [item for number, answer in enumerate(answers, start=1) for item in _hypotheses_of(answer, number)]


def _hypotheses_of(answer: Mapping[str, Any], part: int) -> list[LoggedHypothesis]:
    if answer["configuration"] is None:
        return []
    others = answer["alternatives"]
    first = {**answer, "weight": max(0.0, 1.0 - sum(item["weight"] for item in others))}
    return [_hypothesis_of_result(item, part) for item in (first, *others)]


def _hypothesis_of_result(item: Mapping[str, Any], part: int) -> LoggedHypothesis:
    at, bounds = item["configuration"], item["bounds"]
    lo, hi = bounds["theta"]
    return LoggedHypothesis(
        item["object"],
        item["state"],
        Configuration(at["x"], at["y"], at["theta"]),
        Bounds(tuple(bounds["x"]), tuple(bounds["y"]), (lo, hi)),
        item["weight"],
        verified=None,
        symmetry_order=item.get("symmetry_order", 0 if hi - lo >= math.tau - _ROUNDING_RAD else 1),
        part=part,
    )


def sort_by_weight(hypotheses: Sequence[LoggedHypothesis]) -> list[LoggedHypothesis]:
    """Hypotheses part by part, the heaviest of each first."""
    return sorted(hypotheses, key=lambda item: (item.part, -item.weight))


def by_part(hypotheses: Sequence[LoggedHypothesis]) -> list[list[LoggedHypothesis]]:
    """Sorted hypotheses in a list for each part that there are any of."""
    return [list(own) for _, own in groupby(hypotheses, key=lambda item: item.part)]


def touches_in(values: Mapping[str, Any]) -> list[LoggedTouch]:
    """Touches of the event `touches`."""
    return [
        LoggedTouch(
            values["grip"],
            _contact(touch["contact"]),
            tuple(_contact(item) for item in touch.get("points") or ()),
            (touch.get("patch") or {}).get("force_n"),
        )
        for touch in values["touches"]
    ]


def _contact(item: Mapping[str, Any]) -> Contact:
    values: dict[str, Any] = dict(item)
    normal, finger = values.pop("normal"), Finger(**values.pop("finger"))
    known = {item.name for item in fields(Contact)}
    rest: dict[str, Any] = {name: _hashable(value) for name, value in values.items() if name in known}
    return Contact(finger=finger, normal=None if normal is None else NormalRange(**normal), **rest)


def _hashable(value: object) -> object:
    return tuple(value) if isinstance(value, list) else value


@dataclass(eq=False)
class GripRecord:
    """One grip: what its events say; `stages`: when each began (s).

    `decisive`: whether the plan before it was; None for a grip that explores. `divisions`: that are left of
    the touches among several parts; None for one part. `is_chosen`: a program chose it, by whatever means.
    """

    number: int
    stages: list[tuple[str, float]] = field(default_factory=list)
    touches: Sequence[LoggedTouch] = ()
    hypotheses: Sequence[LoggedHypothesis] = ()
    verdict: str | None = None
    decisive: bool | None = None
    is_moved: bool = False
    is_chosen: bool = False
    divisions: int | None = None


def grip_records(file: SessionFile) -> list[GripRecord]:
    """Grips of a session in order, the last one as far as it went; hypotheses by weight."""
    found: dict[int, GripRecord] = {}
    for t_s, kind, values in file.events():
        number = values.get("grip")
        if not isinstance(number, int):
            continue
        grip = found.setdefault(number, GripRecord(number))
        if kind == "stage":
            grip.stages.append((str(values.get("stage")), t_s))
        elif kind == "touches":
            grip.touches = touches_in(values)
        elif kind == "recognised":
            grip.hypotheses = sort_by_weight(hypotheses_in(kind, values))
            grip.verdict, grip.divisions = values["verdict"], values.get("divisions")
        elif kind == "planned":
            grip.decisive = bool(values["decisive"])
        elif kind == "moved":
            grip.is_moved = True
        elif kind == "grip":
            grip.is_chosen = True
    return [found[number] for number in sorted(found) if found[number].stages or found[number].touches]
