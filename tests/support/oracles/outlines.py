"""Outlines judged by other libraries."""

import math
from functools import partial
from itertools import product

import numpy as np
import shapely
from scipy.optimize import minimize

from palpate.base.geometry import Bools, Floats, Ints, Section
from palpate.base.geometry.plane import cross
from palpate.recognizer.angle_pockets import EdgePieces, Pockets, pockets_of
from palpate.recognizer.edges import EdgeSet
from palpate.recognizer.tables import expand_ranges
from support.oracles.shapely_touches import turned

# ----------------------------------------------------------------------------------------------------
# The closed-form model test as triples of half-planes: an oracle for the tests on two and three contacts.
#
# By Helly's theorem and Farkas' lemma the half-planes of all contacts have a common point iff every
# positively
# dependent triple of them allows one, and each triple is one arc of θ. The recogniser says the same in fewer
# conditions (recognizer/model_test.py, recognizer/model_test.py).


def _pair_triples() -> list[tuple[int, int, int]]:
    """Two half-planes that meet at a corner of one contact's rectangle, and one of the other contact's."""
    corners = [(0, 2), (0, 3), (1, 2), (1, 3)]
    one = [(a, b, 4 + c) for (a, b), c in product(corners, range(4))]
    return one + [(4 + a, 4 + b, c) for (a, b), c in product(corners, range(4))]


PAIR_TRIPLES: Ints = np.array(_pair_triples())
"""(32, 3) indices into the eight half-planes of two contacts: all triples that can rule a pairing out."""

TRIPLE_TRIPLES: Ints = np.array([(a, 4 + b, 8 + c) for a, b, c in product(range(4), repeat=3)])
"""(64, 3) indices into the twelve half-planes of three contacts: those that no pair of contacts holds."""


def triple_arcs(g: Floats, coefficients: Floats, triples: Ints) -> Floats:
    """The condition that each triple of half-planes puts on θ: (C, A, B) with C + A cos θ + B sin θ ≥ 0.

    g (n, m, 2), coefficients (n, m, 3), triples (t, 3); returns (n, t, 3). A triple that does not surround
    the origin says nothing: (1, 0, 0).
    """
    a, b, c = (g[:, triples[:, k]] for k in range(3))
    weight = np.stack([cross(b, c), cross(c, a), cross(a, b)], axis=2)
    tiny = 1e-12
    ccw, cw = np.all(weight >= -tiny, axis=2), np.all(weight <= tiny, axis=2)
    magnitude = np.where(ccw[..., None], np.maximum(weight, 0.0), np.maximum(-weight, 0.0))
    combined = np.einsum("ntk,ntkj->ntj", magnitude, coefficients[:, triples])
    silent = ~(ccw | cw)
    combined[silent] = (1.0, 0.0, 0.0)
    combined[..., 0] += 1e-9
    result: Floats = combined
    return result


def arc_hull(lo: Floats, hi: Floats, conditions: Floats) -> tuple[Floats, Floats]:
    """Narrow intervals [lo, hi] (n,) of θ to the hull of what every condition (n, t, 3) leaves of them.

    Each condition is C + A cos θ + B sin θ ≥ 0. Where nothing is left, lo > hi. The hull may hold
    orientations that are ruled out, never the other way about.
    """
    constant, a, b = conditions[..., 0], conditions[..., 1], conditions[..., 2]
    amplitude = np.hypot(a, b)
    ratio = constant / np.maximum(amplitude, 1e-300)
    always, never = ratio >= 1.0, ratio < -1.0
    half = np.arccos(np.clip(-ratio, -1.0, 1.0)) + 1e-12
    width = (hi - lo)[:, None]
    # The allowed arcs are [begin, begin + 2 half] and its copies a turn before and after, from lo on.
    begin = (np.arctan2(b, a) - half - lo[:, None]) % (2 * np.pi)
    tail = begin - 2 * np.pi + 2 * half
    reaches_lo, starts_inside = tail >= 0, begin <= width
    first = np.where(reaches_lo, 0.0, np.where(starts_inside, begin, np.inf))
    last = np.where(starts_inside, np.minimum(width, begin + 2 * half), np.minimum(width, tail))
    first = np.where(always, 0.0, np.where(never, np.inf, first)).max(axis=1, initial=0.0)
    last = np.where(always, width, np.where(never, -np.inf, last)).min(axis=1, initial=np.inf)
    return lo + first, np.minimum(hi, lo + last)


# ----------------------------------------------------------------------------------------------------
# Exact angle pockets: of single points of edges, where the search takes those of whole edges.


def exact_pockets(
    edges: EdgeSet, edge: Ints, point_mm: Floats, allowance_mm: float, travel_mm: float = math.inf
) -> Pockets:
    """Pocket of each point (m, 2), taken at the nearest point of its edge (m,); mm in the object's frame."""
    start, direction = edges.start[edge], edges.direction[edge]
    along = np.clip(np.sum((point_mm - start) * direction, axis=1), 0.0, edges.length[edge])
    foot = start + along[:, None] * direction
    pieces = []
    for state in range(len(edges.first) - 1):
        row = np.flatnonzero(edges.state[edge] == state)
        pieces.append(EdgePieces(row, edge[row], foot[row], foot[row]))
    return pockets_of(edges, pieces, allowance_mm, travel_mm, edge)


