"""Error messages for files: what is wrong and where, in terms of the file's author.

Turns pydantic's validation errors, also those behind the first wrong entry of a list, into `Problem` values:
a place in the user's own terms and one sentence. None of pydantic's vocabulary or links reaches the user.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice
from types import UnionType
from typing import Annotated, Any, Union, cast, get_args, get_origin

from pydantic import BaseModel, Tag, TypeAdapter, ValidationError
from pydantic_core import ErrorDetails, PydanticCustomError

from palpate.base.errors import InputError, nearest

Place = tuple[str | int, ...]
"""Keys and indices (from 0) from the top of a file to a value; in errors also tags, see `TAG`."""

TAG = "type="
"""What the tags of models that are distinguished by a key `type` begin with; they are no part of a place."""


def child(value: object, step: str | int) -> object:
    """Return what is below a key, or at an index, of a value from a file; None if there is nothing."""
    if isinstance(step, str):
        return value.get(step) if isinstance(value, dict) else None
    return value[step] if isinstance(value, list | tuple) and step < len(value) else None


def _keys_at(model: type[BaseModel], place: Place, data: object) -> list[str]:
    """Keys that the table at `place` of `data` may have."""
    kind = _kind_at(model, place)
    for step in place:
        data = data if _is_tag(step) else child(data, step)
    if hasattr(kind, "variant"):
        kind = kind.variant(data)
    return list(kind.model_fields) if isinstance(kind, type) and issubclass(kind, BaseModel) else []


def _tags_at(model: type[BaseModel], place: Place) -> list[str]:
    """Values that the key `type` of the table at `place` may have."""
    options = _union_members(_kind_at(model, place))
    return [tag.removeprefix(TAG) for tag in options]


def _kind_at(model: type[BaseModel], place: Place) -> Any:
    """The type of what is at `place`, which has a step for every tag."""
    kind: Any = model
    for step in place:
        kind = _inner(kind)
        options = _union_members(kind)
        if options:
            kind = options.get(str(step))
        elif isinstance(kind, type) and issubclass(kind, BaseModel):
            field = kind.model_fields.get(str(step))
            kind = field.annotation if field else None
        else:
            arguments = [argument for argument in get_args(kind) if argument is not Ellipsis]
            kind = arguments[-1] if arguments else None
    return _inner(kind)


def _union_members(kind: Any) -> dict[str, Any]:
    """Models of a tagged union, by tag; empty for anything else."""
    if get_origin(kind) not in {Union, UnionType}:
        return {}
    found = {}
    for part in get_args(kind):
        tags = [item.tag for item in get_args(part)[1:] if isinstance(item, Tag)]
        found.update(dict.fromkeys(tags, part))
    return found


def _is_tag(step: str | int) -> bool:
    """True if a step of an error's place is a tag."""
    return isinstance(step, str) and step.startswith(TAG)


def _inner(kind: Any) -> Any:
    """`kind` without Annotated and without the None of an optional value."""
    while True:
        if get_origin(kind) is Annotated:
            kind = get_args(kind)[0]
        elif get_origin(kind) in {Union, UnionType} and not _union_members(kind):
            kind = next(part for part in get_args(kind) if part is not type(None))
        else:
            return kind


_MAX_ENTRIES_BEHIND = 1000
"""How many entries behind a wrong one are looked at: there may be millions."""


def _all_errors(error: ValidationError, kind: Any, data: object) -> Iterator[ErrorDetails]:
    """The errors that validation of `data` as a `kind` found, then those of entries behind them."""
    found = error.errors(include_url=False)
    yield from found
    ended = {
        detail["loc"][:depth]: step
        for detail in found
        for depth, step in enumerate(detail["loc"])
        if isinstance(step, int) and get_origin(_kind_at(kind, detail["loc"][:depth])) is list
    }
    for place in sorted(ended, key=len, reverse=True):  # what is nearest to the first error comes first
        yield from _errors_behind(kind, data, place, ended[place])


def _errors_behind(kind: Any, data: object, place: Place, wrong: int) -> Iterator[ErrorDetails]:
    """Errors in the list at `place`, behind its entry `wrong`."""
    (item,) = get_args(_kind_at(kind, place))
    entries: Any = data
    for step in place:
        entries = entries if _is_tag(step) else child(entries, step)
    checked = TypeAdapter(item)
    for index, entry in islice(enumerate(entries), wrong + 1, wrong + 1 + _MAX_ENTRIES_BEHIND):
        try:
            checked.validate_python(entry)
        except ValidationError as error:
            for detail in _all_errors(error, item, entry):
                detail["loc"] = (*place, index, *detail["loc"])
                yield detail


