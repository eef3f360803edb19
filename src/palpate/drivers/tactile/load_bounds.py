"""Bounds of a patch's load: on its centroid, and on the share that an array may fail to measure.

Used by `cylinder` for columns and by `pads` for the taxels of a flat pad, one axis at a time. A cell
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

from palpate.base.geometry import Bools, Floats
from palpate.drivers.tactile.baseline import BOUND_SIGMAS


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
