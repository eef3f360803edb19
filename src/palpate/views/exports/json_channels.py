"""JSON channels of a run, for viewers: the topic of each sample, its message, and the schema of each topic.

Schemas are made from the types that the log's events are written from. Messages and schemas are within what
viewers can read (Foxglove's and Lichtblick's parser of JSON Schema): each key has one type, no key is null,
and no list holds lists. So what the log has as null is left out, and lists of lists are flat.
"""

from collections.abc import Mapping
from functools import cache
from itertools import chain
from typing import Any, NotRequired

from pydantic import TypeAdapter
from typing_extensions import TypedDict

from palpate.config.recognition_results import IdentificationOut
from palpate.config.schema import inline_references
from palpate.drivers.tactile import ContactPatch
from palpate.recognizer import Approach, Configuration, Contact, LevelCount, Prediction
from palpate.rig.motion.load_meter import ContactLoad
from palpate.rig.session.logged_values import LoggedHypothesis
from palpate.rig.session.recorded_session import EventSample, FrameSample, Sample, ServoSample, TipSample

_Values = Mapping[str, Any]


class _Frame(TypedDict):
    """Frame of an array; `counts`: raw, row by row, the lowest first."""

    t_s: float
    sequence: int
    device_time_s: float
    rows: int
    columns: int
    counts: list[int]


class _Event(TypedDict):
    """Event of the log, as docs/session-log.md describes it."""

    t_s: float
    event: str


class _Session(_Event):
    format: str
    palpate: str
    rig: str
    seed: NotRequired[int]
    strategy: NotRequired[str]
    scene: NotRequired[bool]
    calibration: NotRequired[bool]
    emulated: NotRequired[bool]
    started: NotRequired[str]
    bus_latency_s: NotRequired[float]
    proof: NotRequired[str]


class _Stage(_Event):
    grip: int
    stage: str


class _Touch(TypedDict):
    """Touch without its load over time, which the log has."""

    finger_index: int
    contact: Contact
    patch: ContactPatch | None
    servos: list[float]
    loads: NotRequired[list[ContactLoad]]
    stage_rad: NotRequired[float]
    points: NotRequired[list[Contact]]


class _Touches(_Event):
    grip: int
    touches: list[_Touch]


class _Recognised(_Event):
    grip: int
    verdict: str
    levels: list[LevelCount]
    hypotheses: list[LoggedHypothesis]


class _PlannedApproach(TypedDict):
    finger_index: int
    approach: Approach
    travel_mm: float
    predictions: list[Prediction]


class _Planned(_Event):
    grip: int
    decisive: bool
    remaining: float
    approaches: list[_PlannedApproach]


class _Moved(_Event):
    grip: int


class _Part(TypedDict):
    engine: str
    mass_kg: float
    friction: float
    tip_friction: float
    feet: int
    seed: int
    slip_n: float


class _Truth(_Event):
    object: str
    state: str
    configuration: Configuration
    at_measurement: NotRequired[list[Configuration]]
    part: NotRequired[_Part]


class _Result(_Event):
    result: IdentificationOut


class _Said(_Event):
    words: str


class _End(_Event):
    how: str
    message: NotRequired[str]


_EVENTS: Mapping[str, type] = {
    "session": _Session,
    "stage": _Stage,
    "touches": _Touches,
    "recognised": _Recognised,
    "planned": _Planned,
    "moved": _Moved,
    "truth": _Truth,
    "result": _Result,
    "said": _Said,
    "end": _End,
}
_TOPICS = {"touches": "/contacts", "recognised": "/verdicts"}


def json_message(sample: Sample) -> tuple[str, type, _Values]:
    """Topic of a sample, the type that its schema is made from, and its message."""
    match sample:
        case FrameSample(t_s, finger, frame):
            rows, columns = frame.counts.shape
            values = {"t_s": t_s, "sequence": frame.sequence, "device_time_s": frame.device_time_s}
            counts = {"rows": rows, "columns": columns, "counts": frame.counts.ravel().tolist()}
            return f"/arrays/{finger}", _Frame, values | counts
        case EventSample(t_s, kind, values):
            topic = _TOPICS.get(kind, f"/events/{kind}")
            return topic, _EVENTS.get(kind, _Event), {"t_s": t_s, "event": kind} | _plain(values)
        case TipSample() | ServoSample():
            name = f"/tips/{sample.finger}" if isinstance(sample, TipSample) else f"/servos/{sample.joint}"
            return name, type(sample), {key: getattr(sample, key) for key in sample.__slots__}


def _plain(value: Any) -> Any:
    """A value of the log without nulls, lists of lists, and the thousands of numbers of a touch's trace."""
    if isinstance(value, Mapping):
        return {key: _plain(item) for key, item in value.items() if item is not None and key != "trace"}
    if isinstance(value, list):
        items = [_plain(item) for item in value if item is not None]
        return list(chain(*items)) if items and isinstance(items[0], list) else items
    return value


@cache
def json_schema(kind: type) -> Mapping[str, Any]:
    """JSON Schema of the messages of a type."""
    schema = TypeAdapter(kind).json_schema(mode="serialization")
    return _plain_schema(inline_references(schema, schema.pop("$defs", {})))


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
