"""Results about sessions, recorded or running: `sessions`, `info`, `replay`, `export` and `watch`."""

from typing import Literal

from pydantic import Field

from palpate.config.fields import Out, Rounded


class DifferenceOut(Out):
    """Place where a replay first differs: the line of the log, from 1, and what is different."""

    line: int
    message: str


class EndOut(Out):
    """End of the recorded run: `how` is "done" or the kind of error, `message` its text."""

    how: str
    message: str | None


class NamedPartOut(Out):
    """One of several parts that a run has found; `object` and `state` are null where none is left."""

    verdict: str
    object: str | None
    state: str | None


class ReplayOut(Out):
    """Answer of `palpate replay`.

    `same`: as far as the log goes, every byte sent and every value is as recorded. `events`: lines of the log
    that came about again. `end` is null if the log was cut off; `object` and `state` are null if nothing
    was identified. `recorded_by`: palpate's version then. `parts`: of several on one table, each.
    """

    format: Literal["palpate/replay@1"] = "palpate/replay@1"
    same: bool
    events: int
    sent_bytes: int
    received_bytes: int
    end: EndOut | None
    verdict: str | None
    object: str | None
    state: str | None
    difference: DifferenceOut | None
    recorded_by: str
    session: str
    parts: tuple[NamedPartOut, ...] = ()


class SessionOut(Out):
    """One recorded session, as its log says.

    `path`: its folder. `began`: UTC. `command` recorded it. `seed`: null if nothing was drawn from one.
    `emulated`: by the rig file, or by what served devices say of themselves, known when there is a result;
    null for sessions of versions that did not record it. `ended` is null while the run goes on, and of one
    that was killed (`writing` says which). `duration` (s) is the rig's own time. `verdict` is null where
    there was no answer, `object` and `state` where it names none. `parts`: of several on one table, each.
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
    parts: tuple[NamedPartOut, ...] = ()


class PortOfSessionOut(Out):
    """A port of the rig file that the run was made with, and the devices that it names there."""

    port: str
    devices: tuple[str, ...]


class VersionsOut(Out):
    """Versions that a session was recorded with; null if the log does not say."""

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


class ExportedOut(Out):
    """A file or folder that was written, and how many messages are on each topic (lines in each CSV file)."""

    path: str
    messages: dict[str, int]


class ExportOut(Out):
    """Files that were written of a session."""

    format: Literal["palpate/export@1"] = "palpate/export@1"
    session: str
    written: tuple[ExportedOut, ...]


class PatchOut(Out):
    """A contact, in the tip frame: its direction from the tip's axis, within `angle_half_range_rad`.

    `centroid_rad` is null on a flat array. `force_bound_n` is null if taxels are saturated: the force
    may be anything then. `flags`: what the bounds had to allow for.
    """

    angle_rad: Rounded
    angle_half_range_rad: Rounded
    centroid_rad: Rounded | None
    height_mm: Rounded
    height_bound_mm: Rounded
    force_n: Rounded
    force_bound_n: Rounded | None
    extent_rad: Rounded
    flags: tuple[str, ...]


class WatchedFingerOut(Out):
    """A finger's array. `counts`: rows of taxels, lowest first; null before the first frame.

    `dead`, `hot` and `saturated` hold [row, column], from 0. `force_n` is that of all taxels, null if
    the array is not tared or silent; `contact` is null then too, or if nothing is touched. `frames`,
    `lost`, `faults`, `misshapen` and `dropped` count from the start or the last reset; `rate_hz`: frames
    that reach the host.
    """

    finger: str
    port: str
    rows: int
    columns: int
    tared: bool
    rate_hz: Rounded
    age_s: Rounded
    frames: int
    lost: int
    faults: int
    misshapen: int
    dropped: int
    force_n: Rounded | None
    contact: PatchOut | None
    dead: tuple[tuple[int, int], ...]
    hot: tuple[tuple[int, int], ...]
    saturated: tuple[tuple[int, int], ...]
    counts: tuple[tuple[int, ...], ...] | None


class WatchOut(Out):
    """All fingers at one instant; `t_s` is the rig's time, from 0, or the session's."""

    format: Literal["palpate/watch@1"] = "palpate/watch@1"
    t_s: Rounded
    rig: str
    session: str | None
    fingers: tuple[WatchedFingerOut, ...]
