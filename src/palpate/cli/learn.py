"""Commands of learning: `objects learn` makes a model of a part that nobody has drawn, `study-learning` says
what that costs.
"""

from pathlib import Path
from typing import Annotated

import typer

from palpate.base.vocabulary import SESSIONS_FOLDER
from palpate.cli.terminal import (
    JsonOption,
    NoCalibrationOption,
    ObjectsOption,
    RigOption,
    SceneOption,
    SeedOption,
    SessionsOption,
    WorkersOption,
    note_on_interruption,
)

_HeightOption = Annotated[
    float, typer.Option("--height", metavar="MM", help="How high the part is.", show_default=False)
]
_ToleranceOption = Annotated[
    float, typer.Option("--tolerance", metavar="MM", help="Tolerance of the model that is asked for.")
]
_MaxSecondsOption = Annotated[
    float, typer.Option("--max-seconds", metavar="S", help="After so much time the model is as it is.")
]


@note_on_interruption("nothing was written")
def learn(
    name: Annotated[str, typer.Argument(metavar="NAME", help="What to call it.", show_default=False)],
    height: _HeightOption,
    rig: RigOption = None,
    tolerance: _ToleranceOption = 2.0,
    max_seconds: _MaxSecondsOption = 900.0,
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
    sessions: SessionsOption = Path(SESSIONS_FOLDER),
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
            sessions=sessions,
            progress=doing.now,
        )
    if picture is not None:
        write_text(picture, learned.picture())
    written = ""
    if learned.model is not None:
        write_text(place, file_text(learned.objects))
        written = f"; written to {place}"
    if learned.session is not None:
        written += f"; session {learned.session}"
    typer.echo(learned.to_json() if json else f"{name}: {learned.text}{written}")
    return 0 if learned.goal_met else 1


@note_on_interruption("runs that were done are lost")
def study_learning(
    height: _HeightOption,
    rig: RigOption = None,
    objects: ObjectsOption = None,
    runs: Annotated[int, typer.Option("--runs", min=1, help="Parts that are learned.")] = 10,
    tolerance: _ToleranceOption = 2.0,
    max_seconds: _MaxSecondsOption = 900.0,
    seed: Annotated[
        int, typer.Option("--seed", min=0, help="Draws parts, places and errors of touches.")
    ] = 0,
    workers: WorkersOption = None,
    json: JsonOption = False,
) -> int:
    """Say how many touches, and how much of a rig's time, it takes to learn parts, by their tolerance.

    Parts of a catalogue are learned as if nobody had drawn them; touches are simulated within the rig's
    bounds. Exit code 1: a truth was outside its bounds.
    """
    from palpate.cli.terminal import StatusLine, Terminal
    from palpate.config.fields import to_json
    from palpate.jobs.files import load_objects, name_of
    from palpate.jobs.learning_study import study_learning as studied
    from palpate.jobs.rig import open_rig
    from palpate.views.report.study_text import learning_study_lines

    bench, models = open_rig(rig).file, load_objects(objects)
    with StatusLine(Terminal(stderr=True, soft_wrap=True), "preparing", written_every_s=60.0) as doing:
        out = studied(
            bench,
            models,
            height_mm=height,
            tolerance_mm=tolerance,
            max_seconds=max_seconds,
            runs=runs,
            seed=seed,
            workers=workers,
            name=name_of(objects),
            progress=doing.now,
        )
    typer.echo(to_json(out) if json else "\n".join(learning_study_lines(out)))
    return 1 if out.outside else 0
