"""Patches on a cylindrical tip: from counts above zero to normals, centroid, force and their bounds.

Puts the steps together: `columns`, then `templates`, then bounds of loads.
"""

import math
from functools import cached_property

import numpy as np

from palpate.base.errors import InputError
from palpate.base.geometry import Bools, Floats, Ints
from palpate.drivers.tactile.baseline import BOUND_SIGMAS
from palpate.drivers.tactile.columns import (
    CellLoads,
    Columns,
    Runs,
    UnseenLoads,
    centroids,
    columns_of,
    load_beyond_edge,
    log_concave_limit_n,
    runs_of,
)
from palpate.drivers.tactile.description import Description
from palpate.drivers.tactile.patches import Patches, PatchFlag, TipCalibration, mask_untouched
from palpate.drivers.tactile.templates import ColumnProfile, TemplateSet, template_set

MISFIT_SLACK = 16.0
_MISFIT_LIMIT = 20.0
_SOFT_THRESHOLD_SHARE = 0.1  # of the strongest column, taken off before the centroid
_MIN_COLUMNS = 2
_GAIN_SPREAD_SHARE = (
    0.4  # of the gains' spread: so much may a patch's force be off by, being shared out over it
)
_MIN_DEPTH_RADII = 0.012  # tip radii; softer contacts only on larger tips
_SIDE_COLUMNS = 2  # columns on either side of a run that may belong to it
_MAX_BEYOND_EDGE_RAD = math.radians(60.0)  # how far a patch may go on beyond the array


