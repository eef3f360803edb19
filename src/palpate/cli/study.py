"""`palpate study`: how well a rig tells parts apart, by simulated identifications on all cores."""

from pathlib import Path
from typing import Annotated

import typer

from palpate.base.errors import printable_text
from palpate.base.vocabulary import PartMotion, Strategy
from palpate.cli.options import JsonOption, NoCalibrationOption, ObjectsOption, RigOption, StrategyOption
from palpate.cli.terminal import note_on_interruption

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
    workers: Annotated[
        int | None,
        typer.Option("--workers", min=1, help="Processes at once; as many as there are cores if left out."),
    ] = None,
    json: JsonOption = False,
) -> int:
    """Say how well a rig tells the parts of a catalogue apart: verdicts, accuracy, touches, hardest pairs.

    Touches are simulated within the rig's bounds, and what fingers push moves, if the rig file says how. Also
    what each error costs, and at which heights fingers should be. Exit code 1: an answer was wrong.
    """
    from palpate.base.file_io import check_places, write_text
    from palpate.cli.options import rig_files
    from palpate.cli.terminal import StatusLine, Terminal, print_notices
    from palpate.config.result_model import to_json
    from palpate.jobs.files import load_objects
    from palpate.jobs.rig import open_rig
    from palpate.jobs.study import study as studied
    from palpate.rig.catalogue.reachability import finding_lines
    from palpate.views.report.study import study_report
    from palpate.views.report.study_text import study_lines

    bench, models = open_rig(rig, calibration=not no_calibration).file, load_objects(objects)
    name = "the shipped objects" if objects is None else str(objects)
    check_places({"--report": report, "--keep": keep}, {**rig_files(rig), "--objects": objects})
    print_notices(finding_lines(bench, models.objects, name))
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