_OWN_TYPE = "palpate"
_FOLLOWS = "default_factory_not_called"  # from another error, which is told
_MAX_PROBLEMS_SHOWN = 10
_MAX_PLACES_SHOWN = 6  # of one problem that are told
_MAX_PROBLEMS_COUNTED = 100
_KINDS: Mapping[str, str] = {
    "float_type": "a number",
    "int_type": "a whole number",
    "int_from_float": "a whole number",
    "string_type": "a text",
    "string_unicode": "a text of valid characters",
    "bool_type": "true or false",
    "list_type": "a list",
    "tuple_type": "a list",
    "dict_type": "a table of keys and values",
    "model_type": "a table of keys and values",
    "model_attributes_type": "a table of keys and values",
}
_LIMITS: Mapping[str, tuple[str, str]] = {
    "greater_than": ("gt", "must be above"),
    "greater_than_equal": ("ge", "must be at least"),
    "less_than": ("lt", "must be below"),
    "less_than_equal": ("le", "must be at most"),
}


@dataclass(frozen=True, slots=True)
class Problem:
    """One thing that is wrong: where (in words, may be empty for the whole file) and what."""

    place: str
    message: str

    def __str__(self) -> str:
        return f"{self.place}: {self.message}" if self.place else self.message


def problem(message: str, *place: str | int) -> PydanticCustomError:
    """Make what a validator raises: `message`, at `place` relative to the value being validated."""
    # The text goes in as a parameter: braces in it would be taken for placeholders.
    return PydanticCustomError(_OWN_TYPE, "{text}", {"text": message, "place": place})


def refuse(source: str, problems: Sequence[Problem]) -> InputError:
    """Make the error of a file: the first problem, and a note, which is a line, for each of the others.

    The same problem in several places is one. Beyond ten a line says how many more there are; of a hundred
    places, that there may be still more.
    """
    places: dict[str, list[str]] = {}
    for item in problems:
        places.setdefault(item.message, []).append(item.place)
    first, *others = (
        f"{source}: {Problem(_several(where), message)}"
        for message, where in list(places.items())[:_MAX_PROBLEMS_SHOWN]
    )
    error = InputError(first)
    for line in others:
        error.add_note(line)
    if len(places) > _MAX_PROBLEMS_SHOWN:
        least = "at least " if len(problems) >= _MAX_PROBLEMS_COUNTED else ""
        error.add_note(f"{source}: {least}{len(places) - _MAX_PROBLEMS_SHOWN} more, which are not shown")
    return error


def _several(places: Sequence[str]) -> str:
    """Places in words, six at most."""
    more = f" and {len(places) - _MAX_PLACES_SHOWN} more" if len(places) > _MAX_PLACES_SHOWN else ""
    return "; ".join(places[:_MAX_PLACES_SHOWN]) + more


def excerpt(value: object, limit: int = 40) -> str:
    """`value` as it stands in the file, cut to `limit` characters and kept on one line."""
    if isinstance(value, bool):
        return str(value).lower()
    if value is None:
        return "null"
    if isinstance(value, Mapping):
        return "a table"
    if isinstance(value, list | tuple):
        return "a list"
    text = str(value)
    text = text if text.isprintable() else repr(text)[1:-1]
    text = text if len(text) <= limit else text[: limit - 1] + "…"
    return f'"{text}"' if isinstance(value, str) else text


def place_in_words(place: Place, data: object, nouns: Mapping[str, str]) -> str:
    """Write `place` for the person who wrote `data`.

    Lists named in `nouns` read as `object "plate", outline point 3` (the name where the entry has one,
    else the index); everything else as `fingers[1].slide.dxl_id`, with the entry's name behind it.
    """
    parts: list[str] = []
    path = ""
    owner = ""
    noun: str | None = None
    value: object = data
    for position, step in enumerate(place):
        value = child(value, step)
        name = value.get("name") if isinstance(value, dict) else None
        if isinstance(step, int):
            if noun is not None:
                parts.append(f"{noun} {excerpt(name) if isinstance(name, str) else step}")
                path, noun = "", None
            else:
                path += f"[{step}]"
                owner = f" ({excerpt(name)})" if isinstance(name, str) else owner
            continue
        following = place[position + 1] if position + 1 < len(place) else None
        noun = nouns.get(step) if isinstance(following, int) else None
        if noun is None:
            path += f".{step}" if path else step
        elif path:
            parts.append(path)
            path = ""
    if path:
        parts.append(path)
    return ", ".join(parts) + owner


