"""Commands on objects files: `palpate objects import`, `list`, `show`, `check` and those that edit them."""

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from palpate.cli.terminal import (
    JsonOption,
    NoCalibrationOption,
    ObjectsArgument,
    RigOption,
    note_on_interruption,
)


class _Units(StrEnum):
    """Units of files that say none."""

    MM = "mm"
    INCH = "inch"
    M = "m"
    PT = "pt"


class _States(StrEnum):
    """Ways to rest that are imported."""

    AUTO = "auto"
    AS_IS = "as-is"


@note_on_interruption("nothing was written")
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
        _States | None,
        typer.Option(
            "--states",
            help="All stable states (auto), or only as it lies in the file, on its lowest point.",
            show_default="auto",
        ),
    ] = None,
    least_probability: Annotated[
        float | None,
        typer.Option(
            "--least-probability",
            metavar="P",
            help="States that are less probable are left out.",
            show_default="0.01",
        ),
    ] = None,
    accept_loss: Annotated[
        bool,
        typer.Option("--accept-loss", help="Although states that are left out are over 20 % of all cases."),
    ] = False,
    tolerance: Annotated[
        float | None,
        typer.Option(
            "--tolerance",
            metavar="MM",
            help="What the model may be off the file; all parts added.",
            show_default="0.1",
        ),
    ] = None,
    deviation: Annotated[
        float | None,
        typer.Option(
            "--deviation",
            metavar="MM",
            help="How far the made part may be off the file; comes on top.",
            show_default="0",
        ),
    ] = None,
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
    recursive: Annotated[
        bool, typer.Option("--recursive", help="Enter the folders of a FOLDER, but for hidden ones.")
    ] = False,
    settings: Annotated[
        Path | None,
        typer.Option(
            "--settings",
            metavar="FILE",
            help="Settings of files (TOML); else palpate-import.toml of their folder, if it has one.",
        ),
    ] = None,
    write_settings: Annotated[
        bool,
        typer.Option(
            "--write-settings", help="Write palpate-import.toml into the FOLDER, to be filled in, and stop."
        ),
    ] = False,
    json: JsonOption = False,
) -> int:
    """Make object models from CAD files: stable states and their cross sections.

    Refused, with the place: surfaces that are not closed or cross themselves, open outlines, files without
    units, parts of odd sizes. Exit code: 1 if some of several files or parts are refused, or states that are
    left out are over 20 % of all cases, 2 if all are refused.
    """
    import time

    from palpate.base.file_io import check_places
    from palpate.cli.import_options import RequestedOptions, SettingsOfFiles, write_settings_template
    from palpate.cli.objects_target import (
        ObjectsTarget,
        check_options,
        load_target,
        requested_heights,
        split_names,
    )
    from palpate.cli.terminal import StatusLine, Terminal, rig_files, several_files
    from palpate.config.catalogue_results import ImportOut
    from palpate.config.fields import to_json
    from palpate.rig.catalogue.folder_import import files_in, import_files
    from palpate.views.import_table import files_out, show_files, show_import

    begin = time.perf_counter()
    said: dict[str, object] = {
        "units": None if units is None else units.value,
        "name": name,
        "tolerance_mm": tolerance,
        "deviation_mm": deviation,
        "thickness_mm": thickness,
        "states": None if states is None else states.value,
        "least_probability": least_probability,
        "accept_loss": accept_loss or None,
        "layers": split_names("--layers", layers) or None,
        "parts": split_names("--parts", parts) or None,
    }
    several = len(paths) > 1 or paths[0].is_dir()
    asked = RequestedOptions(
        {key: value for key, value in said.items() if value is not None},
        requested_heights(rig, heights, all_heights=all_heights),
        SettingsOfFiles.load(paths[0], settings),
    )
    check_options(asked.of(None), several=several)
    found = asked.select(files_in(paths, recursive=recursive))
    files = found.paths
    if write_settings:
        place = write_settings_template(paths[0], files)
        typer.echo(f"{place}: {len(files)} files; fill it in, then import again")
        return 0
    target = out or Path(f"{paths[0].stem or paths[0].resolve().name}.objects.json")
    read = {**rig_files(rig), "--settings": settings, **several_files(files)}
    check_places({"--out": target}, read)
    there = load_target(target, add=add, again=several)
    console = Terminal(stderr=True, soft_wrap=True, highlight=False)
    with StatusLine(console, "reading") as doing, ObjectsTarget(target, there) as file:
        made = import_files(files, asked.of, target, there, doing.now, keep=file.keep, several=several)
        doing.now(f"writing {target}")
        size = file.write(made.text) if made.text.objects else 0
    new = [item for outcome in made.files for item in outcome.objects]
    result = ImportOut(
        source=", ".join(map(str, paths)),
        objects_file=str(target),
        bytes=size,
        objects=tuple(item.result for item in new),
        warnings=(
            *found.left_out,
            *(text for outcome in made.files for text in outcome.warnings),
            *(
                f'object "{name}" is kept, though its file {file} is gone; '
                f"palpate objects remove takes it out of {target}"
                for name, file in made.gone
            ),
        ),
        files=files_out(made),
        seconds=time.perf_counter() - begin,
    )
    if json:
        typer.echo(to_json(result))
    screen = console if json else Terminal(highlight=False)
    one_by_one = several or any(outcome.failure for outcome in made.files)
    (show_files if one_by_one else show_import)(result, screen)
    failed = [outcome for outcome in made.files if outcome.failure is not None]
    all_refused = len(failed) == len(made.files) and not any(outcome.is_loss for outcome in failed)
    some_refused = failed or any(outcome.refused for outcome in made.files)
    return 2 if all_refused else 1 if some_refused else 0


