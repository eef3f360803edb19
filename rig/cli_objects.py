"""The commands for object models: `objects show`, `objects check`.

Registered on the command line's app by `add_to`.
"""

from pathlib import Path
from typing import Annotated

import typer

from palpate.rig.interrupted import if_interrupted

__all__ = ["add_to"]

_FileArgument = Annotated[
    Path, typer.Argument(metavar="FILE", help="Object models (JSON).", show_default=False)
]
_RigOption = Annotated[
    Path | None, typer.Option("--rig", help="Rig file (TOML); without it, the shipped emulated rig.")
]
_NoCalibrationOption = Annotated[
    bool, typer.Option("--no-calibration", help="As if no calibration lay beside the rig file.")
]
_JsonOption = Annotated[bool, typer.Option("--json", help="One JSON object on stdout.")]


def add_to(app: typer.Typer) -> None:
    """Add the commands to the app, as `objects …`."""
    objects = typer.Typer(
        name="objects", help="Object models: see them, and what a rig can tell apart.", no_args_is_help=True
    )
    objects.command("show")(_show)
    objects.command("check")(_check)
    app.add_typer(objects)


def _show(
    file: _FileArgument,
    rig: _RigOption = None,
    picture: Annotated[
        Path | None,
        typer.Option("--picture", help="Where to write the picture (SVG); FILE's stem + .objects.svg, here."),
    ] = None,
    no_calibration: _NoCalibrationOption = False,
    json: _JsonOption = False,
) -> None:
    """List every state of every object, and draw its sections into one picture (SVG).

    Says which states the rig's fingers would not tell apart; `objects check` says what would.
    """
    from palpate.rig.command_objects_show import run_objects_show

    with if_interrupted("no picture was written"):
        raise typer.Exit(
            run_objects_show(
                objects=file, rig=rig, picture=picture, json=json, calibration=not no_calibration
            )
        )


def _check(
    file: _FileArgument,
    rig: _RigOption = None,
    no_calibration: _NoCalibrationOption = False,
    json: _JsonOption = False,
) -> None:
    """Find states that a rig's fingers can never tell apart, and heights at which a finger would.

    Exit code 1: some pair can never be told apart. Pairs that may or may not be: 0.
    """
    from palpate.rig.command_objects_check import run_objects_check

    with if_interrupted("nothing was written"):
        raise typer.Exit(run_objects_check(objects=file, rig=rig, json=json, calibration=not no_calibration))
