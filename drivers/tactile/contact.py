"""From tactile frames to where, how hard and under which normals the tip is touched. Frames in, patches out.

The bound rule. Column forces are the baseline-free counts over nominal gain, summed along the tip. Each has
an error made of the gain spread (shared out over the rows that carry the load), the noise, the crosstalk's
spread and what the templates cannot resolve. The normal range is the hull of all directions from which some
contact of `templates` (flat edge, vertex, edge that ends, notch of two edges) gives these columns with a
misfit at most `MISFIT_SLACK` above the best one's: four standard deviations. Taxels that cannot be trusted
(dead, hot or saturated) are not looked at, and columns beyond the array's edge are unknown: both widen the
range by themselves. If no single edge fits, the contact is probably in a notch: the range is the extent of
the patch, which holds the normals of both edges, and the flag `WIDE` says so. On a flat array the normal is
unknown by nature: the range is the half circle in front of the pad.
"""

import enum
import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from palpate.drivers.tactile.frames import TactileFrame
from palpate.drivers.tactile.messages import Description, Shape
from palpate.drivers.tactile.templates import Match, Profile, TemplateSet, template_set
from palpate.errors import InputError

__all__ = ["Baseline", "ContactExtractor", "ContactPatch", "PatchFlag", "TipCalibration"]

MISFIT_SLACK = 16.0
MISFIT_LIMIT = 20.0
_SIGMAS = 4.0
_TEMPLATE_ERROR = 0.01  # of the strongest column
_SOFT_SHARE = 0.1  # of the strongest column, taken off before the centroid

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]


class PatchFlag(enum.Enum):
    """What a patch's bounds had to allow for."""

    TRUNCATED = "cut by the array's edge"
    SATURATED = "a taxel is at its largest count"
    SINGLE_TAXEL = "one column only"
    SEVERAL_PATCHES = "touched in several places; this is the strongest"
    WIDE = "wider than one edge explains: probably two edges in a notch"
    DEAD_NEIGHBOUR = "a dead or hot taxel in or beside the patch"


@dataclass(frozen=True, eq=False)
class TipCalibration:
    """What is known of one tip.

    `gain`: relative gain per taxel, shape (rows, cols), 1 where unknown; `gain_spread`: half-width of what
    is unknown of it. `noise_counts`: standard deviation of one count. `contact_force_n`: less than this is no
    contact. `stiffness_bound` and `crosstalk_bound` are the half-widths of `stiffness_n_per_mm` (relative)
    and `crosstalk` (absolute; share of a taxel's force that each neighbour takes). `usable`: False for taxels
    known to be dead or hot.
    """

    gain: Floats
    gain_spread: float = 0.2
    noise_counts: float = 2.0
    contact_force_n: float = 0.1
    stiffness_n_per_mm: float = 3.0
    stiffness_bound: float = 0.2
    crosstalk: float = 0.075
    crosstalk_bound: float = 0.03
    usable: Mask | None = None


@dataclass(frozen=True, eq=False)
class Baseline:
    """Counts of the untouched array: mean (rows, cols), noise, and which taxels are alive."""

    mean: Floats
    noise_counts: float
    usable: Mask


@dataclass(frozen=True)
class ContactPatch:
    """A touched place on the tip, in the tip frame (angle 0 at the array's middle, counter-clockwise).

    The object's outward normal points from the object to the tip: it is opposite to `angle_rad`. The
    direction from the tip's axis to the contact is within `angle_rad` ± `angle_half_range_rad`; in a notch
    that holds for at least one of the edges. `centroid_rad` is the pressure-weighted centroid alone, nan on a
    flat array. `height_mm` is the load's centroid over the tip's lower end. `force_n` is what the array sees
    of this patch, within `force_bound_n` (inf if taxels are saturated). `extent_rad` is the width of the
    active patch.
    """

    angle_rad: float
    angle_half_range_rad: float
    centroid_rad: float
    height_mm: float
    height_bound_mm: float
    force_n: float
    force_bound_n: float
    extent_rad: float
    flags: frozenset[PatchFlag] = field(default_factory=frozenset)


@dataclass(frozen=True, eq=False)
class _Columns:
    """Column sums of one measurement and what is known of their errors."""

    taxel_n: Floats
    usable: Mask
    force_n: Floats
    variance: Floats
    noise_n: float
    seen: Mask


