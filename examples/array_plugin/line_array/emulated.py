"""The emulated line array, written from the protocol and not from the driver, so that each checks the other.

`oversampling` is taken and has no effect.
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from line_array.codec import LineDecoder, encode
from palpate.plugins import Description, Emission, Mounting, Taxels

__all__ = ["EmulatedLineArray"]


class EmulatedLineArray:
    """A device on a wire: bytes in, bytes and the instants at which they are sent out."""

    def __init__(self, taxels: Taxels, advance: Callable[[float], None], mounting: Mounting) -> None:
        self._taxels = taxels
        self._advance = advance
        self._mounting = mounting
        self.restart(0.0)

    @property
    def description(self) -> Description:
        """The truth about its taxels."""
        return self._taxels.description

    def restart(self, _now: float) -> None:
        """Forget stream and input, as when power comes on."""
        self._decoder = LineDecoder()
        self._queue: list[Emission] = []
        self._period_s = 0.0
        self._next_s: float | None = None

    def next_sample_s(self) -> float | None:
        """Instant of the next sample, None while it does not stream."""
        return self._next_s

    def sample(self, now: float, force_n: NDArray[np.float64]) -> None:
        """Send a frame of forces (N, rows x cols)."""
        counts = self._mounting.to_device(self._taxels.counts(force_n, now)).ravel()
        self._say(f"f{round(now * 1000):08x}" + "".join(f"{count:03x}" for count in counts), now)
        self._next_s = now + self._period_s

    def feed(self, data: bytes, now: float) -> list[Emission]:
        """Take bytes that arrived at `now`; return answers and frames."""
        self._advance(now)
        for text in self._decoder.feed(data):
            match text.split():
                case ["what"]:
                    self._say(self._matrix(), now)
                case ["go", rate, _oversampling]:
                    self._period_s = 1 / float(rate)
                    self._next_s = now + self._period_s
                    self._say("go", now)
                case ["halt"]:
                    self._next_s = None
                    self._say("halt", now)
        return self.poll(now)

    def poll(self, now: float) -> list[Emission]:
        """Return what is due at `now`."""
        self._advance(now)
        due, self._queue = self._queue, []
        return due

    def next_due(self) -> float | None:
        """Instant of the next emission."""
        return self._queue[0][0] if self._queue else self._next_s

    def _matrix(self) -> str:
        d = self.description
        along = d.columns[1] - d.columns[0]
        sizes = [along * self._mounting.tip_radius_mm, d.row_heights_mm[1] - d.row_heights_mm[0]]
        cells = [d.cols, d.rows]
        if self._mounting.upright:
            cells, sizes = cells[::-1], sizes[::-1]
        return f"what {cells[0]} {cells[1]} {sizes[0]:.2f} {sizes[1]:.2f}"

    def _say(self, text: str, now: float) -> None:
        self._queue.append((now, encode(text)))
