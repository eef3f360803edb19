"""The zero that an emulated array takes off: TARE of `docs/tactile-protocol.md`. Part of `array`."""

import numpy as np

from palpate.base.geometry import Counts, Ints

__all__ = ["Taring"]


class Taring:
    """RAW, AVERAGING or TARED, as in the page's section 3."""

    def __init__(self, max_count: int) -> None:
        self._max_count = max_count
        self._offset: Ints | None = None
        self._samples: list[Counts] = []
        self._wanted = 0
        self._pedestal = 0

    def forget(self) -> None:
        """Go back to raw counts."""
        self._offset = None
        self._wanted = 0

    def begin(self, samples: int, pedestal: int) -> None:
        """Average the next `samples` samples, then take the mean off and add `pedestal` counts."""
        self._samples, self._wanted, self._pedestal = [], samples, pedestal

    def sent(self, raw: Counts) -> tuple[Counts, bool]:
        """Take in one sample; return what the array sends of it, and whether that is tared."""
        offset = self._offset
        if self._wanted:
            self._average(raw)
        if offset is None:
            return raw, False
        counts = np.clip(raw - offset, 0, self._max_count)
        return np.where(raw == self._max_count, raw, counts).astype("<u2"), True  # full ones stay full

    def _average(self, raw: Counts) -> None:
        self._samples.append(raw)
        n = len(self._samples)
        if n == self._wanted:
            total: Ints = np.sum(self._samples, axis=0, dtype=np.int64)
            self._offset = (2 * total + n) // (2 * n) - self._pedestal  # halves go up
            self._samples, self._wanted = [], 0
