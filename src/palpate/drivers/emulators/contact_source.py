"""Emulated contact source: what a skin bears, as a device reports it that knows no more than its bounds.

It computes the place where the skin is dented deepest, and the force of all of it. Its errors have two parts:
one that is held for as long as a touch lasts, and noise; together they stay within what it states. Its clock
runs from its own start, a little too fast or too slow, and a reading takes a while to be computed. Light
touches do not show a normal.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from palpate.base.geometry import Floats
from palpate.drivers.emulators.free_running import EmulatedFreeRunningArray
from palpate.drivers.tactile.contact_lines import encode_line
from palpate.drivers.tactile.description import Description
from palpate.drivers.tactile.frames import ContactReading


@dataclass(frozen=True)
class SourceTruth:
    """Truth of one source, and the bounds that it states.

    Of each bound `held_share` is a held error at most, and `noise_share` noise. From `least_angle_n` on it
    knows the normal. `clock_share`: its clock is off by that at most. It computes a reading for
    `delay_share` of the declared delay.
    """

    angle_bound_rad: float = math.radians(8.0)
    force_bound_n: float = 0.04
    force_bound_share: float = 0.06
    height_bound_mm: float = 3.0
    held_share: float = 0.7
    noise_share: float = 0.1
    least_angle_n: float = 0.15
    clock_share: float = 1e-4
    stamp_bound_s: float = 0.001
    delay_share: float = 0.3


class EmulatedContactSource(EmulatedFreeRunningArray):
    """A contact source on the skin that `cells` describe, whose lines name `source`.

    Drawn by the id of the cells: its errors, its clock, and whether it stamps its readings. `spoil`, for
    faults: what is sent instead of a reading; None: nothing.
    """

    def __init__(
        self,
        cells: Description,
        advance: Callable[[float], None],
        rate_hz: float,
        source: str | None,
        delay_s: float,
        truth: SourceTruth | None = None,
    ) -> None:
        self._truth = SourceTruth() if truth is None else truth
        self._source = source
        self._rng = np.random.default_rng(int.from_bytes(cells.unique_id, "little"))
        self._columns, self._rows_mm = np.asarray(cells.columns), np.asarray(cells.row_heights_mm)
        self._begun_s, self._stamps = self._rng.uniform(0.0, 100.0), bool(self._rng.integers(2))
        self._clock_rate = 1 + self._truth.clock_share * self._rng.uniform(-1, 1)
        self.spoil: Callable[[ContactReading], ContactReading | None] = lambda reading: reading
        self._held = np.zeros(3)
        self._touches = False
        super().__init__(cells, advance, rate_hz, self._line, self._truth.delay_share * delay_s)

    def _line(self, now: float, force_n: Floats) -> bytes:
        sent = self.spoil(self.reading(now, force_n))
        return b"" if sent is None else encode_line(sent, self._source)

    def reading(self, now: float, force_n: Floats) -> ContactReading:
        """The reading at `now` (s) of forces (rows, cols) on the skin."""
        truth, true_n = self._truth, float(force_n.sum())
        if (true_n > 0) != self._touches:
            self._touches = true_n > 0
            self._held = truth.held_share * self._rng.uniform(-1, 1, 3)
        # Noise beyond three standard deviations stays within its bound, too: 0.7 + 3 * 0.1 = 1.
        off = self._held + truth.noise_share * np.clip(self._rng.standard_normal(3), -3, 3)
        force_bound_n = truth.force_bound_n + truth.force_bound_share * true_n
        angle_rad = height_mm = math.nan
        if true_n >= truth.least_angle_n:
            angle_rad = deepest_rad(self._columns, force_n) + truth.angle_bound_rad * float(off[0])
            by_row = force_n.sum(axis=1)
            height_mm = float(by_row @ self._rows_mm / by_row.sum()) + truth.height_bound_mm * float(off[2])
        return ContactReading(
            true_n + force_bound_n * float(off[1]),
            force_bound_n,
            angle_rad,
            truth.angle_bound_rad,
            height_mm,
            truth.height_bound_mm,
            self._begun_s + self._clock_rate * now if self._stamps else None,
            truth.stamp_bound_s,
        )


_SMOOTHED_COLUMNS = 5
_DEEPEST_SHARE = 0.98


def deepest_rad(columns: Floats, force_n: Floats) -> float:
    """Direction in which columns bear most, smoothed: that is where an elastic skin is dented deepest.

    `columns` (cols,): even directions, rad; `force_n` (rows, cols).
    """
    beside = _SMOOTHED_COLUMNS // 2
    smooth = np.convolve(force_n.sum(axis=0), np.ones(_SMOOTHED_COLUMNS))
    most = int(smooth.argmax())
    first = last = most
    while first > 0 and smooth[first - 1] >= _DEEPEST_SHARE * smooth[most]:
        first -= 1
    while last + 1 < len(smooth) and smooth[last + 1] >= _DEEPEST_SHARE * smooth[most]:
        last += 1
    pitch = (columns[-1] - columns[0]) / (len(columns) - 1)
    return float(columns[0] + pitch * ((first + last) / 2 - beside))
