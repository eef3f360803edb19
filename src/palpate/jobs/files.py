"""Files: every format that palpate reads and writes, loaded and saved."""

import os
from importlib.resources.abc import Traversable
from pathlib import Path

from palpate.base.files.writing import write_text
from palpate.config import CalibrationFile, ContactsFile, ObjectsFile, RigFile, Scene
from palpate.config import load_calibration as read_calibration
from palpate.config import load_contacts as read_contacts
from palpate.config import load_objects as read_objects
from palpate.config import load_rig as read_rig
from palpate.config import load_scene as read_scene
from palpate.config.references_file import ReferencesFile
from palpate.config.references_file import load_references as read_references
from palpate.config.shipped import shipped_objects, shipped_references, shipped_rig
from palpate.config.writers import file_text
from palpate.jobs.arguments import checked
from palpate.jobs.warning import warning

__all__ = [
    "PathLike",
    "load_calibration",
    "load_contacts",
    "load_objects",
    "load_references",
    "load_rig",
    "load_scene",
    "name_of",
    "objects_from",
    "save",
    "scene_from",
]

PathLike = str | os.PathLike[str]


@checked
def load_rig(path: PathLike | None = None) -> RigFile:
    """Load a rig file (TOML, `palpate/rig@1`), or the shipped emulated bench; InputError if it is wrong."""
    return read_rig(_path(path, shipped_rig()))


@checked
def load_objects(path: PathLike | None = None) -> ObjectsFile:
    """Load object models (JSON, `palpate/objects@1`), or the six shipped ones; InputError if wrong.

    Warns (`RigWarning`) of points of outlines that repeat others or lie on straight lines: they are left out.
    """
    found = read_objects(_path(path, shipped_objects()))
    for line in found.notices:
        warning(line)
    return found


@checked
def load_contacts(path: PathLike) -> ContactsFile:
    """Load contacts (JSON, `palpate/contacts@1`), grip by grip; InputError if they are wrong."""
    return read_contacts(Path(path))


@checked
def load_scene(path: PathLike) -> Scene:
    """Load what lies on an emulated table (JSON, `palpate/scene@1`); InputError if it is wrong."""
    return read_scene(Path(path))


@checked
def load_calibration(path: PathLike) -> CalibrationFile:
    """Load a calibration (TOML, `palpate/calibration@1`); InputError if it is wrong."""
    return read_calibration(Path(path))


@checked
def load_references(path: PathLike | None = None) -> ReferencesFile:
    """Load calibration's disc and plate (TOML, `palpate/references@1`), or the standard ones; InputError."""
    return read_references(_path(path, shipped_references()))


@checked
def save(
    value: RigFile | ObjectsFile | ContactsFile | Scene | CalibrationFile | ReferencesFile, path: PathLike
) -> None:
    """Save a value in its file format, so that loading it gives the same value again.

    The file is replaced at once: a reader never meets half of it. Raises InputError where the path cannot be
    written and for a value that no format holds, OutputError for a full disk.
    """
    write_text(Path(path), file_text(value))


def objects_from(objects: ObjectsFile | PathLike | None) -> ObjectsFile:
    """Object models as given, from their file, or the shipped ones."""
    return objects if isinstance(objects, ObjectsFile) else load_objects(objects)


def name_of(objects: ObjectsFile | PathLike | None) -> str:
    """What messages call a catalogue: its file as the user gave it."""
    if isinstance(objects, ObjectsFile):
        return "the catalogue"
    return shipped_objects().name if objects is None else os.fspath(objects)


def scene_from(scene: Scene | PathLike | None) -> Scene | None:
    """A scene as given, from its file, or none."""
    return load_scene(scene) if isinstance(scene, str | os.PathLike) else scene


def _path(path: PathLike | None, shipped: Traversable) -> Path | Traversable:
    return shipped if path is None else Path(path)
