"""Plausibility of frames: size, counts and time.

A CRC that holds says that a message is as the array sent it, not that the array is well. The rules are those
of `docs/tactile-protocol.md`, section 4.
"""

import numpy as np

from palpate.drivers.tactile.messages import Description, Frame, Message

__all__ = ["FramePlausibility"]

_LATEST_US = 1 << 53  # 285 years: no array has run for so long
_LEAP_S = 2.0
_DRIFT = 0.05  # of clocks against each other: RC oscillators are a few per cent off


class FramePlausibility:
    """Looks at every frame of one array."""

    def __init__(self, description: Description) -> None:
        d = description
        self._size = (d.rows, d.cols)
        self._max_count = d.max_count
        # A little-endian number whose set bits no taxel may have.
        self._beyond = int.from_bytes((0xFFFF ^ d.max_count).to_bytes(2, "little") * d.taxels, "little")
        self._first: tuple[int, float] | None = None  # time (µs), and when it was read (s)
        self._last = (0, 0.0)

    def problem(self, message: Message, frame: Frame, now: float) -> str | None:
        """Say what makes no sense in a frame that was read at `now` (s), or None if all does."""
        if (frame.rows, frame.cols) != self._size:
            rows, cols = self._size
            return f"{frame.rows} x {frame.cols} taxels (described: {rows} x {cols})"
        if self._beyond and int.from_bytes(frame.taxels, "little") & self._beyond:
            return self._count_problem(frame)
        time_us = message.time_us
        if self._first is not None:
            last_us, last_s = self._last
            if time_us <= last_us:
                return f"device time {time_us} µs after {last_us} µs (allowed: ascending)"
            # A host that was held up reads old frames late, and then a new one soon after them.
            if _leaps(self._last, time_us, now) and _leaps(self._first, time_us, now):
                return f"device time {time_us} µs after {last_us} µs, {now - last_s:.3g} s later"
        if time_us >= _LATEST_US:
            return f"device time {time_us} µs (allowed: below {_LATEST_US})"
        self._last = (time_us, now)
        if self._first is None:
            self._first = self._last
        return None

    def _count_problem(self, frame: Frame) -> str:
        row, col = map(int, np.unravel_index(int(frame.counts.argmax()), frame.counts.shape))
        return f"count {frame.counts[row, col]} at row {row}, column {col} (allowed: 0 to {self._max_count})"


def _leaps(since: tuple[int, float], time_us: int, now: float) -> bool:
    """Whether the device's clock has run further since a frame than the host's can explain."""
    then_us, then_s = since
    return time_us - then_us > ((now - then_s) * (1 + _DRIFT) + _LEAP_S) * 1e6
