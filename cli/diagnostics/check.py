"""`palpate check`: is everything there, healthy and set up as the rig file says?

Moves nothing, unless it is asked to touch a disc and see whether the calibration still holds.
"""

from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import typer

from palpate.api.rig import open_rig
from palpate.cli.commissioning.confirm_motion import ask_to_move
from palpate.cli.commissioning.reference_placement import ConsoleTable
from palpate.cli.terminal import Doing, Terminal
from palpate.views.check_table import show

__all__ = ["Touching", "run_check"]


@dataclass(frozen=True)
class Touching:
    """A disc is to be touched: the file that describes it, None for the standard one; `yes`: do not ask."""

    references: Path | None
    yes: bool


def run_check(
    *, rig: Path | None, json: bool, calibration: bool = True, touching: Touching | None = None, seed: int = 0
) -> int:
    """Check and show; returns the exit code: 3 if something is wrong, 0 with warnings alone.

    `touching`: None to move nothing. `seed`: of an emulated rig's devices.
    """
    opened = open_rig(rig, seed=seed, calibration=calibration)
    err = Terminal(stderr=True, soft_wrap=True)
    moving = False
    with ExitStack() as looking:
        doing = looking.enter_context(Doing(err, "checking"))

        def permit() -> None:
            nonlocal moving
            moving = True
            looking.close()  # a moving line and a question would write over each other
            if touching is not None and not touching.yes:
                ask_to_move(err)

        checked = opened.check(
            touch=touching is not None,
            references=None if touching is None else touching.references,
            table=None if opened.emulated else ConsoleTable(err),
            permit=permit,
            progress=lambda text: err.print(text) if moving else doing.now(text),
        )
    if json:
        typer.echo(checked.to_json())
    show(checked.result, err if json else Terminal(soft_wrap=True))
    if checked.failure is not None:
        raise checked.failure
    return 0 if checked.well else 3
