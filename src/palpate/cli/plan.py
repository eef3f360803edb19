"""`palpate plan`: from a rig and a file of contacts to the next grip, without touching anything."""

from typing import Annotated

import typer

from palpate.base.vocabulary import RecognitionVerdict, Strategy
from palpate.cli.options import (
    ContactsOption,
    JsonOption,
    NoCalibrationOption,
    ObjectsOption,
    PictureOption,
    RigOption,
    StrategyOption,
)

__all__ = ["plan"]


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
    from palpate.base.files.writing import check_places, write_text
    from palpate.cli.output_places import rig_files
    from palpate.cli.terminal import Doing, Terminal, print_notices
    from palpate.jobs.files import load_objects, name_of
    from palpate.jobs.rig import open_rig
    from palpate.rig.catalogue.reachability_text import finding_lines
    from palpate.views.explanation import explain, explanation_lines
    from palpate.views.plan_table import print_plan

    opened = open_rig(rig, seed=seed, calibration=not no_calibration)
    models = load_objects(objects)
    check_places({"--picture": picture}, {**rig_files(rig), "--objects": objects, "--contacts": contacts})
    with Doing(Terminal(stderr=True, soft_wrap=True), "planning") as doing:
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
