"""Data reduction of array recordings: idle ones to zeros, noise and drift, presses to a few load levels.

*Presses.* A level is an interval of the travel. Averaging over it removes noise, encoder steps and most of
the steps of Present Current, and the fit has a dozen numbers per column instead of hundreds.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from palpate.base.errors import InputError
from palpate.base.geometry import Bools, Floats, Ints
from palpate.calibration.measurements import LEG_FREE, LEG_IN, IdleMeasurement, PressMeasurement
from palpate.drivers.tactile import BOUND_SIGMAS

COVERAGE_SIGMAS = 3.3
"""Bounds are this many standard deviations: 99.9 % of a normal distribution."""

_MIN_FRAMES = 8
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
    if not idles or any(len(idle.counts) < _MIN_FRAMES for idle in idles):
        raise InputError(
            f"idle array: a recording has fewer than {_MIN_FRAMES} frames; record a few seconds with "
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
    pieces = min(max(round(length / _LINE_LENGTH_S), 1), len(idle.counts) // _MIN_FRAMES)
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


LEVELS = 16

_MOTION_WINDOW_SAMPLES = 5  # samples within which a finger that moves must have got on by an encoder step
_MIN_SAMPLES = 8  # samples of a leg
_CONTACT_SIGMAS = 8.0  # sum over the array that is a contact for sure


@dataclass(frozen=True, eq=False)
class PressAtBearing:
    """A press, and what is known of where it went.

    `bearing_rad` ± `bearing_sigma_rad`: direction from the tip's axis to the contact, counter-clockwise
    from the direction of travel, when the tip just touches. `curvature_per_mm`: 1 / radius of
    the disc that was pressed, 0 for a flat face.
    """

    press: PressMeasurement
    bearing_rad: float
    bearing_sigma_rad: float
    curvature_per_mm: float

    def approach_mm(self) -> Floats:
        """Travel (n,) as it brings the tip nearer to the face; what it goes aside counts, too."""
        aside = math.tan(self.bearing_rad) * self.press.aside_mm
        result: Floats = self.press.travel_mm + aside
        return result


@dataclass(frozen=True, eq=False)
class PressLevels:
    """All presses of a finger, m levels in all.

    `press` (m,): whose level it is. `travel_mm` ± `spread_mm` (m,): mean and standard deviation of the
    travel since `start_mm` (presses,), about where the tip touched. `push_n` (m,), `facing_rad` (m,) and
    `counts` (m, rows, cols): means over `samples` (m,) samples. `free_n` (presses,): push of the free leg,
    in motion.
    """

    press: Ints
    travel_mm: Floats
    spread_mm: Floats
    push_n: Floats
    facing_rad: Floats
    counts: Floats
    samples: Ints
    start_mm: Floats
    free_n: Floats


def average_levels(presses: Sequence[PressAtBearing], live: Bools, full: Floats, noise: float) -> PressLevels:
    """Cut each press's way in into `LEVELS` levels of equal travel.

    `live` and `full` (rows, cols): taxels that are looked at, and counts at which they are saturated: samples
    with such a one are left out. Raises InputError for a press with too few samples in motion or in contact.
    """
    parts = [_levels(pressed, live, full, noise) for pressed in presses]
    return PressLevels(
        press=np.repeat(np.arange(len(parts)), [len(part.travel_mm) for part in parts]),
        travel_mm=np.concatenate([part.travel_mm for part in parts]),
        spread_mm=np.concatenate([part.spread_mm for part in parts]),
        push_n=np.concatenate([part.push_n for part in parts]),
        facing_rad=np.concatenate([part.facing_rad for part in parts]),
        counts=np.concatenate([part.counts for part in parts]),
        samples=np.concatenate([part.samples for part in parts]),
        start_mm=np.concatenate([part.start_mm for part in parts]),
        free_n=np.concatenate([part.free_n for part in parts]),
    )


def informative_presses(
    presses: Sequence[PressAtBearing], live: Bools, full: Floats, noise: float
) -> list[PressAtBearing]:
    """Presses with enough samples in motion and in contact, or all if these are fewer than half.

    A reference whose place is known by a few touches is met a little elsewhere than predicted now and then.
    """
    found = [item for item in presses if _has_enough(*_parts(item.press, live, full, noise))]
    return found if 2 * len(found) >= len(presses) else list(presses)


def _parts(press: PressMeasurement, live: Bools, full: Floats, noise: float) -> tuple[Bools, Bools]:
    """Samples (n,) of a finger that moves: those of its free way, and those that count as pressing."""
    total = press.counts[:, live].sum(axis=1)
    in_contact = total > _CONTACT_SIGMAS * noise * np.sqrt(live.sum())
    within = ~((press.counts >= full) & live).any(axis=(1, 2))
    return _moving(press, LEG_FREE), _moving(press, LEG_IN) & in_contact & within


def _has_enough(free: Bools, chosen: Bools) -> bool:
    return bool(free.sum() >= _MIN_SAMPLES and chosen.sum() >= _MIN_SAMPLES)


def _levels(pressed: PressAtBearing, live: Bools, full: Floats, noise: float) -> PressLevels:
    press, place = pressed.press, pressed.approach_mm()
    free, chosen = _parts(press, live, full, noise)
    if not _has_enough(free, chosen):
        raise InputError(
            f"finger {press.finger}, placing {press.placing}: a press has too few samples of a finger "
            f"that moves ({free.sum()} free, {chosen.sum()} in contact; {_MIN_SAMPLES} are needed); begin it "
            "further away, press harder or more slowly"
        )
    place, counts = place[chosen], press.counts[chosen]
    start = float(place.min())
    share = (place - start) / max(float(np.ptp(place)), 1e-9)
    wanted = min(LEVELS, len(place) // 2)
    _, level, samples = np.unique(
        np.minimum((share * wanted).astype(int), wanted - 1), return_inverse=True, return_counts=True
    )
    order = np.argsort(level, kind="stable")
    begins = np.concatenate([[0], np.cumsum(samples)[:-1]])
    means = [
        np.add.reduceat(a[order], begins) / samples.reshape(-1, *[1] * (a.ndim - 1))
        for a in (
            place - start,
            (place - start) ** 2,
            press.push_n[chosen],
            press.facing_rad[chosen],
            counts,
        )
    ]
    return PressLevels(
        press=np.zeros(len(samples), dtype=np.int64),
        travel_mm=means[0],
        spread_mm=np.sqrt(np.maximum(means[1] - means[0] ** 2, 0.0)),
        push_n=means[2],
        facing_rad=means[3],
        counts=means[4],
        samples=samples.astype(np.int64),
        start_mm=np.array([start]),
        free_n=np.array([float(press.push_n[free].mean())]),
    )


def _moving(press: PressMeasurement, leg: int) -> Bools:
    """Samples (n,) of a leg in which the finger moves on, by the steps round each of them."""
    there = np.flatnonzero(press.leg == leg)
    result = np.zeros(len(press.leg), dtype=bool)
    if len(there) < _MIN_SAMPLES:
        return result
    window = min(_MOTION_WINDOW_SAMPLES, len(there) // 4)
    place = press.travel_mm[there]
    padded = np.pad(place, window, mode="reflect", reflect_type="odd")
    moved = padded[2 * window :] - padded[: -2 * window]
    result[there[moved > press.step_mm / 2]] = True
    return result
