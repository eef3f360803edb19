"""Repeated samples: frames that carry the reading of the frame before under a new number and time.

Firmware sends them if it samples more slowly than it streams, or hangs. Noise tells them: it moves taxels
independently, so a frame in which none has changed is as rare as the product of their chances to keep still.
An array without noise may send the same reading for ever, and nothing is said of it; nor of a contact source,
which has nothing else to report as long as nothing touches.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from palpate.base.geometry import Bools
from palpate.drivers.tactile.frames import TactileFrame

_MAX_CHANCE = 1e-6
_LEAST = 1e-300  # chance, that logarithms need
_STRETCH_FRAMES = 64


@dataclass(frozen=True)
class Repeats:
    """Repetitions among some frames: `repeated` of `frames` after the first are as the one before.

    `chance`: for noise alone to leave all taxels as they were, at most. `rate_hz`: new readings a second.
    `certain`: noise does not explain as many. `last`: so many frames at the end repeat.
    """

    frames: int
    repeated: int
    chance: float
    rate_hz: float
    certain: bool
    last: int

    def are_stuck(self, in_a_row: int) -> bool:
        """Return whether so many repeated frames in a row are no chance."""
        return in_a_row > 0 and max(self.chance, _LEAST) ** in_a_row < _MAX_CHANCE


def is_new(frames: Sequence[TactileFrame], before: TactileFrame | None = None) -> Bools:
    """Return which frames (n,) differ from the one before; the first one is new if nothing was `before`."""
    earlier = (before, *frames)
    return np.array(
        [
            last is None or frame.contact is not None or not np.array_equal(last.counts, frame.counts)
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
    if frames[0].contact is not None:
        changed[:] = True
    new = changed.any(axis=(1, 2))
    # Where drift takes readings to 0 noise goes, too: each stretch is judged by itself.
    stretches = np.array_split(np.arange(len(new)), max(len(new) // _STRETCH_FRAMES, 1))
    chances = [float(np.prod(1 - changed[part].mean(axis=0))) for part in stretches]
    if noise_counts > 0:  # whatever its mean, a taxel reads one value above 0 with this chance at most
        still = math.erf(0.5 / (noise_counts * math.sqrt(2)))
        above = [int((counts[part[-1]] > 0).sum()) for part in stretches]
        chances = [min(chance, still**taxels) for chance, taxels in zip(chances, above, strict=True)]
    evidence = sum(_evidence(~new[part], chance) for part, chance in zip(stretches, chances, strict=True))
    span_s = frames[-1].device_time_s - frames[0].device_time_s
    return Repeats(
        frames=len(new),
        repeated=int((~new).sum()),
        chance=max(chances),
        rate_hz=float(new.sum()) / span_s if span_s > 0 else 0.0,
        last=int(np.argmax(new[::-1])) if new.any() else len(new),
        certain=evidence > len(stretches) - math.log(_MAX_CHANCE),
    )


def _evidence(repeated: Bools, chance: float) -> float:
    """Minus the logarithm of the chance that as many of some frames repeat, at most (Chernoff)."""
    share, chance = float(repeated.mean()), max(chance, _LEAST)
    if share <= chance:
        return 0.0
    new = 0.0 if share == 1 else (1 - share) * math.log((1 - share) / (1 - chance))
    return len(repeated) * (share * math.log(share / chance) + new)
