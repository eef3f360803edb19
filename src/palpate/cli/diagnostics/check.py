"""`palpate check`: is everything there, healthy and set up as the rig file says?

Moves nothing, unless it is asked to touch a disc and see whether the calibration still holds, or to push a
part and see what force it holds.
"""

from contextlib import ExitStack
from pathlib import Path
from typing import Annotated

import typer

from palpate.cli.interruption import if_interrupted
from palpate.cli.options import JsonOption, NoCalibrationOption, RigOption

__all__ = ["check"]

_READY = "They push the part by up to 2 mm. Does it lie alone near the middle, and are hands away?"


def check(
    rig: RigOption = None,
    json: JsonOption = False,
    no_calibration: NoCalibrationOption = False,
    touch: Annotated[
        bool,
        typer.Option("--touch", help="Fingers move: touch a disc, and see if the calibration still holds."),
    ] = False,
    hold: Annotated[
        bool,
        typer.Option(
            "--hold", help="Fingers move: push the part on the table until it slides; what force it holds."
        ),
    ] = False,
    yes: Annotated[
        bool, typer.Option("--yes", help="With --touch or --hold: fingers may move, do not ask.")
    ] = False,
    references: Annotated[
        Path | None, typer.Option("--references", help="With --touch: the disc (TOML); without it, 50 mm.")
    ] = None,
    picture: Annotated[
        Path | None,
        typer.Option("--picture", help="Also draw here how the rig stands by its file (SVG)."),
    ] = None,
    seed: Annotated[int, typer.Option("--seed", min=0, help="Of an emulated rig's devices and part.")] = 0,
) -> int:
    """Look at every servo, array and the bus of a rig. Moves nothing without --touch or --hold.

    Exit code 3: something is wrong, or touches do not agree with the calibration. Warnings alone: 0.
    """
    from rich.markup import escape

    from palpate.base.files.writing import check_places, write_text
    from palpate.cli.commissioning.confirm_motion import ask_to_move, check_can_ask_to_move
    from palpate.cli.commissioning.reference_placement import ConsoleTable
    from palpate.cli.output_places import rig_files
    from palpate.cli.terminal import Doing, Terminal
    from palpate.jobs.rig import open_rig
    from palpate.views.check_table import show
    from palpate.views.rig_drawing import draw_rig

    with (
        if_interrupted("torque is off" if touch or hold else "torque was left as it was"),
        ExitStack() as looking,
    ):
        if (touch or hold) and not yes:
            check_can_ask_to_move()
        opened = open_rig(rig, seed=seed, calibration=not no_calibration)
        check_places({"--picture": picture}, {**rig_files(rig), "--references": references})
        err = Terminal(stderr=True, soft_wrap=True)
        if picture is not None:
            write_text(picture, draw_rig(opened.file))
            err.print(f"picture {escape(str(picture))}", highlight=False)
        doing = looking.enter_context(Doing(err, "checking"))
        moving = False

        def permit() -> None:
            nonlocal moving
            moving = True
            looking.close()  # a moving line and a question would write over each other
            if not yes:
                ask_to_move(err, _READY) if hold else ask_to_move(err)

        checked = opened.check(
            touch=touch,
            hold=hold,
            references=references if touch else None,
            table=None if opened.emulated else ConsoleTable(err),
            notice=err.print,
            permit=permit,
            progress=lambda text: err.print(text) if moving else doing.now(text),
        )
        looking.close()
        if json:
            typer.echo(checked.to_json())
        show(checked.result, err if json else Terminal(soft_wrap=True))
    if checked.failure is not None:
        raise checked.failure
    return 0 if checked.well else 3
