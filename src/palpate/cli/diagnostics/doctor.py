"""`palpate doctor`: what is wrong with a set-up, step by step, and the next thing to do about it.

Moves nothing, unless it is asked to see which way joints go.
"""

from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from palpate.cli.interruption import if_interrupted
from palpate.cli.options import JsonOption, NoCalibrationOption, RigOption

if TYPE_CHECKING:
    from rich.console import Console

__all__ = ["doctor"]

_WRONG, _DEVICE = 1, 3


def doctor(
    rig: RigOption = None,
    json: JsonOption = False,
    report: Annotated[
        Path | None,
        typer.Option("--report", help="Also write a report for a bug tracker here, with nothing private."),
    ] = None,
    move: Annotated[
        bool, typer.Option("--move", help="Fingers move: see which way each joint goes, if all else is well.")
    ] = False,
    yes: Annotated[bool, typer.Option("--yes", help="With --move: fingers may move, do not ask.")] = False,
    verbose: Annotated[bool, typer.Option("--verbose", help="Also say what each step looks at.")] = False,
    no_calibration: NoCalibrationOption = False,
    seed: Annotated[int, typer.Option("--seed", min=0, help="Of an emulated rig's devices.")] = 0,
) -> int:
    """Find out what is wrong with a set-up, from ports to forces. Moves nothing without --move.

    Exit code 1: something is wrong. 3: a port or device is missing or silent. Warnings alone: 0.
    """
    from palpate.base.files.writing import check_places, write_text
    from palpate.cli.commissioning.confirm_motion import ask_to_move, check_can_ask_to_move
    from palpate.cli.output_places import rig_files
    from palpate.cli.terminal import Doing, Terminal
    from palpate.jobs.rig import open_rig
    from palpate.views.doctor_text import show

    with if_interrupted("torque is off" if move else "torque was left as it was"), ExitStack() as looking:
        if move and not yes:
            check_can_ask_to_move()
        opened = open_rig(rig, seed=seed, calibration=not no_calibration)
        check_places({"--report": report}, rig_files(rig))
        err = Terminal(stderr=True, soft_wrap=True)
        doing = looking.enter_context(Doing(err, "looking at the ports"))

        def permit() -> None:
            looking.close()  # a moving line and a question would write over each other
            if not yes:
                ask_to_move(err)

        found = opened.doctor(
            move=move,
            onlooker=None if opened.emulated else _Person(err),
            permit=permit,
            progress=lambda text: doing.now(f"looking at {text}"),
            notice=err.print,
        )
        looking.close()
        if json:
            typer.echo(found.to_json())
        show(found.result, err if json else Terminal(), verbose=verbose)
        if report is not None:
            write_text(report, found.report())
            err.print(f"report for a bug tracker: {report}", highlight=False)
    if found.well:
        return 0
    return _DEVICE if found.result.device_missing else _WRONG


class _Person:
    """Somebody at the table, who is asked which way a tip went."""

    def __init__(self, console: "Console") -> None:
        self._console = console

    def ready(self, finger: str) -> None:
        """Say which finger to look at."""
        self._ask(f"Look at the tip of finger {finger} from above, and press Enter.")

    def went(self, finger: str, where: str) -> bool:
        """Ask until the answer is yes or no."""
        while True:
            answer = self._ask(f"Did the tip of finger {finger} go {where}? (y/n)").strip().lower()
            if answer in ("y", "yes", "n", "no"):
                return answer.startswith("y")

    def _ask(self, what: str) -> str:
        from palpate.base.errors import InputError

        try:
            return self._console.input(f"{what} ", markup=False)
        except EOFError:
            raise InputError("nobody says which way tips go: standard input has ended") from None
