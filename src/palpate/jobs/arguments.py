"""Checked arguments: a public function gets the kinds of values that its annotations name, or InputError."""

import inspect
import os
import types
from collections.abc import Callable, Sequence
from functools import cache, wraps
from numbers import Real
from typing import Any, ParamSpec, TypeVar, Union, get_args, get_origin, get_type_hints

from palpate.base.errors import InputError
from palpate.config import CalibrationFile, ContactsFile, ObjectsFile, RigFile, Scene
from palpate.config.references_file import ReferencesFile

__all__ = ["checked"]

_P = ParamSpec("_P")
_R = TypeVar("_R")

_WORDS: dict[object, str] = {
    type(None): "None",
    bool: "True or False",
    int: "a whole number",
    float: "a number",
    str: "a text",
    os.PathLike: "a path",
    RigFile: "a RigFile (load_rig(path), or a rig's `file`)",
    ObjectsFile: "an ObjectsFile (load_objects)",
    ContactsFile: "a ContactsFile (load_contacts)",
    Scene: "a Scene (load_scene)",
    CalibrationFile: "a CalibrationFile (load_calibration)",
    ReferencesFile: "a ReferencesFile (load_references)",
}
_PATH = os.PathLike[str]
_LONG = 60  # characters of a value in a message


def checked(function: Callable[_P, _R]) -> Callable[_P, _R]:
    """Decorate a public function: arguments of kinds that its annotations do not allow raise InputError.

    Checks what a message can name: plain values, palpate's files, functions, and sequences of these. Any
    other annotation allows everything.
    """
    signature = inspect.signature(function)
    hints = cache(lambda: get_type_hints(function))  # at the first call: names may be defined further below

    @wraps(function)
    def with_checked_arguments(*args: _P.args, **kwargs: _P.kwargs) -> _R:
        for name, value in signature.bind(*args, **kwargs).arguments.items():
            if name in hints() and not _fits(value, hints()[name]):
                allowed = " or ".join(dict.fromkeys(_words(hints()[name])))
                raise InputError(f"{function.__name__}: {name} is {_shown(value)}; it must be {allowed}")
        return function(*args, **kwargs)

    return with_checked_arguments


def _fits(value: object, hint: Any) -> bool:
    kind = get_origin(hint) or hint
    if kind in (Union, types.UnionType):
        return any(_fits(value, each) for each in get_args(hint))
    if kind is Callable:
        return callable(value)
    if kind is Sequence:
        (item,) = get_args(hint)
        return isinstance(value, Sequence) and all(_fits(each, item) for each in value)
    if kind in (int, float):
        return isinstance(value, int if kind is int else Real) and not isinstance(value, bool)
    return not isinstance(kind, type) or getattr(kind, "_is_protocol", False) or isinstance(value, kind)


def _words(hint: Any) -> list[str]:
    kind = get_origin(hint) or hint
    if kind in (Union, types.UnionType):
        return [
            word
            for each in get_args(hint)
            for word in _words(each)
            if not (each is str and _PATH in get_args(hint))
        ]
    if kind is Callable:
        return ["a function"]
    if kind is Sequence:
        return [f"a sequence, each {' or '.join(_words(get_args(hint)[0]))}"]
    return [_WORDS.get(kind, f"a {getattr(kind, '__name__', kind)}")]


def _shown(value: object) -> str:
    text = " ".join(repr(value).split())
    return f"{text if len(text) <= _LONG else text[: _LONG - 1] + '…'} ({type(value).__name__})"
