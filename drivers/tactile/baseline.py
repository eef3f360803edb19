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

from palpate.errors import InputError
from palpate.geometry import Bools, Counts, Floats, Ints

__all__ = ["Baseline", "BaselineTracker", "Zeros", "baseline_of"]

SIGMAS = 4.0
_BLOCK_S = 0.1
_MOST_FRAMES = 64  # of a block
_SLIGHT = 2 * SIGMAS  # standard deviations: a touch that was never more is soon taken for drift
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


class BaselineTracker:
    """The zeros of one array from its tare on, in blocks of a tenth of a second.

    `drift_counts_per_s` bounds how fast a taxel's zero may move; `tared_s`: when it was tared, by the array's
    clock.
    """

    def __init__(self, baseline: Baseline, drift_counts_per_s: float, tared_s: float | None = None) -> None:
        self._usable = baseline.usable
        self._noise = baseline.noise_counts
        self._drift = drift_counts_per_s
        self._lower = baseline.mean - self._noise
        self._upper = baseline.mean + self._noise
        self._held = np.zeros(baseline.mean.shape, dtype=bool)
        self._furthest = np.zeros_like(baseline.mean)
        self._then = tared_s

    @property
    def mean(self) -> Floats:
        """Zeros as far as they have been followed, (rows, cols) counts."""
        result: Floats = (self._lower + self._upper) / 2
        return result

    @property
    def bound(self) -> Floats:
        """They are within this of `mean`, (rows, cols) counts."""
        result: Floats = (self._upper - self._lower) / 2
        return result

    def bound_at(self, time_s: float) -> Floats:
        """They are within this of `mean` at `time_s`, by the array's clock: what may have drifted since the
        last frame that was followed comes on top. (rows, cols) counts.
        """
        result: Floats = self.bound + self._drift * self._passed(time_s)
        return result

    def follow(self, counts: Counts, time_s: Floats) -> Zeros:
        """Go on through frames (n, rows, cols), sampled at `time_s` (n,), touched or not.

        A block's zeros are those known from the frames before it, so that a recording gives what a live run
        gives that looks at the array ten times a second.
        """
        starts = _blocks(time_s)
        means, bounds = [], []
        for begin, end in zip(starts, [*starts[1:], len(counts)], strict=True):
            means.append(self.mean)
            bounds.append(self.bound_at(float(time_s[end - 1])))
            # What is seen is the mean of the block, at its middle.
            self._step(counts[begin:end].mean(axis=0), end - begin, float(time_s[begin:end].mean()))
        sizes = np.diff([*starts, len(counts)])
        return Zeros(np.stack(means), np.stack(bounds), np.repeat(np.arange(len(starts)), sizes))

    def _passed(self, now: float) -> float:
        """Seconds since the last block; an array that was restarted begins with none."""
        return 0.0 if self._then is None else max(now - self._then, 0.0)

    def _step(self, mean: Floats, frames: int, now: float) -> None:
        grown = self._drift * self._passed(now)
        self._then = now
        seen = SIGMAS * self._noise / math.sqrt(frames)
        lower, upper = self._lower - grown, self._upper + grown
        away = mean - (lower + upper) / 2
        touched = self._usable & (mean - seen > upper)
        back = np.abs(away) < np.maximum(0.5 * self._furthest, _SLIGHT * self._noise)
        self._held = touched | (self._held & ~back)
        self._furthest = np.where(self._held, np.maximum(self._furthest, np.abs(away)), 0.0)
        near = binary_dilation(self._held, structure=_AROUND) if self._held.any() else self._held
        # Load only adds: whatever touches it, a zero is not above what its taxel reads.
        upper = np.minimum(upper, mean + seen)
        lower = np.where(near, lower, np.maximum(lower, mean - seen))
        # A zero that was thought to be higher had been mistaken: it begins anew.
        lower = np.where(lower > upper, mean - seen, lower)
        spare = np.maximum(self._noise / math.sqrt(frames) - (upper - lower) / 2, 0.0)
        self._lower, self._upper = lower - spare, upper + spare


def _blocks(time_s: Floats) -> list[int]:
    """Indices at which blocks begin: a tenth of a second, and not too many frames, from one to the next."""
    starts = [0]
    while True:
        first = starts[-1]
        later = int(np.searchsorted(time_s[first:], time_s[first] + _BLOCK_S)) + first
        following = min(max(later, first + 1), first + _MOST_FRAMES)
        if following >= len(time_s):
            return starts
        starts.append(following)
