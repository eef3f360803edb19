"""Whether the frames of an array make sense: size, counts and time. Between `array` and what it is sent.

A CRC that holds says that a message is as the array sent it, not that the array is well. The rules are those
of `docs/tactile-protocol.md`, section 4.
"""

import numpy as np

from palpate.drivers.tactile.messages import Description, Frame, Message

__all__ = ["FrameCheck"]

_LATEST_US = 1 << 53  # 285 years: no array has run for so long
_LEAP_S = 2.0  # that a clock may be ahead of the host's since the last frame; reading late puts it behind
_RESTART_SPARE_S = 1.0


class FrameCheck:
    """Looks at every frame of one array; `last` is the last one that made sense."""

    def __init__(self, description: Description) -> None:
        d = description
        self._size = (d.rows, d.cols)
        self._max_count = d.max_count
        # A little-endian number whose set bits no taxel may have.
        self._beyond = int.from_bytes((0xFFFF ^ d.max_count).to_bytes(2, "little") * d.taxels, "little")
        self._last_us: int | None = None
        self._last_s = 0.0

    def problem(self, message: Message, frame: Frame, now: float) -> str | None:
        """Say what makes no sense in a frame that was read at `now` (s), or None if all does."""
        if (frame.rows, frame.cols) != self._size:
            rows, cols = self._size
            return f"{frame.rows} x {frame.cols} taxels (described: {rows} x {cols})"
        if self._beyond and int.from_bytes(frame.taxels, "little") & self._beyond:
            return self._count_problem(frame)
        time_us, last_us = message.time_us, self._last_us
        if last_us is not None:
            step_us = time_us - last_us
            if step_us <= 0:
                return f"device time {time_us} µs after {last_us} µs (allowed: ascending)"
            if step_us > (now - self._last_s + _LEAP_S) * 1e6:
                return f"device time {time_us} µs after {last_us} µs, {now - self._last_s:.3g} s later"
        if time_us >= _LATEST_US:
            return f"device time {time_us} µs (allowed: below {_LATEST_US})"
        self._last_us, self._last_s = time_us, now
        return None

    def _count_problem(self, frame: Frame) -> str:
        row, col = map(int, np.unravel_index(int(frame.counts.argmax()), frame.counts.shape))
        return f"count {frame.counts[row, col]} at row {row}, column {col} (allowed: 0 to {self._max_count})"
