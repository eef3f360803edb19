"""`palpate objects show`: what a file of objects holds, as a listing and as a picture."""

from pathlib import Path
from typing import Annotated

import typer

from palpate.cli.interruption import if_interrupted
from palpate.cli.options import JsonOption, NoCalibrationOption, ObjectsArgument, RigOption

__all__ = ["show_objects"]


@if_interrupted("no picture was written")
def show_objects(
    file: ObjectsArgument,
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
    from palpate.base.files.writing import check_places, write_text
    from palpate.cli.output_places import rig_files
    from palpate.cli.terminal import Doing, Terminal
    from palpate.config.results import to_json
    from palpate.jobs.catalogue import list_objects
    from palpate.jobs.files import load_objects
    from palpate.jobs.rig import open_rig
    from palpate.views.catalogue.listing import print_listing

    bench, models = open_rig(rig, calibration=not no_calibration).file, load_objects(file)
    # In the current folder, and named so that no drawing beside the file is written over.
    place = picture or Path(f"{file.stem.removesuffix('.objects')}.objects.svg")
    read = {**rig_files(rig), "FILE": file}
    check_places({"--picture": place}, read)
    with Doing(Terminal(stderr=True, soft_wrap=True), "reading") as doing:
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
