"""Error messages for files: what is wrong, in words for the person who wrote the file.

Turns pydantic's validation errors into `Problem` values: a place in the user's own terms and one sentence.
Nothing of pydantic's vocabulary, and none of its links, gets past this module.
"""

import difflib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice
from typing import cast

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails, PydanticCustomError

from palpate.base.errors import InputError
from palpate.config.model_places import Place, child, is_tag, keys_at, tags_at
from palpate.config.validation_errors import all_errors

__all__ = [
    "Problem",
    "nearest",
    "place_in_words",
    "problem",
    "problems_of",
    "refuse",
    "shown",
]

_OWN_TYPE = "palpate"
_FOLLOWS = "default_factory_not_called"  # from another error, which is told
_SHOWN = 10
_PLACES = 6  # of one problem that are told
_COUNTED = 100
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
    """What to raise for a file: the first problem, and a note, which is a line, for each of the others.

    The same problem in several places is one. Beyond ten a line says how many more there are; of a hundred
    places, that there may be still more.
    """
    places: dict[str, list[str]] = {}
    for item in problems:
        places.setdefault(item.message, []).append(item.place)
    first, *others = (
        f"{source}: {Problem(_several(where), message)}" for message, where in list(places.items())[:_SHOWN]
    )
    error = InputError(first)
    for line in others:
        error.add_note(line)
    if len(places) > _SHOWN:
        least = "at least " if len(problems) >= _COUNTED else ""
        error.add_note(f"{source}: {least}{len(places) - _SHOWN} more, which are not shown")
    return error


def _several(places: Sequence[str]) -> str:
    """Places in words, six at most."""
    more = f" and {len(places) - _PLACES} more" if len(places) > _PLACES else ""
    return "; ".join(places[:_PLACES]) + more


def shown(value: object, limit: int = 40) -> str:
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


def nearest(word: str, allowed: Iterable[str]) -> str | None:
    """The word of `allowed` that `word` was probably meant to be, or None."""
    matches = difflib.get_close_matches(word, list(allowed), n=1, cutoff=0.6)
    return matches[0] if matches else None


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
                parts.append(f"{noun} {shown(name) if isinstance(name, str) else step}")
                path, noun = "", None
            else:
                path += f"[{step}]"
                owner = f" ({shown(name)})" if isinstance(name, str) else owner
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
    """What `error` found in `data`: unknown keys first, since they may be the cause of the others.

    A mistyped key shows up twice (unknown, and missing under its right name): only the first is kept.
    """
    details = list(islice(all_errors(error, model, data), _COUNTED))
    unknown = {
        (detail["loc"][:-1], nearest(str(detail["loc"][-1]), keys_at(model, detail["loc"][:-1], data)))
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
    return [_reworded(detail, model, data, nouns) for detail in kept]


def _reworded(
    detail: ErrorDetails, model: type[BaseModel], data: object, nouns: Mapping[str, str]
) -> Problem:
    kind, place, context = detail["type"], detail["loc"], detail.get("ctx", {})
    about_parent = kind in {"extra_forbidden", "missing"}
    if kind == _OWN_TYPE:
        place += cast("Place", context["place"])
    if kind == "finger_type":
        place += ("type",)
    shown_place = tuple(step for step in place if not is_tag(step))
    if kind == "too_short" and context["actual_length"] == 0 and shown_place[-1] in _plurals(nouns):
        return Problem(place_in_words(shown_place[:-1], data, nouns), f"contains no {shown_place[-1]}")
    words = place_in_words(shown_place[:-1] if about_parent else shown_place, data, nouns)
    if kind == "finger_type":
        return Problem(words, _other_type(detail, model))
    return Problem(words, _sentence(detail, model, data))


def _plurals(nouns: Mapping[str, str]) -> list[str]:
    """Keys of lists that are the plural of what their entries are called."""
    return [key for key, noun in nouns.items() if key == f"{noun}s"]


def _sentence(  # noqa: PLR0911 - a table with logic
    detail: ErrorDetails, model: type[BaseModel], data: object
) -> str:
    kind, place, value = detail["type"], detail["loc"], detail["input"]
    context = detail.get("ctx", {})
    if kind == _OWN_TYPE:
        return str(context["text"])
    if kind == "extra_forbidden":
        return _unknown_key(str(place[-1]), keys_at(model, place[:-1], data))
    if kind == "missing":
        if isinstance(place[-1], int):
            return f"has {place[-1]} value{'' if place[-1] == 1 else 's'}, more are needed"
        return f'the key "{place[-1]}" is missing'
    if kind in _KINDS:
        return f"is {shown(value)}; it must be {_KINDS[kind]}"
    if kind in _LIMITS:
        key, words = _LIMITS[kind]
        return f"is {shown(value)}; it {words} {context[key]:g}"
    if kind == "finite_number":
        return f"is {shown(value)}; it must be a finite number"
    if kind == "literal_error":
        allowed = str(context["expected"]).replace("'", '"').replace(" or ", ", ")
        return f"is {shown(value)}; allowed: {allowed}"
    if kind in {"too_short", "too_long"}:
        limit = "at least" if kind == "too_short" else "at most"
        number = context["min_length" if kind == "too_short" else "max_length"]
        return f"has {context['actual_length']} values; it must have {limit} {number}"
    if kind == "string_too_short":
        return "is empty"
    if kind == "string_too_long":
        return f"is {len(str(value))} characters long; at most {context['max_length']} are allowed"
    if kind == "string_pattern_mismatch":
        return f"is {shown(value)}; a name is one line without blanks around it"
    return f"is {shown(value)}: {detail['msg'][:1].lower()}{detail['msg'][1:]}"


def _other_type(detail: ErrorDetails, model: type[BaseModel]) -> str:
    """About a key `type` that names none of the models that are distinguished by it."""
    value = detail["input"]
    given = value.get("type") if isinstance(value, Mapping) else value
    return f"is {shown(given)}; allowed: {', '.join(map(shown, tags_at(model, detail['loc'])))}"


def _unknown_key(key: str, allowed: Sequence[str]) -> str:
    near = nearest(key, allowed)
    if near is not None:
        return f'unknown key "{shown(key)[1:-1]}"; did you mean "{near}"?'
    return f'unknown key "{shown(key)[1:-1]}"; allowed: {", ".join(allowed)}'
