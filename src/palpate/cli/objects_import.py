"""`palpate objects import`: from a CAD file to an objects file."""

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from palpate.cli.interruption import if_interrupted
from palpate.cli.options import JsonOption

__all__ = ["import_objects"]


class _Units(StrEnum):
    """Of files that say none."""

    MM = "mm"
    INCH = "inch"
    M = "m"
    PT = "pt"


class _States(StrEnum):
    """Which ways to rest are imported."""

    AUTO = "auto"
    AS_IS = "as-is"


@if_interrupted("nothing was written")
def import_objects(
    paths: Annotated[
        list[Path],
        typer.Argument(
            metavar="FILE|FOLDER…",
            help="STL, OBJ, PLY, 3MF or STEP; drawings: DXF or SVG. Of several, only what changed is read.",
            show_default=False,
        ),
    ],
    units: Annotated[
        _Units | None, typer.Option("--units", help="The file's units; needed where it has none.")
    ] = None,
    thickness: Annotated[
        float | None, typer.Option("--thickness", metavar="MM", help="Of a drawing: height of the part.")
    ] = None,
    layers: Annotated[
        str | None,
        typer.Option("--layers", metavar="NAME,…", help="Of a DXF file: the layers with outlines."),
    ] = None,
    parts: Annotated[
        str | None,
        typer.Option(
            "--parts", metavar="NAME,…", help="Of a file with several parts: names, or numbers from 1."
        ),
    ] = None,
    rig: Annotated[
        Path | None,
        typer.Option(
            "--rig", help="Sections within 0.5 mm of this rig's fingers; without it, of the shipped one's."
        ),
    ] = None,
    heights: Annotated[
        str | None,
        typer.Option("--heights", metavar="MM,…", help="Sections within 0.5 mm of these, such as 5,12."),
    ] = None,
    all_heights: Annotated[
        bool, typer.Option("--all-heights", help="Sections at all heights: takes longer, for any rig.")
    ] = False,
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
    accept_loss: Annotated[
        bool,
        typer.Option("--accept-loss", help="Although states that are left out are over 20 % of all cases."),
    ] = False,
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
            "--out",
            metavar="FILE",
            help="Objects file; else the name of FILE or FOLDER with .objects.json, here.",
        ),
    ] = None,
    add: Annotated[
        bool,
        typer.Option(
            "--add", help="Add to the objects file, if there is one; what came from other files stays."
        ),
    ] = False,
    json: JsonOption = False,
) -> int:
    """Make object models from CAD files: stable states and their cross sections.

    Refused, with the place: surfaces that are not closed or cross themselves, open outlines, files without
    units, parts of odd sizes. Exit code: 1 if some of several files are refused, or states that are left out
    are over 20 % of all cases, 2 if all are refused.
    """
    import time

    from palpate.base.files.writing import check_places
    from palpate.cli.objects_file import ObjectsTarget, check_options, listed, load_target, wanted_heights
    from palpate.cli.output_places import rig_files, several_files
    from palpate.cli.terminal import Doing, Terminal
    from palpate.config.import_result import ImportOut
    from palpate.config.results import to_json
    from palpate.rig.catalogue.cad_import import ImportOptions
    from palpate.rig.catalogue.folder_import import files_in, import_files
    from palpate.views.import_table import files_out, show, show_files

    begin = time.perf_counter()
    options = ImportOptions(
        units=None if units is None else units.value,
        name=name,
        tolerance_mm=tolerance,
        deviation_mm=deviation,
        heights_mm=wanted_heights(rig, heights, all_heights=all_heights),
        thickness_mm=thickness,
        as_is=states is _States.AS_IS,
        least_probability=least_probability,
        accept_loss=accept_loss,
        layers=listed("--layers", layers),
        parts=listed("--parts", parts),
    )
    several = len(paths) > 1 or paths[0].is_dir()
    check_options(options, several=several)
    files = files_in(paths)
    target = out or Path(f"{paths[0].stem or paths[0].resolve().name}.objects.json")
    check_places({"--out": target}, {**rig_files(rig), **several_files(files)})
    there = load_target(target, add=add, again=several)
    console = Terminal(stderr=True, soft_wrap=True, highlight=False)
    with Doing(console, "reading") as doing, ObjectsTarget(target, there) as file:
        made = import_files(files, options, target, there, doing.now, keep=file.keep, several=several)
        doing.now(f"writing {target}")
        size = file.write(made.text) if made.text.objects else 0
    new = [item for outcome in made.files for item in outcome.objects]
    result = ImportOut(
        source=", ".join(map(str, paths)),
        objects_file=str(target),
        bytes=size,
        objects=tuple(item.result for item in new),
        warnings=(
            *(text for outcome in made.files for text in outcome.warnings),
            *(f'object "{name}" is kept, though its file {file} is gone' for name, file in made.gone),
        ),
        files=files_out(made),
        seconds=time.perf_counter() - begin,
    )
    if json:
        typer.echo(to_json(result))
    screen = console if json else Terminal(highlight=False)
    one_by_one = several or any(outcome.failure for outcome in made.files)
    (show_files if one_by_one else show)(result, screen)
    failed = [outcome for outcome in made.files if outcome.failure is not None]
    all_refused = len(failed) == len(made.files) and not any(outcome.is_loss for outcome in failed)
    return 2 if all_refused else 1 if failed else 0
