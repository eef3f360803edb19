"""`palpate objects check`: which states of a catalogue a rig can never tell apart, and what would help."""

from pathlib import Path

import typer

from palpate.cli.terminal import Doing, Terminal, print_notices
from palpate.config import load_objects
from palpate.config.objects_result import ObjectsCheckOut
from palpate.config.results import to_json
from palpate.rig.calibrated_rig import load_calibrated
from palpate.rig.catalogue.finger_model import rig_fingers
from palpate.rig.catalogue.reachability_text import finding_lines
from palpate.rig.catalogue.section_stack import state_sections
from palpate.rig.catalogue.separating_heights import separating_heights
from palpate.rig.catalogue.twins import find_twins
from palpate.views.catalogue.check_text import check_lines
from palpate.views.catalogue.results import not_known_out, rig_out, separating_out

__all__ = ["run_objects_check"]


def run_objects_check(*, objects: Path, rig: Path | None, json: bool, calibration: bool = True) -> int:
    """Compare and print; returns the exit code: 1 if some pair can never be told apart."""
    rig_file = load_calibrated(rig, calibration=calibration).rig
    objects_file = load_objects(objects)
    fingers, states = rig_fingers(rig_file), state_sections(objects_file)
    print_notices(finding_lines(rig_file, objects_file.objects, str(objects)))
    with Doing(Terminal(stderr=True, soft_wrap=True), "comparing") as doing:
        doing.now(f"{len(states)} states")
        pairs = find_twins(states, fingers)
        found = []
        for number, pair in enumerate(pairs, 1):
            doing.now(f"heights of pair {number} of {len(pairs)}")
            found.append(separating_out(pair, separating_heights(pair)))
    compared = len(states) * (len(states) - 1) // 2
    out = ObjectsCheckOut(
        objects=str(objects),
        rig=rig_out(fingers, shipped=rig is None),
        states=len(states),
        pairs_compared=compared,
        told_apart=compared - len(pairs),
        pairs=tuple(found),
        not_known=not_known_out(states, fingers),
    )
    typer.echo(to_json(out) if json else "\n".join(check_lines(out)))
    return 1 if any(pair.likeness == "same" for pair in found) else 0
