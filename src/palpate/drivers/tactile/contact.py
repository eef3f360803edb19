"""Contact extractor: where and how hard a tip is touched, and the possible normals. Frames in, patches out.

The bound rule. On a cylinder column forces are the baseline-free counts over nominal gain, summed along the
tip. Each has an error made of the gain spread (shared out over the rows that carry the load), the noise, the
drift, the crosstalk's spread and what the templates cannot resolve. `extract`, for a contact that is to be
measured: the normal range is the hull of all directions from which some contact of `templates` (flat edge,
vertex, edge that ends, notch of two edges) gives these columns with a misfit at most `MISFIT_SLACK` above the
best one's: four standard deviations. `process` does the same for every frame of a recording.
Taxels that cannot be trusted (dead, hot or saturated) are not looked at, and columns beyond the array's edge
are unknown: both widen the range by themselves. If no single edge fits, the contact is probably in a notch:
the range is the extent of the patch, which holds the normals of both edges, and the flag `WIDE` says so. Flat
and free arrays: see `pads`.
"""

import math
from collections.abc import Sequence
from functools import cached_property

import numpy as np

from palpate.base.errors import InputError
from palpate.base.geometry import Bools, Counts, Floats
from palpate.drivers.tactile.baseline import (
    BOUND_SIGMAS,
    Baseline,
    BaselineTracker,
    TaxelSums,
    ZeroBounds,
    baseline_of,
)
from palpate.drivers.tactile.columns import column_windows
from palpate.drivers.tactile.cylinder import CylinderTip
from palpate.drivers.tactile.description import Description, Shape, TaxelSurface, surface_of
from palpate.drivers.tactile.frames import TactileFrame
from palpate.drivers.tactile.pads import TaxelForces, pad_patches
from palpate.drivers.tactile.patches import (
    ContactPatch,
    Patches,
    TipCalibration,
    concatenate_patches,
)

_FRAMES_AT_ONCE = 4096  # frames at once
_MATCHED_SIGMAS = 6.0  # a matched sum above that is no noise: less than once in a day
_STEADY_SHARE = 0.01
_ZERO_SIGMAS = 6.0  # by which a zero that has moved is no chance, of hundreds of taxels
_ROUNDING_COUNTS = 2.0  # that a quiet taxel's rounded zero may jump by
_FULL_SHARE = 0.95  # of the largest count: no zero has drifted there
_SINGLE_TAXEL_SIGMAS = 10.0  # likewise, of the sum of single taxels that are above the noise


