"""Clocks: time as a value that is passed in. Code below `rig` uses no other clock.

A `VirtualClock` moves only when somebody waits on it: the mock transport advances it by wire time, by device
latency and by polling, so an emulated session is deterministic and runs faster than real time.
"""

import time
from typing import Protocol


class Clock(Protocol):
    """Seconds since an arbitrary start, never running backwards."""

    def now(self) -> float:
        """Current time in s."""
        ...

    def sleep(self, seconds: float) -> None:
        """Return once `seconds` have passed on this clock."""
        ...


class MonotonicClock:
    """The machine's monotonic clock, starting at 0 when made."""

    def __init__(self) -> None:
        self._start = time.monotonic()

    def now(self) -> float:
        """Seconds since this clock was made."""
        return time.monotonic() - self._start

    def sleep(self, seconds: float) -> None:
        """Sleep in real time."""
        if seconds > 0:
            time.sleep(seconds)


class VirtualClock:
    """A clock that stands still until it is moved."""

    def __init__(self) -> None:
        self._now = 0.0

    def now(self) -> float:
        """Virtual seconds since this clock was made."""
        return self._now

    def sleep(self, seconds: float) -> None:
        """Move on by `seconds`; a negative span raises ValueError."""
        if seconds < 0:
            raise ValueError(f"cannot sleep {seconds} s")
        self._now += seconds

    def advance_to(self, instant: float) -> None:
        """Move on to `instant` (s); an instant that has passed leaves the clock where it is."""
        self._now = max(self._now, instant)
