"""Result of `palpate sessions` and `palpate info`: `palpate/sessions@1`."""

from typing import Literal

from pydantic import Field

from palpate.config.replay_result import EndOut
from palpate.config.results import Out, Rounded

__all__ = ["SessionOut", "SessionsOut", "UnreadableOut"]


class SessionOut(Out):
    """One recorded session, as its log says.

    `started`: UTC. `emulated`: null for sessions of versions that did not record it. `end` is null while the
    run goes on, and of one that was killed (`writing` says which). `duration` (s) is the rig's own time.
    `verdict` is null where there was no answer, `object` and `state` where it names none.
    """

    session: str
    started: str | None
    palpate: str | None
    rig: str | None
    seed: int | None
    emulated: bool | None
    calibration: bool
    writing: bool = Field(description="A process is writing it now.")
    end: EndOut | None
    duration: Rounded
    grips: int
    touches: int
    verdict: str | None
    object: str | None
    state: str | None
    bytes: int


class UnreadableOut(Out):
    """A folder whose log cannot be read, and why."""

    session: str
    why: str


class SessionsOut(Out):
    """All sessions in a folder, the oldest first."""

    format: Literal["palpate/sessions@1"] = "palpate/sessions@1"
    units: Literal["s"] = "s"
    folder: str
    sessions: tuple[SessionOut, ...]
    unreadable: tuple[UnreadableOut, ...]
