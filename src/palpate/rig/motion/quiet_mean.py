"""Mean of what an array reads while nothing is noticed: a force that lasts is noticed in it."""

from collections import deque

import numpy as np

from palpate.base.geometry import Floats

__all__ = ["STEADY_FRAMES", "QuietMean"]

STEADY_FRAMES = 64
"""A force that lasts for so many frames is noticed in their mean, where the noise is less."""


class QuietMean:
    """Mean readings of the newest frames, up to `STEADY_FRAMES` of them."""

    def __init__(self) -> None:
        self._newest: deque[Floats] = deque(maxlen=STEADY_FRAMES)
        self._sum = np.zeros(0)

    @property
    def count(self) -> int:
        """How many they are."""
        return len(self._newest)

    def add(self, readings: Floats) -> tuple[Floats, int]:
        """Take readings (n,) of one more frame; the mean (n,), and of how many."""
        newest = self._newest
        if not newest:
            self._sum = readings.copy()
        else:
            self._sum += readings
            if len(newest) == STEADY_FRAMES:
                self._sum -= newest[0]
        newest.append(readings)
        return self._sum / float(len(newest)), len(newest)