def problems_of(
    error: ValidationError, model: type[BaseModel], data: object, nouns: Mapping[str, str]
) -> list[Problem]:
    """List what `error` found in `data`: unknown keys first, since they may be the cause of the others.

    A mistyped key shows up twice (unknown, and missing under its right name): only the first is kept.
    """
    details = list(islice(_all_errors(error, model, data), _MAX_PROBLEMS_COUNTED))
    unknown = {
        (detail["loc"][:-1], nearest(str(detail["loc"][-1]), _keys_at(model, detail["loc"][:-1], data)))
        for detail in details
        if detail["type"] == "extra_forbidden"
    }
    kept = [
        detail
        for detail in details
        if not (detail["type"] == "missing" and (detail["loc"][:-1], detail["loc"][-1]) in unknown)
        and detail["type"] != _FOLLOWS
    ]
    kept.sort(key=lambda detail: detail["type"] != "extra_forbidden")  # stable
    return [_to_problem(detail, model, data, nouns) for detail in kept]


def _to_problem(
    detail: ErrorDetails, model: type[BaseModel], data: object, nouns: Mapping[str, str]
) -> Problem:
    kind, place, context = detail["type"], detail["loc"], detail.get("ctx", {})
    about_parent = kind in {"extra_forbidden", "missing"}
    if kind == _OWN_TYPE:
        place += cast("Place", context["place"])
    if kind == "finger_type":
        place += ("type",)
    shown_place = tuple(step for step in place if not _is_tag(step))
    if kind == "too_short" and context["actual_length"] == 0 and shown_place[-1] in _plurals(nouns):
        return Problem(place_in_words(shown_place[:-1], data, nouns), f"contains no {shown_place[-1]}")
    words = place_in_words(shown_place[:-1] if about_parent else shown_place, data, nouns)
    if kind == "finger_type":
        return Problem(words, _other_type(detail, model))
    return Problem(words, _sentence(detail, model, data))


def _plurals(nouns: Mapping[str, str]) -> list[str]:
    """Keys of lists that are the plural of what their entries are called."""
    return [key for key, noun in nouns.items() if key == f"{noun}s"]


def _sentence(detail: ErrorDetails, model: type[BaseModel], data: object) -> str:
    kind, place, context = detail["type"], detail["loc"], detail.get("ctx", {})
    if kind == _OWN_TYPE:
        return str(context["text"])
    if kind == "extra_forbidden":
        return _unknown_key(str(place[-1]), _keys_at(model, place[:-1], data))
    if kind == "missing":
        if isinstance(place[-1], int):
            return f"has {place[-1]} value{'' if place[-1] == 1 else 's'}, more are needed"
        return f'the key "{place[-1]}" is missing'
    return _wrong_value(kind, detail["input"], context) or (
        f"is {excerpt(detail['input'])}: {detail['msg'][:1].lower()}{detail['msg'][1:]}"
    )


def _wrong_value(  # noqa: PLR0911 - a table with logic
    kind: str, value: object, context: Mapping[str, Any]
) -> str | None:
    """Say what a value of a wrong kind or beyond a limit must be; None for other errors."""
    if kind in _KINDS:
        return f"is {excerpt(value)}; it must be {_KINDS[kind]}"
    if kind in _LIMITS:
        key, words = _LIMITS[kind]
        return f"is {excerpt(value)}; it {words} {context[key]:g}"
    if kind == "finite_number":
        return f"is {excerpt(value)}; it must be a finite number"
    if kind in {"literal_error", "enum"}:
        allowed = str(context["expected"]).replace("'", '"').replace(" or ", ", ")
        return f"is {excerpt(value)}; allowed: {allowed}"
    if kind in {"too_short", "too_long"}:
        limit = "at least" if kind == "too_short" else "at most"
        number = context["min_length" if kind == "too_short" else "max_length"]
        return f"has {context['actual_length']} values; it must have {limit} {number}"
    if kind == "string_too_short":
        return "is empty"
    if kind == "string_too_long":
        return f"is {len(str(value))} characters long; at most {context['max_length']} are allowed"
    if kind == "string_pattern_mismatch":
        return f"is {excerpt(value)}; a name is one line without blanks around it"
    return None


def _other_type(detail: ErrorDetails, model: type[BaseModel]) -> str:
    """About a key `type` that names none of the models that are distinguished by it."""
    value = detail["input"]
    given = value.get("type") if isinstance(value, Mapping) else value
    return f"is {excerpt(given)}; allowed: {', '.join(map(excerpt, _tags_at(model, detail['loc'])))}"


def _unknown_key(key: str, allowed: Sequence[str]) -> str:
    near = nearest(key, allowed)
    if near is not None:
        return f'unknown key "{excerpt(key)[1:-1]}"; did you mean "{near}"?'
    return f'unknown key "{excerpt(key)[1:-1]}"; allowed: {", ".join(allowed)}'
