"""The zero that an emulated array takes off: TARE of `docs/tactile-protocol.md`. Part of `array`."""

from dataclasses import dataclass

import numpy as np

from palpate.geometry import Counts, Ints

__all__ = ["Taring"]


@dataclass(frozen=True, eq=False)
class Zero:
    """What is taken off the raw counts of every taxel, `zero` of shape (rows, cols), and what is added."""

    zero: Ints
    pedestal: int
    max_count: int

    def taken_off(self, raw: Counts) -> Counts:
        """Return tared counts of raw ones, both of shape (rows, cols); full ones stay full."""
        counts = np.clip(raw - self.zero + self.pedestal, 0, self.max_count)
        return np.where(raw == self.max_count, raw, counts).astype("<u2")


class Taring:
    """RAW, AVERAGING or TARED, as in the page's section 3."""

    def __init__(self, max_count: int) -> None:
        self._max_count = max_count
        self._zero: Zero | None = None
        self._samples: list[Counts] = []
        self._wanted = 0
        self._pedestal = 0

    def forget(self) -> None:
        """Go back to raw counts."""
        self._zero = None
        self._wanted = 0

    def begin(self, samples: int, pedestal: int) -> None:
        """Average the next `samples` samples, then take the mean off and add `pedestal` counts."""
        self._samples, self._wanted, self._pedestal = [], samples, pedestal

    def sent(self, raw: Counts) -> tuple[Counts, bool]:
        """Take in one sample; return what the array sends of it, and whether that is tared."""
        zero = self._zero
        if self._wanted:
            self._average(raw)
        return (raw, False) if zero is None else (zero.taken_off(raw), True)

    def _average(self, raw: Counts) -> None:
        self._samples.append(raw)
        n = len(self._samples)
        if n == self._wanted:
            total: Ints = np.sum(self._samples, axis=0, dtype=np.int64)
            self._zero = Zero((2 * total + n) // (2 * n), self._pedestal, self._max_count)  # halves go up
            self._samples, self._wanted = [], 0
