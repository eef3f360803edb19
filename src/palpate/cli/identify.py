"""Commands of recognition: `identify` with a rig, `recognize` and `plan` from contacts, `study` simulated."""

from pathlib import Path
from typing import Annotated

import typer

from palpate.base.errors import PalpateError, printable_text
from palpate.base.vocabulary import (
    DEFAULT_BUDGET,
    LEAST_BUDGET,
    SESSIONS_FOLDER,
    PartMotion,
    RecognitionVerdict,
    Strategy,
)
from palpate.cli.terminal import (
    FOXGLOVE_PORT,
    VIEW_PORT,
    ContactsOption,
    FoxgloveOption,
    JsonOption,
    NoCalibrationOption,
    ObjectsOption,
    PictureOption,
    RigOption,
    RosOption,
    SceneOption,
    SeedOption,
    SessionsOption,
    StrategyOption,
    ViewOption,
    ViewPortOption,
    WorkersOption,
    note_on_interruption,
)


def identify(
    rig: RigOption = None,
    objects: ObjectsOption = None,
    scene: SceneOption = None,
    seed: SeedOption = 0,
    json: JsonOption = False,
    picture: PictureOption = None,
    strategy: StrategyOption = Strategy.PLANNED,
    parts: Annotated[
        str, typer.Option("--parts", metavar="N|up-to-N", help="How many parts lie on the table.")
    ] = "1",
    sessions: SessionsOption = Path(SESSIONS_FOLDER),
    no_calibration: NoCalibrationOption = False,
    unconfirmed: Annotated[
        bool, typer.Option("--unconfirmed", help="On a real rig whose wiring was never proven, too.")
    ] = False,
    view: ViewOption = False,
    view_port: ViewPortOption = VIEW_PORT,
    foxglove: FoxgloveOption = False,
    foxglove_port: Annotated[
        int, typer.Option("--foxglove-port", min=1, max=65535, help="With --foxglove: its port here.")
    ] = FOXGLOVE_PORT,
    ros: RosOption = None,
) -> int:
    """Touch what lies on the table until it is known which object it is and where."""
    from palpate.base.file_io import check_places, write_text
    from palpate.cli.run_display import (
        IdentificationProgress,
        closing_lines,
        foxglove_starter,
        ros_starter,
        view_starter,
    )
    from palpate.cli.terminal import (
        Terminal,
        fit_to_screen,
        print_notices,
        rig_files,
        scene_files,
        with_rig_given,
    )
    from palpate.jobs.rig import open_rig

    opened = open_rig(rig, seed=seed, calibration=not no_calibration)
    read = {**rig_files(rig), "--objects": objects, **scene_files(scene)}
    check_places({"--picture": picture}, read)
    starters = [view_starter(view_port)] if view else []
    starters += [foxglove_starter(foxglove_port)] if foxglove else []
    starters += [] if ros is None else [ros_starter(ros)]

    def show(session: Path) -> None:
        for start in starters:
            start(session)

    terminal = Terminal(stderr=True, highlight=False, markup=False)
    with IdentificationProgress(terminal) as progress:
        answer = opened.identify(
            objects,
            scene=scene,
            strategy=strategy.value,
            parts=parts,
            unconfirmed=unconfirmed,
            sessions=sessions,
            on_event=progress,
            on_session=show,
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
    lines = closing_lines(answer, place)
    typer.echo(answer.to_json() if json else fit_to_screen(with_rig_given("\n".join(lines))))
    if failure is not None:
        raise failure
    return 0 if answer.verdict.is_answer else 1


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
    from palpate.views.recognition import recognition_lines

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
    from palpate.cli.terminal import StatusLine, Terminal, print_notices, rig_files
    from palpate.jobs.files import load_objects, name_of
    from palpate.jobs.rig import open_rig
    from palpate.rig.catalogue.reachability import finding_lines
    from palpate.views.plan_table import print_plan
    from palpate.views.recognition import explain, explanation_lines

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


_PIPED_LINE_INTERVAL_S = 60.0


def study(
    objects: ObjectsOption = None,
    rig: RigOption = None,
    runs: Annotated[int, typer.Option("--runs", min=1, help="Simulated identifications.")] = 1000,
    seed: Annotated[
        int, typer.Option("--seed", min=0, help="Draws parts, places and errors of touches.")
    ] = 0,
    strategy: StrategyOption = Strategy.PLANNED,
    parts: Annotated[
        PartMotion | None,
        typer.Option("--parts", help="Whether fingers move parts; as the rig file says if left out."),
    ] = None,
    placed_within: Annotated[
        float | None,
        typer.Option(
            "--placed-within",
            min=0,
            metavar="MM",
            help="How far from the middle of the workspace parts are put; as the rig file says if left out.",
        ),
    ] = None,
    no_calibration: NoCalibrationOption = False,
    keep: Annotated[
        Path | None,
        typer.Option("--keep", help="Keep runs here (JSON Lines), and go on from those there are."),
    ] = None,
    report: Annotated[
        Path | None, typer.Option("--report", help="Write the result as a page (HTML), too.")
    ] = None,
    budget: Annotated[
        int | None,
        typer.Option(
            "--budget",
            min=0,
            help="Runs to repeat with each error halved and parts held; a tenth, 200 at most, if left out.",
        ),
    ] = None,
    scheduler: Annotated[
        str | None, typer.Option("--scheduler", metavar="ADDRESS", help="Use a dask cluster's workers.")
    ] = None,
    workers: WorkersOption = None,
    json: JsonOption = False,
) -> int:
    """Say how well a rig tells the parts of a catalogue apart: verdicts, accuracy, touches, hardest pairs.

    Touches are simulated within the rig's bounds, and what fingers push moves, if the rig file says how. Also
    what each error costs, and at which heights fingers should be. Exit code 1: an answer was wrong.
    """
    from palpate.base.file_io import check_places, write_text
    from palpate.cli.terminal import StatusLine, Terminal, rig_files
    from palpate.config.fields import to_json
    from palpate.jobs.files import load_objects
    from palpate.jobs.rig import open_rig
    from palpate.jobs.study import study as studied
    from palpate.views.report.study import study_report
    from palpate.views.report.study_text import study_lines

    bench, models = open_rig(rig, calibration=not no_calibration).file, load_objects(objects)
    name = "the shipped objects" if objects is None else str(objects)
    check_places({"--report": report, "--keep": keep}, {**rig_files(rig), "--objects": objects})
    terminal = Terminal(stderr=True, soft_wrap=True, highlight=False)
    with (
        note_on_interruption(_interruption_note(keep)),
        StatusLine(terminal, "preparing", _PIPED_LINE_INTERVAL_S) as doing,
    ):
        out = studied(
            bench,
            models,
            runs=runs,
            seed=seed,
            strategy=strategy,
            parts=parts,
            placed_within_mm=placed_within,
            budget=budget,
            keep=keep,
            scheduler=scheduler,
            workers=workers,
            name=name,
            rig_name=None if rig is None else str(rig),
            progress=doing.now,
        )
    heights = [finger.height_mm for finger in bench.fingers]
    if report is not None:
        write_text(report, study_report(out, models.objects, heights))
    typer.echo(to_json(out) if json else "\n".join([*study_lines(out, heights), *_file_lines(report, keep)]))
    return 1 if out.wrong else 0


def _file_lines(report: Path | None, keep: Path | None) -> list[str]:
    """Say what was written, and where."""
    named = (("report", report), ("runs", keep))
    words = ", ".join(f"{what} {printable_text(str(place))}" for what, place in named if place is not None)
    return ["", words] if words else []


def _interruption_note(keep: Path | None) -> str:
    if keep is None:
        return "runs that were done are lost; with --keep FILE they are kept, and the same command goes on"
    return f"runs that were done are in {keep}; the same command goes on from there"
