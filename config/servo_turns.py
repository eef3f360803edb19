"""Does what a servo moves stay within the turns that it knows, and off its stops? Checks of one servo's keys.

Called while the tables of `rig_fingers` and `rig_file` are made. mm and degrees, as in the file.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from palpate.config.problems import problem

if TYPE_CHECKING:
    from palpate.config.rig_fingers import SlideConfig

__all__ = ["check_one_turn", "check_slide", "check_turns"]

_TURNS = 256
"""Turns either way in Extended Position Control Mode (e-Manual, Operating Mode (11))."""

_STOP_MARGIN_MM = 0.5


def check_one_turn(gear_ratio: float, zero_deg: float, range_deg: tuple[float, float]) -> None:
    """Refuse a range that leaves the one turn within which a servo knows its angle at power-up."""
    turns = [(zero_deg + gear_ratio * angle) / 360 for angle in range_deg]
    if min(turns) < 0 or max(turns) >= 1:
        raise problem(
            f"needs servo turns {min(turns):.2f} to {max(turns):.2f}; this servo must stay within 0 … 1, "
            "because it knows its angle within one turn when it starts",
            "range_deg",
        )


def check_turns(turns: list[float], key: str) -> None:
    """Refuse turns that a servo cannot count."""
    if max(abs(turn) for turn in turns) > _TURNS:
        raise problem(
            f"needs servo turns {min(turns):.0f} to {max(turns):.0f}; a servo reaches {_TURNS} either way",
            key,
        )


def check_slide(slide: SlideConfig) -> None:
    """Refuse a slide that starts outside of the servo's first turn, or goes where the servo cannot count."""
    turns = [(distance - slide.zero_mm) / slide.mm_per_turn for distance in slide.range_mm]
    check_turns(turns, "range_mm")
    # After power-up a servo knows its angle within one turn, so the finger must start in that one.
    if not 0 <= turns[0] < 1:
        raise problem(
            f"is {slide.zero_mm:g}: retracted, at {slide.range_mm[0]:g} mm, the servo would stand at turn "
            f"{turns[0]:.2f}; it must be in 0 … 1, because a servo starts within one turn",
            "zero_mm",
        )
    if slide.stops_mm is not None:
        _check_stops(slide, *slide.stops_mm)


def _check_stops(slide: SlideConfig, back_mm: float, front_mm: float) -> None:
    """Refuse soft limits that may lie on the stops or beyond, and a back stop outside of the first turn."""
    lo, hi = slide.range_mm
    needed = [_STOP_MARGIN_MM + slide.off_mm(distance) for distance in (lo, hi)]
    if lo - back_mm < needed[0] or front_mm - hi < needed[1]:
        raise problem(
            f"is [{back_mm:g}, {front_mm:g}]; range_mm [{lo:g}, {hi:g}] needs stops at "
            f"{lo - needed[0]:.4g} or less and {hi + needed[1]:.4g} or more: {_STOP_MARGIN_MM:g} mm clear by "
            "all that zero_bound_mm and mm_per_turn_spread allow",
            "stops_mm",
        )
    turns = [(stop - slide.zero_mm) / slide.mm_per_turn for stop in (back_mm, front_mm)]
    check_turns(turns, "stops_mm")
    # Somebody may have pushed the finger back to its stop before switching on; turned on, it reads a whole
    # turn too much if that is before the servo's zero, and nothing would show it.
    off = slide.off_mm(back_mm) / abs(slide.mm_per_turn)
    if not off <= turns[0] < 1 - off:
        raise problem(
            f"is [{back_mm:g}, {front_mm:g}]: at the back stop the servo would stand at turn {turns[0]:.3f}, "
            f"± {off:.3f}; it must be in 0 … 1, because a servo starts within one turn",
            "stops_mm",
        )
