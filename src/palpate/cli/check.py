"""Diagnosis of a rig: `palpate check` and, step by step with the next thing to do, `palpate doctor`.

Neither moves anything, unless asked to touch a disc, to push a part, or to see which way joints go.
"""

from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from palpate.cli.options import JsonOption, NoCalibrationOption, RigOption
from palpate.cli.terminal import note_on_interruption

if TYPE_CHECKING:
    from rich.console import Console

_PUSH_QUESTION = "They push the part by up to 2 mm. Does it lie alone near the middle, and are hands away?"


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

    from palpate.base.file_io import check_places, write_text
    from palpate.cli.calibration_dialogue import ConsoleTable
    from palpate.cli.options import rig_files
    from palpate.cli.terminal import StatusLine, Terminal, ask_to_move, check_can_ask_to_move
    from palpate.jobs.rig import open_rig
    from palpate.views.check_table import show_check
    from palpate.views.rig_drawing import draw_rig

    with (
        note_on_interruption("torque is off" if touch or hold else "torque was left as it was"),
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
        doing = looking.enter_context(StatusLine(err, "checking"))
        moving = False

        def permit() -> None:
            nonlocal moving
            moving = True
            looking.close()  # a moving line and a question would write over each other
            if not yes:
                ask_to_move(err, _PUSH_QUESTION) if hold else ask_to_move(err)

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
        show_check(checked.result, err if json else Terminal(soft_wrap=True))
    if checked.failure is not None:
        raise checked.failure
    return 0 if checked.well else 3


_EXIT_WRONG, _EXIT_DEVICE = 1, 3


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
    from palpate.base.file_io import check_places, write_text
    from palpate.cli.options import rig_files
    from palpate.cli.terminal import StatusLine, Terminal, ask_to_move, check_can_ask_to_move
    from palpate.jobs.rig import open_rig
    from palpate.views.doctor import show_doctor

    with (
        note_on_interruption("torque is off" if move else "torque was left as it was"),
        ExitStack() as looking,
    ):
        if move and not yes:
            check_can_ask_to_move()
        opened = open_rig(rig, seed=seed, calibration=not no_calibration)
        check_places({"--report": report}, rig_files(rig))
        err = Terminal(stderr=True, soft_wrap=True)
        doing = looking.enter_context(StatusLine(err, "looking at the ports"))

        def permit() -> None:
            looking.close()  # a moving line and a question would write over each other
            if not yes:
                ask_to_move(err)

        found = opened.doctor(
            move=move,
            onlooker=None if opened.emulated else _ConsoleOnlooker(err),
            permit=permit,
            progress=lambda text: doing.now(f"looking at {text}"),
            notice=err.print,
        )
        looking.close()
        if json:
            typer.echo(found.to_json())
        show_doctor(found.result, err if json else Terminal(), verbose=verbose)
        if report is not None:
            write_text(report, found.report())
            err.print(f"report for a bug tracker: {report}", highlight=False)
    if found.well:
        return 0
    return _EXIT_DEVICE if found.result.device_missing else _EXIT_WRONG


class _ConsoleOnlooker:
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
