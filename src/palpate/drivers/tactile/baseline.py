"""Baseline: what an untouched array reads, with bounds, followed while it drifts.

A taxel's zero wanders with temperature and wear, and a finger that comes
to rest on a part very slowly looks the same at first. So the zero is not filtered, it is bounded: a taxel's
zero is known to lie in an interval, which grows by the drift that the calibration allows and is cut with what
the taxel reads, four standard deviations either way. Load only adds, so a zero is never above what its taxel
reads. It is not below either, unless the taxel is touched: where reading and interval have nothing in common,
it and its neighbours are held, and nothing cuts their intervals from below. A taxel is let go when it has
come back by more than half of the way, or was never far away. So of a contact that grows by `r` counts per
second, about drift · (interval + noise) / (r - drift) counts are taken for drift; one that grows no faster
than the drift cannot be distinguished from it by counts alone. What was taken is given back when
the taxel is let go.
"""

import math
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import binary_dilation

from palpate.base.errors import InputError
from palpate.base.geometry import Bools, Counts, Floats, Ints
from palpate.drivers.tactile.zero_intervals import SIGMAS, Block, ZeroBounds, ZeroIntervals

__all__ = ["SIGMAS", "Baseline", "BaselineTracker", "SumsOfTaxels", "Zeros", "baseline_of"]

_BLOCK_S = 0.1
_MOST_FRAMES = 64  # of a block
_AROUND = np.ones((3, 3), dtype=bool)
_ENOUGH_FRAMES = 8  # to judge the noise
_NEVER = 1e-6  # chance for a live taxel to read the same all the time


@dataclass(frozen=True, eq=False)
class Baseline:
    """Counts of the untouched array: mean (rows, cols), noise, and which taxels are alive."""

    mean: Floats
    noise_counts: float
    usable: Bools


@dataclass(frozen=True, eq=False)
class Zeros:
    """Zeros of a recording: in block b they are `mean[b]` ± `bound[b]`, shape (blocks, rows, cols), counts.

    `block_of` (frames,) says which block a frame belongs to.
    """

    mean: Floats
    bound: Floats
    block_of: Ints


def baseline_of(counts: Counts, max_count: int, noise_counts: float, usable: Bools | None) -> Baseline:
    """The baseline from still, untouched frames (n, rows, cols).

    `noise_counts` is the calibration's, taken where there are too few frames to measure it. A taxel that
    reads its largest count, or always the same although noise would have moved a live one, or always 0 where
    most others rest well above it, is left out from here on, and so is one that is not `usable`. Raises
    InputError without frames.
    """
    if not len(counts):
        raise InputError("tactile tare: no frames; start the array and keep the tip off everything")
    values = counts.astype(float)
    mean, spread = values.mean(axis=0), values.std(axis=0)
    alive = mean < 0.95 * max_count
    if usable is not None:
        alive &= usable
    enough = len(counts) >= _ENOUGH_FRAMES
    if noise_counts > 0 and math.erf(0.5 / (noise_counts * math.sqrt(2))) ** len(counts) < _NEVER:
        alive &= spread > 0
    alive &= (values > 0).any(axis=0) | (np.median(mean) <= SIGMAS * max(noise_counts, 1.0))
    measured = float(np.sqrt((spread[alive] ** 2).mean())) if alive.any() else 0.0
    noise = max(measured, 0.3) if enough else max(measured, noise_counts)
    return Baseline(mean, noise * math.sqrt(1 + 1 / len(counts)), alive)


@dataclass(frozen=True, eq=False)
class _Piece:
    """Frames of a block that is not complete: the first one's time, and sums of counts (n,) and times."""

    begin_s: float
    frames: int
    sum: Floats
    time_sum_s: float
    may_touch: bool


@dataclass(frozen=True, eq=False)
class SumsOfTaxels:
    """Sums of taxels with `weights` (rows · cols, k), whose zeros move no faster than `drift_per_s` (k,)."""

    weights: Floats
    drift_per_s: Floats


