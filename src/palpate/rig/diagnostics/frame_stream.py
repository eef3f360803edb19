"""Judgement of an array's stream: whether frames come often enough, and whether too many get lost.

One criterion for `check`, `doctor` and the tests of a real rig.
"""

from collections.abc import Sequence

from palpate.drivers.tactile.frames import ArrayCounters, TactileFrame

__all__ = ["comes_too_seldom", "frame_rate_hz", "frames_gone", "loses_too_many"]

_RATE_SHARE = 0.95  # of the wanted rate: arrays have clocks of their own
_LOST_SHARE = 0.005


def frame_rate_hz(frames: Sequence[TactileFrame]) -> float:
    """Frames that arrive in a second of the array's own clock; 0 for fewer than two."""
    if len(frames) < 2:
        return 0.0
    span_s = frames[-1].device_time_s - frames[0].device_time_s
    return (len(frames) - 1) / span_s if span_s > 0 else 0.0


def comes_too_seldom(rate_hz: float, wanted_hz: float) -> bool:
    """Whether that is less than 95 % of what was asked for."""
    return rate_hz < _RATE_SHARE * wanted_hz


def frames_gone(begin: ArrayCounters, end: ArrayCounters) -> int:
    """Frames that never came, or came damaged, from `begin` on: not what boards send while they start."""
    return (end.lost - begin.lost) + (end.faults - begin.faults) + (end.misshapen - begin.misshapen)


def loses_too_many(gone: int, came: int) -> bool:
    """Whether more than 0.5 % of the frames are gone, and more than one."""
    return gone > 1 and gone > _LOST_SHARE * (came + gone)
