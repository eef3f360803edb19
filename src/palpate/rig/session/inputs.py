"""What a session was started from, kept in its folder, so that the folder is enough to run it again.

The copies of rig file and calibration lie beside each other as the originals do, so that the folder's rig
file can be given to any command.
"""

from dataclasses import replace
from importlib.resources.abc import Traversable
from pathlib import Path

from palpate.base.errors import InputError
from palpate.base.files.writing import write_text
from palpate.config import ObjectsFile, Scene, calibration_path, load_objects, load_scene
from palpate.config.writers import file_text
from palpate.rig.calibrated_rig import RigOnBench, load_calibrated
from palpate.rig.session.log_reader import SessionFile

__all__ = ["calibrated_run", "keep_inputs", "keep_rig", "kept_inputs"]

_RIG, _OBJECTS, _SCENE, _SCENE_OBJECTS = "rig.toml", "objects.json", "scene.json", "scene-objects.json"


def keep_inputs(folder: Path, on_bench: RigOnBench, objects: ObjectsFile, scene: Scene | None) -> None:
    """Keep the inputs of a run in its session's folder; InputError if one cannot be written.

    A scene whose object comes from a file of its own gets that file's copy instead.
    """
    keep_rig(folder, on_bench)
    write_text(folder / _OBJECTS, file_text(objects))
    if scene is not None and scene.objects is not None:
        write_text(folder / _SCENE_OBJECTS, file_text(load_objects(scene.objects)))
        scene = replace(scene, objects=Path(_SCENE_OBJECTS))
    if scene is not None:
        write_text(folder / _SCENE, file_text(scene))


def keep_rig(folder: Path, on_bench: RigOnBench) -> None:
    """Keep a rig file and the calibration that is in use; InputError if one cannot be written."""
    write_text(folder / _RIG, _text(on_bench.path))
    if on_bench.calibration_path is not None:
        write_text(calibration_path(folder / _RIG), _text(on_bench.calibration_path))


def kept_inputs(
    folder: Path, *, scene: bool, calibration: bool
) -> tuple[RigOnBench, ObjectsFile, Scene | None]:
    """The inputs that a session's folder keeps; InputError if one is missing or cannot be read.

    `scene`, `calibration`: whether the session had one.
    """
    if not (folder / _RIG).is_file():
        raise InputError(
            f"{folder} cannot be replayed: it keeps no {_RIG}; "
            "sessions do so since palpate records them for replay"
        )
    on_bench = load_calibrated(folder / _RIG, calibration=calibration)
    if calibration and on_bench.calibration is None:
        missing = calibration_path(folder / _RIG).name
        raise InputError(f"{folder} cannot be replayed: its run used a calibration, but {missing} is missing")
    return (
        on_bench,
        load_objects(folder / _OBJECTS),
        load_scene(folder / _SCENE) if scene else None,
    )


def calibrated_run(file: SessionFile) -> bool:
    """Whether the run of a session used a calibration; InputError if its first line says neither."""
    value = file.header.get("calibration", False)
    if not isinstance(value, bool):
        raise InputError(f'{file.path}: line 1: "calibration" must be true or false')
    return value


def _text(source: Path | Traversable) -> str:
    try:
        return source.read_bytes().decode("utf-8-sig")
    except (OSError, ValueError) as error:  # it was read a moment ago
        raise InputError(f"{source} cannot be read any more: {error}") from error