@note_on_interruption("nothing was written")
def list_objects(
    file: ObjectsArgument,
    names: Annotated[
        list[str] | None, typer.Argument(metavar="NAME…", help="List their states.", show_default=False)
    ] = None,
    tags: Annotated[
        list[str] | None,
        typer.Option("--tag", metavar="TAG", help="Only objects with this tag; may be given again."),
    ] = None,
    json: JsonOption = False,
) -> None:
    """List the objects of a file: size, mass, states, and at which heights they are known.

    Nothing is compared or drawn; `objects show` does both.
    """
    from palpate.cli.objects_target import load_for_edit
    from palpate.cli.terminal import Terminal
    from palpate.config.fields import to_json
    from palpate.config.objects_tables import select_objects, select_tagged
    from palpate.views.catalogue.inventory import inventory_out, print_inventory, print_states

    text = load_for_edit(file)
    text = select_objects(text, names, str(file)) if names else text
    text = select_tagged(text, tags, str(file)) if tags else text
    out = inventory_out(str(file), text)
    if json:
        typer.echo(to_json(out))
    else:
        (print_states if names else print_inventory)(out, Terminal(highlight=False, soft_wrap=True))


@note_on_interruption("no picture was written")
def show_objects(
    file: ObjectsArgument,
    names: Annotated[
        list[str] | None, typer.Argument(metavar="NAME…", help="Only these.", show_default=False)
    ] = None,
    rig: RigOption = None,
    picture: Annotated[
        Path | None,
        typer.Option(
            "--picture",
            help="Where to write the picture (SVG); FILE's stem + .objects.svg, here; further pages: -2, …",
        ),
    ] = None,
    no_calibration: NoCalibrationOption = False,
    every: Annotated[bool, typer.Option("--all", help="List all states, and pairs one by one.")] = False,
    json: JsonOption = False,
) -> None:
    """List every state of every object, and draw its sections into a picture (SVG), 60 cards a page.

    Says which states the rig's fingers would not tell apart; `objects check` says what would.
    """
    from palpate.base.file_io import check_places, write_text
    from palpate.cli.terminal import StatusLine, Terminal, rig_files
    from palpate.config.fields import to_json
    from palpate.jobs.catalogue import list_objects
    from palpate.jobs.files import load_objects
    from palpate.jobs.rig import open_rig
    from palpate.views.catalogue.listing import print_listing

    bench, models = open_rig(rig, calibration=not no_calibration).file, load_objects(file)
    models = models.select(names, str(file)) if names else models
    # In the current folder, and named so that no drawing beside the file is written over.
    place = picture or Path(f"{file.stem.removesuffix('.objects')}.objects.svg")
    read = {**rig_files(rig), "FILE": file}
    check_places({"--picture": place}, read)
    with StatusLine(Terminal(stderr=True, soft_wrap=True), "reading") as doing:
        listing = list_objects(bench, models, name=file.name, progress=doing.now)
    places = [
        place if page == 1 else place.with_stem(f"{place.stem}-{page}")
        for page in range(1, len(listing.pages) + 1)
    ]
    check_places({f"page {page} of the picture": where for page, where in enumerate(places, 1)}, read)
    for where, page in zip(places, listing.pages, strict=True):
        write_text(where, page)
    out = listing.out(bench, str(file), list(map(str, places)), shipped=rig is None)
    if json:
        typer.echo(to_json(out))
    else:
        print_listing(out, Terminal(highlight=False, markup=False, emoji=False, soft_wrap=True), every=every)


