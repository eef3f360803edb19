"""How much two outlines differ: share of the boundary that is further off than a distance, best aligned."""

import math
from functools import partial

import numpy as np
import shapely
from scipy.optimize import minimize
from shapely_bench import turned

from palpate.base.geometry import Floats

_POINTS, _TURNS, _TRIED = 160, 72, 3


def difference(one: Floats, other: Floats, large_mm: float) -> float:
    """Share of the boundary of either ring, (n, 2) mm, that stays further than `large_mm` from the other.

    Of rigid motions that were searched, that with the least: an upper bound of the true least.
    """
    a, b = _sampled(one), _sampled(other)
    a, b = a - shapely.Polygon(one).centroid.coords[0], b - shapely.Polygon(other).centroid.coords[0]
    ring_a, ring_b = (shapely.LinearRing(ring) for ring in (a, b))
    shapely.prepare(ring_a)
    shapely.prepare(ring_b)
    share = partial(_share, a=a, b=b, ring_a=ring_a, ring_b=ring_b, large_mm=large_mm)
    starts = [np.array([0.0, 0.0, 2 * math.pi * k / _TURNS]) for k in range(_TURNS)]
    mean = [_mean(at, a[::4], ring_b) for at in starts]
    best = 1.0
    for k in np.argsort(mean)[:_TRIED].tolist():
        # Least mean distance first, which is smooth, then the share itself from there.
        found = minimize(_mean, starts[k], (a[::2], ring_b), "Nelder-Mead", options={"maxfev": 120})
        best = min(best, share(found.x), share(starts[k]))
        if best == 0.0:
            break
    return best


def _sampled(ring: Floats) -> Floats:
    line = shapely.LinearRing(ring)
    at = np.arange(_POINTS) / _POINTS
    return shapely.get_coordinates(shapely.line_interpolate_point(line, at, normalized=True))


def _moved(points: Floats, at: Floats) -> Floats:
    cos, sin = math.cos(at[2]), math.sin(at[2])
    x, y = points.T
    return np.column_stack([cos * x - sin * y + at[0], sin * x + cos * y + at[1]])


def _mean(at: Floats, points: Floats, ring: shapely.LinearRing) -> float:
    return float(np.minimum(shapely.distance(ring, shapely.points(_moved(points, at))), 8.0).mean())


def _share(
    at: Floats,
    *,
    a: Floats,
    b: Floats,
    ring_a: shapely.LinearRing,
    ring_b: shapely.LinearRing,
    large_mm: float,
) -> float:
    there = shapely.distance(ring_b, shapely.points(_moved(a, at))) > large_mm
    back = turned(-np.asarray(at[:2]), -at[2])
    return float(
        max(
            there.mean(),
            (shapely.distance(ring_a, shapely.points(_moved(b, (*back, -at[2])))) > large_mm).mean(),
        )
    )
