"""Column forces of a cylindrical tip, with error bounds. Counts in, sums along the tip out.

All arrays begin with the frames: n is their number, r the rows, c the columns. Windows of neighbouring
columns are what a light contact touches, wherever it is between columns.

*Load.* Used by `cylinder` for columns and by `pads` for the taxels of a flat pad, one axis at a time. A cell
measures how much load it bears, not where: the centroid is within half a cell of that of the cells. The
bound also includes the gains' spread (four standard deviations, at most its limit), noise, the baseline's
drift and crosstalk.

Two things limit hidden load. Crosstalk: a share of it shows on the neighbours. And the shape of one contact:
the pressure between a convex part and an elastic skin is log-concave, and so are the loads of cells in a
line.
"""

import math
from dataclasses import dataclass

import numpy as np

from palpate.base.geometry import Bools, Floats, Ints
from palpate.drivers.tactile.baseline import BOUND_SIGMAS
from palpate.drivers.tactile.patches import TipCalibration

_TEMPLATE_ERROR_SHARE = 0.01  # of the strongest column, what templates cannot resolve ...
_TEMPLATE_PITCH_RAD = math.radians(13.5)  # ... in columns this far apart
_MIN_COVERED_SHARE = 0.3  # of the load: a column of which less can be seen is not seen


@dataclass(frozen=True, eq=False)
class Columns:
    """Forces of taxels and columns in n frames.

    `taxel_n` (n, r, c) N, 0 where not `usable` (n, r, c); `force_n` and its `variance` (n, c); `floor_n`
    (n,): less than this in a column may be noise or drift; `noise_n` (r, c): standard deviation of each taxel
    in N; `seen` (n, c): enough of the column's load can be seen. The variance is infinite where it cannot.
    """

    taxel_n: Floats
    usable: Bools
    force_n: Floats
    variance: Floats
    noise_n: Floats
    floor_n: Floats
    seen: Bools


@dataclass(frozen=True, eq=False)
class Runs:
    """The strongest connected stretch of active columns of each frame: `first` … `last` (n,), both included.

    `found` (n,): there is one. `count` (n,): how many there are. `other` (n, c): columns of the others.
    """

    first: Ints
    last: Ints
    found: Bools
    count: Ints
    other: Bools


def columns_of(
    counts: Floats,
    usable: Bools,
    n_per_count: Floats,
    noise_counts: float,
    drift_counts: Floats | None,
    calibration: TipCalibration,
    pitch_rad: float,
) -> Columns:
    """Sum counts above zero (n, r, c) along the tip, in columns `pitch_rad` apart.

    `drift_counts` (n or 1, r, c) bounds what the zeros may be off by; None: nothing.
    """
    taxel_n = counts * n_per_count
    taxel_n *= usable
    noise_n = noise_counts * n_per_count
    share = _row_shares(taxel_n, usable, noise_counts * float(n_per_count.mean()))
    covered = np.einsum("nrc,nr->nc", usable.astype(float), share)
    seen = covered > _MIN_COVERED_SHARE
    rim = np.maximum(covered, _MIN_COVERED_SHARE)
    scale = np.where(seen, 1 / rim, 0.0)
    force = taxel_n.sum(axis=1) * scale
    gain_variance = _gain_variance(share, usable, rim, calibration.spreads)
    guess = np.where(covered < 0.999, 0.1, 0.0)
    strongest = force.max(axis=1, keepdims=True)
    variance = (
        (gain_variance + guess**2) * np.maximum(force, 0.0) ** 2
        + scale**2 * np.einsum("nrc,rc->nc", usable, noise_n**2)
        + (_template_error(pitch_rad) * strongest) ** 2
        + (calibration.crosstalk_bound / math.sqrt(3) * _bend(force, calibration)) ** 2
        + 1e-12
    )
    floor = np.full(len(counts), BOUND_SIGMAS * math.sqrt((noise_n**2).sum(axis=0).max()))
    if drift_counts is not None:
        drift_n = (drift_counts * n_per_count * usable).sum(axis=1) * scale
        variance += (drift_n / 2) ** 2  # bounds of one sign: four standard deviations are twice of them
        floor += drift_n.max(axis=1)
    variance[~seen] = np.inf
    return Columns(taxel_n, usable, force, variance, noise_n, floor, seen)


