"""JSON channels of a run, for viewers: the topic of each sample, its message, and the schema of each topic.

Schemas are made from the types that the log's events are written from. Messages and schemas are within what
viewers can read (Foxglove's and Lichtblick's parser of JSON Schema): each key has one type, no key is null,
and no list holds lists. So what the log has as null is left out, and lists of lists are flat.
"""

from collections.abc import Mapping
from functools import cache
from itertools import chain
from typing import Any, get_type_hints

from pydantic import TypeAdapter
from typing_extensions import TypedDict

from palpate.config import RigFile
from palpate.config.recognition_results import IdentificationOut
from palpate.config.schema import inline_references
from palpate.drivers.tactile import ContactPatch
from palpate.recognizer import Approach, Configuration, Contact, LevelCount, Prediction
from palpate.rig.motion.load_meter import ContactLoad
from palpate.rig.session.logged_values import LoggedHypothesis
from palpate.rig.session.recorded_session import EventSample, FrameSample, Sample, ServoSample, TipSample

_Values = Mapping[str, Any]


def _typed(name: str, fields: _Values) -> Any:
    return TypedDict(name, dict(fields))  # type: ignore[operator]


_TOUCH = {
    "finger_index": int,
    "contact": Contact,
    "patch": ContactPatch | None,
    "servos": list[float],
    "loads": list[ContactLoad] | None,
    "stage_rad": float,
    "points": list[Contact] | None,
}
_PLANNED = {
    "finger_index": int,
    "approach": Approach,
    "travel_mm": float,
    "predictions": list[Prediction],
}
_CHOSEN = {
    **{"finger_index": int, "start_mm": list[float]},
    **dict.fromkeys(("direction_rad", "travel_mm", "position_bound_mm", "stage_rad", "fast_mm"), float),
    "touch_mm_s": float | None,
}
_PART = {
    "engine": str,
    **dict.fromkeys(("mass_kg", "friction", "tip_friction", "slip_n"), float),
    **dict.fromkeys(("feet", "seed"), int),
}
_TRUTH = {
    **{"object": str, "state": str, "configuration": Configuration},
    **{"at_measurement": list[Configuration] | None, "part": _typed("Part", _PART) | None},
}
_HEADER = {
    **dict.fromkeys(("format", "palpate", "rig"), str),
    **dict.fromkeys(("command", "strategy", "started", "proof"), str | None),
    **dict.fromkeys(("scene", "calibration", "emulated"), bool | None),
    "seed": int | None,
    "bus_latency_s": float,
}
_FIELDS: Mapping[str, Mapping[str, Any]] = {
    "Frame": {"sequence": int, "device_time_s": float, "rows": int, "columns": int, "counts": list[int]},
    "Servo": get_type_hints(ServoSample),
    "Tip": get_type_hints(TipSample),
    "session": _HEADER,
    "stage": {"grip": int, "stage": str},
    "touches": {"grip": int, "touches": list[_typed("Touch", _TOUCH)]},  # type: ignore[misc]
    "recognised": {
        **{"grip": int, "verdict": str},
        **{"levels": list[LevelCount], "hypotheses": list[LoggedHypothesis], "divisions": int | None},
    },
    "planned": {
        **{"grip": int, "decisive": bool, "remaining": float},
        "approaches": list[_typed("PlannedApproach", _PLANNED)],  # type: ignore[misc]
    },
    "grip": {"grip": int, "approaches": list[_typed("ChosenApproach", _CHOSEN)]},  # type: ignore[misc]
    "left": {"how": str, "message": str},
    "moved": {"grip": int},
    "truth": _TRUTH | {"others": list[_typed("PartTruth", _TRUTH)] | None},  # type: ignore[misc]
    "result": {"result": IdentificationOut},
    "said": {"words": str},
    "end": {"how": str, "message": str | None},
}
"""Keys and types of each kind of sample and event, beside `t_s` and an event's `event`."""

_TOPICS = {"touches": "/contacts", "recognised": "/verdicts"}


def json_topics(rig: RigFile) -> Mapping[str, str]:
    """Topics that a run on a rig may have, and the names of their schemas."""
    found = {_event_topic(kind): kind for kind in _FIELDS if kind.islower()}
    for finger in rig.fingers:
        found |= {f"/arrays/{finger.name}": "Frame", f"/tips/{finger.name}": "Tip"}
    return found | {f"/servos/{servo.name}": "Servo" for servo in rig.servos}


def _event_topic(kind: str) -> str:
    return _TOPICS.get(kind, f"/events/{kind}")


def json_message(sample: Sample) -> tuple[str, str, _Values]:
    """Topic of a sample, the name of its schema, and its message."""
    match sample:
        case FrameSample(t_s, finger, frame):
            rows, columns = frame.counts.shape
            values = {"t_s": t_s, "sequence": frame.sequence, "device_time_s": frame.device_time_s}
            counts = {"rows": rows, "columns": columns, "counts": frame.counts.ravel().tolist()}
            return f"/arrays/{finger}", "Frame", values | counts
        case EventSample(t_s, kind, values):
            return _event_topic(kind), kind, {"t_s": t_s, "event": kind} | _plain(values)
        case TipSample():
            topic, name = f"/tips/{sample.finger}", "Tip"
        case ServoSample():
            topic, name = f"/servos/{sample.joint}", "Servo"
    return topic, name, _plain({key: getattr(sample, key) for key in sample.__slots__})


@cache
def json_schema(name: str) -> Mapping[str, Any]:
    """JSON Schema of the messages of this name; an event of a kind that is not known has any keys."""
    fields = {"t_s": float} | ({"event": str} if name.islower() else {}) | dict(_FIELDS.get(name, {}))
    schema = TypeAdapter(_typed(name, fields)).json_schema(mode="serialization")
    return _plain_schema(inline_references(schema, schema.pop("$defs", {})))


def _plain(value: Any) -> Any:
    """A value of the log without nulls, lists of lists, and the thousands of numbers of a touch's trace."""
    if isinstance(value, Mapping):
        return {key: _plain(item) for key, item in value.items() if item is not None and key != "trace"}
    if isinstance(value, list | tuple):
        items = [_plain(item) for item in value if item is not None]
        return list(chain(*items)) if items and isinstance(items[0], list) else items
    return value


def _plain_schema(schema: Mapping[str, Any]) -> dict[str, Any]:
    """A schema of what `_plain` leaves. Numbers are not required: unknown and infinite ones are left out."""
    if "anyOf" in schema:
        first, *others = [_plain_schema(item) for item in schema["anyOf"] if item.get("type") != "null"]
        return first if not others else {"type": first["type"]}
    kept = {key: schema[key] for key in ("type", "description", "enum") if key in schema}
    if schema["type"] == "object":
        parts = schema["properties"]
        needed = [key for key in schema.get("required", ()) if not _may_lack(parts[key])]
        kept |= {"properties": {key: _plain_schema(part) for key, part in parts.items()}, "required": needed}
    elif schema["type"] == "array":
        items = _plain_schema(schema.get("items") or schema["prefixItems"][0])
        kept["items"] = items["items"] if items["type"] == "array" else items
    return kept


def _may_lack(part: Mapping[str, Any]) -> bool:
    return part.get("type") == "number" or {"type": "null"} in part.get("anyOf", ())
