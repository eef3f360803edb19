"""Numbers and times for frames of devices that only stamp them with a counter of 32 bits.

Lost frames are estimated: a step much longer than usual
means that frames are missing. A device that pauses by itself looks the same.
"""

from collections import deque
from dataclasses import dataclass
from statistics import median

__all__ = ["FrameTime", "FrameTimes"]

_WRAP = 1 << 32
_REMEMBERED = 16
_ENOUGH = 4  # steps, before one may be called long
_LONG = 1.6  # of the usual step
_IMPOSSIBLE_S = 10.0  # no stream pauses for so long: the stamp is damaged, or the device has started anew


@dataclass(frozen=True)
class FrameTime:
    """Where a frame belongs: its number, with a gap where frames seem to be missing, and its time."""

    sequence: int
    time_s: float


class FrameTimes:
    """Unwraps stamps of `tick_s` each and numbers frames; `lost` counts those that seem to be missing."""

    def __init__(self, tick_s: float) -> None:
        self.lost = 0
        self._tick_s = tick_s
        self._sequence = -1
        self._last: int | None = None
        self._ticks = 0
        self._fresh = True
        self._steps: deque[int] = deque(maxlen=_REMEMBERED)

    def restart(self) -> None:
        """A new stream begins, maybe at another rate: no frame is missing between the old one and it."""
        self._fresh = True
        self._steps.clear()

    def place(self, stamp: int) -> FrameTime | None:
        """Number and time of the next frame; None if it is repeated or its time is impossible.

        After an impossible one, times go on from it: if it was the damaged one, one more frame is
        refused.
        """
        last, self._last = self._last, stamp
        step = stamp if last is None else (stamp - last) % _WRAP
        missing = 0
        if self._fresh:
            self._fresh = False
        elif step == 0 or step * self._tick_s > _IMPOSSIBLE_S:
            return None
        else:
            missing = self._missing(step)
        self._ticks += step
        self.lost += missing
        self._sequence += 1 + missing
        return FrameTime(self._sequence, self._ticks * self._tick_s)

    def _missing(self, step: int) -> int:
        usual = median(self._steps) if len(self._steps) >= _ENOUGH else None
        if usual is not None and step > _LONG * usual:
            return round(step / usual) - 1
        self._steps.append(step)
        return 0
