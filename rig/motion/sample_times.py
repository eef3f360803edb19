"""Sample times: when the frames of a stream were sampled, on the host's clock, within bounds.

Adapters and hubs hand frames over late, some later than others. An array's own time stamps say how much: by
how little a frame is behind its stamp shows how far the two clocks are apart at most, and that no frame was
sampled before the stream was asked for, how far they are at least.
"""

import math
from collections import deque
from collections.abc import Sequence

import numpy as np

from palpate.drivers.tactile.frames import TactileFrame
from palpate.geometry import Floats

__all__ = ["SampleTimes"]

_LATELY = 64  # frames, in which clocks run apart by little
_FIRST = 48  # frames: fewer than a tare takes


class SampleTimes:
    """Bounds on when each frame of one stream was sampled.

    Assumed is that among any 64 frames one is no later than the earliest of the first 48 may have been. A
    clock that runs faster or slower by a share r makes the bounds wrong by r times the time of 64 frames.
    """

    def __init__(self, asked_s: float) -> None:
        """`asked_s`: the instant (s, host's clock) before which the stream was not asked for."""
        self._asked_s = asked_s
        self._behind: deque[float] = deque(maxlen=_LATELY)
        self._least_behind_s: float | None = None  # by causality
        self._first = 0
        self.spread_s = math.inf
        """By how much a frame may be older than the latest instant at which it can have been sampled."""
        self.sampled_s = -math.inf
        """Since when, at least, everything up to the newest frame's sample has been read."""

    def latest_s(self, frames: Sequence[TactileFrame]) -> Floats:
        """The latest instants (n,) at which frames that come next in the stream can have been sampled."""
        stamps = np.array([frame.device_time_s for frame in frames])
        behind = np.array([frame.host_time_s for frame in frames]) - stamps
        self._behind.extend(behind.tolist())
        if self._least_behind_s is None:
            self._least_behind_s = self._asked_s - float(stamps[0])
        # One list of frames was read at about one time: the newest says the most of all of them.
        clocks_s = min(self._behind)
        if self._first < _FIRST:
            self._first += len(frames)
            self.spread_s = max(clocks_s - self._least_behind_s, 0.0)
        self.sampled_s = max(self.sampled_s, float(stamps[-1]) + clocks_s - self.spread_s)
        result: Floats = stamps + clocks_s
        return result
