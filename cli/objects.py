"""The commands for object models: `objects import`, `objects show`, `objects check`.

Registered on the command line's app by `add_to`.
"""

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from palpate.cli.interruption import if_interrupted

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


class _Units(StrEnum):
    """Of files that say none."""

    MM = "mm"
    INCH = "inch"
    M = "m"


class _States(StrEnum):
    """Which ways to rest are imported."""

    AUTO = "auto"
    AS_IS = "as-is"


def add_to(app: typer.Typer) -> None:
    """Add the commands to the app."""
    objects = typer.Typer(
        help="Object models: make them from CAD files, see them, and what a rig can tell apart.",
        no_args_is_help=True,
        pretty_exceptions_enable=False,
        context_settings={"help_option_names": ["-h", "--help"]},
    )
    objects.command("import")(_import)
    objects.command("show")(_show)
    objects.command("check")(_check)
    app.add_typer(objects, name="objects")


def _import(
    file: Annotated[
        Path,
        typer.Argument(help="STL, OBJ, PLY, 3MF or STEP; drawings: DXF or SVG.", show_default=False),
    ],
    units: Annotated[
        _Units | None, typer.Option("--units", help="The file's units; needed where it has none.")
    ] = None,
    thickness: Annotated[
        float | None, typer.Option("--thickness", metavar="MM", help="Of a drawing: height of the part.")
    ] = None,
    heights: Annotated[
        str | None,
        typer.Option("--heights", metavar="MM,…", help="Sections within 0.5 mm of these only, such as 5,12."),
    ] = None,
    states: Annotated[
        _States,
        typer.Option(
            "--states", help="All stable states, or only as it lies in the file, on its lowest point."
        ),
    ] = _States.AUTO,
    least_probability: Annotated[
        float,
        typer.Option("--least-probability", metavar="P", help="States that are less probable are left out."),
    ] = 0.01,
    tolerance: Annotated[
        float,
        typer.Option(
            "--tolerance", metavar="MM", help="What the model may be off the file; all parts added."
        ),
    ] = 0.1,
    deviation: Annotated[
        float,
        typer.Option(
            "--deviation", metavar="MM", help="How far the made part may be off the file; comes on top."
        ),
    ] = 0.0,
    name: Annotated[
        str | None, typer.Option("--name", help="What to call the object; else as the file does.")
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out", metavar="FILE", help="Objects file; else FILE's name with .objects.json, here."
        ),
    ] = None,
    add: Annotated[
        bool,
        typer.Option("--add", help="Add to the objects file, if there is one; same names are replaced."),
    ] = False,
    json: _JsonOption = False,
) -> None:
    """Make object models from a CAD file: stable states and their cross sections.

    Refused, with the place: surfaces that are not closed or cross themselves, open outlines, files without
    units, parts of odd sizes.
    """
    from palpate.cli.objects_import import Into, heights_of, run_import
    from palpate.rig.catalogue.cad_import import ImportOptions

    with if_interrupted("nothing was written"):
        raise typer.Exit(
            run_import(
                file,
                ImportOptions(
                    units=None if units is None else units.value,
                    name=name,
                    tolerance_mm=tolerance,
                    deviation_mm=deviation,
                    heights_mm=None if heights is None else heights_of(heights),
                    thickness_mm=thickness,
                    as_is=states is _States.AS_IS,
                    least_probability=least_probability,
                ),
                Into(out, add=add),
                json=json,
            )
        )


def _show(
    file: _FileArgument,
    rig: _RigOption = None,
    picture: Annotated[
        Path | None,
        typer.Option("--picture", help="Where to write the picture (SVG); FILE's stem + .objects.svg, here."),
    ] = None,
    no_calibration: _NoCalibrationOption = False,
    every: Annotated[bool, typer.Option("--all", help="List all states, and pairs one by one.")] = False,
    json: _JsonOption = False,
) -> None:
    """List every state of every object, and draw its sections into one picture (SVG).

    Says which states the rig's fingers would not tell apart; `objects check` says what would.
    """
    from palpate.cli.objects_show import run_objects_show

    with if_interrupted("no picture was written"):
        raise typer.Exit(
            run_objects_show(
                objects=file,
                rig=rig,
                picture=picture,
                every=every,
                json=json,
                calibration=not no_calibration,
            )
        )


def _check(
    file: _FileArgument,
    rig: _RigOption = None,
    no_calibration: _NoCalibrationOption = False,
    json: _JsonOption = False,
) -> None:
    """Find states that a rig's fingers can never tell apart, and heights at which a finger would.

    Exit code 1: some pair can never be distinguished. Pairs for which that is open: 0.
    """
    from palpate.cli.objects_check import run_objects_check

    with if_interrupted("nothing was written"):
        raise typer.Exit(run_objects_check(objects=file, rig=rig, json=json, calibration=not no_calibration))