@note_on_interruption("nothing was written")
def check_objects(
    file: ObjectsArgument,
    rig: RigOption = None,
    no_calibration: NoCalibrationOption = False,
    report: Annotated[
        Path | None,
        typer.Option(
            "--report", help="Also write it here as a page (HTML), with every state and its sections."
        ),
    ] = None,
    every: Annotated[bool, typer.Option("--all", help="List all pairs, however many there are.")] = False,
    json: JsonOption = False,
) -> int:
    """Find states that a rig's fingers can never tell apart, and heights at which a finger would.

    Exit code 1: some pair can never be distinguished. Pairs for which that is open: 0.
    """
    from palpate.base.file_io import check_places, write_text
    from palpate.cli.terminal import StatusLine, Terminal, print_notices, rig_files
    from palpate.config.fields import to_json
    from palpate.jobs import catalogue
    from palpate.jobs.files import load_objects
    from palpate.jobs.rig import open_rig
    from palpate.rig.catalogue.reachability import finding_lines
    from palpate.views.catalogue.check_text import catalogue_report, check_lines

    bench, models, name = open_rig(rig, calibration=not no_calibration).file, load_objects(file), str(file)
    check_places({"--report": report}, {**rig_files(rig), "FILE": file})
    notices = finding_lines(bench, models.objects, name)
    print_notices(notices)
    with StatusLine(Terminal(stderr=True, soft_wrap=True), "comparing") as doing:
        out = catalogue.check_objects(bench, models, name=name, shipped=rig is None, progress=doing.now)
        if report is not None:
            listing = catalogue.list_objects(bench, models, name=file.name, progress=doing.now)
            write_text(report, catalogue_report(out, listing.states, listing.pages, notices))
    typer.echo(to_json(out) if json else "\n".join(check_lines(out, every=every)))
    return 1 if any(pair.likeness == "same" for pair in out.pairs) else 0


@note_on_interruption("the file is as it was")
def remove(
    file: ObjectsArgument,
    names: Annotated[list[str], typer.Argument(metavar="NAME…", show_default=False)],
) -> None:
    """Remove objects from an objects file.

    An imported object comes back with the next import of its folder, unless its CAD file is moved away.
    """
    from palpate.base.errors import quantity
    from palpate.cli.objects_target import load_for_edit, write_edited
    from palpate.config.objects_tables import remove_objects

    before = load_for_edit(file)
    after = remove_objects(before, names, str(file))
    write_edited(file, after)
    removed = quantity(len(before.objects) - len(after.objects), "object", "objects")
    typer.echo(f"{removed} removed, {len(after.objects)} left in {file}")


@note_on_interruption("the file is as it was")
def rename(
    file: ObjectsArgument,
    old: Annotated[str, typer.Argument(metavar="NAME", show_default=False)],
    new: Annotated[str, typer.Argument(metavar="NEW", show_default=False)],
) -> None:
    """Rename an object of an objects file. Scenes and scripts that name it are not changed."""
    from palpate.cli.objects_target import check_name, load_for_edit, write_edited
    from palpate.config.objects_tables import rename_object

    check_name("NEW", new)
    write_edited(file, rename_object(load_for_edit(file), old, new, str(file)))
    typer.echo(f"{old} is now {new} in {file}")


@note_on_interruption("nothing was written")
def merge(
    files: Annotated[
        list[Path], typer.Argument(metavar="FILE…", help="Objects files (JSON).", show_default=False)
    ],
    out: Annotated[
        Path, typer.Option("--out", metavar="FILE", help="The new objects file.", show_default=False)
    ],
) -> None:
    """Merge objects files into a new one. Two different objects of one name are refused."""
    from palpate.base.errors import InputError, quantity
    from palpate.cli.objects_target import load_for_edit, write_edited
    from palpate.config.objects_tables import merge_objects

    if out.exists():
        raise InputError(f"{out} is there already; choose another with --out")
    made = merge_objects([(file, load_for_edit(file)) for file in files], out)
    write_edited(out, made)
    typer.echo(f"{quantity(len(made.objects), 'object', 'objects')} in {out}")