class CylinderTip:
    """A cylinder with evenly spaced columns of taxels.

    `n_per_count` (rows, cols). Raises InputError if there is one column only, or they are not evenly
    spaced.
    """

    def __init__(self, description: Description, calibration: TipCalibration, n_per_count: Floats) -> None:
        self._description = description
        self._calibration = calibration
        self._n_per_count = n_per_count
        self._spreads = calibration.spreads
        self._columns = np.asarray(description.columns)
        self._heights = np.asarray(description.row_heights_mm)
        if len(self._columns) < _MIN_COLUMNS:
            raise InputError(
                "tactile array: a cylinder of one column; a direction takes two: describe the "
                "array as flat, or as free with the places of its taxels"
            )
        steps = np.diff(self._columns)
        self._pitch = float(steps.mean())
        if float(np.abs(steps - self._pitch).max()) > 0.01 * self._pitch:
            raise InputError(
                "tactile array: columns are not evenly spaced about the tip; the extractor needs them "
                "within 1 % of a common pitch"
            )

    @cached_property
    def _templates(self) -> TemplateSet:
        d, c = self._description, self._calibration
        softest = c.contact_force_n / (c.stiffness_n_per_mm * (1 + c.stiffness_bound)) / d.tip_radius_mm
        return template_set(
            pitch_rad=self._pitch,
            radius_mm=d.tip_radius_mm,
            stiffness_n_per_mm=c.stiffness_n_per_mm,
            stiffness_bound=min(0.9, c.stiffness_bound + _GAIN_SPREAD_SHARE * self._widest_spread()),
            crosstalk=c.crosstalk,
            least_depth=min(_MIN_DEPTH_RADII, 2 * softest),
        )

    def _widest_spread(self) -> float:
        """The largest spread of the gains that are used.

        Templates are made once, for patches anywhere, and one may lie on the worst taxels alone: a mean over
        the array would promise too much there.
        """
        usable = self._calibration.usable
        spreads = self._spreads if usable is None else self._spreads[usable]
        return float(spreads.max(initial=0.0))

    def prepare(self) -> None:
        """Make the templates, if they are not made yet."""
        _ = self._templates

    def patches(
        self,
        counts: Floats,
        doubt_counts: Floats | None,
        usable: Bools,
        full: Bools,
        noise_counts: float,
    ) -> Patches:
        """Patches from counts above zero (n, r, c), zeros being off by at most `doubt_counts`."""
        cols = counts.shape[2]
        columns = columns_of(
            counts, usable, self._n_per_count, noise_counts, doubt_counts, self._calibration, self._pitch
        )
        runs = runs_of(columns)
        place = np.arange(cols)
        span = (place >= runs.first[:, None]) & (place <= runs.last[:, None]) & runs.found[:, None]
        beside = (_dilate(span, _SIDE_COLUMNS) & ~_dilate(runs.other, 1) & columns.seen) | span
        # Crosstalk and a patch's thin ends leave some of its load on columns that are not the patch's.
        force = np.where(beside, columns.force_n, 0.0).sum(axis=1)
        touched = runs.found & (force >= self._calibration.contact_force_n)
        flags = self._flags(columns, runs, span, usable, full)
        angle, half, wide = self._normals(columns, runs, span, flags, touched)
        flags |= np.where(wide, PatchFlag.WIDE.bit, 0)
        centroid, centroid_bound = self._centroid(columns, span, beside, flags)
        height, height_bound = self._height(columns, span)
        force_bound = self._force_bound(columns, span, beside, doubt_counts)
        force_bound[(flags & PatchFlag.SATURATED.bit) > 0] = np.inf
        radius = self._description.tip_radius_mm
        across = np.minimum(radius * centroid_bound, 2 * radius)
        strongest = columns.taxel_n.max(axis=(1, 2), keepdims=True)
        weakest = np.maximum(BOUND_SIGMAS * columns.noise_n, _SOFT_THRESHOLD_SHARE * strongest)
        loaded = (columns.taxel_n > weakest) & span[:, None, :]

        return mask_untouched(
            Patches(
                touched=touched,
                angle_rad=angle,
                angle_half_range_rad=half,
                centroid_rad=centroid,
                centroid_bound_rad=centroid_bound,
                position_mm=np.stack([radius * np.cos(centroid), radius * np.sin(centroid), height], axis=1),
                position_bound_mm=np.stack([across, across, height_bound], axis=1),
                height_mm=height,
                height_bound_mm=height_bound,
                force_n=force,
                force_bound_n=force_bound,
                extent_rad=np.multiply(runs.last - runs.first + 1, self._pitch),
                area_mm2=loaded.sum(axis=(1, 2)) * self._cell_mm2(),
                pressed_mm=np.full((len(touched), 2, 2), np.nan),
                loaded_mm=np.full((len(touched), 2), np.nan),
                flags=flags.astype(np.uint8),
            )
        )

    def _cell_mm2(self) -> float:
        width = self._pitch * self._description.tip_radius_mm
        return width * (float(np.diff(self._heights).mean()) if len(self._heights) > 1 else width)

    def _flags(self, columns: Columns, runs: Runs, span: Bools, usable: Bools, full: Bools) -> Ints:
        near = span.copy()
        near[:, 1:] |= span[:, :-1]
        near[:, :-1] |= span[:, 1:]
        cut = (runs.first == 0) | (runs.last == span.shape[1] - 1)
        saturated = (full.any(axis=1) & near).any(axis=1)
        dead = ((~usable & ~full).any(axis=1) & near).any(axis=1)
        force = np.where(span, columns.force_n, -np.inf)
        single = (force > 0.25 * force.max(axis=1, keepdims=True)).sum(axis=1) == 1
        result: Ints = (
            PatchFlag.TRUNCATED.bit * cut
            + PatchFlag.SATURATED.bit * saturated
            + PatchFlag.DEAD_NEIGHBOUR.bit * dead
            + PatchFlag.SEVERAL_PATCHES.bit * (runs.count > 1)
            + PatchFlag.SINGLE_TAXEL.bit * single
        )
        return result

    def _normals(
        self, columns: Columns, runs: Runs, span: Bools, flags: Ints, touched: Bools
    ) -> tuple[Floats, Floats, Bools]:
        """Middle and half of the range of normals (n,), and True where it is the patch's extent."""
        past = np.where((flags & PatchFlag.TRUNCATED.bit) > 0, 2.0, 0.5)
        low, high = runs.first - past, runs.last + past
        narrow = np.zeros(len(touched), dtype=bool)
        whole = ((flags & PatchFlag.SATURATED.bit) == 0) & (columns.seen | ~span).all(axis=1)
        missing = np.where(whole, self._missing(columns, runs), np.inf)
        variance = self._variance(columns, runs, span)
        for i in np.flatnonzero(touched):
            first, last = int(runs.first[i]), int(runs.last[i])
            profile = ColumnProfile(columns.force_n[i], variance[i], first, last, float(missing[i]))
            match = self._templates.match(profile, MISFIT_SLACK)
            if match is not None and match.misfit <= _MISFIT_LIMIT and match.one_edge:
                low[i], high[i] = match.low_rad / self._pitch, match.high_rad / self._pitch
                narrow[i] = True
        return (
            self._columns[0] + (low + high) / 2 * self._pitch,
            (high - low) / 2 * self._pitch,
            ~narrow,
        )

    def _missing(self, columns: Columns, runs: Runs) -> Floats:
        """Force (n,) N beyond the array's edge that the patch may have; inf if nothing bounds it.

        A patch that has fallen off by half at the edge goes on for at most two columns more.
        """
        force, last = columns.force_n, columns.force_n.shape[1] - 1
        ends = np.maximum(force[:, 0] * (runs.first == 0), force[:, -1] * (runs.last == last))
        return np.where(ends < 0.5 * force.max(axis=1), 2 * np.maximum(ends, 0.0), np.inf)

    def _variance(self, columns: Columns, runs: Runs, span: Bools) -> Floats:
        """Variance (n, c) of what belongs to the patch; infinite where another one is."""
        result: Floats = np.where(_dilate(runs.other, 1) & ~span, np.inf, columns.variance)
        return result

    def _centroid(self, columns: Columns, span: Bools, beside: Bools, flags: Ints) -> tuple[Floats, Floats]:
        """Direction of the load's centroid and its bound, both (n,) rad."""
        c, pitch = self._calibration, self._pitch
        total = np.maximum(np.where(span, columns.force_n, 0.0).sum(axis=1), 1e-12)
        error = np.where(columns.seen, np.sqrt(np.where(columns.seen, columns.variance, 0.0)), 0.0)
        load = CellLoads(
            force_n=columns.force_n,
            noise_n=error,
            drift_n=np.zeros_like(error),
            patch=span,
            around=beside,
            soft_n=columns.floor_n,
            gain_spread=np.zeros_like(error),  # is in the variance
        )
        first, last = columns.force_n[:, 0] * span[:, 0], columns.force_n[:, -1] * span[:, -1]
        shift = (c.crosstalk + c.crosstalk_bound) * pitch * np.maximum(first + last, 0.0) / total
        saturated = (flags & PatchFlag.SATURATED.bit)[:, None] > 0
        suspect = ~columns.usable.all(axis=1)  # what is left of a saturated column says nothing of its force
        blind: Bools = span & np.where(saturated, suspect, ~columns.seen)
        return centroids(load, self._columns, pitch / 2, shift, self._unseen(blind, columns, error, span))

    def _unseen(self, blind: Bools, columns: Columns, error_n: Floats, span: Bools) -> UnseenLoads:
        """Columns whose load is unknown, and what lies beyond the array's edges."""
        pitch, place = self._pitch, self._columns
        n = len(blind)
        most, low, high = [], [], []
        for k in np.flatnonzero(blind.any(axis=0)):
            most.append(np.where(blind[:, k], np.inf, 0.0))
            low.append(np.full(n, place[k] - pitch / 2))
            high.append(np.full(n, place[k] + pitch / 2))
        for edge, inner, way in ((0, 1, -1.0), (-1, -2, 1.0)):
            load, cells = _past_edge(columns.force_n, error_n**2, edge, inner, span[:, edge])
            near = np.full(n, place[edge] + way * pitch / 2)
            far = place[edge] + way * np.minimum((cells + 0.5) * pitch, _MAX_BEYOND_EDGE_RAD)
            most.append(load)
            low.append(np.minimum(near, far))
            high.append(np.maximum(near, far))
        return UnseenLoads(np.stack(most, axis=1), np.stack(low, axis=1), np.stack(high, axis=1))

    def _height(self, columns: Columns, span: Bools) -> tuple[Floats, Floats]:
        """Centroid along the tip and its bound, mm: half a row, and the gain errors and noise of the rows."""
        z = self._heights
        patch = columns.taxel_n * span[:, None, :]
        rows = np.maximum(patch.sum(axis=2), 0.0)
        rows = np.maximum(rows - _SOFT_THRESHOLD_SHARE * rows.max(axis=1, keepdims=True), 0.0)
        total = np.maximum(rows.sum(axis=1), 1e-12)
        centre = rows @ z / total
        arm = z[None, :] - centre[:, None]
        squares = np.einsum("nrc,nrc,rc->nr", patch, patch, self._spreads**2)
        gain = np.sqrt((squares * arm**2).sum(axis=1) / 3)
        width = span.sum(axis=1)
        noise = np.sqrt(((span @ (columns.noise_n**2).T) * arm**2).sum(axis=1))
        lost = (~columns.usable & span[:, None, :]).sum(axis=(1, 2)) / np.maximum(width * len(z), 1)
        reach = np.abs(arm).max(axis=1) * lost
        half = 0.5 * float(np.diff(z).max()) if len(z) > 1 else 0.0
        return centre, half + reach + BOUND_SIGMAS * np.hypot(gain, noise) / total

    def _force_bound(
        self, columns: Columns, span: Bools, beside: Bools, doubt_counts: Floats | None
    ) -> Floats:
        """Bound of the force (n,) N: gain errors of taxels, at most their common limit, noise and drift."""
        spread = self._spreads / (1 - self._spreads)  # of a gain: its force may be wrong by this share
        patch = columns.taxel_n * beside[:, None, :]
        force = np.where(beside, columns.force_n, 0.0)
        total = force.sum(axis=1)
        doubt = np.where(
            columns.seen, BOUND_SIGMAS * np.sqrt(np.where(columns.seen, columns.variance, 0.0)), 0.0
        )
        likely = BOUND_SIGMAS / math.sqrt(3) * np.sqrt(np.einsum("nrc,nrc,rc->n", patch, patch, spread**2))
        loaded = np.maximum(patch, 0.0)
        mean = np.einsum("nrc,rc->n", loaded, spread) / np.maximum(loaded.sum(axis=(1, 2)), 1e-12)
        noise = BOUND_SIGMAS * math.sqrt((columns.noise_n**2).sum())
        guessed = np.abs(total - patch.sum(axis=(1, 2)))
        bound: Floats = np.minimum(likely, mean * total) + noise + guessed
        low, high = np.maximum(force - doubt, 0.0), np.where(columns.seen, force + doubt, np.inf)
        hidden = log_concave_limit_n(low[:, None], high[:, None])[:, 0]
        bound += np.where(span & ~columns.seen, hidden, 0.0).sum(axis=1)
        if doubt_counts is not None:
            bound += (doubt_counts * self._n_per_count * beside[:, None, :]).sum(axis=(1, 2))
        return bound


def _past_edge(
    force_n: Floats, variance: Floats, edge: int, inner: int, loaded: Bools
) -> tuple[Floats, Floats]:
    """Load beyond a column at the array's edge where it is `loaded` (n,), and how far out: N, columns."""
    outer = np.maximum(force_n[:, edge] + BOUND_SIGMAS * np.sqrt(variance[:, edge]), 0.0)
    least = force_n[:, inner] - BOUND_SIGMAS * np.sqrt(variance[:, inner])
    load, cells = load_beyond_edge(np.where(loaded, outer, 0.0), np.where(loaded, least, 1.0))
    return load, cells


def _dilate(mask: Bools, by: int) -> Bools:
    """Columns within `by` of those in `mask`, (n, c)."""
    wide = mask.copy()
    for step in range(1, by + 1):
        wide[:, step:] |= mask[:, :-step]
        wide[:, :-step] |= mask[:, step:]
    return wide