class ContactExtractor:
    """Turns frames of one array into contact patches. `tare` first, with nothing touching.

    Raises InputError if the calibration does not fit the array, or a cylinder has one column or its columns
    are not evenly spaced.
    """

    def __init__(self, description: Description, calibration: TipCalibration) -> None:
        shape = (description.rows, description.cols)
        _check(calibration, shape)
        self._description = description
        self._calibration = calibration
        self._n_per_count = 1 / (calibration.gain * description.counts_per_n)
        self._tared_frames = 1
        self._tared_s = math.inf
        self._cylinder = None
        if description.shape is Shape.CYLINDER:
            self._cylinder = CylinderTip(description, calibration, self._n_per_count)
        usable = calibration.usable if calibration.usable is not None else np.ones(shape, dtype=bool)
        self._use(Baseline(np.zeros(shape), calibration.noise_counts, usable))

    @property
    def baseline(self) -> Baseline:
        """The baseline in use, as far as it has been followed."""
        b = self._baseline
        return b if self._tracker is None else Baseline(self._tracker.mean, b.noise_counts, b.usable)

    def tare(self, frames: Sequence[TactileFrame]) -> Baseline:
        """Take the mean of still, untouched frames as baseline and return it.

        A taxel that reads its largest count, or never moves although the calibration says it is noisy,
        is left out from here on. Raises InputError without frames.
        """
        c = self._calibration
        counts = np.stack([f.counts for f in frames]) if frames else np.zeros((0, 1, 1), np.uint16)
        baseline = baseline_of(counts, self._description.max_count, c.noise_counts, c.usable)
        self._tared_frames = len(frames)
        self._tared_s = float(np.mean([f.device_time_s for f in frames]))
        self._use(baseline, self._tared_s)
        return self._baseline

    def _use(self, baseline: Baseline, tared_s: float | None = None) -> None:
        self._baseline = baseline
        drift = self._calibration.drift_counts_per_s
        gain = np.where(baseline.usable, self._n_per_count, 0.0)
        self._guard_gain = gain.ravel()
        self._window_gain = column_windows(gain)
        self._window_noise = baseline.noise_counts * np.sqrt((self._window_gain**2).sum(axis=0))
        self._tracker = None
        if drift > 0:
            sums = TaxelSums(self._window_gain, self._window_drift(drift))
            self._tracker = BaselineTracker(baseline, drift, tared_s, self._tared_frames, sums)
        self._set_guard(tared_s)

    def _window_drift(self, drift_counts_per_s: float) -> Floats:
        """Largest drift of the zero of each window's force, N/s."""
        alone: Floats = drift_counts_per_s * self._window_gain.sum(axis=0)
        calibrated = self._calibration.force_drift_n_per_s
        if calibrated is None:
            return alone
        # Of all taxels that were usable then; what has been left out since counts by itself.
        usable = self._calibration.usable
        every = self._n_per_count if usable is None else self._n_per_count * usable
        left_out = (column_windows(every) - self._window_gain).sum(axis=0)
        result: Floats = np.minimum(alone, calibrated + drift_counts_per_s * left_out)
        return result

    def _set_guard(self, now: float | None) -> None:
        """Compare frames from now on with the zeros as they are at `now`, by the array's clock."""
        tracker, gain, base = self._tracker, self._window_gain, self.baseline.mean
        self._guard_base = base
        if tracker is None:
            sums = base.ravel() @ gain
            self._guard_doubt, self._zeros_n = np.zeros_like(base), ZeroBounds(sums, sums, sums)
        else:
            at_s = -math.inf if now is None else now
            self._guard_doubt = tracker.bound_at(at_s)
            self._zeros_n = tracker.sums_at(at_s)
            if self._cylinder is None:  # every taxel is judged by itself
                taxels = tracker.taxels_at(at_s)
                self._zeros_n = ZeroBounds(taxels.lower @ gain, taxels.upper @ gain, taxels.least @ gain)
        self._guard_limit = (base + BOUND_SIGMAS * self._baseline.noise_counts + self._guard_doubt).ravel()
        zeros = self._zeros_n
        self._window_limits_n: dict[int, Floats] = {}
        self._zero_doubt_n = (
            float((zeros.upper - zeros.lower).max()),
            float((zeros.upper - zeros.least).max()),
        )

    @property
    def follows(self) -> bool:
        """True if zeros drift, so that `follow` does something."""
        return self._tracker is not None

    def follow(self, frames: Sequence[TactileFrame], *, may_touch: bool = False) -> None:
        """Let the baseline follow its drift through frames; without drift nothing happens.

        `may_touch`: see `BaselineTracker.follow`.
        """
        if self._tracker is None or not frames:
            return
        times = np.array([f.device_time_s for f in frames])
        self._tracker.follow(np.stack([f.counts for f in frames]), times, may_touch=may_touch)
        self._set_guard(float(times[-1]))

    def zero_shift(self, frames: Sequence[TactileFrame]) -> tuple[int, float]:
        """Return how many zeros have moved since the tare by more than drift and noise allow.

        By untouched frames; and by how many counts the farthest has moved, 0 if none.
        """
        base, drift = self._baseline, self._calibration.drift_counts_per_s
        mean = np.mean([frame.counts for frame in frames], axis=0)
        off = np.where(mean < _FULL_SHARE * self._description.max_count, mean - base.mean, 0.0)
        passed_s = max(float(np.mean([frame.device_time_s for frame in frames])) - self._tared_s, 0.0)
        noise = base.noise_counts * math.sqrt(1 / len(frames) + 1 / self._tared_frames)
        moved = base.usable & (np.abs(off) > drift * passed_s + _ZERO_SIGMAS * noise + _ROUNDING_COUNTS)
        off = np.where(moved, off, 0.0)
        return int(moved.sum()), float(off.flat[np.abs(off).argmax()])

    def is_changing(self, earlier: Sequence[TactileFrame], later: Sequence[TactileFrame]) -> bool:
        """Return whether the force of a contact at rest changes by more than noise and 1 % of it."""
        first, second = (np.mean([f.counts for f in part], axis=0) for part in (earlier, later))
        pressed = (first + second) / 2 - self._guard_base
        noise = self._baseline.noise_counts * math.sqrt(1 / len(earlier) + 1 / len(later))
        counted = self._baseline.usable & (pressed > BOUND_SIGMAS / 2 * noise)
        least = max(BOUND_SIGMAS * noise * math.sqrt(counted.sum()), _STEADY_SHARE * pressed[counted].sum())
        return bool(abs((second - first)[counted].sum()) > least)

    def prepare(self) -> None:
        """Make what contacts are compared with; if this is left out, the first contact waits for it."""
        if self._cylinder is not None:
            self._cylinder.prepare()

    def force_n(self, frame: TactileFrame) -> float:
        """Force (N) of all taxels above the noise: quick, for the closing loop.

        On a cylinder a light contact may leave each taxel within the noise: then the force is that of the
        three neighbouring columns which together are most above theirs.
        """
        return self.sense(frame)[0]

    def sense(self, frame: TactileFrame) -> tuple[float, Floats]:
        """`force_n`, and what `steady_force_n` wants of this frame: readings (n,), linear in its counts."""
        read = frame.counts.astype(float).ravel()
        above = read > self._guard_limit
        force = 0.0
        if np.count_nonzero(above):
            force = float(((read - self._guard_base.ravel()) * above) @ self._guard_gain)
        if self._cylinder is None:
            return force, read
        sums = read.dot(self._window_gain)
        return max(force, self._matched_n(sums)), sums

    def weighted_n(self, frame: TactileFrame, weights: Floats) -> float:
        """Sum of the forces (N) of a frame's columns, each times its weight (cols,), at most.

        As read, and four standard deviations of its noise; what zeros may be off by comes on top.
        """
        gain = self._guard_gain.reshape(frame.counts.shape) * weights
        read = float(((frame.counts - self._guard_base) * gain).sum())
        noise = self._baseline.noise_counts * math.sqrt(float((gain**2).sum()))
        return max(read, 0.0) + BOUND_SIGMAS * noise

    def windows_n(self, readings: Floats, windows: Bools, frames: int = 1) -> float:
        """Largest force (N) of some windows of a cylinder's columns (windows,) that is above the noise.

        `readings` as `steady_force_n` wants them, of the mean of so many frames.
        """
        return self._matched_n(np.where(windows, readings, -math.inf), frames)

    def windows_most_n(self, readings: Floats, windows: Bools, frames: int) -> float:
        """Largest force (N) that may press on one of some windows (windows,), likewise, at most.

        As read, and four standard deviations of its noise; what zeros may be off by comes on top.
        """
        noise = BOUND_SIGMAS * self.noise_share(frames) * self._window_noise
        return max(float((readings - self._zeros_n.upper + noise)[windows].max()), 0.0)

    def steady_force_n(self, readings: Floats, frames: int) -> float:
        """Force (N) that is above the noise in the mean of the readings (n,) of some frames: likewise."""
        if self._cylinder is not None:
            return self._matched_n(readings, frames)
        above = readings - self._guard_base.ravel()
        least = _MATCHED_SIGMAS * self.noise_share(frames) * self._baseline.noise_counts
        return float((above * (above > least + self._guard_doubt.ravel())) @ self._guard_gain)

    @property
    def zero_doubt_n(self) -> tuple[float, float]:
        """Force (N) that zeros at the ends of their intervals may hide, beside the noise.

        A zero may be off by half of its interval, and as much again is taken off what is felt. The second
        value: likewise, if all that `follow` has seen since the tare may have been touched.
        """
        return self._zero_doubt_n

    @property
    def zero_doubt_n_per_s(self) -> float:
        """Rate at which `zero_doubt_n` grows while the tip may touch."""
        drift = self._calibration.drift_counts_per_s
        return 2 * float(self._window_drift(drift).max(initial=0.0)) if drift > 0 else 0.0

    def noise_share(self, frames: int) -> float:
        """Noise of the mean of some frames, over one frame's; both with what the tare had of it.

        Where zeros are followed that is in their bounds.
        """
        tared = self._tared_frames
        zero = 0.0 if self._tracker is not None else 1 / tared
        return math.sqrt((1 / frames + zero) / (1 + 1 / tared))

    def _matched_n(self, sums: Floats, frames: int = 1) -> float:
        """The largest force of any window that is above the noise; `sums` (windows,) of counts as read."""
        limit = self._window_limits_n.get(frames)
        if limit is None:
            noise = _MATCHED_SIGMAS * self.noise_share(frames) * self._window_noise
            limit = self._window_limits_n[frames] = self._zeros_n.upper + noise
        above = sums > limit
        return float((sums - self._zeros_n.upper)[above].max()) if np.count_nonzero(above) else 0.0

    def spread_hidden_n(self, later_s: float = 0.0) -> float:
        """Force (N), spread over the whole array, that `force_n` may not show; 0 on a cylinder.

        `later_s`: after so long in which the tip may touch, so that zeros are not followed.
        """
        if self._cylinder is not None:
            return 0.0
        # A zero may be as far below where it is thought to be as the limit allows it to be above.
        doubt = self._guard_doubt.ravel() + self._calibration.drift_counts_per_s * later_s
        return float((BOUND_SIGMAS * self._baseline.noise_counts + 2 * doubt) @ self._guard_gain)

    @property
    def least_force_n(self) -> float:
        """Least threshold (N) that `force_n` does not exceed untouched, by the noise that was tared."""
        if self._cylinder is None:
            return _SINGLE_TAXEL_SIGMAS * self._baseline.noise_counts * float(self._guard_gain.max())
        return _MATCHED_SIGMAS * float(self._window_noise.max())

    def extract(self, frames: TactileFrame | Sequence[TactileFrame]) -> ContactPatch | None:
        """Return the strongest contact in a frame, or in the mean of several; None if nothing is touched."""
        group = [frames] if isinstance(frames, TactileFrame) else list(frames)
        if not group:
            raise InputError("tactile contact: no frames to look at; wait for a frame first")
        raw = np.stack([f.counts for f in group])
        tracker, now = self._tracker, max(f.device_time_s for f in group)
        patches = self._patches(
            raw.mean(axis=0)[None] - self.baseline.mean,
            None if tracker is None else tracker.bound_at(now)[None],
            (raw.max(axis=0) >= self._description.max_count)[None],
        )
        return patches.patch(0)

    def process(self, counts: Counts, time_s: Floats) -> Patches:
        """Every frame of a recording: `counts` (n, rows, cols), sampled at `time_s` (n,), the array's time.

        The baseline follows its drift on the way, as `follow` lets it. Raises InputError if the frames are
        not this array's.
        """
        d = self._description
        if counts.ndim != 3 or counts.shape[1:] != (d.rows, d.cols) or time_s.shape != counts.shape[:1]:
            raise InputError(
                f"tactile recording: counts of shape {counts.shape} and times of shape {time_s.shape} for an "
                f"array of {d.rows} x {d.cols}; one time a frame, and frames of this array's size"
            )
        pieces = []
        for begin in range(0, len(counts), _FRAMES_AT_ONCE):
            piece = counts[begin : begin + _FRAMES_AT_ONCE]
            zeros, doubt = self._zeros(piece, time_s[begin : begin + _FRAMES_AT_ONCE])
            pieces.append(self._patches(piece - zeros, doubt, piece >= d.max_count))
        if not pieces:
            pieces = [self._patches(np.zeros((0, d.rows, d.cols)), None, np.zeros((0, d.rows, d.cols), bool))]
        return concatenate_patches(pieces)

    def _zeros(self, counts: Counts, time_s: Floats) -> tuple[Floats, Floats | None]:
        if self._tracker is None:
            return self._baseline.mean, None
        zeros = self._tracker.follow(counts, time_s)
        self._set_guard(float(time_s[-1]))
        return zeros.mean[zeros.block_of], zeros.bound[zeros.block_of]

    def _patches(self, counts: Floats, doubt_counts: Floats | None, full: Bools) -> Patches:
        """Patches from counts above zero (n, r, c), within `doubt_counts`; `full`: at the largest count."""
        full &= self._baseline.usable
        usable = self._baseline.usable & ~full
        if self._cylinder is not None:
            return self._cylinder.patches(counts, doubt_counts, usable, full, self._baseline.noise_counts)
        drift = np.zeros_like(counts) if doubt_counts is None else doubt_counts * self._n_per_count
        noise = np.broadcast_to(self._n_per_count * self._baseline.noise_counts, counts.shape)
        force = np.where(usable, counts * self._n_per_count, 0.0)
        return pad_patches(TaxelForces(force, noise, drift, usable, full), self._surface, self._calibration)

    @cached_property
    def _surface(self) -> TaxelSurface:
        return surface_of(self._description)


def _check(calibration: TipCalibration, shape: tuple[int, int]) -> None:
    """Raise InputError if the calibration is not one of an array of this shape."""
    gain, spread = calibration.gain, np.asarray(calibration.gain_spread)
    if gain.shape != shape or not (gain > 0).all():
        raise InputError(
            f"tactile calibration: gain of shape {gain.shape} for an array of {shape[0]} x {shape[1]}, or a "
            "gain that is not positive; calibrate this tip again"
        )
    if spread.shape not in ((), shape) or not ((spread >= 0) & (spread < 1)).all():
        raise InputError(
            f"tactile calibration: gain_spread of shape {spread.shape} for an array of {shape[0]} x "
            f"{shape[1]}, or one that is not a share from 0 to less than 1; calibrate this tip again"
        )
