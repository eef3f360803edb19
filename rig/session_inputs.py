"""What a session was started from, kept in its folder, so that the folder is enough to run it again."""

import json
from importlib.resources.abc import Traversable
from pathlib import Path

from palpate.config import ObjectsFile, RigFile, Scene, load_objects, load_rig, load_scene
from palpate.errors import InputError
from palpate.rig.files import write_text

__all__ = ["keep_inputs", "kept_inputs"]

_RIG, _OBJECTS, _SCENE, _SCENE_OBJECTS = "rig.toml", "objects.json", "scene.json", "scene-objects.json"


def keep_inputs(
    folder: Path, rig: Path | Traversable, objects: Path | Traversable, scene: Path | None
) -> None:
    """Copy the input files of a run into its session's folder; InputError if one cannot be written.

    A scene that takes its object from a file of its own gets that file's copy instead.
    """
    write_text(folder / _RIG, _text(rig))
    write_text(folder / _OBJECTS, _text(objects))
    if scene is None:
        return
    text = _text(scene)
    others = load_scene(scene).objects
    if others is not None:
        write_text(folder / _SCENE_OBJECTS, _text(others))
        text = json.dumps(json.loads(text) | {"objects": _SCENE_OBJECTS}, indent=1) + "\n"
    write_text(folder / _SCENE, text)


def kept_inputs(folder: Path, *, scene: bool) -> tuple[RigFile, ObjectsFile, Scene | None]:
    """The inputs that a session's folder keeps; InputError if one is missing or cannot be read."""
    if not (folder / _RIG).is_file():
        raise InputError(
            f"{folder} cannot be replayed: it keeps no {_RIG}; "
            "sessions do so since palpate records them for replay"
        )
    return (
        load_rig(folder / _RIG),
        load_objects(folder / _OBJECTS),
        load_scene(folder / _SCENE) if scene else None,
    )


def _text(source: Path | Traversable) -> str:
    try:
        return source.read_bytes().decode("utf-8-sig")
    except (OSError, ValueError) as error:  # it was read a moment ago
        raise InputError(f"{source} cannot be read any more: {error}") from error
