"""Command `palpate objects learn`: an object model of a part that nobody has drawn."""

from pathlib import Path
from typing import Annotated

import typer

from palpate.cli.terminal import (
    JsonOption,
    NoCalibrationOption,
    RigOption,
    SceneOption,
    SeedOption,
    note_on_interruption,
)


@note_on_interruption("nothing was written")
def learn(
    name: Annotated[str, typer.Argument(metavar="NAME", help="What to call it.", show_default=False)],
    height: Annotated[
        float, typer.Option("--height", metavar="MM", help="How high the part is.", show_default=False)
    ],
    rig: RigOption = None,
    tolerance: Annotated[
        float, typer.Option("--tolerance", metavar="MM", help="Tolerance of the model that is asked for.")
    ] = 2.0,
    max_seconds: Annotated[
        float,
        typer.Option("--max-seconds", metavar="S", help="After so much time the model is written as it is."),
    ] = 900.0,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out", metavar="FILE", help="Objects file; else NAME.objects.json, here.", show_default=False
        ),
    ] = None,
    picture: Annotated[
        Path | None, typer.Option("--picture", help="Also draw bounds, touches and model (SVG).")
    ] = None,
    objects: Annotated[
        Path | None,
        typer.Option(
            "--objects",
            help="What is known already: only what is none of these is learned, and written with them.",
        ),
    ] = None,
    state: Annotated[
        str, typer.Option("--state", metavar="STATE", help="What to call the way it lies now.")
    ] = "learned",
    contacts: Annotated[
        Path | None,
        typer.Option(
            "--contacts", help="Contacts of this part as it lies, to go on from: a session's contacts.json."
        ),
    ] = None,
    scene: SceneOption = None,
    seed: SeedOption = 0,
    no_calibration: NoCalibrationOption = False,
    unconfirmed: Annotated[
        bool, typer.Option("--unconfirmed", help="On a real rig whose wiring was never proven, too.")
    ] = False,
    json: JsonOption = False,
) -> int:
    """Touch round a part that is held on the table, and write an object model of it.

    With --objects it is recognised first. Exit code 1: it is neither known nor was it learned, or its
    tolerance is not what was asked for.
    """
    from palpate.base.errors import InputError
    from palpate.base.file_io import check_places, write_text
    from palpate.cli.terminal import StatusLine, Terminal, rig_files, scene_files
    from palpate.config.writers import file_text
    from palpate.jobs.rig import open_rig

    place = out or Path(f"{name}.objects.json")
    read = {**rig_files(rig), "--objects": objects, "--contacts": contacts, **scene_files(scene)}
    check_places({"--out": place, "--picture": picture}, read)
    if not place.parent.is_dir():
        raise InputError(f"{place} cannot be written: there is no folder {place.parent}")
    if place.exists():
        raise InputError(f"{place} is there already; choose another with --out")
    opened = open_rig(rig, seed=seed, calibration=not no_calibration)
    with StatusLine(Terminal(stderr=True, soft_wrap=True), "connecting", written_every_s=30.0) as doing:
        learned = opened.learn(
            name,
            height_mm=height,
            tolerance_mm=tolerance,
            max_seconds=max_seconds,
            objects=objects,
            state=state,
            contacts=contacts or (),
            scene=scene,
            unconfirmed=unconfirmed,
            progress=doing.now,
        )
    if picture is not None:
        write_text(picture, learned.picture())
    written = ""
    if learned.model is not None:
        write_text(place, file_text(learned.objects))
        written = f"; written to {place}"
    typer.echo(learned.to_json() if json else f"{name}: {learned.text}{written}")
    return 0 if learned.goal_met else 1
