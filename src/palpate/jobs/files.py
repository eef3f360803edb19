"""Checks of arguments of public functions, and reading and writing of every file format of palpate."""

import inspect
import os
import types
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cache, wraps
from importlib.resources.abc import Traversable
from numbers import Real
from pathlib import Path
from typing import Any, ParamSpec, TypeVar, Union, get_args, get_origin, get_type_hints

from palpate.base.errors import InputError, warn_operator
from palpate.base.file_io import write_text
from palpate.base.geometry import ObjectModel
from palpate.config import CalibrationFile, ContactsFile, ObjectsFile, RigFile, Scene
from palpate.config import load_calibration as read_calibration
from palpate.config import load_contacts as read_contacts
from palpate.config import load_objects as read_objects
from palpate.config import load_rig as read_rig
from palpate.config import load_scene as read_scene
from palpate.config.calibration_file import ReferencesFile
from palpate.config.calibration_file import load_references as read_references
from palpate.config.contacts_file import CONTACT_NOUNS
from palpate.config.loading import check_values, shipped_objects, shipped_references, shipped_rig
from palpate.config.objects_file import objects_of_values
from palpate.config.recognition_results import UnknownStateOut
from palpate.config.writers import file_text, objects_values
from palpate.recognizer import Contact
from palpate.rig.catalogue.finger_model import HasHeight, KnownObjects
from palpate.rig.conversion import contacts_json

_P = ParamSpec("_P")
_R = TypeVar("_R")

_KIND_WORDS: dict[object, str] = {
    type(None): "None",
    bool: "True or False",
    int: "a whole number",
    float: "a number",
    str: "a text",
    os.PathLike: "a path",
    Mapping: "a dict of what a file holds",
    ObjectModel: "an ObjectModel",
    Contact: "a Contact",
    tuple[float, float]: "a pair of numbers",
    RigFile: "a RigFile (load_rig(path), or a rig's `file`)",
    ObjectsFile: "an ObjectsFile (load_objects)",
    ContactsFile: "a ContactsFile (load_contacts)",
    Scene: "a Scene (load_scene)",
    CalibrationFile: "a CalibrationFile (load_calibration)",
    ReferencesFile: "a ReferencesFile (load_references)",
}
_PATH = os.PathLike[str]
_MAX_CHARS = 60  # characters of a value in a message


def check_arguments(function: Callable[_P, _R]) -> Callable[_P, _R]:
    """Decorate a public function: arguments of kinds that its annotations do not allow raise InputError.

    Checks what a message can name: plain values, palpate's files, functions, and sequences of these. Any
    other annotation allows everything.
    """
    signature = inspect.signature(function)
    hints = cache(lambda: get_type_hints(function))  # at the first call: names may be defined further below

    @wraps(function)
    def with_checked_arguments(*args: _P.args, **kwargs: _P.kwargs) -> _R:
        for name, value in signature.bind(*args, **kwargs).arguments.items():
            if name in hints() and not _is_allowed(value, hints()[name]):
                allowed = " or ".join(dict.fromkeys(_kind_words(hints()[name])))
                raise InputError(f"{function.__name__}: {name} is {_repr_of(value)}; it must be {allowed}")
        return function(*args, **kwargs)

    return with_checked_arguments


def _is_allowed(value: object, hint: Any) -> bool:
    kind = get_origin(hint) or hint
    if kind in (Union, types.UnionType):
        return any(_is_allowed(value, each) for each in get_args(hint))
    if kind is Callable:
        return callable(value)
    if kind is Sequence:
        (item,) = get_args(hint)
        return isinstance(value, Sequence) and all(_is_allowed(each, item) for each in value)
    if kind is tuple and Ellipsis not in get_args(hint):
        items = get_args(hint)
        return isinstance(value, tuple) and len(value) == len(items) and all(map(_is_allowed, value, items))
    if kind in (int, float):
        return isinstance(value, int if kind is int else Real) and not isinstance(value, bool)
    return not isinstance(kind, type) or getattr(kind, "_is_protocol", False) or isinstance(value, kind)


def _kind_words(hint: Any) -> list[str]:
    kind = get_origin(hint) or hint
    if kind in (Union, types.UnionType):
        return [
            word
            for each in get_args(hint)
            for word in _kind_words(each)
            if not (each is str and _PATH in get_args(hint))
        ]
    if kind is Callable:
        return ["a function"]
    if kind is Sequence:
        (item,) = get_args(hint)
        if item is Contact:
            return ["a list of contacts"]
        if item == Sequence[Contact]:
            return ["a list of grips, each a list of contacts"]
        return [f"a sequence, each {' or '.join(_kind_words(item))}"]
    return [_KIND_WORDS.get(hint) or _KIND_WORDS.get(kind, f"a {getattr(kind, '__name__', kind)}")]


def _repr_of(value: object) -> str:
    text = " ".join(repr(value).split())
    return f"{text if len(text) <= _MAX_CHARS else text[: _MAX_CHARS - 1] + '…'} ({type(value).__name__})"


PathLike = str | os.PathLike[str]

ObjectsLike = ObjectsFile | PathLike | Mapping[str, object] | Sequence[ObjectModel]
"""Object models: as loaded, their file, a dict of what it would hold, or models made in Python."""

