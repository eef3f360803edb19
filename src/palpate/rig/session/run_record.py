"""Record of a run: its grips with what was touched, planned and recognised, as the log's events say."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import Any

from palpate.recognizer import Contact, Finger
from palpate.recognizer.contact import NormalRange
from palpate.rig.session.log_reader import SessionFile

__all__ = ["GripRecord", "contacts_in", "grip_records", "places_touched"]


@dataclass(eq=False)
class GripRecord:
    """One grip: values of its events, in the log's words; `stages`: when each began (s).

    `planned` is what was planned before it; None for one that explores.
    """

    number: int
    stages: list[tuple[str, float]] = field(default_factory=list)
    touches: Sequence[Mapping[str, Any]] = ()
    hypotheses: Sequence[Mapping[str, Any]] = ()
    verdict: str | None = None
    planned: Mapping[str, Any] | None = None
    is_moved: bool = False
    end_s: float = 0.0


def grip_records(file: SessionFile) -> list[GripRecord]:
    """Grips of a session in order, the last one as far as it went."""
    found: dict[int, GripRecord] = {}
    for t_s, kind, values in file.events():
        number = values.get("grip")
        if not isinstance(number, int):
            continue
        grip = found.setdefault(number, GripRecord(number))
        grip.end_s = t_s
        if kind == "stage":
            grip.stages.append((str(values.get("stage")), t_s))
        elif kind == "touches":
            grip.touches = values["touches"]
        elif kind == "recognised":
            grip.hypotheses, grip.verdict = values["hypotheses"], values["verdict"]
        elif kind == "planned":
            grip.planned = values
        elif kind == "moved":
            grip.is_moved = True
    return [found[number] for number in sorted(found) if found[number].stages or found[number].touches]


def contacts_in(touch: Mapping[str, Any]) -> list[Contact]:
    """What the recogniser was given of a touch in the log: its contact, or those of a pad's points."""
    return [_contact(item) for item in touch.get("points") or [touch["contact"]]]


def places_touched(touch: Mapping[str, Any]) -> Sequence[Mapping[str, Any]]:
    """Contacts by which a touch in the log is shown, each a place with its own bound.

    Those of the touched points of a pad, without normals: it measures none. Else its contact or miss.
    """
    points = [{**item, "normal": None} for item in touch.get("points") or () if item["touched"]]
    return points or [touch["contact"]]


def _contact(item: Mapping[str, Any]) -> Contact:
    values: dict[str, Any] = dict(item)
    normal, finger = values.pop("normal"), Finger(**values.pop("finger"))
    known = {item.name for item in fields(Contact)}
    rest: dict[str, Any] = {name: _plain(value) for name, value in values.items() if name in known}
    return Contact(finger=finger, normal=None if normal is None else NormalRange(**normal), **rest)


def _plain(value: object) -> object:
    return tuple(value) if isinstance(value, list) else value
