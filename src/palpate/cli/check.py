"""Diagnosis of a rig: `palpate check`, and with `--full`, also called `palpate doctor`, step by step.

Nothing moves, unless asked to touch a disc, to push a part, or to see which way joints go.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from palpate.cli.terminal import JsonOption, NoCalibrationOption, RigOption, note_on_interruption

if TYPE_CHECKING:
    from rich.console import Console

    from palpate.cli.terminal import StatusLine
    from palpate.config import FingerConfig, RigFile
    from palpate.jobs.check import CheckAnswer, DoctorAnswer
    from palpate.jobs.rig import Rig
    from palpate.rig.diagnostics.wiring import Side
    from palpate.rig.diagnostics.wiring_check import Sight

_PUSH_QUESTION = "They push the part by up to 2 mm. Does it lie alone near the middle, and are hands away?"
_EXIT_WRONG, _EXIT_DEVICE = 1, 3

ReportOption = Annotated[
    Path | None,
    typer.Option("--report", help="Also write a report for a bug tracker here, with nothing private."),
]
PressOption = Annotated[
    bool,
    typer.Option("--press", help="Ask for a press on each tip, and see which array feels it, and where."),
]
MoveOption = Annotated[
    bool, typer.Option("--move", help="Fingers move: ask which tip each joint moves, and which way.")
]
ApplyOption = Annotated[
    bool, typer.Option("--apply", help="With --press, --move: write what is to be changed into the rig file.")
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
    press: PressOption = False,
    move: MoveOption = False,
    apply: ApplyOption = False,
    verbose: VerboseOption = False,
    seed: SeedOption = 0,
) -> int:
    """Look at every servo, array and the bus of a rig. Moves nothing without --touch, --hold or --move.

    Exit code 1: something is wrong, or touches do not agree with the calibration. 3: a port or device is
    missing or silent. 0: warnings alone, or --apply has written all that was wrong. With --full as `palpate
    doctor`: --verbose is for it. --press and --move together prove the wiring, which identify asks for on a
    real rig; --json gives what they found.
    """
    from palpate.base.errors import InputError
    from palpate.cli.calibration_dialogue import ConsoleTable
    from palpate.config.fields import to_json
    from palpate.views.check_table import show_check

    if full and (touch or hold):
        raise InputError("--full goes without --touch and --hold: ask for them by themselves")
    if not full and verbose:
        raise InputError("--verbose is for --full")
    asked = _Asked(rig, json, no_calibration, yes, seed, report, picture, press, move, apply)
    if full:
        return _examine(asked, verbose=verbose)
    with asked.look("checking", references, moves=touch or hold or move) as looking:
        checked = looking.rig.check(
            touch=touch,
            hold=hold,
            press=press,
            move=move,
            onlooker=looking.onlooker(),
            references=references if touch else None,
            table=None if looking.rig.emulated else ConsoleTable(looking.err),
            notice=looking.err.print,
            permit=lambda: looking.permit(_PUSH_QUESTION if hold else None),
            progress=looking.tell,
        )
        looking.close()
        if json:
            typer.echo(checked.to_json() if checked.result.wiring is None else to_json(checked.result.wiring))
        show_check(checked.result, looking.console(soft_wrap=True))
        looking.write_report(checked.report)
        mended = looking.apply(checked)
    if checked.failure is not None:
        raise checked.failure
    return _exit_code(checked, mended=mended)


def doctor(
    rig: RigOption = None,
    json: JsonOption = False,
    report: ReportOption = None,
    press: PressOption = False,
    move: MoveOption = False,
    apply: ApplyOption = False,
    yes: Annotated[bool, typer.Option("--yes", help="With --move: fingers may move, do not ask.")] = False,
    verbose: VerboseOption = False,
    no_calibration: NoCalibrationOption = False,
    seed: SeedOption = 0,
) -> int:
    """Find out what is wrong with a set-up, from ports to forces: another name of `palpate check --full`.

    Moves nothing without --move. Exit code 1: something is wrong. 3: a port or device is missing or silent.
    0: warnings alone, or --apply has written all that was wrong.
    """
    asked = _Asked(rig, json, no_calibration, yes, seed, report, None, press, move, apply)
    return _examine(asked, verbose=verbose)


def _examine(asked: "_Asked", *, verbose: bool) -> int:
    from palpate.views.doctor import show_doctor

    with asked.look("looking at the ports", moves=asked.move) as looking:
        found = looking.rig.doctor(
            press=asked.press,
            move=asked.move,
            onlooker=looking.onlooker(),
            permit=looking.permit,
            progress=lambda text: looking.tell(f"looking at {text}"),
            notice=looking.err.print,
        )
        looking.close()
        if asked.json:
            typer.echo(found.to_json())
        show_doctor(found.result, looking.console(), verbose=verbose)
        looking.write_report(found.report)
        mended = looking.apply(found)
    return _exit_code(found, mended=mended)


def _exit_code(found: "CheckAnswer | DoctorAnswer", *, mended: bool) -> int:
    """Exit code, 0 also if all that was wrong is the wiring, and the rig file was mended."""
    from palpate.config.diagnosis_results import Outcome

    wrong = [item.step for item in found.steps if item.outcome is Outcome.WRONG]
    if not wrong or (mended and wrong == ["wiring"]):
        return 0
    return _EXIT_DEVICE if found.device_missing else _EXIT_WRONG


@dataclass
class _Asked:
    """Options that both forms of the command have."""

    rig: Path | None
    json: bool
    no_calibration: bool
    yes: bool
    seed: int
    report: Path | None
    picture: Path | None = None
    press: bool = False
    move: bool = False
    apply: bool = False

    @contextmanager
    def look(self, doing: str, references: Path | None = None, *, moves: bool) -> "Iterator[_Looking]":
        """Open the rig, draw it if asked to, and say on a moving line what is being done."""
        from palpate.base.errors import InputError
        from palpate.base.file_io import check_places, write_text
        from palpate.cli.terminal import StatusLine, Terminal, check_can_ask_to_move, rig_files
        from palpate.jobs.rig import open_rig
        from palpate.views.rig_drawing import draw_rig

        with (
            note_on_interruption("torque is off" if moves else "torque was left as it was"),
            ExitStack() as line,
        ):
            if self.apply and not (self.press or self.move):
                raise InputError("--apply writes what --press and --move find: say which")
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

    def onlooker(self) -> "_ConsoleOnlooker | None":
        """Person at the table of a real rig, who is asked from now on; an emulated one has its own."""
        if self.rig.emulated or not (self.asked.press or self.asked.move):
            return None
        self.moving = True
        self.close()
        return _ConsoleOnlooker(self.err, self.rig.described)

    def apply(self, found: "CheckAnswer | DoctorAnswer") -> bool:
        """Write what is to be changed into the rig file, if that was asked for, or if somebody says so.

        True if it was written.
        """
        from palpate.cli.terminal import can_ask
        from palpate.views.doctor import change_lines

        wiring = found.result.wiring
        if wiring is None or not wiring.changes:
            return False
        for line in change_lines(wiring):
            self.err.print(line, highlight=False, markup=False)
        if not self.asked.apply and can_ask():
            answer = self.err.input("Write this into the rig file? [y/N] ", markup=False)
            self.asked.apply = answer.strip().lower() in ("y", "yes")
        if self.asked.apply:
            found.apply()
            text = f"written into {found.on_bench.path}, not tried yet; next: palpate check --press --move"
            self.err.print(text, highlight=False, markup=False)
        return self.asked.apply

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
    """Somebody at the table, who is asked to press tips, and which one went which way."""

    def __init__(self, console: "Console", rig: "RigFile") -> None:
        self._console, self._fingers = console, rig.fingers
        self._begun = False

    def press(self, finger: "FingerConfig", side: "Side") -> bool:
        """Ask for a press that is held; no if nothing stands there."""
        from palpate.views.doctor import press_request

        return self._ask(press_request(finger, side), ("", "n")) == ""

    def release(self) -> None:
        """Say that it is enough."""
        self._console.print("Let go.")

    def watch(self) -> None:
        """Ask for attention."""
        self._ask("One tip is going to move a little. Look at all of them, and press Enter.", ("",))

    def saw(self) -> "Sight | None":
        """Ask which tip moved, and which way."""
        from palpate.rig.diagnostics.wiring import Way
        from palpate.rig.diagnostics.wiring_check import Sight
        from palpate.views.doctor import moved_question

        places = {str(number): finger.base_mm for number, finger in enumerate(self._fingers, 1)}
        which = self._ask(moved_question(self._fingers), ("0", *places), or_place=True)
        if which == "0":
            return None
        base_mm = places.get(which) or _numbers(which)
        assert base_mm is not None, "asked until it is one"
        way = self._ask("Which way, seen from its base? (o)ut, (i)n, (l)eft, (r)ight:", ("o", "i", "l", "r"))
        return Sight(base_mm, next(item for item in Way if item.name.lower().startswith(way)))

    def _ask(self, what: str, allowed: Sequence[str], *, or_place: bool = False) -> str:
        """Ask until the answer is allowed."""
        from palpate.base.errors import InputError
        from palpate.views.doctor import WHERE_TO_STAND

        if not self._begun:
            self._console.print(WHERE_TO_STAND, markup=False)
        self._begun = True
        while True:
            try:
                answer = self._console.input(f"{what} ", markup=False).strip().lower()
            except EOFError:
                raise InputError("nobody says what tips do: standard input has ended") from None
            if answer in allowed or (or_place and _numbers(answer) is not None):
                return answer


def _numbers(answer: str) -> tuple[float, float] | None:
    """Two numbers that somebody wrote; None if it is something else."""
    try:
        x, y = map(float, answer.replace(",", " ").split())
    except ValueError:
        return None
    return x, y
