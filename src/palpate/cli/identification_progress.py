"""Progress of an identification on the terminal, and its answer in words."""

import math
from pathlib import Path

from rich.console import Console
from rich.status import Status

from palpate.base.errors import counted
from palpate.cli.time_left import TimeLeft
from palpate.jobs.answers import Answer
from palpate.recognizer import Recognition
from palpate.rig.identification.observers import (
    Event,
    MoveEvent,
    PlanEvent,
    RecognitionEvent,
    StageEvent,
    TouchEvent,
)

__all__ = ["Progress", "answer_lines"]

_NAMES_SHOWN = 5


class Progress:
    """Shows on stderr what the bench is doing: a line for each grip, and a moving line on a terminal."""

    def __init__(self, console: Console) -> None:
        self._console = console
        self._status: Status | None = None
        self._left = TimeLeft()

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

    def doing(self, text: str) -> None:
        """What goes on before the bench is connected; how much time is left stands after a count in it."""
        self._now(self._left.after(text))

    def __call__(self, event: Event) -> None:
        """Show an event."""
        match event:
            case StageEvent(grip, stage):
                self._now(f"grip {grip}: {stage.value}")
            case PlanEvent(grip, plan, reason):
                self._console.print(f"        next {reason}")
                self._now(f"grip {grip}: planned{', decisive' if plan.decisive else ''}")
            case TouchEvent(grip, touches):
                contacts = [touch.contact for touch in touches]
                each = (f"{item.name} {'touched' if item.touched else 'missed'}" for item in contacts)
                self._console.print(f"grip {grip}: {', '.join(each)}")
            case RecognitionEvent():
                self._console.print(f"        {_hypotheses(event.recognition)}")
            case MoveEvent(_, float() as furthest_mm):
                far = f"by {furthest_mm:.1f} mm" if math.isfinite(furthest_mm) else "without a bound"
                moved = f"fingers may have moved the part {far}"
                self._console.print(f"        {moved}: earlier grips are dropped")
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


def answer_lines(answer: Answer, picture: Path) -> list[str]:
    """The answer for a person, a paragraph each."""
    out = answer.result
    return [
        answer.text(),
        f"{counted(out.grips, 'grip', 'grips')}, {counted(out.touches, 'touch', 'touches')}, "
        f"{out.rig_seconds:.1f} s on the {'emulated ' if out.emulated else ''}rig, "
        f"{out.wall_seconds:.1f} s here",
        f"picture {picture}, session {out.session}",
    ]
