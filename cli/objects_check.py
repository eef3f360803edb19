"""`palpate objects check`: which states of a catalogue a rig can never tell apart, and what would help."""

from pathlib import Path

import typer

from palpate.api.catalogue import check_objects
from palpate.api.files import load_objects
from palpate.api.rig import open_rig
from palpate.cli.terminal import Doing, Terminal, print_notices
from palpate.config.results import to_json
from palpate.rig.catalogue.reachability_text import finding_lines
from palpate.views.catalogue.check_text import check_lines

__all__ = ["run_objects_check"]


def run_objects_check(*, objects: Path, rig: Path | None, json: bool, calibration: bool = True) -> int:
    """Compare and print; returns the exit code: 1 if some pair can never be told apart."""
    file, models = open_rig(rig, calibration=calibration).file, load_objects(objects)
    print_notices(finding_lines(file, models.objects, str(objects)))
    with Doing(Terminal(stderr=True, soft_wrap=True), "comparing") as doing:
        out = check_objects(file, models, name=str(objects), shipped=rig is None, progress=doing.now)
    typer.echo(to_json(out) if json else "\n".join(check_lines(out)))
    return 1 if any(pair.likeness == "same" for pair in out.pairs) else 0