def _gain_variance(share: Floats, usable: Bools, covered: Floats, spreads: Floats) -> Floats:
    """Variance (n, c) of columns' forces through their taxels' gains, relative.

    Gains are anywhere within their `spreads` (r, c), each by itself, so that the rows that carry a column's
    load share out their errors: by its `share` (n, r) each, of which the part `covered` (n, c) can be seen.
    """
    weight = share**2
    rows = covered / weight.sum(axis=1, keepdims=True)
    seen = np.maximum(np.einsum("nrc,nr->nc", usable, weight), 1e-30)
    mean = np.einsum("nrc,nr,rc->nc", usable, weight, spreads**2) / seen
    result: Floats = mean / 3 / np.maximum(rows, 1.0)
    return result


def _template_error(pitch_rad: float) -> float:
    """Share of the strongest column that templates cannot resolve; narrow columns show more of a shape.

    The power is as small as it can be without emulated contacts outside, their gains being known.
    """
    finer = max(1.0, _TEMPLATE_PITCH_RAD / pitch_rad)
    return _TEMPLATE_ERROR_SHARE * math.pow(finer, 1.25)


def runs_of(columns: Columns) -> Runs:
    """Find the columns that are touched; ones that cannot be seen join what is beside them."""
    force = columns.force_n
    n, c = force.shape
    limit = np.maximum(columns.floor_n, 0.04 * force.max(axis=1))[:, None]
    active = (force > limit) | ~columns.seen
    begins = active.copy()
    begins[:, 1:] &= ~active[:, :-1]
    label = np.where(active, np.cumsum(begins, axis=1), 0)
    flat = label + (np.arange(n) * (c + 1))[:, None]
    size = n * (c + 1)
    total = np.bincount(flat.ravel(), force.ravel(), size).reshape(n, c + 1)
    alive = np.bincount(flat.ravel(), columns.seen.ravel(), size).reshape(n, c + 1) > 0
    alive[:, 0] = False
    best = np.where(alive, total, -np.inf).argmax(axis=1)
    found: Bools = np.logical_or.reduce(alive, axis=1)
    inside: Bools = (label == best[:, None]) & found[:, None]
    first = inside.argmax(axis=1)
    last = c - 1 - inside[:, ::-1].argmax(axis=1)
    other: Bools = np.take_along_axis(alive, label, axis=1) & ~inside
    return Runs(first, last, found, alive.sum(axis=1), other)


def _bend(force: Floats, calibration: TipCalibration) -> Floats:
    """Force that crosstalk moves from column to column, for each share of it, shape (n, c)."""
    padded = np.pad(force, ((0, 0), (1, 1)))
    bend = np.abs(padded[:, :-2] + padded[:, 2:] - 2 * force)
    # What crosstalk would take beyond the array's edge stays: there the whole of it is in doubt.
    edge = calibration.crosstalk / max(calibration.crosstalk_bound, 1e-3)
    bend[:, 0] += edge * force[:, 0]
    bend[:, -1] += edge * force[:, -1]
    return bend


def _strongest(taxel_n: Floats, whole: Bools) -> Floats:
    """The strongest of the columns that can be seen whole, as a share of the strongest of all, (n,)."""
    column = taxel_n.sum(axis=1)
    most = np.maximum(column.max(axis=1), 1e-12)
    result: Floats = np.where(whole, column, 0.0).max(axis=1) / most
    return result


def _fit_rows(taxel_n: Floats, usable: Floats) -> Floats:
    """Rows (n, r) of the product of a row and a column that comes nearest to the taxels that can be seen."""
    rows: Floats = taxel_n.sum(axis=2) / np.maximum(usable.sum(axis=2), 1)
    for _ in range(3):
        rows = np.maximum(rows, 0.0)
        norm = np.maximum(np.einsum("nrc,nr->nc", usable, rows**2), 1e-30)
        columns = np.maximum(np.einsum("nrc,nr->nc", taxel_n, rows) / norm, 0.0)
        norm = np.maximum(np.einsum("nrc,nc->nr", usable, columns**2), 1e-30)
        rows = np.einsum("nrc,nc->nr", taxel_n, columns) / norm
    return rows


