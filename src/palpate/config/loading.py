"""Loading of files, given or shipped: from bytes to a checked pydantic model, or one `InputError` line.

Every failure names the file, the place in it, what is wrong and what is allowed: a missing file, a file of
another format, bytes that are not UTF-8, broken JSON or TOML (line and column), keys given twice, unknown
keys, wrong values. Rigs, object models and references that ship inside the package are sources like any
other.
"""

import json
import os
import re
import tomllib
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib.resources import files
from importlib.resources.abc import Traversable
from pathlib import PurePath
from typing import Any, TypeVar, get_args

from pydantic import BaseModel, ValidationError

from palpate.base.errors import InputError
from palpate.base.file_io import (
    JSON_BYTES,
    MOST_NESTING,
    MOST_TABLE_KEYS,
    MOST_VALUES,
    TOML_BYTES,
    read_bytes,
    size_in_words,
)
from palpate.config.problems import Problem, excerpt, place_in_words, problems_of, refuse

_CAD_SUFFIXES = frozenset({".3mf", ".dxf", ".obj", ".ply", ".step", ".stl", ".stp", ".svg"})
_OBJECTS_FORMAT = "palpate/objects@1"
_FORMAT_SEARCH_CHARS = 10_000  # characters in which a file says its format
_FORMAT_PATTERN = re.compile(
    r'(?:^|[{,])[ \t]*"?format"?[ \t]*[:=][ \t]*"(palpate/[\w-]{1,40}@\d{1,4})"', re.MULTILINE
)


def _describe_other_format(name: str, text: str, wanted: str) -> str | None:
    """Describe a file that is not of the format `wanted`; None: one of this with a fault, perhaps."""
    if PurePath(name).suffix.lower() in _CAD_SUFFIXES:
        rest = f"`palpate objects import {name}` makes object models of it"
        return f"is a CAD file; {rest if wanted == _OBJECTS_FORMAT else f'needed here: {excerpt(wanted)}'}"
    found = _FORMAT_PATTERN.search(text[:_FORMAT_SEARCH_CHARS])
    if found is None or found[1] == wanted:
        return None
    return f"format: is {excerpt(found[1])}; needed here: {excerpt(wanted)}"


@dataclass(frozen=True)
class Content:
    """A file that was read already: the name that its user gave it, and its bytes."""

    name: str
    data: bytes

    def read_bytes(self) -> bytes:
        """All of it."""
        return self.data


Source = str | os.PathLike[str] | Traversable | Content
"""A path, a file that ships inside the package, or one that was read already."""

_ADVICE_DIVIDE = "divide it into several files"
_Model = TypeVar("_Model", bound=BaseModel)
_TOML_POSITION = re.compile(r"^(?P<what>.*?)\s*\(at (?P<where>.*)\)$", re.DOTALL)


_KEY_PATTERN = r"""(?:[\w-]++|"(?:[^"\\\n]|\\.)*+"|'[^'\n]*+')"""
_DEEP_KEY_PATTERN = re.compile(
    rf"(?:^|(?<=[\s\[,{{])){_KEY_PATTERN}(?:[ \t]*+\.[ \t]*+{_KEY_PATTERN}){{{MOST_NESTING}}}"
)
"""A dotted key of too many parts, or a text that looks like one."""
_INTEGER_TOO_LONG = "integer string conversion"


class _Refused(ValueError):
    """Found before or while decoding, at a place the decoder does not know."""


def load_json(source: Source, model: type[_Model], nouns: Mapping[str, str]) -> _Model:
    """Read `source` as JSON into `model`, whose `format` field is the literal name of the format.

    `nouns` says how list entries are called in messages: {"objects": "object"}.

    Raises:
        InputError: anything is wrong with the file; one line, and a note for each further problem.

    """
    text = _read_text(source, JSON_BYTES, _ADVICE_DIVIDE, _format_of(model))
    return _load(source, text, model, nouns, _decode_json, "JSON")


def load_toml(source: Source, model: type[_Model], nouns: Mapping[str, str]) -> _Model:
    """Read `source` as TOML into `model`; otherwise as `load_json`."""
    text = _read_text(source, TOML_BYTES, "give the file that was meant", _format_of(model))
    return _load(source, text, model, nouns, _decode_toml, "TOML")


def read_json(path: str | os.PathLike[str]) -> Content:
    """The bytes of a JSON file, to be a source. InputError where it cannot be read, or is too large."""
    return Content(os.fspath(path), read_bytes(path, JSON_BYTES, _ADVICE_DIVIDE))


def source_name(source: Source) -> str:
    """Name of the file in messages: its path as the user gave it."""
    return os.fspath(source) if isinstance(source, str | os.PathLike) else source.name


def _load(
    source: Source,
    text: str,
    model: type[_Model],
    nouns: Mapping[str, str],
    decode: Callable[[str], object],
    language: str,
) -> _Model:
    name = source_name(source)
    try:
        data = decode(text)
    except _Refused as error:
        raise InputError(f"{name}: {error}") from None
    except RecursionError:
        raise InputError(f"{name}: brackets are nested too deeply") from None
    except ValueError as error:
        another = _describe_other_format(name, text, _format_of(model))
        raise InputError(f"{name}: {another or f'not valid {language}: {_syntax(error)}'}") from None
    return check_values(name, data, model, nouns)


