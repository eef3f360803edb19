"""Baseline: bounds on the readings of an untouched array, tracked while it drifts.

A taxel's zero wanders with temperature and wear, and a finger that comes to rest on a part very slowly looks
the same at first. So the zero is not filtered but bounded: a taxel's zero is known to lie in an interval,
which grows by the drift that the calibration allows and is intersected with the taxel's reading, plus or
minus four standard deviations.

A mean of many frames has little noise, but zeros have moved meanwhile; so means of the newest 1, 2, 4, …
blocks of frames are all compared. Load only adds: any mean cuts an interval from above, and from below only
one of blocks that nothing has touched.
"""

import math
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import binary_dilation

from palpate.base.errors import InputError
from palpate.base.geometry import Bools, Counts, Floats, Ints

BOUND_SIGMAS = 4.0
_LIGHT_TOUCH_SIGMAS = (
    2 * BOUND_SIGMAS
)  # standard deviations: a touch that was never more is soon taken for drift
_MAX_BLOCKS = 64


@dataclass(frozen=True, eq=False)
class FrameBlock:
    """Mean readings (n,) of some frames, and their mean time `time_s`."""

    mean: Floats
    frames: int
    time_s: float


@dataclass(frozen=True, eq=False)
class ZeroBounds:
    """Zeros of n taxels or sums of taxels are from `lower` to `upper`, (n,).

    `least` (n,): from there, if all that has been followed since the tare may have been touched.
    """

    lower: Floats
    upper: Floats
    least: Floats


@dataclass(frozen=True, eq=False)
class _Mean:
    """Mean (n,) of the newest blocks: within `within` (n,) of the zeros as they are at the newest one."""

    value: Floats
    within: Floats
    blocks: int
    frames: int


class ZeroIntervals:
    """Intervals of n quantities: `lower` and `upper` (n,). Their blocks have the same times.

    `noise` (n,): standard deviation in one frame; `drift_per_s` (n,): how fast a zero moves at most; `zero`
    (n,): mean of `tared_frames` untouched ones. Those that are not `usable` (n,) never count as touched.
    `least` (n,): lower bounds, whatever has touched since then.
    """

    def __init__(
        self, zero: Floats, noise: Floats, drift_per_s: Floats, usable: Bools, tared_frames: int
    ) -> None:
        self._noise, self._drift, self._usable = noise, drift_per_s, usable
        within = BOUND_SIGMAS * noise / math.sqrt(tared_frames)
        self.lower, self.upper, self.least = zero - within, zero + within, zero - within
        self._held = np.zeros(zero.shape, dtype=bool)
        self._furthest = np.zeros_like(zero)
        self._blocks: deque[FrameBlock] = deque(maxlen=_MAX_BLOCKS)
        self._means: tuple[_Mean, ...] = ()
        self._untouched: Ints = np.zeros(zero.shape, dtype=np.int64)  # so many of the newest blocks

    def notice(self, block: FrameBlock, passed_s: float) -> Bools:
        """Take a block, `passed_s` after the one before, and return what is touched (n,); then `cut`."""
        if self._blocks and block.time_s < self._blocks[-1].time_s:  # an array that was restarted
            self._blocks.clear()
            self._untouched[:] = 0
        self._blocks.append(block)
        self._means = tuple(self._means_of_newest())
        grown = self._drift * passed_s
        self.lower, self.upper, self.least = self.lower - grown, self.upper + grown, self.least - grown
        touched = np.zeros_like(self._held)
        for mean in self._means:
            touched |= (mean.value - mean.within > self.upper) & (self._untouched >= mean.blocks - 1)
        away = np.abs(block.mean - (self.lower + self.upper) / 2)
        back = away < np.maximum(0.5 * self._furthest, _LIGHT_TOUCH_SIGMAS * self._noise)
        self._held = (touched & self._usable) | (self._held & ~back)
        self._furthest = np.where(self._held, np.maximum(self._furthest, away), 0.0)
        return self._held

    def cut(self, near: Bools) -> None:
        """Cut the intervals with the newest means, but from below not where a touch is `near` (n,)."""
        self._untouched = np.where(near, 0, self._untouched + 1)
        lower, upper = self.lower, self.upper
        newest, least_noise = self._means[0], self._noise
        for mean in self._means:
            upper = np.minimum(upper, mean.value + mean.within)
            usable = self._untouched >= mean.blocks
            lower = np.where(usable, np.maximum(lower, mean.value - mean.within), lower)
            noise = self._noise / math.sqrt(mean.frames)
            least_noise = np.where(usable | (mean is newest), noise, least_noise)
        # A zero that was thought to be higher had been mistaken: it begins anew.
        mistaken = lower > upper
        lower = np.where(mistaken, newest.value - newest.within, lower)
        self._untouched[mistaken] = 0
        spare = np.maximum(least_noise - (upper - lower) / 2, 0.0)
        self.lower, self.upper = lower - spare, upper + spare
        self.least = np.minimum(self.least, self.lower)

    def after(self, passed_s: float) -> ZeroBounds:
        """Bounds so long after the newest block."""
        grown = self._drift * passed_s
        return ZeroBounds(self.lower - grown, self.upper + grown, self.least - grown)

    def _means_of_newest(self) -> Iterator[_Mean]:
        """Means of the newest 1, 2, 4, … blocks."""
        newest = self._blocks[-1].time_s
        frames = np.cumsum([block.frames for block in reversed(self._blocks)])
        ages = np.cumsum([block.frames * (newest - block.time_s) for block in reversed(self._blocks)])
        sums = np.cumsum([block.frames * block.mean for block in reversed(self._blocks)], axis=0)
        for blocks in (2**power for power in range(len(frames).bit_length())):
            count = int(frames[blocks - 1])
            within = (
                BOUND_SIGMAS * self._noise / math.sqrt(count) + self._drift * float(ages[blocks - 1]) / count
            )
            yield _Mean(sums[blocks - 1] / count, within, blocks, count)


