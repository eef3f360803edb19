"""`palpate plan`: from a rig and a file of contacts to the next grip, without touching anything."""

from pathlib import Path

import typer

from palpate.cli.terminal import Terminal, print_notices
from palpate.config import load_contacts, load_objects, shipped_objects
from palpate.config.loading import source_name
from palpate.config.results import to_json
from palpate.files.writing import check_place, write_text
from palpate.recognizer import Catalogue
from palpate.rig.calibrated_rig import load_calibrated
from palpate.rig.catalogue.heights import check_known, fingers_of
from palpate.rig.catalogue.reachability_text import finding_lines
from palpate.rig.conversion import grips_of
from palpate.rig.identification.next_grip import plan_for
from palpate.views.explanation import Felt, explain, explanation_lines
from palpate.views.grip_result import grip_out
from palpate.views.plan_picture import plan_picture
from palpate.views.plan_table import print_plan
from palpate.vocabulary import RecognitionVerdict, Strategy

__all__ = ["run_plan"]


def run_plan(
    *,
    rig: Path | None,
    objects: Path | None,
    contacts: Path,
    strategy: str,
    seed: int,
    json: bool,
    picture: Path | None,
    calibration: bool = True,
) -> int:
    """Plan, print, draw; returns the exit code (1 if nothing fits or no grip would tell anything apart)."""
    rig_file = load_calibrated(rig, calibration=calibration).rig
    objects_source = objects or shipped_objects()
    objects_file = load_objects(objects_source)
    felt = Felt(grips_of(load_contacts(contacts)))
    check_known(objects_file.objects, [*rig_file.fingers, *fingers_of(felt.contacts)])
    print_notices(finding_lines(rig_file, objects_file.objects, source_name(objects_source)))
    catalogue = Catalogue(objects_file.objects)
    if picture is not None:
        check_place(picture)
    planned = plan_for(rig_file, catalogue, felt.contacts, Strategy(strategy), seed)
    if picture is not None:
        write_text(picture, plan_picture(planned, felt, f"{contacts.name} on rig {rig_file.name}"))
    if json:
        typer.echo(to_json(grip_out(planned)))
    elif planned.recognition.verdict is RecognitionVerdict.NONE:
        _print_none(catalogue, felt)
    else:
        print_plan(planned, Terminal(highlight=False, markup=False, emoji=False))
    return 0 if planned.is_help else 1


def _print_none(catalogue: Catalogue, felt: Felt) -> None:
    typer.echo(f"none: 0 hypotheses after {sum(item.touched for item in felt.contacts)} contacts")
    for line in explanation_lines(explain(catalogue, felt, 0), felt):
        typer.echo(f"  {line}")