def check_values(name: str, data: object, model: type[_Model], nouns: Mapping[str, str]) -> _Model:
    """Check values that a file holds, or that are given in place of one; errors are those of `load_json`."""
    wrong_format = _format_problem(data, model)
    if wrong_format is not None:
        raise refuse(name, [wrong_format])
    try:
        return model.model_validate(data)
    except ValidationError as error:
        raise refuse(name, problems_of(error, model, data, nouns)) from None


def _read_text(source: Source, most_bytes: int, advice: str, wanted: str) -> str:
    name = source_name(source)
    if isinstance(source, str | os.PathLike):
        raw = read_bytes(source, most_bytes, advice)
    else:
        raw = source.read_bytes()
    try:
        return raw.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = raw.count(b"\n", 0, error.start) + 1
        fault = f"line {line} holds byte 0x{raw[error.start]:02x}, which is not UTF-8; save it as UTF-8"
        raise InputError(f"{name}: {_describe_other_format(name, '', wanted) or fault}") from None


def check_readable(name: str, text: str) -> None:
    """Raise InputError for a JSON text that is too large to be read again once it is written."""
    size, values = len(text.encode()), _count_values(text)
    if size > JSON_BYTES or values > MOST_VALUES:
        raise InputError(
            f"{name}: would have {size_in_words(size)} and {values} values; at most "
            f"{size_in_words(JSON_BYTES)} and {MOST_VALUES} are read: put some of it into another file"
        )


def _count_values(text: str) -> int:
    return sum(text.count(mark) for mark in ",[{")


def _decode_json(text: str) -> object:
    values = _count_values(text)
    if values > MOST_VALUES:
        raise _Refused(
            f"holds about {values} values; at most {MOST_VALUES} are read: divide it into several files"
        )
    return json.loads(text, object_pairs_hook=_no_repeats)


def _decode_toml(text: str) -> object:
    if found := _DEEP_KEY_PATTERN.search(text):  # tomllib takes time by the square of this
        line = text.count("\n", 0, found.start()) + 1
        raise _Refused(f"line {line} has a key of more than {MOST_NESTING} parts between dots")
    data = tomllib.loads(text)
    _check_keys(data)
    return data


def _check_keys(value: object) -> None:
    """Refuse a table of too many keys, at any depth."""
    if isinstance(value, dict):
        _check_size(value)
    for inner in value.values() if isinstance(value, dict) else value if isinstance(value, list) else ():
        _check_keys(inner)


def _check_size(table: Mapping[str, object] | list[tuple[str, Any]]) -> None:
    if len(table) > MOST_TABLE_KEYS:
        raise _Refused(f"a table has {len(table)} keys; at most {MOST_TABLE_KEYS} are read")


def _no_repeats(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    _check_size(pairs)
    table = dict(pairs)
    if len(table) < len(pairs):
        counts = Counter(key for key, _ in pairs)
        twice = next(key for key, count in counts.items() if count > 1)
        raise _Refused(f"the key {excerpt(twice)} is given twice in one table")
    return table


def _syntax(error: ValueError) -> str:
    if isinstance(error, json.JSONDecodeError):
        return f"line {error.lineno}, column {error.colno}: {error.msg[:1].lower()}{error.msg[1:]}"
    match = _TOML_POSITION.match(str(error))
    if match is not None:
        return f"{match['where']}: {match['what'][:1].lower()}{match['what'][1:]}"
    if _INTEGER_TOO_LONG in str(error):
        return "a whole number has thousands of digits"
    return " ".join(str(error).split())


def _format_problem(data: object, model: type[BaseModel]) -> Problem | None:
    """Check the format before anything else: errors against the wrong format mislead."""
    wanted = _format_of(model)
    if not isinstance(data, dict):
        return Problem(
            "", f"holds {excerpt(data)}; it must be a table with the key format = {excerpt(wanted)}"
        )
    if "format" not in data:
        return (
            None
            if len(data) and _has_misspelt_format(data)
            else Problem("", f'the key "format" is missing; this file must say format {excerpt(wanted)}')
        )
    if data["format"] != wanted:
        return Problem(
            place_in_words(("format",), data, {}),
            f"is {excerpt(data['format'])}; needed here: {excerpt(wanted)}",
        )
    return None


def _format_of(model: type[BaseModel]) -> str:
    """The name of the format that a model's files have."""
    return str(get_args(model.model_fields["format"].annotation)[0])


def _has_misspelt_format(data: Mapping[str, object]) -> bool:
    return any(isinstance(value, str) and value.startswith("palpate/") for value in data.values())


SHIPPED_RIGS = ("bench", "xm430-bench", "xl330-bench")
"""Rigs that ship with palpate; the first is used where no other is given."""


def shipped_rig(name: str = SHIPPED_RIGS[0]) -> Traversable:
    """Give one of `SHIPPED_RIGS`, else the emulated bench with three fingers; for `load_rig`."""
    return files("palpate.config").joinpath("rigs", f"{name}.toml")


def shipped_objects() -> Traversable:
    """Give the object models tr-1, tr-2, tr-3, grip, gator and hand; for `load_objects`."""
    return files("palpate.config").joinpath("objects", "memo.json")


def shipped_references() -> Traversable:
    """Give the references that calibration expects unless told otherwise; for `load_references`."""
    return files("palpate.config").joinpath("references", "standard.toml")


def template_text(name: str) -> str:
    """Return the text of a template of a new rig file: "rig" for its head, "finger" for each finger."""
    return files("palpate.config").joinpath("templates", f"{name}.toml").read_text(encoding="utf-8")