_BLOCK_S = 0.1
_MAX_BLOCK_FRAMES = 64  # of a block
_NEIGHBOURHOOD = np.ones((3, 3), dtype=bool)
_MIN_NOISE_FRAMES = 8  # to judge the noise
_MIN_CHANGE_SHARE = 0.25  # of the frames, in which the median taxel changes
_STUCK_PROBABILITY = 1e-6  # chance for a live taxel to read the same all the time


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
    enough = len(counts) >= _MIN_NOISE_FRAMES
    changes = (np.diff(values, axis=0) != 0).sum(axis=0)[spread > 0]
    still = math.erf(0.5 / (noise_counts * math.sqrt(2))) ** len(counts) if noise_counts > 0 else 1.0
    # Firmware that filters leaves less noise, which tells no dead taxel.
    lively = changes.size == 0 or np.median(changes) >= _MIN_CHANGE_SHARE * len(counts)
    if lively and still < _STUCK_PROBABILITY:
        alive &= spread > 0
    alive &= (values > 0).any(axis=0) | (np.median(mean) <= BOUND_SIGMAS * max(noise_counts, 1.0))
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
class TaxelSums:
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
        sums: TaxelSums | None = None,
    ) -> None:
        self._shape = baseline.mean.shape
        size = baseline.mean.size
        sums = TaxelSums(np.zeros((size, 0)), np.zeros(0)) if sums is None else sums
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
        """Bound of the zeros' distance from `mean`, (rows, cols) counts."""
        result: Floats = ((self._taxels.upper - self._taxels.lower) / 2).reshape(self._shape)
        return result

    def bound_at(self, time_s: float) -> Floats:
        """Bound of the zeros' distance from `mean` at `time_s`, by the array's clock, (rows, cols) counts.

        It includes what may have drifted since the last block that was followed.
        """
        result: Floats = self.bound + self._drift * self._elapsed_s(time_s)
        return result

    def taxels_at(self, time_s: float) -> ZeroBounds:
        """Bounds of all taxels' zeros at `time_s`, row by row."""
        return self._taxels.after(self._elapsed_s(time_s))

    def sums_at(self, time_s: float) -> ZeroBounds:
        """Bounds of the zeros of `sums` at `time_s`."""
        return self._summed.after(self._elapsed_s(time_s))

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
        """Number of these frames that still belong to the block that is waiting."""
        first = self._waiting[0].begin_s if self._waiting else time_s[0]
        most = _MAX_BLOCK_FRAMES - sum(piece.frames for piece in self._waiting)
        near = time_s[:most]
        others = np.flatnonzero((near < first) | (near >= first + _BLOCK_S))
        return int(others[0]) if len(others) else len(near)

    def _elapsed_s(self, now: float) -> float:
        """Seconds since the last block; an array that was restarted begins with none."""
        return 0.0 if self._then is None else max(now - self._then, 0.0)

    def _step(self) -> None:
        """Go on by the block that is waiting."""
        frames = sum(piece.frames for piece in self._waiting)
        mean = np.sum([piece.sum for piece in self._waiting], axis=0) / frames
        now = sum(piece.time_sum_s for piece in self._waiting) / frames
        may_touch = any(piece.may_touch for piece in self._waiting)
        self._waiting = []
        passed_s, self._then = self._elapsed_s(now), now
        held = self._taxels.notice(FrameBlock(mean, frames, now), passed_s)
        held_sums = self._summed.notice(FrameBlock(mean @ self._sums, frames, now), passed_s)
        near = held | (self._has @ held_sums)
        if near.any():
            near = binary_dilation(near.reshape(self._shape), structure=_NEIGHBOURHOOD).ravel()
        self._taxels.cut(near | may_touch)
        self._summed.cut((near @ self._has) | may_touch)
