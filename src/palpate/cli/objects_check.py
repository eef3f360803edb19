"""`palpate objects check`: which states of a catalogue a rig can never tell apart, and what would help."""

from pathlib import Path
from typing import Annotated

import typer

from palpate.cli.interruption import if_interrupted
from palpate.cli.options import JsonOption, NoCalibrationOption, ObjectsArgument, RigOption

__all__ = ["check_objects"]


@if_interrupted("nothing was written")
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
    from palpate.base.files.writing import check_places, write_text
    from palpate.cli.output_places import rig_files
    from palpate.cli.terminal import Doing, Terminal, print_notices
    from palpate.config.results import to_json
    from palpate.jobs import catalogue
    from palpate.jobs.files import load_objects
    from palpate.jobs.rig import open_rig
    from palpate.rig.catalogue.reachability_text import finding_lines
    from palpate.views.catalogue.check_text import check_lines
    from palpate.views.report.catalogue import catalogue_report

    bench, models, name = open_rig(rig, calibration=not no_calibration).file, load_objects(file), str(file)
    check_places({"--report": report}, {**rig_files(rig), "FILE": file})
    notices = finding_lines(bench, models.objects, name)
    print_notices(notices)
    with Doing(Terminal(stderr=True, soft_wrap=True), "comparing") as doing:
        out = catalogue.check_objects(bench, models, name=name, shipped=rig is None, progress=doing.now)
        if report is not None:
            listing = catalogue.list_objects(bench, models, name=file.name, progress=doing.now)
            write_text(report, catalogue_report(out, listing.states, listing.pages, notices))
    typer.echo(to_json(out) if json else "\n".join(check_lines(out, every=every)))
    return 1 if any(pair.likeness == "same" for pair in out.pairs) else 0
