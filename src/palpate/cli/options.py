"""Options that several commands share, each with its help, and the files that they name.

Imports no more than typer at its top: every command needs it at start-up.
"""

from collections.abc import Iterable
from pathlib import Path
from typing import Annotated

import typer

from palpate.base.vocabulary import Strategy

VIEW_PORT = 8765
"""Of the live view, if no other is given."""

RigOption = Annotated[
    Path | None, typer.Option("--rig", help="Rig file (TOML); without it, the shipped emulated rig.")
]
NoCalibrationOption = Annotated[
    bool, typer.Option("--no-calibration", help="Leave out the calibration that lies beside the rig file.")
]
ObjectsOption = Annotated[
    Path | None, typer.Option("--objects", help="Object models (JSON); without it, the six shipped ones.")
]
SceneOption = Annotated[
    Path | None, typer.Option("--scene", help="What lies on the table of an emulated rig (JSON).")
]
SeedOption = Annotated[
    int, typer.Option("--seed", min=0, help="Draws the scene and the emulated devices' errors.")
]
ContactsOption = Annotated[Path, typer.Option("--contacts", help="Contacts so far (JSON).")]
StrategyOption = Annotated[
    Strategy,
    typer.Option(
        "--strategy",
        help="How grips are chosen: to distinguish most, at random, or beside the last touches.",
    ),
]
JsonOption = Annotated[bool, typer.Option("--json", help="One JSON object on stdout.")]
PictureOption = Annotated[Path | None, typer.Option("--picture", help="Also write a picture (SVG) here.")]
PortOption = Annotated[str | None, typer.Option("--port", help="Port of the servos' bus.")]
ObjectsArgument = Annotated[
    Path, typer.Argument(metavar="FILE", help="Object models (JSON).", show_default=False)
]
SessionArgument = Annotated[
    Path, typer.Argument(metavar="SESSION", help="A session's folder, or its log.", show_default=False)
]
ViewOption = Annotated[
    bool, typer.Option("--view", help="Show it on a page in the browser; see palpate view.")
]
ViewPortOption = Annotated[
    int, typer.Option("--view-port", min=1, max=65535, help="With --view: its port on this computer.")
]


def rig_files(rig: Path | None) -> dict[str, Path | None]:
    """The rig file and the calibration beside it, whether it is used or not."""
    from palpate.config import calibration_path

    return {"--rig": rig, "the rig's calibration": None if rig is None else calibration_path(rig)}


def scene_files(scene: Path | None) -> dict[str, Path | None]:
    """The scene and the objects file that it names. Raises InputError for a scene that is wrong."""
    from palpate.config import load_scene

    objects = None if scene is None else load_scene(scene).objects
    return {"--scene": scene, "the scene's objects": None if objects is None else Path(objects)}


def session_files(session: Path | None) -> dict[str, Path | None]:
    """Files that a run recorded in its folder, which its log may name; a report can be written anew."""
    from palpate.rig.session.archive import recorded_files
    from palpate.rig.session.log_file import session_of

    if session is None:
        return {}
    return {f"the session's {file.name}": file for file in recorded_files(session_of(session))}


def several_files(paths: Iterable[Path]) -> dict[str, Path | None]:
    """Files that have no option each."""
    return {str(path): path for path in paths}
