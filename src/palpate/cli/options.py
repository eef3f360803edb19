"""Options that several commands share, each with its help."""

from pathlib import Path
from typing import Annotated

import typer

from palpate.base.vocabulary import Strategy

__all__ = [
    "VIEW_PORT",
    "ContactsOption",
    "JsonOption",
    "NoCalibrationOption",
    "ObjectsArgument",
    "ObjectsOption",
    "PictureOption",
    "PortOption",
    "RigOption",
    "SceneOption",
    "SeedOption",
    "SessionArgument",
    "StrategyOption",
    "ViewOption",
    "ViewPortOption",
]

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
