"""Intervals in which zeros lie: grown by drift, cut with means of what is read.

A mean of many frames has little noise, but zeros have moved meanwhile; so means of the newest 1, 2, 4, …
blocks of frames are all compared. Load only adds: any mean cuts an interval from above, and from below only
one of blocks that nothing has touched.
"""

import math
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from palpate.base.geometry import Bools, Floats, Ints

__all__ = ["SIGMAS", "Block", "ZeroBounds", "ZeroIntervals"]

SIGMAS = 4.0
_SLIGHT = 2 * SIGMAS  # standard deviations: a touch that was never more is soon taken for drift
_MOST_BLOCKS = 64


@dataclass(frozen=True, eq=False)
class Block:
    """What is read (n,) in the mean of some frames, which are of `time_s` in the mean."""

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
    """Of n quantities: `lower` and `upper` (n,). Their blocks have the same times.

    `noise` (n,): standard deviation in one frame; `drift_per_s` (n,): how fast a zero moves at most; `zero`
    (n,): mean of `tared_frames` untouched ones. Those that are not `usable` (n,) never count as touched.
    `least` (n,): lower bounds, whatever has touched since then.
    """

    def __init__(
        self, zero: Floats, noise: Floats, drift_per_s: Floats, usable: Bools, tared_frames: int
    ) -> None:
        self._noise, self._drift, self._usable = noise, drift_per_s, usable
        within = SIGMAS * noise / math.sqrt(tared_frames)
        self.lower, self.upper, self.least = zero - within, zero + within, zero - within
        self._held = np.zeros(zero.shape, dtype=bool)
        self._furthest = np.zeros_like(zero)
        self._blocks: deque[Block] = deque(maxlen=_MOST_BLOCKS)
        self._means: tuple[_Mean, ...] = ()
        self._untouched: Ints = np.zeros(zero.shape, dtype=np.int64)  # so many of the newest blocks

    def notice(self, block: Block, passed_s: float) -> Bools:
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
        back = away < np.maximum(0.5 * self._furthest, _SLIGHT * self._noise)
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
            within = SIGMAS * self._noise / math.sqrt(count) + self._drift * float(ages[blocks - 1]) / count
            yield _Mean(sums[blocks - 1] / count, within, blocks, count)
