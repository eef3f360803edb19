"""Sample times: when the frames of a stream were sampled, on the host's clock, within bounds.

Adapters and hubs hand frames over late, some later than others. An array's own time stamps say how much: by
how little any frame is behind its stamp shows how far the two clocks are apart at most; and that no frame was
sampled before the stream was asked for, how far they are apart at least.
"""

import math
from collections import deque
from collections.abc import Sequence

import numpy as np

from palpate.drivers.tactile.frames import TactileFrame
from palpate.geometry import Floats

__all__ = ["SampleTimes"]

_FIRST = 48  # frames: fewer than a tare takes
_LATELY = 128  # frames, in which no two clocks run apart by much
_LONG = 1024  # frames, in which good clocks do not either


class SampleTimes:
    """Bounds on when each frame of one stream was sampled.

    They hold if among any 1024 frames one comes about as soon, but for a period, as the soonest of the first
    48 did. A clock that is wrong by a share r shifts them by r times the duration of 128 frames.
    """

    def __init__(self, asked_s: float) -> None:
        """`asked_s`: the instant (s, host's clock) before which the stream was not asked for."""
        self._asked_s = asked_s
        self._behind_s: deque[float] = deque(maxlen=_LONG)
        self._first = 0
        self._apart_s = math.nan  # at least, at the first frame
        self._delay_s = math.inf  # of the soonest frame, at most
        self.spread_s = math.inf
        """By how much a frame may be older than the latest instant at which it can have been sampled."""
        self.sampled_s = -math.inf
        """Up to when, at least, everything has been read that was sampled."""

    def latest_s(self, frames: Sequence[TactileFrame]) -> Floats:
        """The latest instants (n,) at which frames that come next in the stream can have been sampled."""
        stamps = np.array([frame.device_time_s for frame in frames])
        behind = np.array([frame.host_time_s for frame in frames]) - stamps
        if not self._first:
            self._apart_s = self._asked_s - float(stamps[0])
        self._behind_s.extend(behind.tolist())
        soonest = min(self._behind_s)
        if self._first < _FIRST:
            self._first += len(frames)
            self._delay_s = max(soonest - self._apart_s, 0.0)
        # Where the last few are all later than others before, delays have grown, or the clock is slow.
        lately = min(list(self._behind_s)[-_LATELY:])
        self.spread_s = self._delay_s + lately - soonest
        self.sampled_s = max(self.sampled_s, float(stamps[-1]) + lately - self.spread_s)
        result: Floats = stamps + lately
        return result