class BaselineTracker:
    """The zeros of one array from its tare on, in blocks of a tenth of a second.

    `drift_counts_per_s` bounds how fast a taxel's zero may move; `tared_s`: when it was tared, by the array's
    clock, with the mean of `tared_frames`. `sums` are followed as well: in them noise adds up to less than
    the taxels' bounds do.
    """

    def __init__(
        self,
        baseline: Baseline,
        drift_counts_per_s: float,
        tared_s: float | None = None,
        tared_frames: int = 16,
        sums: SumsOfTaxels | None = None,
    ) -> None:
        self._shape = baseline.mean.shape
        size = baseline.mean.size
        sums = SumsOfTaxels(np.zeros((size, 0)), np.zeros(0)) if sums is None else sums
        self._sums = sums.weights
        self._has: Bools = self._sums != 0
        zeros, usable = baseline.mean.ravel(), baseline.usable.ravel()
        noise, drift = np.full(size, baseline.noise_counts), np.full(size, drift_counts_per_s)
        self._taxels = ZeroIntervals(zeros, noise, drift, usable, tared_frames)
        self._summed = ZeroIntervals(
            zeros @ self._sums,
            baseline.noise_counts * np.sqrt((self._sums**2).sum(axis=0)),
            sums.drift_per_s,
            self._has.any(axis=0),
            tared_frames,
        )
        self._drift = drift_counts_per_s
        self._then = tared_s
        self._waiting: list[_Piece] = []

    @property
    def mean(self) -> Floats:
        """Zeros as far as they have been followed, (rows, cols) counts."""
        result: Floats = ((self._taxels.lower + self._taxels.upper) / 2).reshape(self._shape)
        return result

    @property
    def bound(self) -> Floats:
        """They are within this of `mean`, (rows, cols) counts."""
        result: Floats = ((self._taxels.upper - self._taxels.lower) / 2).reshape(self._shape)
        return result

    def bound_at(self, time_s: float) -> Floats:
        """They are within this of `mean` at `time_s`, by the array's clock: what may have drifted since the
        last block that was followed comes on top. (rows, cols) counts.
        """
        result: Floats = self.bound + self._drift * self._passed(time_s)
        return result

    def taxels_at(self, time_s: float) -> ZeroBounds:
        """Bounds of all taxels' zeros at `time_s`, row by row."""
        return self._taxels.after(self._passed(time_s))

    def sums_at(self, time_s: float) -> ZeroBounds:
        """Bounds of the zeros of `sums` at `time_s`."""
        return self._summed.after(self._passed(time_s))

    def follow(self, counts: Counts, time_s: Floats, *, may_touch: bool = False) -> Zeros:
        """Go on through frames (n, rows, cols), sampled at `time_s` (n,), touched or not.

        `may_touch`: the tip may be at something, however lightly, and nothing that is read is taken for a
        zero that has risen. A block's zeros are those known from the blocks before it, wherever the stream is
        cut, so that a recording gives what a live run gives.
        """
        blocks, sizes, begin = [], [], 0
        while begin < len(counts):
            size = self._size(time_s[begin:])
            if size == 0:
                self._step()
                continue
            blocks.append((self.mean, self.bound_at(float(time_s[begin + size - 1]))))
            sizes.append(size)
            self._waiting.append(
                _Piece(
                    float(time_s[begin]),
                    size,
                    counts[begin : begin + size].sum(axis=0, dtype=float).ravel(),
                    float(time_s[begin : begin + size].sum()),
                    may_touch,
                )
            )
            begin += size
        means, bounds = (np.stack(items) for items in zip(*blocks, strict=True))
        return Zeros(means, bounds, np.repeat(np.arange(len(sizes)), sizes))

    def _size(self, time_s: Floats) -> int:
        """How many of these frames still belong to the block that is waiting."""
        first = self._waiting[0].begin_s if self._waiting else time_s[0]
        most = _MOST_FRAMES - sum(piece.frames for piece in self._waiting)
        near = time_s[:most]
        others = np.flatnonzero((near < first) | (near >= first + _BLOCK_S))
        return int(others[0]) if len(others) else len(near)

    def _passed(self, now: float) -> float:
        """Seconds since the last block; an array that was restarted begins with none."""
        return 0.0 if self._then is None else max(now - self._then, 0.0)

    def _step(self) -> None:
        """Go on by the block that is waiting."""
        frames = sum(piece.frames for piece in self._waiting)
        mean = np.sum([piece.sum for piece in self._waiting], axis=0) / frames
        now = sum(piece.time_sum_s for piece in self._waiting) / frames
        may_touch = any(piece.may_touch for piece in self._waiting)
        self._waiting = []
        passed_s, self._then = self._passed(now), now
        held = self._taxels.notice(Block(mean, frames, now), passed_s)
        held_sums = self._summed.notice(Block(mean @ self._sums, frames, now), passed_s)
        near = held | (self._has @ held_sums)
        if near.any():
            near = binary_dilation(near.reshape(self._shape), structure=_AROUND).ravel()
        self._taxels.cut(near | may_touch)
        self._summed.cut((near @ self._has) | may_touch)
