"""What a command reads, by the names of its options: no file that it writes may be one of these."""

from collections.abc import Iterable
from pathlib import Path

__all__ = ["rig_files", "scene_files", "session_files", "several_files"]


def rig_files(rig: Path | None) -> dict[str, Path | None]:
    """The rig file and the calibration beside it, whether it is used or not."""
    from palpate.config import calibration_path

    return {"--rig": rig, "the rig's calibration": None if rig is None else calibration_path(rig)}


def scene_files(scene: Path | None) -> dict[str, Path | None]:
    """The scene and the objects file that it names. Raises InputError for a scene that is wrong."""
    from palpate.config import load_scene

    return {"--scene": scene, "the scene's objects": None if scene is None else load_scene(scene).objects}


def session_files(session: Path | None) -> dict[str, Path | None]:
    """What a run recorded in its folder, which may be named by its log, too; a report can be written anew."""
    from palpate.rig.session.log_file import session_of
    from palpate.rig.session.pruning import recorded_files

    if session is None:
        return {}
    return {f"the session's {file.name}": file for file in recorded_files(session_of(session))}


def several_files(paths: Iterable[Path]) -> dict[str, Path | None]:
    """Files that have no option each."""
    return {str(path): path for path in paths}
