"""Diagnosis of a rig: `palpate check`, and with `--full`, also called `palpate doctor`, step by step.

Nothing moves, unless asked to touch a disc, to push a part, or to see which way joints go.
"""

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from palpate.cli.terminal import JsonOption, NoCalibrationOption, RigOption, note_on_interruption

if TYPE_CHECKING:
    from rich.console import Console

    from palpate.cli.terminal import StatusLine
    from palpate.jobs.rig import Rig

_PUSH_QUESTION = "They push the part by up to 2 mm. Does it lie alone near the middle, and are hands away?"
_EXIT_WRONG, _EXIT_DEVICE = 1, 3

ReportOption = Annotated[
    Path | None,
    typer.Option("--report", help="Also write a report for a bug tracker here, with nothing private."),
]
MoveOption = Annotated[
    bool, typer.Option("--move", help="Fingers move: see which way each joint goes, if all else is well.")
]
VerboseOption = Annotated[bool, typer.Option("--verbose", help="Also say what each step looks at.")]
SeedOption = Annotated[int, typer.Option("--seed", min=0, help="Of an emulated rig's devices and part.")]


def check(
    rig: RigOption = None,
    json: JsonOption = False,
    no_calibration: NoCalibrationOption = False,
    full: Annotated[
        bool, typer.Option("--full", help="Step by step, with the next thing to do: `palpate doctor`.")
    ] = False,
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
        bool, typer.Option("--yes", help="With what moves fingers: they may move, do not ask.")
    ] = False,
    references: Annotated[
        Path | None, typer.Option("--references", help="With --touch: the disc (TOML); without it, 50 mm.")
    ] = None,
    picture: Annotated[
        Path | None,
        typer.Option("--picture", help="Also draw here how the rig stands by its file (SVG)."),
    ] = None,
    report: ReportOption = None,
    move: MoveOption = False,
    verbose: VerboseOption = False,
    seed: SeedOption = 0,
) -> int:
    """Look at every servo, array and the bus of a rig. Moves nothing without --touch, --hold or --move.

    Exit code 3: something is wrong, or touches do not agree with the calibration. Warnings alone: 0. With
    --full as `palpate doctor`: --move and --verbose are for it.
    """
    from palpate.base.errors import InputError
    from palpate.cli.calibration_dialogue import ConsoleTable
    from palpate.views.check_table import show_check

    if full and (touch or hold):
        raise InputError("--full goes without --touch and --hold: ask for them by themselves")
    if not full and (move or verbose):
        raise InputError("--move and --verbose are for --full")
    asked = _Asked(rig, json, no_calibration, yes, seed, report, picture)
    if full:
        return _examine(asked, move=move, verbose=verbose)
    with asked.look("checking", references, moves=touch or hold) as looking:
        checked = looking.rig.check(
            touch=touch,
            hold=hold,
            references=references if touch else None,
            table=None if looking.rig.emulated else ConsoleTable(looking.err),
            notice=looking.err.print,
            permit=lambda: looking.permit(_PUSH_QUESTION if hold else None),
            progress=looking.tell,
        )
        looking.close()
        if json:
            typer.echo(checked.to_json())
        show_check(checked.result, looking.console(soft_wrap=True))
        looking.write_report(checked.report)
    if checked.failure is not None:
        raise checked.failure
    return 0 if checked.well else 3


def doctor(
    rig: RigOption = None,
    json: JsonOption = False,
    report: ReportOption = None,
    move: MoveOption = False,
    yes: Annotated[bool, typer.Option("--yes", help="With --move: fingers may move, do not ask.")] = False,
    verbose: VerboseOption = False,
    no_calibration: NoCalibrationOption = False,
    seed: SeedOption = 0,
) -> int:
    """Find out what is wrong with a set-up, from ports to forces: another name of `palpate check --full`.

    Moves nothing without --move. Exit code 1: something is wrong. 3: a port or device is missing or silent.
    Warnings alone: 0.
    """
    return _examine(_Asked(rig, json, no_calibration, yes, seed, report), move=move, verbose=verbose)


def _examine(asked: "_Asked", *, move: bool, verbose: bool) -> int:
    from palpate.views.doctor import show_doctor

    with asked.look("looking at the ports", moves=move) as looking:
        found = looking.rig.doctor(
            move=move,
            onlooker=None if looking.rig.emulated else _ConsoleOnlooker(looking.err),
            permit=looking.permit,
            progress=lambda text: looking.tell(f"looking at {text}"),
            notice=looking.err.print,
        )
        looking.close()
        if asked.json:
            typer.echo(found.to_json())
        show_doctor(found.result, looking.console(), verbose=verbose)
        looking.write_report(found.report)
    if found.well:
        return 0
    return _EXIT_DEVICE if found.result.device_missing else _EXIT_WRONG


@dataclass(frozen=True)
class _Asked:
    """Options that both forms of the command have."""

    rig: Path | None
    json: bool
    no_calibration: bool
    yes: bool
    seed: int
    report: Path | None
    picture: Path | None = None

    @contextmanager
    def look(self, doing: str, references: Path | None = None, *, moves: bool) -> "Iterator[_Looking]":
        """Open the rig, draw it if asked to, and say on a moving line what is being done."""
        from palpate.base.file_io import check_places, write_text
        from palpate.cli.terminal import StatusLine, Terminal, check_can_ask_to_move, rig_files
        from palpate.jobs.rig import open_rig
        from palpate.views.rig_drawing import draw_rig

        with (
            note_on_interruption("torque is off" if moves else "torque was left as it was"),
            ExitStack() as line,
        ):
            if moves and not self.yes:
                check_can_ask_to_move()
            opened = open_rig(self.rig, seed=self.seed, calibration=not self.no_calibration)
            read = {**rig_files(self.rig), "--references": references}
            check_places({"--picture": self.picture, "--report": self.report}, read)
            err = Terminal(stderr=True, soft_wrap=True)
            if self.picture is not None:
                write_text(self.picture, draw_rig(opened.file))
                err.print(f"picture {self.picture}", highlight=False, markup=False)
            yield _Looking(self, opened, err, line, line.enter_context(StatusLine(err, doing)))


@dataclass
class _Looking:
    """A rig that is being looked at. Once fingers may move, what is done stands on lines of its own."""

    asked: _Asked
    rig: "Rig"
    err: "Console"
    line: ExitStack
    status: "StatusLine"
    moving: bool = False

    def close(self) -> None:
        """Take the moving line away: it and a question or a result would write over each other."""
        self.line.close()

    def permit(self, question: str | None = None) -> None:
        """Ask whether fingers may move, unless that was said."""
        from palpate.cli.terminal import ask_to_move

        self.moving = True
        self.close()
        if not self.asked.yes:
            ask_to_move(self.err) if question is None else ask_to_move(self.err, question)

    def tell(self, text: str) -> None:
        """Say what is being done."""
        self.err.print(text) if self.moving else self.status.now(text)

    def write_report(self, report: Callable[[], str]) -> None:
        """Write the report for a bug tracker, if it was asked for."""
        from palpate.base.file_io import write_text

        if self.asked.report is not None:
            write_text(self.asked.report, report())
            self.err.print(f"report for a bug tracker: {self.asked.report}", highlight=False)

    def console(self, *, soft_wrap: bool = False) -> "Console":
        """Console on which people read the result."""
        from palpate.cli.terminal import Terminal

        return self.err if self.asked.json else Terminal(soft_wrap=soft_wrap)


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
