"""What `palpate watch --json` prints, a line for each update: `palpate/watch@1`."""

from typing import Literal

from palpate.config.results import Out, Rounded

__all__ = ["PatchOut", "WatchOut", "WatchedFingerOut"]


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
