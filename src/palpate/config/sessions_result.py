"""Results of `palpate sessions` (`palpate/sessions@1`) and `palpate info` (`palpate/session-info@1`)."""

from typing import Literal

from pydantic import Field

from palpate.config.replay_result import EndOut
from palpate.config.results import Out, Rounded

__all__ = ["PortOfSessionOut", "SessionInfoOut", "SessionOut", "SessionsOut", "UnreadableOut", "VersionsOut"]


class SessionOut(Out):
    """One recorded session, as its log says.

    `path`: its folder. `began`: UTC. `command` recorded it. `seed`: null if nothing was drawn from one.
    `emulated`: by the rig file, or by what served devices say of themselves, known when there is a result;
    null for sessions of versions that did not record it. `ended` is null while the run goes on, and of one
    that was killed (`writing` says which). `duration` (s) is the rig's own time. `verdict` is null where
    there was no answer, `object` and `state` where it names none.
    """

    path: str
    began: str | None
    command: str
    palpate: str | None
    rig: str | None
    seed: int | None
    emulated: bool | None
    calibration: bool
    writing: bool = Field(description="A process is writing it now.")
    ended: EndOut | None
    duration: Rounded
    grips: int
    touches: int
    verdict: str | None
    object: str | None
    state: str | None
    bytes: int


class PortOfSessionOut(Out):
    """A port of the rig file that the run was made with, and the devices that it names there."""

    port: str
    devices: tuple[str, ...]


class VersionsOut(Out):
    """What a session was recorded with; null if the log does not say."""

    palpate: str | None


class SessionInfoOut(SessionOut):
    """One session with what its rig file names; no devices where it keeps none."""

    format: Literal["palpate/session-info@1"] = "palpate/session-info@1"
    units: Literal["s"] = "s"
    devices: tuple[PortOfSessionOut, ...]
    versions: VersionsOut


class UnreadableOut(Out):
    """A folder whose log cannot be read, and why."""

    path: str
    why: str


class SessionsOut(Out):
    """All sessions in a folder, the oldest first."""

    format: Literal["palpate/sessions@1"] = "palpate/sessions@1"
    units: Literal["s"] = "s"
    folder: str
    sessions: tuple[SessionOut, ...]
    unreadable: tuple[UnreadableOut, ...]
