"""`palpate objects show`: what a file of objects holds, as a listing and as a picture."""

from pathlib import Path

import typer

from palpate.api.catalogue import list_objects
from palpate.api.files import load_objects
from palpate.api.rig import open_rig
from palpate.cli.terminal import Doing, Terminal
from palpate.config.results import to_json
from palpate.files.writing import check_place, write_text
from palpate.views.catalogue.listing import print_listing

__all__ = ["picture_beside", "run_objects_show"]


def run_objects_show(
    *,
    objects: Path,
    rig: Path | None,
    picture: Path | None,
    every: bool = False,
    json: bool = False,
    calibration: bool = True,
) -> int:
    """List, draw and print; returns the exit code, 0. An existing picture is written over.

    `every`: a long listing, with each state and pair for itself; JSON has them always.
    """
    file, models = open_rig(rig, calibration=calibration).file, load_objects(objects)
    place = picture or picture_beside(objects)
    check_place(place)
    with Doing(Terminal(stderr=True, soft_wrap=True), "reading") as doing:
        listing = list_objects(file, models, name=objects.name, progress=doing.now)
    write_text(place, listing.svg)
    out = listing.out(file, str(objects), str(place), shipped=rig is None)
    if json:
        typer.echo(to_json(out))
    else:
        console = Terminal(highlight=False, markup=False, emoji=False, soft_wrap=True)
        print_listing(out, console, every=every)
    return 0


def picture_beside(objects: Path) -> Path:
    """Where the picture goes unless told: in the current folder, named so that no drawing is written over."""
    return Path(f"{objects.stem.removesuffix('.objects')}.objects.svg")
