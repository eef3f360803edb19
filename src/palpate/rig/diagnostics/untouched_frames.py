"""Statistics of an untouched array's frames: taxels that stand still, are stuck high, unsteady, or drift."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from palpate.base.geometry import Bools, Floats
from palpate.drivers.tactile.frames import TactileFrame

__all__ = ["UntouchedFrames", "untouched_frames"]

_ENOUGH = 16  # frames
_HOT = 0.95  # of the largest count
_NEVER = 1e-6  # chance for a live taxel to read the same in every frame
_UNSTEADY = 6.0  # times the median noise
_LEAST_NOISE = 0.3  # counts: of a taxel whose noise is lost in rounding
_SIGMAS = 6.0  # above which a slope is no chance
_BLOCKS = 12


@dataclass(frozen=True, eq=False)
class UntouchedFrames:
    """What frames of an untouched array show, by taxel (rows, cols).

    `dead` never change, which is certain only where there is noise enough (`tells_dead`); `at_zero` of them
    read 0, as one does whose zero has drifted below what can be read. `noise_counts`: median of the live
    taxels' standard deviations. `drift_counts_per_s`: the fastest drift that is certain, in absolute value, 0
    if none is; `drifting`: how many taxels' is beyond what was allowed.
    """

    dead: Bools
    at_zero: Bools
    hot: Bools
    unsteady: Bools
    noise_counts: float
    drift_counts_per_s: float
    drifting: int
    tells_dead: bool


def untouched_frames(
    frames: Sequence[TactileFrame], max_count: int, allowed_drift: float
) -> UntouchedFrames | None:
    """Look at frames of an array that nothing touches; None if they are too few.

    A taxel drifts for certain if a straight line through the means of a dozen stretches is steeper than
    `allowed_drift` (counts/s) by six times its error. The error comes from how far the means lie off the
    line, of this taxel or in the median, which noise of any colour moves.
    """
    if len(frames) < _ENOUGH:
        return None
    counts = np.stack([frame.counts for frame in frames]).astype(float)
    times = np.array([frame.device_time_s for frame in frames])
    mean, spread = counts.mean(axis=0), counts.std(axis=0)
    hot = mean >= _HOT * max_count
    moving = spread > 0
    noise = float(np.median(spread[moving & ~hot])) if (moving & ~hot).any() else 0.0
    still = ~moving & ~hot
    certain = noise > 0 and math.erf(0.5 / (noise * math.sqrt(2))) ** len(frames) < _NEVER
    low = still & (mean == 0)
    dead = (still & certain & ~low) | (
        low & (np.median(mean) > 4 * max(noise, 1.0))
    )  # others rest well above
    live = ~(dead | hot)
    slope, error = _slopes(counts, times, max(noise, _LEAST_NOISE))
    unsteady = live & (_fast(counts) > _UNSTEADY * max(noise, _LEAST_NOISE))
    beyond = live & ~unsteady & (np.abs(slope) - allowed_drift > _SIGMAS * error)
    fastest = float(np.abs(slope)[beyond].max()) if beyond.any() else 0.0
    return UntouchedFrames(dead, dead & low, hot, unsteady, noise, fastest, int(beyond.sum()), certain)


def _fast(counts: Floats) -> Floats:
    """Noise from one frame to the next, which drift does not move: (rows, cols) standard deviation."""
    result: Floats = np.diff(counts, axis=0).std(axis=0) / math.sqrt(2)
    return result


def _slopes(counts: Floats, times: Floats, noise: float) -> tuple[Floats, Floats]:
    """Slope of each taxel (counts/s) and its standard error, by the means of stretches."""
    parts = np.array_split(np.arange(len(times)), _BLOCKS)
    means = np.stack([counts[part].mean(axis=0) for part in parts])
    at = np.array([times[part].mean() for part in parts])
    off = at - at.mean()
    along = float((off**2).sum())
    slope: Floats = np.tensordot(off, means, axes=1) / along
    rest = means - means.mean(axis=0) - off[:, None, None] * slope
    variance = (rest**2).sum(axis=0) / (_BLOCKS - 2)
    # A taxel's own ten degrees of freedom are too few: in one of ten thousand chance makes them too small.
    least = max(noise**2 * _BLOCKS / len(times), float(np.median(variance)))
    error: Floats = np.sqrt(np.maximum(variance, least) / along)
    return slope, error
