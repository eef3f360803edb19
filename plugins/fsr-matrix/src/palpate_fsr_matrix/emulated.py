"""The emulated matrix: cells with gains of their own, a soft beginning and a memory, and the circuit.

It is written from the circuit and the frame, not from the driver.
"""

from dataclasses import dataclass

import numpy as np

from palpate.plugins import Corner, Description, Floats
from palpate_fsr_matrix.circuit import readings_of
from palpate_fsr_matrix.codec import Readings, encode_readings

__all__ = ["FsrTruth", "ResistiveSkin"]


@dataclass(frozen=True)
class FsrTruth:
    """Truth of one matrix: what a cell conducts, over the column's resistor.

    `per_n`: by 1 N, far above `turn_on_n`, at which it conducts half of that; `gain_spread`: from cell to
    cell. Of a load that falls `memory_share` stays at first, and is forgotten within `memory_s`.
    """

    per_n: float = 1.0
    gain_spread: float = 0.2
    turn_on_n: float = 0.01
    memory_share: float = 0.2
    memory_s: float = 0.3
    leak: float = 0.002
    noise_lsb: float = 0.5


class ResistiveSkin:
    """Frames of one matrix, whose cells are those of the bench."""

    def __init__(
        self, cells: Description, first: Corner, truth: FsrTruth, seed: int, matrix: int = 0
    ) -> None:
        self._truth, self._first, self._rng = truth, first, np.random.default_rng(seed)
        shape = cells.rows, cells.cols
        self._gain = truth.per_n * (1 + truth.gain_spread * self._rng.uniform(-1, 1, shape))
        self._leak = truth.leak * self._rng.uniform(0.5, 1, shape)
        self._kept = np.zeros(shape)
        self._last_s = 0.0
        self._matrix, self._number = matrix, 0

    def frame(self, now: float, force_n: Floats) -> bytes:
        """The frame that is sampled at `now` (s), for forces on the cells (N)."""
        truth = self._truth
        step_s, self._last_s = max(now - self._last_s, 0.0), now
        self._kept = np.maximum(force_n, self._kept * np.exp(-step_s / truth.memory_s))
        pressed = force_n + truth.memory_share * (self._kept - force_n)
        conductance = self._leak + self._gain * pressed**2 / (pressed + truth.turn_on_n)
        adc = readings_of(conductance, truth.noise_lsb * self._rng.standard_normal(conductance.shape))
        self._number = (self._number + 1) % (1 << 16)
        time_us = round(now * 1e6) % (1 << 32)
        return encode_readings(Readings(self._matrix, self._number, time_us, self._first.flip(adc)))
