"""Zeros, noise, drift and stuck taxels of an array, from recordings of it with nothing near the tip."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from palpate.base.errors import InputError
from palpate.base.geometry import Bools, Floats
from palpate.calibration.measurements import IdleMeasurement
from palpate.drivers.tactile import BOUND_SIGMAS

COVERAGE_SIGMAS = 3.3
"""Bounds are this many standard deviations: 99.9 % of a normal distribution."""

MIN_FRAMES = 8
"""Fewer frames of a recording say nothing about noise."""

_LINE_LENGTH_S = 30.0
"""About so long are lines: the noise of a slope falls with the length to the power of 1.5."""

_MIN_WANDER_PERIOD_S = 60.0
"""Zeros wander with temperature: up and down takes a minute at least."""

_MIN_LINE_S = 5.0
"""Lines that are shorter show little but noise: they are asked only where there is nothing else."""

_MAX_STUCK_CHANCE = 1e-6  # chance for a live taxel to read the same all the time
_HOT_SHARE = 0.95  # of the largest count: no taxel rests there
_ROUNDING_SIGMA_COUNTS = 1 / math.sqrt(12)  # standard deviation of rounding, counts
_MIN_DITHER_COUNTS = 0.4  # noise in counts that makes the mean of rounded counts true to a hundredth
_TOUCHED_COLUMNS = 3  # of a light contact, wherever it stands between the columns


@dataclass(frozen=True, eq=False)
class _Window:
    """A stretch of a recording: n frames in `span_s`, mean at its middle, slope and what is left of it.

    `mean`, `slope_per_s` and `spread` (standard deviation from the straight line) have shape (rows,
    cols).
    """

    n: int
    middle_s: float
    slope_sigma_s: float
    span_s: float
    mean: Floats
    slope_per_s: Floats
    spread: Floats


@dataclass(frozen=True, eq=False)
class IdleFit:
    """An untouched array.

    `zero_counts` (rows, cols): mean counts. `noise_counts`: standard deviation of a live taxel.
    `drift_counts_per_s`: no zero of a live taxel moved faster in the recordings. `dead` and `hot`: (row,
    col) of taxels that never move and of those at the largest count. `lines`: what drift is read from.
    """

    zero_counts: Floats
    noise_counts: float
    drift_counts_per_s: float
    dead: tuple[tuple[int, int], ...]
    hot: tuple[tuple[int, int], ...]
    lines: tuple[_Window, ...]

    def drift_of_sums(self, weights: Floats) -> float:
        """Bound on the speed of the zeros of sums of taxels, in counts times weights, per second.

        `weights` (rows · cols, k): of live taxels. Noise adds up to less in a sum than taxels' bounds do.
        """
        return _drift(self.lines, weights, self.noise_counts)

    @property
    def live(self) -> Bools:
        """Taxels that are neither dead nor hot, (rows, cols)."""
        live = np.ones(self.zero_counts.shape, dtype=bool)
        for row, col in (*self.dead, *self.hot):
            live[row, col] = False
        return live


def analyse_idle(idles: Sequence[IdleMeasurement], max_count: int) -> IdleFit:
    """Analyse idle recordings of one finger, in any order but by one clock; `max_count`: the array's.

    Noise is the median of the live taxels' standard deviations about straight lines of half a minute, and
    never less than that of rounding. Drift is the largest slope of a line, or of a zero from one line to
    the next, with `COVERAGE_SIGMAS` of its own uncertainty added; a line's for a zero that wanders up and
    down in a minute, and is not always as fast as in the middle of the line. Raises InputError for
    recordings that are too short to say anything, and for an array without a live taxel.
    """
    if not idles or any(len(idle.counts) < MIN_FRAMES for idle in idles):
        raise InputError(
            f"idle array: a recording has fewer than {MIN_FRAMES} frames; record a few seconds with "
            "nothing near the tip"
        )
    windows = sorted((w for idle in idles for w in _windows(idle)), key=lambda w: w.middle_s)
    frames = sum(w.n for w in windows)
    zero: Floats = sum((w.mean * w.n for w in windows), np.zeros_like(windows[0].mean)) / frames
    hot = zero >= _HOT_SHARE * max_count
    still = np.all([(i.counts == idles[0].counts[0]).all(axis=0) for i in idles], axis=0) & ~hot
    spread = np.sqrt(sum((w.spread**2 * w.n for w in windows), np.zeros_like(zero)) / frames)
    dead = still & _is_suspicious(spread[~still & ~hot], still.sum(), frames)
    live = ~dead & ~hot
    if not live.any():
        raise InputError(f"idle array {idles[0].finger}: no taxel is alive; check the array and its cable")
    noise = max(float(np.median(spread[live])), _ROUNDING_SIGMA_COUNTS)
    drift = _drift(windows, np.eye(live.size)[:, live.ravel()], noise)
    return IdleFit(zero, noise, drift, _places(dead), _places(hot), tuple(windows))


def least_contact_force_n(idle: IdleFit, counts_per_n: float) -> float:
    """Force (N) that stands out of the noise: `SIGMAS` of it in the sum over all rows of three columns.

    That many columns a light contact touches wherever it is; drift is not in it.
    """
    taxels = _TOUCHED_COLUMNS * idle.zero_counts.shape[0]
    return BOUND_SIGMAS * idle.noise_counts * math.sqrt(taxels) / counts_per_n


def _windows(idle: IdleMeasurement) -> list[_Window]:
    """Cut a recording into stretches of about `_LINE_S`, each long enough to be judged."""
    length = float(idle.time_s[-1] - idle.time_s[0])
    pieces = min(max(round(length / _LINE_LENGTH_S), 1), len(idle.counts) // MIN_FRAMES)
    counts = np.array_split(idle.counts.astype(float), pieces)
    times = np.array_split(idle.time_s, pieces)
    return [_line(c, t) for c, t in zip(counts, times, strict=True)]


def _line(counts: Floats, time_s: Floats) -> _Window:
    """A straight line through frames (n, rows, cols), taxel by taxel."""
    n, middle = len(counts), float(time_s.mean())
    since = time_s - middle
    square = float(since @ since)
    if square == 0:
        raise InputError("idle array: all frames of a recording have one time; record them with their times")
    mean = counts.mean(axis=0)
    slope = np.tensordot(since, counts, axes=(0, 0)) / square
    rest = counts - mean - since[:, None, None] * slope
    spread = np.sqrt((rest**2).sum(axis=0) / (n - 2))
    return _Window(n, middle, 1 / math.sqrt(square), float(np.ptp(time_s)), mean, slope, spread)


def _is_suspicious(others: Floats, still: int, frames: int) -> bool:
    """True if noise like that of other taxels would have moved a taxel that never moved."""
    if not still or not len(others):
        return False
    noise = max(float(np.median(others)), 1e-3)
    return math.erf(0.5 / (noise * math.sqrt(2))) ** frames < _MAX_STUCK_CHANCE


def _drift(windows: Sequence[_Window], weights: Floats, noise: float) -> float:
    """Bound on the speed of the zero of any sum, counts/s, from lines and from what lies between them.

    `weights` (rows · cols, k): of taxels in sums. `noise`: of a taxel.
    """
    sigma, alone = noise * np.sqrt((weights**2).sum(axis=0)), np.abs(weights).sum(axis=0)
    # Without noise a zero moves by a count before it shows.
    rounding: Floats = alone if noise < _MIN_DITHER_COUNTS else 0.0 * alone
    speeds = []
    for w in windows:
        slope = np.abs(w.slope_per_s.ravel() @ weights) + COVERAGE_SIGMAS * sigma * w.slope_sigma_s
        fastest = float((slope + rounding / w.span_s).max(initial=0.0))
        speeds.append((w.span_s, fastest / _slope_share(w.span_s)))
    for before, after in pairwise(windows):
        passed = after.middle_s - before.middle_s
        moved = np.abs((after.mean - before.mean).ravel() @ weights)
        unsure = COVERAGE_SIGMAS * sigma * math.sqrt(1 / before.n + 1 / after.n) + rounding
        speeds.append((passed, float((moved + unsure).max(initial=0.0)) / passed))
    long = [speed for seconds, speed in speeds if seconds >= _MIN_LINE_S]
    return max(long or [speed for _, speed in speeds])


def _slope_share(span_s: float) -> float:
    """Slope of the line through a stretch of a sinusoid of `_WANDER_S`, over that in its middle."""
    x = math.pi * span_s / _MIN_WANDER_PERIOD_S
    return 3 * (math.sin(x) - x * math.cos(x)) / x**3 if x < math.pi else 3 / math.pi**2


def _places(mask: Bools) -> tuple[tuple[int, int], ...]:
    return tuple((int(row), int(col)) for row, col in np.argwhere(mask))
