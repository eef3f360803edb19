"""Paced clock: holds another clock back to the wall's pace, to display what does not run in real time."""

import math

from palpate.base.errors import InputError
from palpate.drivers.transport.clock import Clock, MonotonicClock

__all__ = ["PacedClock", "paced"]

_MOST_LATE_S = 0.25


class PacedClock:
    """`clock`, whose sleeps take `speed` times less on `wall`. What was missed by much stays missed."""

    def __init__(self, clock: Clock, wall: Clock, speed: float = 1.0) -> None:
        self._clock = clock
        self._wall = wall
        self._speed = speed
        self._begin()

    def now(self) -> float:
        """The clock's own time, s."""
        return self._clock.now()

    def sleep(self, seconds: float) -> None:
        """Sleep on the clock, then on the wall until it has come as far."""
        self._clock.sleep(seconds)
        due = self._wall_start + (self._clock.now() - self._start) / self._speed
        late = self._wall.now() - due
        if late < 0:
            self._wall.sleep(-late)
        elif late > _MOST_LATE_S:
            self._begin()

    def _begin(self) -> None:
        self._start, self._wall_start = self._clock.now(), self._wall.now()


def paced(clock: Clock, speed: float | None, wall: Clock | None = None) -> Clock:
    """`clock`, held back to `speed` of its seconds in one of the wall's; None: as fast as it is computed."""
    if speed is None:
        return clock
    if not 0 < speed < math.inf:
        raise InputError(f"speed is {speed:g}; it must be above 0")
    return PacedClock(clock, wall or MonotonicClock(), speed)