SceneLike = Scene | PathLike | Mapping[str, object]
"""What lies on an emulated table: as loaded, its file, or a dict of what it would hold."""

ContactLists = Sequence[Contact] | Sequence[Sequence[Contact]]
"""Contacts, misses included: one list of them, or a list of grips, which are lists."""


@check_arguments
def load_rig(path: PathLike | None = None) -> RigFile:
    """Load a rig file (TOML, `palpate/rig@1`), or the shipped emulated bench; InputError if it is wrong."""
    return read_rig(_path(path, shipped_rig()))


@check_arguments
def load_objects(
    objects: PathLike | Mapping[str, object] | Sequence[ObjectModel] | None = None,
) -> ObjectsFile:
    """Load object models (JSON, `palpate/objects@1`), or the six shipped ones; InputError if wrong.

    Values made in Python are checked as a file is: a dict of what it would hold (`format` and `units` may be
    left out), or a list of models. Warns (`RigWarning`) of points of outlines that repeat others or lie on
    straight lines: they are left out.
    """
    if objects is None or isinstance(objects, str | os.PathLike):
        found = read_objects(_path(objects, shipped_objects()))
    else:
        values = objects if isinstance(objects, Mapping) else {"objects": objects_values(objects)}
        found = objects_of_values(
            {"format": "palpate/objects@1", "units": "mm"} | dict(values), name_of(objects)
        )
    for line in found.notices:
        warn_operator(line)
    return found


def select_known(
    objects: ObjectsFile, fingers: Sequence[HasHeight], name: str, warn: Callable[[str], None]
) -> tuple[ObjectsFile, tuple[UnknownStateOut, ...]]:
    """The objects without states that are not known where fingers are, and these; `warn` is told of them.

    Raises InputError if none is left.
    """
    known = KnownObjects.of(objects.objects, fingers)
    if known.notice is None:
        return objects, ()
    warn(f"{name}: {known.notice}")
    return replace(objects, objects=known.objects), known.left_out


@check_arguments
def load_contacts(path: PathLike) -> ContactsFile:
    """Load contacts (JSON, `palpate/contacts@1`), grip by grip; InputError if they are wrong."""
    return read_contacts(Path(path))


@check_arguments
def load_scene(scene: PathLike | Mapping[str, object]) -> Scene:
    """Load what lies on an emulated table (JSON, `palpate/scene@1`); InputError if it is wrong.

    From its file, or a dict of what it would hold, in which `format` may be left out.
    """
    if isinstance(scene, Mapping):
        return check_values("the scene", {"format": "palpate/scene@1"} | dict(scene), Scene, {})
    return read_scene(Path(scene))


@check_arguments
def load_calibration(path: PathLike) -> CalibrationFile:
    """Load a calibration (TOML, `palpate/calibration@1`); InputError if it is wrong."""
    return read_calibration(Path(path))


@check_arguments
def load_references(path: PathLike | None = None) -> ReferencesFile:
    """Load calibration's disc and plate (TOML, `palpate/references@1`), or the standard ones; InputError."""
    return read_references(_path(path, shipped_references()))


@check_arguments
def save(
    value: RigFile
    | ObjectsFile
    | ContactsFile
    | Scene
    | CalibrationFile
    | ReferencesFile
    | Sequence[ObjectModel]
    | ContactLists,
    path: PathLike,
) -> None:
    """Save a value in its file format, so that loading it gives the same value again.

    Object models and contacts that were made in Python are checked as their file is. One list of contacts is
    one grip, or, if a finger occurs in it twice, as many single touches. The file is replaced at once: a
    reader never meets half of it. Raises InputError where the path cannot be written and for a value that no
    format holds, OutputError for a full disk.
    """
    write_text(Path(path), file_text(_file_value(value) if isinstance(value, Sequence) else value))


def _file_value(items: Sequence[object]) -> ObjectsFile | ContactsFile:
    """The file of object models, or of contacts."""
    models = [item for item in items if isinstance(item, ObjectModel)]
    if models:
        return load_objects(models)
    touches = [item for item in items if isinstance(item, Contact)]
    names = {item.name for item in touches}
    grips = [item for item in items if isinstance(item, Sequence)]
    if touches:
        grips = [touches] if len(names) == len(touches) else [[item] for item in touches]
    for contact in (contact for grip in grips for contact in grip):
        if contact.turn_bound_rad:
            raise InputError(f"save: the contact of {contact.name} has a turn_bound_rad: no file holds that")
    return check_values("the contacts", contacts_json(grips), ContactsFile, CONTACT_NOUNS)


def objects_from(objects: ObjectsLike | None) -> ObjectsFile:
    """Object models as given, from their file, or the shipped ones."""
    return objects if isinstance(objects, ObjectsFile) else load_objects(objects)


def name_of(objects: ObjectsLike | None) -> str:
    """Name of a catalogue in messages: its file as the user gave it."""
    if isinstance(objects, str | os.PathLike):
        return os.fspath(objects)
    return shipped_objects().name if objects is None else "the catalogue"


def scene_from(scene: SceneLike | None) -> Scene | None:
    """A scene as given, from its file or its values, or none."""
    return scene if scene is None or isinstance(scene, Scene) else load_scene(scene)


def _path(path: PathLike | None, shipped: Traversable) -> Path | Traversable:
    return shipped if path is None else Path(path)
