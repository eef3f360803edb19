"""`palpate identify`: the main job, from a rig file to a verdict, a session log and a picture."""

from pathlib import Path

import typer
from rich.console import Console
from rich.status import Status

from palpate.api.answers import Answer
from palpate.api.rig import open_rig
from palpate.cli.terminal import Terminal, print_notices
from palpate.errors import PalpateError, counted
from palpate.files.writing import check_place, write_text
from palpate.recognizer import Recognition
from palpate.rig.identification.observers import (
    Event,
    MoveEvent,
    PlanEvent,
    RecognitionEvent,
    StageEvent,
    TouchEvent,
)
from palpate.vocabulary import IdentificationVerdict

__all__ = ["run_identify"]

_NAMES_SHOWN = 5


def run_identify(
    *,
    rig: Path | None,
    objects: Path | None,
    scene: Path | None,
    seed: int,
    json: bool,
    picture: Path | None,
    sessions: Path,
    strategy: str = "planned",
    calibration: bool = True,
) -> int:
    """Run the bench to a verdict; returns the exit code (1 if it is not an answer).

    `strategy`: how grips are chosen, as `Strategy` names it. `calibration`: False to do without the one
    beside the rig file.
    """
    opened = open_rig(rig, seed=seed, calibration=calibration)
    if picture is not None:
        check_place(picture)
    with Progress(Terminal(stderr=True, highlight=False, markup=False)) as progress:
        answer = opened.identify(
            objects,
            scene=scene,
            strategy=strategy,
            sessions=sessions,
            on_event=progress,
            notice=progress.notice,
            warn=lambda line: print_notices([line]),
        )
    failure = answer.failure
    try:
        if picture is not None:
            write_text(picture, answer.picture())
    except PalpateError as error:  # an answer that could not be written down is still an answer
        failure = failure or error
    if json:
        typer.echo(answer.to_json())
    else:
        _print(answer, picture or Path(answer.session or "", "picture.svg"))
    if failure is not None:
        raise failure
    answered = (IdentificationVerdict.IDENTIFIED, IdentificationVerdict.INDISTINGUISHABLE)
    return 0 if answer.verdict in answered else 1


class Progress:
    """Shows on stderr what the bench is doing: a line for each grip, and a moving line on a terminal."""

    def __init__(self, console: Console) -> None:
        self._console = console
        self._status: Status | None = None

    def __enter__(self) -> "Progress":
        if self._console.is_terminal:
            self._status = self._console.status("connecting")
            self._status.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._status is not None:
            self._status.stop()

    def notice(self, text: str) -> None:
        """The operator should know or do something now."""
        self._console.print(text)

    def __call__(self, event: Event) -> None:
        """Show an event."""
        match event:
            case StageEvent(grip, stage):
                self._now(f"grip {grip}: {stage.value}")
            case PlanEvent(grip, plan):
                self._now(f"grip {grip}: planned{', decisive' if plan.decisive else ''}")
            case TouchEvent(grip, touches):
                contacts = [touch.contact for touch in touches]
                each = (f"{item.name} {'touched' if item.touched else 'missed'}" for item in contacts)
                self._console.print(f"grip {grip}: {', '.join(each)}")
            case RecognitionEvent():
                self._console.print(f"        {_hypotheses(event.recognition)}")
            case MoveEvent():
                self._console.print(
                    "        contradicts earlier grips: the part may have moved, they are dropped"
                )

    def _now(self, text: str) -> None:
        if self._status is not None:
            self._status.update(text)


def _hypotheses(recognition: Recognition) -> str:
    """How many hypotheses are left, and the first of their objects' names."""
    names = [item.state.object_name for item in recognition.hypotheses]
    distinct = list(dict.fromkeys(names))
    shown = ", ".join(distinct[:_NAMES_SHOWN])
    more = f" and {len(distinct) - _NAMES_SHOWN} more" if len(distinct) > _NAMES_SHOWN else ""
    return f"{counted(len(names), 'hypothesis', 'hypotheses')}{': ' if names else ''}{shown}{more}"


def _print(answer: Answer, picture: Path) -> None:
    """The answer for a person."""
    out = answer.result
    typer.echo(answer.text())
    typer.echo(
        f"{counted(out.grips, 'grip', 'grips')}, {counted(out.touches, 'touch', 'touches')}, "
        f"{out.rig_seconds:.1f} s on the {'emulated ' if out.emulated else ''}rig, "
        f"{out.wall_seconds:.1f} s here"
    )
    typer.echo(f"picture {picture}, session {out.session}")
