"""Where the load of a patch is centred, and within what. Forces of cells in, an interval out.

Used by `cylinder` for columns and by `pads` for the taxels of a flat pad, one axis at a time.

The bound rule. A cell says how much load it bears, not where in it: the centroid is within half a cell of the
cells' own. On top come the gains' spread (four standard deviations, at most its limit), noise, the crosstalk
that stays inside at the array's edge, what the soft threshold moved, and cells that cannot be seen: the load
on one is bounded by what its neighbours show of it through the crosstalk, and if nothing bounds it the
centroid may be where that cell is.
"""

import math
from dataclasses import dataclass

import numpy as np

from palpate.base.geometry import Bools, Floats
from palpate.drivers.tactile.baseline import SIGMAS

__all__ = ["Load", "Unseen", "centroids"]


@dataclass(frozen=True, eq=False)
class Load:
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
class Unseen:
    """Load that the array does not show: on m places at most `most_n` N between `low` and `high`, (n, m)."""

    most_n: Floats
    low: Floats
    high: Floats


def centroids(
    load: Load, place: Floats, half_cell: float, edge_shift: Floats, unseen: Unseen
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
    likely = SIGMAS / math.sqrt(3) * np.sqrt(((bearing * arm) ** 2).sum(axis=1))
    gain = np.minimum(likely, (bearing * arm).sum(axis=1))
    noise = SIGMAS * np.sqrt(((load.noise_n * arm) ** 2).sum(axis=1))
    noise += _drift(load, place[None, :] - plain[:, None])
    half = half_cell + (gain + noise) / whole + edge_shift
    low, high = plain - half, plain + half
    for most, begin, end in zip(unseen.most_n.T, unseen.low.T, unseen.high.T, strict=True):
        low = np.minimum(low, _mixed(low, whole, begin, most))
        high = np.maximum(high, _mixed(high, whole, end, most))
    return centre, np.maximum(high - centre, centre - low)


def _drift(load: Load, away: Floats) -> Floats:
    """Moment of what zeros may be off by, (n,): each by itself and all alike, at most all at their worst."""
    moment = np.where(load.around, load.drift_n * away, 0.0)
    alone = SIGMAS / math.sqrt(3) * np.sqrt((moment**2).sum(axis=1))
    result: Floats = np.minimum(alone + np.abs(moment.sum(axis=1)), np.abs(moment).sum(axis=1))
    return result


def _mixed(here: Floats, weight: Floats, there: Floats, most: Floats) -> Floats:
    """The centroid if `most` more lies at `there`, all (n,); `there` itself where nothing bounds it."""
    known = np.isfinite(most)
    added = np.where(known, most, 0.0)
    at = np.where(added > 0, there, 0.0)  # a place may be infinite where nothing is
    with np.errstate(invalid="ignore"):
        mixed = (here * weight + at * added) / (weight + added)
    return np.where(known, mixed, there)
