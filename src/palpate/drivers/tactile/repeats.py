"""Repeated samples: frames that carry the reading of the frame before under a new number and time.

Firmware sends them if it samples more slowly than it streams, or hangs. Noise tells them: it moves taxels
independently, so a frame in which none has changed is as rare as the product of their chances to keep still.
An array without noise may send the same reading for ever, and nothing is said of it.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from palpate.base.geometry import Bools
from palpate.drivers.tactile.frames import TactileFrame

_MAX_CHANCE = 1e-6


@dataclass(frozen=True)
class Repeats:
    """Repetitions among some frames: `repeated` of `frames` after the first are as the one before.

    `chance`: for noise alone to leave all taxels as they were, at most. `rate_hz`: new readings a second.
    """

    frames: int
    repeated: int
    chance: float
    rate_hz: float

    @property
    def certain(self) -> bool:
        """True if noise does not explain as many."""
        share, chance = self.repeated / self.frames, max(self.chance, 1e-300)
        if share <= chance:
            return False
        changed = 0.0 if share == 1 else (1 - share) * math.log((1 - share) / (1 - chance))
        return self.frames * (share * math.log(share / chance) + changed) > -math.log(_MAX_CHANCE)

    def are_stuck(self, in_a_row: int) -> bool:
        """Return whether so many repeated frames in a row are no chance."""
        return in_a_row > 0 and max(self.chance, 1e-300) ** in_a_row < _MAX_CHANCE


def is_new(frames: Sequence[TactileFrame], before: TactileFrame | None = None) -> Bools:
    """Return which frames (n,) differ from the one before; the first one is new if nothing was `before`."""
    earlier = (before, *frames)
    return np.array(
        [
            last is None or not np.array_equal(last.counts, frame.counts)
            for last, frame in zip(earlier, frames, strict=False)
        ],
        dtype=bool,
    )


def count_repeats(frames: Sequence[TactileFrame], noise_counts: float = 0.0) -> Repeats:
    """Count the repeated ones of two or more frames of an untouched array.

    `noise_counts`: the standard deviation that a taxel is known to have, 0 if it is not known: then frames
    that are all the same prove nothing.
    """
    counts = np.stack([frame.counts for frame in frames])
    changed = counts[1:] != counts[:-1]
    new = changed.any(axis=(1, 2))
    chance = float(np.prod(1 - changed.mean(axis=0)))
    if noise_counts > 0:  # whatever its mean, a taxel reads one value above 0 with this chance at most
        chance = min(chance, math.erf(0.5 / (noise_counts * math.sqrt(2))) ** int((counts[-1] > 0).sum()))
    span_s = frames[-1].device_time_s - frames[0].device_time_s
    return Repeats(len(new), int((~new).sum()), chance, float(new.sum()) / span_s if span_s > 0 else 0.0)