class ContactExtractor:
    """Turns frames of one array into contact patches. `tare` first, with nothing touching.

    Raises InputError if the calibration does not fit the array or the columns are not evenly spaced.
    """

    def __init__(self, description: Description, calibration: TipCalibration) -> None:
        shape = (description.rows, description.cols)
        if calibration.gain.shape != shape or not (calibration.gain > 0).all():
            raise InputError(
                f"tactile calibration: gain of shape {calibration.gain.shape} for an array of {shape[0]} x "
                f"{shape[1]}, or a gain that is not positive; calibrate this tip again"
            )
        self._description = description
        self._calibration = calibration
        self._columns = np.asarray(description.columns)
        self._n_per_count = 1 / (calibration.gain * description.counts_per_n)
        usable = calibration.usable if calibration.usable is not None else np.ones(shape, dtype=bool)
        self._baseline = Baseline(np.zeros(shape), calibration.noise_counts, usable)
        self._set_guard()
        self._pitch, self._templates = self._make_templates()

    def _make_templates(self) -> tuple[float, TemplateSet | None]:
        d, c = self._description, self._calibration
        if d.shape is Shape.FLAT or d.cols < 2:
            return 0.0, None
        steps = np.diff(self._columns)
        pitch = float(steps.mean())
        if float(np.abs(steps - pitch).max()) > 0.01 * pitch:
            raise InputError(
                "tactile array: columns are not evenly spaced about the tip; the extractor needs them "
                "within 1 % of a common pitch"
            )
        templates = template_set(
            pitch_rad=pitch,
            radius_mm=d.tip_radius_mm,
            stiffness_n_per_mm=c.stiffness_n_per_mm,
            stiffness_bound=min(0.9, c.stiffness_bound + 0.4 * c.gain_spread),
            crosstalk=c.crosstalk,
        )
        return pitch, templates

    @property
    def baseline(self) -> Baseline:
        """The baseline in use."""
        return self._baseline

    def tare(self, frames: Sequence[TactileFrame]) -> Baseline:
        """Take the mean of still, untouched frames as baseline and return it.

        A taxel that reads its largest count, or never moves although the calibration says it is noisy,
        is left out from here on. Raises InputError without frames.
        """
        if not frames:
            raise InputError("tactile tare: no frames; start the array and keep the tip off everything")
        counts = np.stack([f.counts for f in frames]).astype(float)
        mean, spread = counts.mean(axis=0), counts.std(axis=0)
        usable = mean < 0.95 * self._description.max_count
        if self._calibration.usable is not None:
            usable &= self._calibration.usable
        if len(frames) >= 8 and self._calibration.noise_counts >= 1:
            usable &= spread > 0
        measured = float(np.sqrt((spread[usable] ** 2).mean())) if usable.any() else 0.0
        noise = max(measured, self._calibration.noise_counts) if len(frames) < 8 else max(measured, 0.3)
        self._baseline = Baseline(mean, noise * math.sqrt(1 + 1 / len(frames)), usable)
        self._set_guard()
        return self._baseline

    def _set_guard(self) -> None:
        self._guard_base = self._baseline.mean
        self._guard_threshold = _SIGMAS * self._baseline.noise_counts
        self._guard_gain = np.where(self._baseline.usable, self._n_per_count, 0.0).ravel()

    def force_n(self, frame: TactileFrame) -> float:
        """Force (N) of all taxels above the noise: quick, for the closing loop."""
        counts = frame.counts - self._guard_base
        counts *= counts > self._guard_threshold
        return float(counts.ravel() @ self._guard_gain)

    def extract(self, frames: TactileFrame | Sequence[TactileFrame]) -> ContactPatch | None:
        """Return the strongest contact in a frame, or in the mean of several; None if nothing is touched."""
        group = [frames] if isinstance(frames, TactileFrame) else list(frames)
        if not group:
            raise InputError("tactile contact: no frames to look at; wait for a frame first")
        raw = np.stack([f.counts for f in group])
        columns = self._measure(raw)
        runs = self._runs(columns)
        if not runs:
            return None
        first, last = max(runs, key=lambda run: float(columns.force_n[run[0] : run[1] + 1].sum()))
        force = float(columns.force_n[first : last + 1].sum())
        if force < self._calibration.contact_force_n:
            return None
        flags = self._flags(raw, columns, runs, first, last)
        low, high = self._normal_range(columns, runs, first, last, flags)
        height, height_bound = self._height(columns, first, last)
        span = slice(first, last + 1)
        weight = np.maximum(columns.force_n[span] - _SOFT_SHARE * columns.force_n[span].max(), 0.0)
        return ContactPatch(
            angle_rad=(low + high) / 2,
            angle_half_range_rad=(high - low) / 2,
            centroid_rad=float(weight @ self._columns[span] / weight.sum()) if self._pitch else math.nan,
            height_mm=height,
            height_bound_mm=height_bound,
            force_n=force,
            force_bound_n=self._force_bound(columns, first, last, flags),
            extent_rad=(last - first + 1) * self._pitch,
            flags=frozenset(flags),
        )

    def _measure(self, raw: NDArray[np.uint16]) -> _Columns:
        c = self._calibration
        counts = raw.mean(axis=0) - self._baseline.mean
        usable = self._baseline.usable & (raw.max(axis=0) < self._description.max_count)
        taxel_n = np.where(usable, counts * self._n_per_count, 0.0)
        noise_n = self._baseline.noise_counts * float(self._n_per_count.mean())
        share = _row_shares(taxel_n, usable, noise_n)
        covered = np.where(usable, share[:, None], 0.0).sum(axis=0)
        seen = covered > 0.3
        scale = np.where(seen, 1 / np.maximum(covered, 0.3), 0.0)
        force = taxel_n.sum(axis=0) * scale
        rows = np.maximum(covered, 0.3) / float((share**2).sum())  # rows that share out the gain errors
        gain = c.gain_spread / math.sqrt(3) / np.sqrt(np.maximum(rows, 1.0))
        guess = np.where(covered < 0.999, 0.1, 0.0)
        padded = np.pad(force, 1)
        bend = np.abs(padded[:-2] + padded[2:] - 2 * force)
        bend[[0, -1]] += c.crosstalk / max(c.crosstalk_bound, 1e-3) * force[[0, -1]]
        variance = (
            (gain**2 + guess**2) * np.maximum(force, 0.0) ** 2
            + (noise_n * scale) ** 2 * usable.sum(axis=0)
            + (_TEMPLATE_ERROR * force.max()) ** 2
            + (c.crosstalk_bound / math.sqrt(3) * bend) ** 2
            + 1e-12
        )
        variance[~seen] = np.inf
        return _Columns(taxel_n, usable, force, variance, noise_n, seen)

    def _runs(self, columns: _Columns) -> list[tuple[int, int]]:
        """Connected stretches of active columns; columns that cannot be seen join what is beside them."""
        floor = _SIGMAS * columns.noise_n * math.sqrt(self._description.rows)
        active = (columns.force_n > max(floor, 0.04 * float(columns.force_n.max()))) | ~columns.seen
        edges = np.flatnonzero(np.diff(np.concatenate(([0], active.astype(np.int8), [0]))))
        runs = [(int(a), int(b) - 1) for a, b in zip(edges[::2], edges[1::2], strict=True)]
        return [(a, b) for a, b in runs if columns.seen[a : b + 1].any()]

    def _flags(
        self, raw: NDArray[np.uint16], columns: _Columns, runs: list[tuple[int, int]], first: int, last: int
    ) -> set[PatchFlag]:
        near = slice(max(first - 1, 0), last + 2)
        full = (raw.max(axis=0) >= self._description.max_count) & self._baseline.usable
        flags = set()
        if first == 0 or last == self._description.cols - 1:
            flags.add(PatchFlag.TRUNCATED)
        if full[:, near].any():
            flags.add(PatchFlag.SATURATED)
        if (~self._baseline.usable[:, near]).any():
            flags.add(PatchFlag.DEAD_NEIGHBOUR)
        if len(runs) > 1:
            flags.add(PatchFlag.SEVERAL_PATCHES)
        span = columns.force_n[first : last + 1]
        if (span > 0.25 * span.max()).sum() == 1:
            flags.add(PatchFlag.SINGLE_TAXEL)
        return flags

    def _normal_range(
        self, columns: _Columns, runs: list[tuple[int, int]], first: int, last: int, flags: set[PatchFlag]
    ) -> tuple[float, float]:
        if self._templates is None:
            return -math.pi, 0.0
        match = self._match(self._templates, columns, runs, first, last, flags)
        if match is None or match.misfit > MISFIT_LIMIT or not match.one_edge:
            flags.add(PatchFlag.WIDE)
            beyond = 2.0 if PatchFlag.TRUNCATED in flags else 0.5
            low, high = (
                self._columns[first] - beyond * self._pitch,
                self._columns[last] + beyond * self._pitch,
            )
            return float(low), float(high)
        return float(self._columns[0]) + match.low_rad, float(self._columns[0]) + match.high_rad

    def _match(
        self,
        templates: TemplateSet,
        columns: _Columns,
        runs: list[tuple[int, int]],
        first: int,
        last: int,
        flags: set[PatchFlag],
    ) -> Match | None:
        variance = columns.variance.copy()
        for a, b in runs:
            if (a, b) != (first, last):
                variance[max(a - 1, 0) : b + 2] = np.inf
        variance[first : last + 1] = columns.variance[first : last + 1]
        missing = 0.0
        if PatchFlag.SATURATED in flags or not columns.seen[first : last + 1].all():
            missing = math.inf
        elif PatchFlag.TRUNCATED in flags:
            ends = float(
                max(columns.force_n[0] * (first == 0), columns.force_n[-1] * (last == len(variance) - 1))
            )
            # A patch that has fallen off this far at the array's edge goes on for at most two columns more.
            missing = 2 * ends if ends < 0.5 * columns.force_n.max() else math.inf
        return templates.match(Profile(columns.force_n, variance, first, last, missing), MISFIT_SLACK)

    def _height(self, columns: _Columns, first: int, last: int) -> tuple[float, float]:
        """Centroid along the tip and its bound, mm: half a row, and the gain errors and noise of the rows."""
        z = np.asarray(self._description.row_heights_mm)
        patch = columns.taxel_n[:, first : last + 1]
        rows = np.maximum(patch.sum(axis=1), 0.0)
        rows = np.maximum(rows - _SOFT_SHARE * rows.max(), 0.0)
        centre = float(rows @ z / rows.sum())
        arm = (z - centre)[:, None]
        gain = self._calibration.gain_spread / math.sqrt(3) * math.sqrt(float(((patch * arm) ** 2).sum()))
        noise = columns.noise_n * math.sqrt(float((arm**2).sum()) * patch.shape[1])
        lost = ~columns.usable[:, first : last + 1]
        reach = float(np.abs(arm).max()) * float(lost.mean())
        half = 0.5 * float(np.diff(z).max()) if len(z) > 1 else 0.0
        return centre, half + reach + _SIGMAS * math.hypot(gain, noise) / float(rows.sum())

    def _force_bound(self, columns: _Columns, first: int, last: int, flags: set[PatchFlag]) -> float:
        """Bound of the force in N: gain errors of all taxels, at most their common limit, and noise."""
        if PatchFlag.SATURATED in flags:
            return math.inf
        g = self._calibration.gain_spread
        patch = columns.taxel_n[:, first : last + 1]
        total = float(columns.force_n[first : last + 1].sum())
        likely = _SIGMAS * g / math.sqrt(3) * math.sqrt(float((patch**2).sum()))
        noise = _SIGMAS * columns.noise_n * math.sqrt(columns.taxel_n.size)
        tails = 0.04 * float(columns.force_n.max()) * 2  # columns below the patch threshold on either side
        guessed = abs(total - float(patch.sum()))
        return min(likely, g * total) / (1 - g) + noise + tails + guessed


def _row_shares(taxel_n: Floats, usable: Mask, noise_n: float) -> Floats:
    """Share of the load that each row carries, shape (rows,), from columns whose rows can all be seen."""
    whole = usable.all(axis=0)
    rows = taxel_n[:, whole].sum(axis=1)
    if rows.max(initial=0.0) < 10 * noise_n * math.sqrt(max(int(whole.sum()), 1)):
        rows = taxel_n.sum(axis=1) / np.maximum(usable.sum(axis=1), 1)
    rows = np.where(rows > 0.1 * rows.max(initial=0.0), rows, 0.0)
    total = float(rows.sum())
    return rows / total if total > 0 else np.full(len(rows), 1 / len(rows))
