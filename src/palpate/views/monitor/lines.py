"""The state of watched fingers as lines: text for people, JSON for programs."""

import math
from collections.abc import Sequence

import numpy as np

from palpate.base.errors import counted
from palpate.base.geometry import Bools
from palpate.config.watch_result import PatchOut, WatchedFingerOut, WatchOut
from palpate.drivers.tactile.contact import ContactPatch
from palpate.drivers.tactile.frames import ArrayCounters
from palpate.drivers.tactile.messages import Shape
from palpate.rig.monitor.finger_monitor import FingerView, TareState

__all__ = ["age_words", "flag_words", "line_of", "out_of", "place_words", "summary_of", "taxel_words"]


def line_of(view: FingerView, t_s: float) -> str:
    """One line about a finger, for where there is no screen."""
    state = view.tare.value
    if view.counts is None or view.silent:
        state = "no frames"
    elif view.tare is TareState.DONE:
        state = _contact_words(view)
    return (
        f"{t_s:8.2f} s  {view.name}  {state}; {view.rate_hz:.1f} frames/s, "
        f"the last {age_words(view.age_s)} ago; {_counter_words(view.counters)}"
    )


def summary_of(view: FingerView) -> str:
    """What a finger's port has been through, at the end."""
    frames = counted(view.counters.frames, "frame", "frames")
    return f"{view.name}: {frames}, {_counter_words(view.counters)}"


def place_words(patch: ContactPatch, shape: Shape) -> str:
    """Where round the tip a contact is; of a flat array that is not known."""
    if shape is Shape.FLAT:
        return "direction not known: flat array"
    angle, half = math.degrees(patch.angle_rad), math.degrees(patch.angle_half_range_rad)
    return f"{angle:+.1f}° ± {half:.1f}°"


def flag_words(patch: ContactPatch) -> list[str]:
    """What the bounds had to allow for."""
    return sorted(flag.value for flag in patch.flags)


def taxel_words(view: FingerView) -> str:
    """How many taxels are not to be trusted; "" if all are."""
    kinds = (
        ("dead", view.dead),
        ("hot", view.hot),
        ("at its largest count", view.saturated & ~view.hot),
    )
    counts = ((name, int(mask.sum())) for name, mask in kinds)
    return ", ".join(f"{count} {name}" for name, count in counts if count)


def age_words(age_s: float) -> str:
    """A time since, short."""
    return f"{age_s * 1e3:.0f} ms" if age_s < 1 else f"{age_s:.1f} s"


def out_of(views: Sequence[FingerView], *, t_s: float, rig: str, session: str | None) -> WatchOut:
    """One update as a result."""
    fingers = tuple(_finger_out(view) for view in views)
    return WatchOut(t_s=t_s, rig=rig, session=session, fingers=fingers)


def _contact_words(view: FingerView) -> str:
    patch = view.patch
    if patch is None:
        return f"{view.force_n or 0:.3f} N, nothing touched"
    words = [
        f"{patch.force_n:.3f} N",
        f"touched at {place_words(patch, view.description.shape)}",
        f"height {patch.height_mm:.1f} ± {patch.height_bound_mm:.1f} mm",
        *flag_words(patch),
    ]
    return ", ".join(words)


def _counter_words(counters: ArrayCounters) -> str:
    words = f"lost {counters.lost}, faults {counters.faults}, dropped {counters.dropped}"
    return f"{words}, misshapen {counters.misshapen}" if counters.misshapen else words


def _finger_out(view: FingerView) -> WatchedFingerOut:
    return WatchedFingerOut.of(
        view.counters,
        finger=view.name,
        port=view.port,
        rows=view.description.rows,
        columns=view.description.cols,
        tared=view.tare is TareState.DONE,
        rate_hz=view.rate_hz,
        age_s=view.age_s,
        force_n=view.force_n,
        contact=None if view.patch is None else _patch_out(view.patch),
        dead=_places(view.dead),
        hot=_places(view.hot),
        saturated=_places(view.saturated),
        counts=None if view.counts is None else tuple(tuple(row) for row in view.counts.tolist()),
    )


def _patch_out(patch: ContactPatch) -> PatchOut:
    return PatchOut.of(
        patch,
        centroid_rad=patch.centroid_rad if math.isfinite(patch.centroid_rad) else None,
        force_bound_n=patch.force_bound_n if math.isfinite(patch.force_bound_n) else None,
        flags=tuple(flag_words(patch)),
    )


def _places(mask: Bools) -> tuple[tuple[int, int], ...]:
    return tuple((int(row), int(column)) for row, column in np.argwhere(mask))
