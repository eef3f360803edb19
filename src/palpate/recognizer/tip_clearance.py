"""Tip clearance: bounds on the errors of normals on short edges, from the size of the tip.

An edge much shorter than the tolerance δ says nothing of the true outline's normals there, but a tip of
radius r rests on peaks. The true outline is within δ of the nominal section S, so a tip's centre c is nowhere
nearer to S than r − δ. Let it touch at q with the normal n, so that c = q + r n, and let p be a point of S
within δ of q. Then p + r n is within δ of c, and its distance from each point x of S is r − 2δ at least. With
d = x − p, ℓ = |d| and β the angle between n and d,

    |r n − d| ≥ r − 2δ   ⇔   cos β ≤ (ℓ² + ℓ₀²) / 2 r ℓ,   ℓ₀² = 4 δ (r − δ)

Each x excludes an arc of normals about its direction; those at the distance ℓ₀ exclude most. On a flat
surface that leaves arcsin(ℓ₀ / r) = arccos(1 − 2δ/r) to either side of the nominal normal, whatever the
roughness. For one n and one x the points p that are excluded make a disc, so a whole edge is if both of its
ends are.
"""

import math

import numpy as np
import shapely
from scipy.spatial import cKDTree

from palpate.base.geometry import Bools, Floats, Ints
from palpate.base.geometry.plane import cross, wrap_angle
from palpate.recognizer.tables import expand_ranges

_NORMAL_BINS = 720  # of normals; excluded are those that one arc covers as a whole
_SAMPLES_PER_DISTANCE = 8  # of the boundary in an effective distance
_MOST_POINTS = 20_000  # between vertices; fewer exclude less
_ROWS_AT_ONCE = 2048
_MAX_LENGTH_DISTANCES = 8.0  # effective distances; of longer edges the length says more
_PIECES_PER_DISTANCE = 2  # of an edge in an effective distance
_ROUNDING_RAD = 1e-6
_ROUNDING_MM = 1e-6
_STRETCH_CELLS = 12  # of the stretch that a contact with an edge can be on


def _effective_distance_mm(radius_mm: float, off_mm: float) -> float:
    """The distance ℓ₀ at which a point of the section excludes most normals; ∞ where it excludes none."""
    if radius_mm <= 2 * off_mm:
        return math.inf
    return 2 * math.sqrt(off_mm * (radius_mm - off_mm))


def worthwhile_tilt_rad(radius_mm: float, off_mm: float) -> float:
    """Tilt of normals that a tip allows on a surface that is no sharper than a tip, and a quarter more."""
    far = _effective_distance_mm(radius_mm, off_mm)
    return 1.25 * math.asin(min(far / radius_mm, 1.0)) if math.isfinite(far) else 0.0


def clearance_tilts_rad(
    solid: shapely.Geometry, start: Floats, end: Floats, radius_mm: float, off_mm: float
) -> Floats:
    """Largest deviation of normals at edges of a section, (n,); π where nothing is said.

    `start` and `end` (n, 2) mm, the solid on the left. A contact is with an edge where the true point that
    is touched is within `off_mm` of a point of the edge, its ends included.
    """
    tilt = np.full(len(start), np.pi)
    far = _effective_distance_mm(radius_mm, off_mm)
    length = np.hypot(*(end - start).T)
    short = np.flatnonzero(length <= _MAX_LENGTH_DISTANCES * far)
    if not math.isfinite(far) or off_mm <= 0 or not len(short):
        return tilt
    count = np.ceil(_PIECES_PER_DISTANCE * length[short] / far).astype(np.int64)
    edge, place = expand_ranges(np.zeros_like(count), count)
    step = ((end - start)[short] / count[:, None])[edge]
    a = start[short][edge] + step * place[:, None]
    tilt[short] = 0.0
    np.maximum.at(tilt, short[edge], _tilts_of_pieces(solid, a, a + step, radius_mm, off_mm))
    return tilt


def _tilts_of_pieces(
    solid: shapely.Geometry, start: Floats, end: Floats, radius_mm: float, off_mm: float
) -> Floats:
    shapely.prepare(solid)
    far = _effective_distance_mm(radius_mm, off_mm)
    boundary = _boundary_points(solid, far / _SAMPLES_PER_DISTANCE)
    tree = cKDTree(boundary)
    tilts = []
    for begin in range(0, len(start), _ROWS_AT_ONCE):
        a, b = start[begin : begin + _ROWS_AT_ONCE], end[begin : begin + _ROWS_AT_ONCE]
        edge, near = _pairs_within(tree, (a + b) / 2, 2 * far)
        behind = _points_behind(solid, a, b, far)
        point = np.concatenate([boundary[near], behind.reshape(-1, 2)])
        owner = np.concatenate([edge, np.repeat(np.arange(len(a)), 2)])
        known = np.isfinite(point[:, 0])
        tilts.append(_largest_tilt(a, b, owner[known], point[known], radius_mm, off_mm))
    return np.concatenate(tilts)


def _pairs_within(tree: cKDTree, middle: Floats, reach: Floats | float) -> tuple[Ints, Ints]:
    """Pairs of a place (n, 2) and a point of the tree within its reach."""
    found = [np.asarray(each, np.int64) for each in np.atleast_1d(tree.query_ball_point(middle, reach))]
    owner = np.repeat(np.arange(len(found)), [len(each) for each in found])
    return owner, np.concatenate([np.empty(0, np.int64), *found])


