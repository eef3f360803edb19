"""The emulated FlexiTac: resistive taxels in a divider, eight bits each, sent without a pause.

It is written from the maker's firmware and reader, not from the driver.
"""

from dataclasses import dataclass

import numpy as np

from palpate.plugins import Corner, Description, Floats
from palpate_flexitac.codec import encode_matrix

__all__ = ["FlexiTacTruth", "PressedMatrix"]


@dataclass(frozen=True)
class FlexiTacTruth:
    """Truth of one matrix: a taxel conducts `per_n` of the divider's resistor by 1 N, within `gain_spread`.

    At rest it reads `rest_counts`. Of a load that falls `memory_share` is forgotten within `memory_s` only.
    """

    per_n: float = 4.0
    gain_spread: float = 0.2
    rest_counts: float = 20.0
    memory_share: float = 0.15
    memory_s: float = 0.3
    noise_counts: float = 0.7


class PressedMatrix:
    """Frames of one matrix, whose taxels are those of the bench."""

    def __init__(self, cells: Description, first: Corner, truth: FlexiTacTruth, seed: int) -> None:
        self._truth, self._first, self._rng = truth, first, np.random.default_rng(seed)
        shape = cells.rows, cells.cols
        self._gain = truth.per_n * (1 + truth.gain_spread * self._rng.uniform(-1, 1, shape))
        self._rest = truth.rest_counts * self._rng.uniform(0.5, 1.5, shape)
        self._kept = np.zeros(shape)
        self._last_s = 0.0

    def frame(self, now: float, force_n: Floats) -> bytes:
        """The frame that is sampled at `now` (s), for forces on the taxels (N)."""
        truth = self._truth
        step_s, self._last_s = max(now - self._last_s, 0.0), now
        self._kept = np.maximum(force_n, self._kept * np.exp(-step_s / truth.memory_s))
        pressed = force_n + truth.memory_share * (self._kept - force_n)
        conducts = self._gain * pressed
        read = self._rest + (255 - self._rest) * conducts / (1 + conducts)
        read += truth.noise_counts * self._rng.standard_normal(read.shape)
        return encode_matrix(self._first.flip(np.clip(np.rint(read), 0, 255)).astype(np.uint8))
