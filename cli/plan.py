"""`palpate plan`: from a rig and a file of contacts to the next grip, without touching anything."""

from pathlib import Path

import typer

from palpate.api.answers import Plan
from palpate.api.files import load_objects, name_of
from palpate.api.rig import open_rig
from palpate.cli.terminal import Terminal, print_notices
from palpate.files.writing import check_place, write_text
from palpate.rig.catalogue.reachability_text import finding_lines
from palpate.views.explanation import explain, explanation_lines
from palpate.views.plan_table import print_plan
from palpate.vocabulary import RecognitionVerdict

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
    opened, models = open_rig(rig, seed=seed, calibration=calibration), load_objects(objects)
    if picture is not None:
        check_place(picture)
    plan = opened.plan(models, contacts, strategy=strategy)
    print_notices(finding_lines(opened.file, models.objects, name_of(objects)))
    if picture is not None:
        write_text(picture, plan.picture())
    if json:
        typer.echo(plan.to_json())
    elif plan.planned.recognition.verdict is RecognitionVerdict.NONE:
        _print_none(plan)
    else:
        print_plan(plan.planned, Terminal(highlight=False, markup=False, emoji=False))
    return 0 if plan.is_help else 1


def _print_none(plan: Plan) -> None:
    touched = sum(item.touched for item in plan.contacts.contacts)
    typer.echo(f"none: 0 hypotheses after {touched} contacts")
    for line in explanation_lines(explain(plan.catalogue, plan.contacts, 0), plan.contacts):
        typer.echo(f"  {line}")