def _boundary_points(solid: shapely.Geometry, step_mm: float) -> Floats:
    """The vertices of a section and points between them, about `step_mm` apart or not too many, (m, 2)."""
    step_mm = max(step_mm, solid.length / _MOST_POINTS)
    points: Floats = shapely.get_coordinates(shapely.segmentize(solid, step_mm))
    return points


def _points_behind(solid: shapely.Geometry, start: Floats, end: Floats, far_mm: float) -> Floats:
    """Points inside of the section behind the middles of edges, (n, 2, 2); NaN where they are outside."""
    leg = end - start
    normal = np.column_stack([leg[:, 1], -leg[:, 0]]) / np.maximum(np.hypot(*leg.T), 1e-300)[:, None]
    depth = far_mm * np.array([1.0, 0.5])
    point = ((start + end) / 2)[:, None] - depth[:, None] * normal[:, None]
    inside = shapely.contains_xy(solid, point[..., 0], point[..., 1])
    result: Floats = np.where(inside[..., None], point, np.nan)
    return result


def _largest_tilt(
    start: Floats, end: Floats, owner: Ints, point: Floats, radius_mm: float, off_mm: float
) -> Floats:
    """The tilts (n,) that points (m, 2), each beside the edge `owner` (m,), leave."""
    leg = end - start
    outward = np.arctan2(-leg[:, 0], leg[:, 1])
    middle, half = _excluded_arcs(start[owner], point, outward[owner], radius_mm, off_mm)
    other, other_half = _excluded_arcs(end[owner], point, outward[owner], radius_mm, off_mm)
    apart = wrap_angle(other - middle)
    lo = middle + np.maximum(-half, apart - other_half)
    hi = middle + np.minimum(half, apart + other_half)
    excluded = _covered_bins(len(start), owner, lo, hi)
    border = np.abs(-np.pi + 2 * np.pi / _NORMAL_BINS * np.arange(_NORMAL_BINS + 1))
    reach = np.maximum(border[:-1], border[1:])
    result: Floats = np.max(np.where(excluded, 0.0, reach), axis=1)
    return result


def _excluded_arcs(
    at: Floats, point: Floats, outward: Floats, radius_mm: float, off_mm: float
) -> tuple[Floats, Floats]:
    """Arcs of normals that points (m, 2) exclude at `at` (m, 2): middle from `outward` on, half-width."""
    d = point - at
    away = np.maximum(np.hypot(*d.T), 1e-9)
    cosine = (away**2 + 4 * off_mm * (radius_mm - off_mm)) / (2 * radius_mm * away)
    half = np.where(cosine < 1, np.arccos(np.minimum(cosine, 1.0)) - _ROUNDING_RAD, -np.pi)
    return wrap_angle(np.arctan2(d[:, 1], d[:, 0]) - outward), half


def _covered_bins(rows: int, owner: Ints, lo: Floats, hi: Floats) -> Bools:
    """Mask (rows, bins) of normals, from −π on, that an arc [lo, hi] (m,) of their `owner` covers."""
    width = 2 * np.pi / _NORMAL_BINS
    first = np.ceil((lo + np.pi) / width).astype(np.int64)
    last = np.floor((hi + np.pi) / width).astype(np.int64)
    some = np.flatnonzero(last > first)
    edges = np.zeros((rows, 3 * _NORMAL_BINS + 1), np.int32)
    np.add.at(edges, (owner[some], first[some] + _NORMAL_BINS), 1)
    np.add.at(edges, (owner[some], last[some] + _NORMAL_BINS), -1)
    covered = np.cumsum(edges, axis=1)[:, :-1].reshape(rows, 3, _NORMAL_BINS).sum(axis=1)
    result: Bools = covered > 0
    return result


def clearance_depths_mm(
    solid: shapely.Geometry, start: Floats, end: Floats, reach: Floats, depth: Floats, clear_mm: float
) -> Floats:
    """Largest depth (n,) mm of a tip's centre inside of lines from `start` to `end` (n, 2).

    It is known to be `depth` (n,) mm deep at most, and no further along than `reach` (n,) beyond the ends. It
    is nowhere nearer to the section than `clear_mm`, positive.
    """
    leg = end - start
    length = np.hypot(*leg.T)
    along = leg / np.maximum(length, 1e-300)[:, None]
    stretch = length + 2 * reach
    boundary = _boundary_points(solid, clear_mm / 32)
    owner, near = _pairs_within(cKDTree(boundary), (start + end) / 2, stretch / 2 + clear_mm)
    rel = boundary[near] - start[owner]
    ahead = np.sum(rel * along[owner], axis=1) + reach[owner]
    inward = cross(along[owner], rel)
    left = np.full((len(start), _STRETCH_CELLS), np.inf)
    for cell in range(_STRETCH_CELLS):
        lo, hi = (stretch[owner] * share / _STRETCH_CELLS for share in (cell, cell + 1))
        aside = np.maximum(np.abs(ahead - lo), np.abs(ahead - hi))
        rise = np.sqrt(np.maximum(clear_mm**2 - aside**2, 0.0))
        # The centre is above the disc about the point, because it is not as deep as below that.
        above = (aside < clear_mm) & (inward + rise > depth[owner] + _ROUNDING_MM)
        np.minimum.at(left[:, cell], owner[above], (inward - rise)[above])
    result: Floats = np.minimum(depth, left.max(axis=1) + _ROUNDING_MM)
    return result
