"""Sample times: when the frames of a stream were sampled, on the host's clock, within bounds.

Adapters and hubs hand frames over late, some later than others. An array's own time stamps say how much: by
how little any frame is behind its stamp shows how far the two clocks are apart at most; and that no frame was
sampled before the stream was asked for, how far they are apart at least.
"""

import math
from collections import deque
from collections.abc import Sequence

from palpate.drivers.tactile.frames import TactileFrame

__all__ = ["SampleTimes"]

_FIRST = 48  # frames: fewer than a tare takes
_LATELY = 128  # frames, in which no two clocks run apart by much
_LONG = 1024  # frames, in which good clocks do not either


class SampleTimes:
    """Bounds on when each frame of one stream was sampled.

    They hold if among any 1024 frames one comes about as soon, but for a period, as the soonest of the first
    48 did. A clock that is slow by a share r shifts them by r times the duration of 128 frames, one that is
    fast by up to that of 1024.
    """

    def __init__(self, asked_s: float) -> None:
        """`asked_s`: the instant (s, host's clock) before which the stream was not asked for."""
        self._asked_s = asked_s
        self._soonest, self._lately = _LeastOfLast(_LONG), _LeastOfLast(_LATELY)
        self._first = 0
        self._apart_s = math.nan  # at least, at the first frame
        self._delay_s = math.inf  # of the soonest frame, at most
        self.spread_s = math.inf
        """By how much a frame may be older than the latest instant at which it can have been sampled."""
        self.sampled_s = -math.inf
        """Up to when, at least, everything has been read that was sampled."""

    def latest_s(self, frames: Sequence[TactileFrame]) -> list[float]:
        """The latest instants at which frames (one or more) that come next can have been sampled."""
        stamps = [frame.device_time_s for frame in frames]
        if not self._first:
            self._apart_s = self._asked_s - stamps[0]
        for frame in frames:
            behind = frame.host_time_s - frame.device_time_s
            soonest, lately = self._soonest.add(behind), self._lately.add(behind)
        if self._first < _FIRST:
            self._first += len(frames)
            self._delay_s = max(soonest - self._apart_s, 0.0)
        # Where the last few are all later than others before, delays have grown, or the clock is slow.
        self.spread_s = self._delay_s + lately - soonest
        self.sampled_s = max(self.sampled_s, stamps[-1] + lately - self.spread_s)
        return [stamp + lately for stamp in stamps]


class _LeastOfLast:
    """The least of the last `size` values: this is asked for at each look at an array."""

    def __init__(self, size: int) -> None:
        self._size, self._count = size, 0
        self._left: deque[tuple[int, float]] = deque()  # that may be least yet, the oldest and least first

    def add(self, value: float) -> float:
        """Take one more; the least now."""
        while self._left and self._left[-1][1] >= value:
            self._left.pop()
        self._left.append((self._count, value))
        self._count += 1
        if self._left[0][0] < self._count - self._size:
            self._left.popleft()
        return self._left[0][1]
