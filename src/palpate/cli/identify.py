"""Commands of recognition: `identify` with a rig, `recognize` and `plan` from a file of contacts."""

from pathlib import Path
from typing import Annotated

import typer

from palpate.base.errors import PalpateError
from palpate.base.vocabulary import (
    DEFAULT_BUDGET,
    LEAST_BUDGET,
    SESSIONS_FOLDER,
    IdentificationVerdict,
    RecognitionVerdict,
    Strategy,
)
from palpate.cli.options import (
    VIEW_PORT,
    ContactsOption,
    JsonOption,
    NoCalibrationOption,
    ObjectsOption,
    PictureOption,
    RigOption,
    SceneOption,
    SeedOption,
    StrategyOption,
    ViewOption,
    ViewPortOption,
)

_SESSIONS = Path(SESSIONS_FOLDER)


def identify(
    rig: RigOption = None,
    objects: ObjectsOption = None,
    scene: SceneOption = None,
    seed: SeedOption = 0,
    json: JsonOption = False,
    picture: PictureOption = None,
    strategy: StrategyOption = Strategy.PLANNED,
    sessions: Annotated[Path, typer.Option("--sessions", help="Folder for session logs.")] = _SESSIONS,
    no_calibration: NoCalibrationOption = False,
    view: ViewOption = False,
    view_port: ViewPortOption = VIEW_PORT,
) -> int:
    """Touch what lies on the table until it is known which object it is and where."""
    from palpate.base.file_io import check_places, write_text
    from palpate.cli.options import rig_files, scene_files
    from palpate.cli.run_display import IdentificationProgress, closing_lines, view_starter
    from palpate.cli.terminal import Terminal, print_notices
    from palpate.jobs.rig import open_rig

    opened = open_rig(rig, seed=seed, calibration=not no_calibration)
    read = {**rig_files(rig), "--objects": objects, **scene_files(scene)}
    check_places({"--picture": picture}, read)
    terminal = Terminal(stderr=True, highlight=False, markup=False)
    with IdentificationProgress(terminal) as progress:
        answer = opened.identify(
            objects,
            scene=scene,
            strategy=strategy.value,
            sessions=sessions,
            on_event=progress,
            on_session=view_starter(view_port) if view else lambda _: None,
            notice=terminal.print,
            warn=lambda line: print_notices([line]),
            progress=progress.now,
        )
    failure = answer.failure
    try:
        if picture is not None:
            write_text(picture, answer.picture())
    except PalpateError as error:  # an answer that could not be written down is still an answer
        failure = failure or error
    place = picture or Path(answer.session or "", "picture.svg")
    typer.echo(answer.to_json() if json else "\n".join(closing_lines(answer, place)))
    if failure is not None:
        raise failure
    answered = (IdentificationVerdict.IDENTIFIED, IdentificationVerdict.INDISTINGUISHABLE)
    return 0 if answer.verdict in answered else 1


def recognize(
    objects: Annotated[Path, typer.Option("--objects", help="Object models (JSON).")],
    contacts: ContactsOption,
    json: JsonOption = False,
    picture: PictureOption = None,
    max_spurious: Annotated[
        int, typer.Option("--max-spurious", min=0, help="As many contacts need not be the object's.")
    ] = 0,
    budget: Annotated[
        int, typer.Option("--budget", min=LEAST_BUDGET, help="Units of work: more give narrower bounds.")
    ] = DEFAULT_BUDGET,
    why: Annotated[
        str | None,
        typer.Option("--why", metavar="OBJECT[/STATE]", help="Also say why this object was ruled out."),
    ] = None,
    statistics: Annotated[
        bool, typer.Option("--statistics", help="Also count interpretations as the memo's tables do.")
    ] = False,
) -> int:
    """Say which objects, states and configurations agree with a file of contacts."""
    from palpate.base.file_io import check_places, write_text
    from palpate.cli.terminal import StatusLine, Terminal
    from palpate.jobs.recognition import recognise
    from palpate.recognizer import memo_counts
    from palpate.views.recognition_text import recognition_lines

    check_places({"--picture": picture}, {"--objects": objects, "--contacts": contacts})
    with StatusLine(Terminal(stderr=True, soft_wrap=True), "reading") as doing:
        answer = recognise(objects, contacts, max_spurious=max_spurious, budget=budget, progress=doing.now)
    because = None if why is None else answer.why(why)
    memo = memo_counts(answer.catalogue, answer.contacts.contacts) if statistics else None
    if picture is not None:
        write_text(picture, answer.picture())
    if json:
        typer.echo(answer.to_json(because, memo))
    else:
        for line in recognition_lines(
            answer.recognition, answer.contacts, answer.explanation(), because, memo, answer.seconds
        ):
            typer.echo(line)
    return 0 if answer.verdict is RecognitionVerdict.UNIQUE else 1


def plan(
    contacts: ContactsOption,
    rig: RigOption = None,
    objects: ObjectsOption = None,
    strategy: StrategyOption = Strategy.PLANNED,
    seed: Annotated[int, typer.Option("--seed", min=0, help="Draws the grip of --strategy random.")] = 0,
    json: JsonOption = False,
    picture: PictureOption = None,
    no_calibration: NoCalibrationOption = False,
) -> int:
    """Plan the next grip, and say what each hypothesis predicts of it.

    Exit code 1: nothing fits, or nothing within reach tells apart what does.
    """
    from palpate.base.file_io import check_places, write_text
    from palpate.cli.options import rig_files
    from palpate.cli.terminal import StatusLine, Terminal, print_notices
    from palpate.jobs.files import load_objects, name_of
    from palpate.jobs.rig import open_rig
    from palpate.rig.catalogue.reachability import finding_lines
    from palpate.views.plan_table import print_plan
    from palpate.views.recognition_text import explain, explanation_lines

    opened = open_rig(rig, seed=seed, calibration=not no_calibration)
    models = load_objects(objects)
    check_places({"--picture": picture}, {**rig_files(rig), "--objects": objects, "--contacts": contacts})
    with StatusLine(Terminal(stderr=True, soft_wrap=True), "planning") as doing:
        answer = opened.plan(models, contacts, strategy=strategy.value, progress=doing.now)
    print_notices(finding_lines(opened.file, models.objects, name_of(objects)))
    if picture is not None:
        write_text(picture, answer.picture())
    if json:
        typer.echo(answer.to_json())
    elif answer.planned.recognition.verdict is RecognitionVerdict.NONE:
        touched = sum(item.touched for item in answer.contacts.contacts)
        typer.echo(f"none: 0 hypotheses after {touched} contacts")
        for line in explanation_lines(explain(answer.catalogue, answer.contacts, 0), answer.contacts):
            typer.echo(f"  {line}")
    else:
        print_plan(answer.planned, Terminal(highlight=False, markup=False, emoji=False))
    return 1 if answer.is_dead_end else 0