def _row_shares(taxel_n: Floats, usable: Bools, noise_n: float) -> Floats:
    """Share of the load that each row carries, shape (n, r), from columns whose rows can all be seen."""
    whole: Bools = np.logical_and.reduce(usable, axis=1)
    rows = np.einsum("nrc,nc->nr", taxel_n, whole.astype(float))
    least = 10 * noise_n * np.sqrt(np.maximum(whole.sum(axis=1), 1))
    weak = (rows.max(axis=1) < least) | (_strongest(taxel_n, whole) < 0.5)
    if weak.any():
        rows[weak] = _fit_rows(taxel_n[weak], usable[weak].astype(float))
    most = np.maximum(rows.max(axis=1, keepdims=True), 0.0)
    rows = np.where(rows > 0.1 * most, rows, 0.0)
    total = rows.sum(axis=1, keepdims=True)
    even = 1 / rows.shape[1]
    result: Floats = np.where(total > 0, rows / np.where(total > 0, total, 1.0), even)
    return result


WINDOW_COLUMNS = 3
"""A light contact's share of a cylinder."""


def column_windows(weights: Floats) -> Floats:
    """Matrix (rows · cols, windows) that takes counts (row by row) to their sums in each few columns.

    `weights` (rows, cols): of each taxel, 0 for one that is left out.
    """
    rows, cols = weights.shape
    width = min(WINDOW_COLUMNS, cols)
    matrix = np.zeros((rows, cols, cols - width + 1))
    for window in range(matrix.shape[2]):
        matrix[:, window : window + width, window] = weights[:, window : window + width]
    return matrix.reshape(rows * cols, -1)


def windows_within(columns: Bools) -> tuple[Bools, Bools]:
    """Windows (windows,) of which all columns are among some (cols,), and the columns (cols,) of these."""
    width = min(WINDOW_COLUMNS, len(columns))
    windows = np.asarray(np.lib.stride_tricks.sliding_window_view(columns, width).all(axis=1))
    return windows, np.convolve(windows, np.ones(width)) > 0


@dataclass(frozen=True, eq=False)
class CellLoads:
    """Load on k cells in n frames, all (n, k).

    `noise_n`: standard deviation of `force_n`; `drift_n`: bound of what zeros are off by; `patch`: cells of
    the patch; `around`: those and what may belong to it; `gain_spread`: half-width of the relative error.
    `soft_n` (n,) is taken off each cell before the centroid.
    """

    force_n: Floats
    noise_n: Floats
    drift_n: Floats
    patch: Bools
    around: Bools
    soft_n: Floats
    gain_spread: Floats


@dataclass(frozen=True, eq=False)
class UnseenLoads:
    """Load that the array does not show: on m places at most `most_n` N between `low` and `high`, (n, m)."""

    most_n: Floats
    low: Floats
    high: Floats


def centroids(
    load: CellLoads, place: Floats, half_cell: float, edge_shift: Floats, unseen: UnseenLoads
) -> tuple[Floats, Floats]:
    """Centroid and its half range along one axis, both (n,); `place` (k,) are the cells' middles.

    `edge_shift` (n,) bounds what crosstalk at the array's edge moves. The half range is inf where unseen load
    may be anywhere.
    """
    soft = np.where(load.patch, np.maximum(load.force_n - load.soft_n[:, None], 0.0), 0.0)
    total = np.maximum(soft.sum(axis=1), 1e-12)
    centre = soft @ place / total
    force = np.where(load.around, load.force_n, 0.0)
    whole = np.maximum(force.sum(axis=1), 1e-12)
    plain = force @ place / whole
    arm = np.abs(place[None, :] - plain[:, None]) * load.around
    bearing = np.maximum(force, 0.0) * load.gain_spread
    likely = BOUND_SIGMAS / math.sqrt(3) * np.sqrt(((bearing * arm) ** 2).sum(axis=1))
    gain = np.minimum(likely, (bearing * arm).sum(axis=1))
    noise = BOUND_SIGMAS * np.sqrt(((load.noise_n * arm) ** 2).sum(axis=1))
    noise += _drift_moment(load, place[None, :] - plain[:, None])
    half = half_cell + (gain + noise) / whole + edge_shift
    low, high = plain - half, plain + half
    for most, begin, end in zip(unseen.most_n.T, unseen.low.T, unseen.high.T, strict=True):
        low = np.minimum(low, _shift_centroid(low, whole, begin, most))
        high = np.maximum(high, _shift_centroid(high, whole, end, most))
    return centre, np.maximum(high - centre, centre - low)