def hold(pockets: Pockets, row: Ints, direction_rad: Floats) -> Bools:
    """Whether each direction (m,) lies in the pocket of its row (m,)."""
    owner, arc = expand_ranges(pockets.first[row], np.diff(pockets.first)[row])
    past = (direction_rad[owner] - pockets.lo_rad[arc]) % (2 * np.pi)
    inside: Bools = np.zeros(len(row), dtype=bool)
    inside[owner[past <= pockets.hi_rad[arc] - pockets.lo_rad[arc]]] = True
    return inside


def widths_rad(pockets: Pockets) -> Floats:
    """Angle that the arcs of each row cover together, (n,)."""
    width = np.zeros(len(pockets))
    np.add.at(width, pockets.row, pockets.hi_rad - pockets.lo_rad)
    return width


# ----------------------------------------------------------------------------------------------------
# Whether the edges that contacts are paired with cover the true boundary of a grown section: a judge.
#
# The boundary of a section grown by r is where a disc of radius r rests: its centre is r from the section,
# along a normal of an edge or between the normals at a convex vertex. Places are drawn along every edge and
# about every vertex; those that are really r away, by shapely, have to be covered: within the slack of an
# edge,
# with their normal within its span.

_ROUNDING_MM = 1e-12


def places_of_rest(
    section: Section, radius_mm: float, each: int, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Centres (n, 2) of discs that rest on a section, and directions (n,) rad of the outward normal there.

    `each`: as many are drawn for each edge and for each vertex.
    """
    solid = shapely.union_all([shapely.Polygon(p.outer, p.holes) for p in section.polygons])
    points, normals = [], []
    for part in shapely.get_parts(solid):
        oriented = shapely.geometry.polygon.orient(part)
        for ring in (oriented.exterior, *oriented.interiors):
            start = np.asarray(ring.coords)[:-1]
            leg = np.roll(start, -1, axis=0) - start
            start = start[np.hypot(*leg.T) > 1e-6]
            leg = np.roll(start, -1, axis=0) - start
            angle = np.arctan2(leg[:, 1], leg[:, 0]) - np.pi / 2
            turn = (angle - np.roll(angle, 1) + np.pi) % (2 * np.pi) - np.pi
            share = _shares(len(start), each, rng)
            points.append((start[:, None] + share[..., None] * leg[:, None]).reshape(-1, 2))
            normals.append(np.repeat(angle, each))
            convex = (turn > 0) & (radius_mm > 0)  # a point rests with the normal of either edge
            share = _shares(int(convex.sum()), each, rng)
            points.append(np.repeat(start[convex], each, axis=0))
            normals.append((angle[convex, None] - turn[convex, None] * share).ravel())
    point, normal = np.vstack(points), np.concatenate(normals)
    centre = point + radius_mm * np.column_stack([np.cos(normal), np.sin(normal)])
    rests = shapely.distance(solid, shapely.points(centre)) >= radius_mm - _ROUNDING_MM
    return centre[rests], normal[rests]


def _shares(count: int, each: int, rng: np.random.Generator) -> np.ndarray:
    """Shares (count, each) of ways, some of them very near to an end."""
    even = rng.uniform(size=(count, each))
    ends = 10.0 ** rng.uniform(-9, -2, (count, each))
    side = rng.integers(0, 4, (count, each))
    return np.select([side == 0, side == 1], [ends, 1 - ends], even)


def uncovered(edges: EdgeSet, state: int, centre: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """Which places (n,), seen from the state's centroid, no edge covers."""
    rows = slice(int(edges.first[state]), int(edges.first[state + 1]))
    reach = float(np.max(edges.slack_mm[rows])) + 1e-6
    lines = shapely.linestrings(np.stack([edges.start[rows], edges.end[rows]], axis=1))
    place, edge = shapely.STRtree(lines).query(shapely.points(centre), predicate="dwithin", distance=reach)
    rel = centre[place] - edges.start[rows][edge]
    along = np.sum(rel * edges.direction[rows][edge], axis=1)
    out = np.sum(rel * edges.normal[rows][edge], axis=1)
    off = np.abs((normal[place] - edges.normal_rad[rows][edge] + np.pi) % (2 * np.pi) - np.pi)
    slack = edges.slack_along[rows][edge]
    fits = (
        (along >= -slack) & (along <= edges.length[rows][edge] + slack) & (out <= edges.slack_out[rows][edge])
    )
    fits &= (out >= -edges.slack_in[rows][edge]) & (off <= edges.span[rows][edge])
    covered = np.zeros(len(centre), dtype=bool)
    covered[place[fits]] = True
    return ~covered


# ----------------------------------------------------------------------------------------------------
# How much two outlines differ: share of the boundary that is further off than a distance, best aligned.

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