def _drift_moment(load: CellLoads, away: Floats) -> Floats:
    """Moment of what zeros may be off by, (n,): each by itself and all alike, at most all at their worst."""
    moment = np.where(load.around, load.drift_n * away, 0.0)
    alone = BOUND_SIGMAS / math.sqrt(3) * np.sqrt((moment**2).sum(axis=1))
    result: Floats = np.minimum(alone + np.abs(moment.sum(axis=1)), np.abs(moment).sum(axis=1))
    return result


def _shift_centroid(here: Floats, weight: Floats, there: Floats, most: Floats) -> Floats:
    """The centroid if `most` more lies at `there`, all (n,); `there` itself where nothing bounds it."""
    known = np.isfinite(most)
    added = np.where(known, most, 0.0)
    at = np.where(added > 0, there, 0.0)  # a place may be infinite where nothing is
    with np.errstate(invalid="ignore"):
        mixed = (here * weight + at * added) / (weight + added)
    return np.where(known, mixed, there)


_STEADY_RATIO = 0.9  # a ratio above it may go on for ever


def crosstalk_limit_n(shown_n: Floats, least_share: float) -> Floats:
    """The most that each cell can bear, (n, r, c) N.

    `shown_n` (n, r, c): the most that its neighbours really show, inf where they cannot be seen;
    `least_share`: the least share of a load that appears on each neighbour.
    """
    if least_share <= 0:
        return np.full_like(shown_n, np.inf)
    padded = np.pad(shown_n / least_share, ((0, 0), (1, 1), (1, 1)), constant_values=np.inf)
    result: Floats = np.minimum.reduce(
        [padded[:, 1:-1, 2:], padded[:, 1:-1, :-2], padded[:, 2:, 1:-1], padded[:, :-2, 1:-1]]
    )
    return result


def log_concave_limit_n(low_n: Floats, high_n: Floats) -> Floats:
    """The most that each cell of a log-concave load can bear, (n, r, c) N; inf where nothing says.

    `low_n`, `high_n` (n, r, c): limits of the other cells' loads; 0 and inf where they cannot be seen.
    """
    edges = ((0, 0), (2, 2), (2, 2))
    low, high = np.pad(low_n, edges), np.pad(high_n, edges, constant_values=np.inf)
    inner = slice(2, -2)
    limits = []
    for near, far in ((slice(3, -1), slice(4, None)), (slice(1, -3), slice(0, -4))):
        limits.append(_ratio(high[:, inner, near], low[:, inner, far]))
        limits.append(_ratio(high[:, near, inner], low[:, far, inner]))
    result: Floats = np.minimum.reduce(limits)
    return result


def _ratio(near: Floats, far: Floats) -> Floats:
    known = (far > 0) & np.isfinite(near)
    square = np.where(known, near, 0.0) ** 2
    return np.where(known, square / np.where(known, far, 1.0), np.inf)


def load_beyond_edge(outer_n: Floats, inner_n: Floats) -> tuple[Floats, Floats]:
    """Load beyond an edge, and how many cells beyond the outermost one it is centred at most; both (n,).

    `outer_n`: the most that the outermost line of cells bears; `inner_n`: the least that the next one does.
    Falling by the same ratio for ever is the most that a log-concave load can do. Both are inf where it does
    not fall.
    """
    falls = outer_n < _STEADY_RATIO * inner_n
    none = outer_n <= 0
    ratio = np.where(falls & ~none, outer_n / np.where(falls, inner_n, 1.0), 0.0)
    load = np.where(falls, outer_n * ratio / (1 - ratio), np.inf)
    reach = np.where(falls, 1 / (1 - ratio), np.inf)
    return np.where(none, 0.0, load), np.where(none, 0.0, reach)
