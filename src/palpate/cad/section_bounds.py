"""Bounds on the distance between an outline and the surface in a slab of heights; bounded simplification.

They bound what the recogniser calls an object's tolerance. *Edges.* Every facet is clipped to the slab and
projected: all edges of all true sections in the slab lie in these pieces, and all convex corners on the
clipped edges between facets. The distance to one edge (or vertex) of the outline is convex over a piece, so
the greatest of its corners' distances bounds it. An edge of length L passes for one whose normal differs by
at most asin(4δ/L), so a piece needs δ = L/4 · sin(angle) of it, too; a vertex passes for normals between
those of its edges, tilted likewise. A piece needs the least that any edge or vertex asks, and is halved where
that is too much, because its ends may be near to different ones. Facets without a normal of their own (level
or thinner than 1 µm) need only be near.

*Material.* Every edge of a true section in the slab is within `off` of the outline's, so what lies deeper
than that in the outline is solid at every height. Where this is not enough (at sharp corners and in thin
fins), what the slab's clipped facets do not touch of the exact section is solid at every height, because the
surface crosses no vertical line elsewhere.

*Simplification.* An edge of length L stands for a run of true edges as well as the recogniser's tolerance δ
says: they lie within δ of it and their normals differ by at most asin(4δ/L). So a chord costs the greater of
the run's distance and of L/4 times the sine of the angle between normals, and a step of 0.03 mm in a long
wall stays, because its riser cannot pass for the wall.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import shapely
from scipy.spatial import cKDTree

from palpate.base.geometry import Bools, Floats, Ints, Polygon
from palpate.base.geometry.outlines import EdgeRings
from palpate.base.geometry.plane import cross, turn_between
from palpate.cad.resting_surface import SAME_HEIGHT_MM, RestingSurface

_STRAIGHT_SINE = 1e-7
"""Sine of the turn between facets of one plane, or next to it."""
_GUESS_FACTORS = np.array([0.7, 0.9, 0.96, 1.0, 1.04, 1.12, 1.4])
_SHORT_EDGES = 8
"""Chords over so many edges are tried from every point at once."""
_REACH_FRACTION = 32
"""A chord is as long as it may be within this part of it."""


def _normal_mismatch(normal: Floats, other: Floats) -> Floats:
    """4δ/L that lets an edge's normal (n, 2) turn to another: the sine of the angle, or 1 beyond 90°."""
    across = np.abs(cross(normal, other))
    return np.where(normal[:, 0] * other[:, 0] + normal[:, 1] * other[:, 1] > 0, across, 1.0)


def simplify_ring(points: Floats, normal: Floats, bare: Bools, budget_mm: float) -> Ints:
    """Choose points (k,) of a ring (n, 2), ascending, so that no chord costs more than the budget.

    `normal` (n, 2): the outward unit normal of the edge after each point, unless it is `bare`. Points in a
    straight line go in any case; a budget of 0 keeps all others. Starts at the sharpest corner. Fewer than
    three are left of a ring that is no wider than the budget.
    """
    bent = np.flatnonzero(_bends(normal, bare))
    if len(bent) < 4 or budget_mm <= 0:
        return bent if len(bent) > 2 else np.arange(len(points))
    return bent[_fewest_points(points[bent], normal[bent], bare[bent], budget_mm)]


def _bends(normal: Floats, bare: Bools) -> Bools:
    """Mark corners of a ring (n,), however slight: facets of one plane leave points in a straight line."""
    before, bare_before = np.roll(normal, 1, axis=0), np.roll(bare, 1)
    result: Bools = (_normal_mismatch(normal, before) > _STRAIGHT_SINE) | bare | bare_before
    return result


def _fewest_points(points: Floats, normal: Floats, bare: Bools, budget_mm: float) -> Ints:
    count = len(points)
    if count < 4:
        return np.arange(count)
    begin = int(np.sum(normal * np.roll(normal, 1, axis=0), axis=1).argmin())
    ring = np.roll(points, -begin, axis=0)
    normals, bares = np.roll(normal, -begin, axis=0), np.roll(bare, -begin)
    short = _short_reach(ring, normals, bares, budget_mm)
    kept = []
    at, step = 0, _SHORT_EDGES
    while at < count:
        kept.append(at)
        if short[at] < _SHORT_EDGES or at + _SHORT_EDGES >= count:
            at += short[at]
        else:
            step = _long_reach(ring, normals, bares, budget_mm, at, step)
            at += step
    return np.sort((np.array(kept) + begin) % count)


def _short_reach(ring: Floats, normal: Floats, bare: Bools, budget_mm: float) -> list[int]:
    """Over how many edges a chord from each point may go: no more than `_SHORT`, and not past the end."""
    count = len(ring)
    reach = np.ones(count, dtype=np.int64)
    left = np.arange(count)
    # Most chords are short: longer ones are only tried from where those before them fit.
    for steps in (np.arange(2, 4), np.arange(4, _SHORT_EDGES + 1)):
        start, step = np.repeat(left, len(steps)), np.tile(steps, len(left))
        fits = _chord_costs(ring, normal, bare, start, step) <= budget_mm
        fits &= start + step <= count
        longer = np.cumprod(fits.reshape(len(left), len(steps)), axis=1).sum(axis=1)
        reach[left] += longer
        left = left[longer == len(steps)]
        if not len(left):
            break
    result: list[int] = reach.tolist()
    return result


def _long_reach(ring: Floats, normal: Floats, bare: Bools, budget_mm: float, start: int, guess: int) -> int:
    """Over how many edges a chord from `start` may go, at least `_SHORT`; looked for about a guess first."""
    most = len(ring) - start
    good, bad = _SHORT_EDGES, most + 1
    tries = np.unique(np.clip(np.round(guess * _GUESS_FACTORS), _SHORT_EDGES, most).astype(np.int64))
    while True:
        fits = _chord_costs(ring, normal, bare, np.full(len(tries), start), tries) <= budget_mm
        fail = len(tries) if fits.all() else int(fits.argmin())
        good = max(good, int(tries[fail - 1])) if fail else good
        bad = min(bad, int(tries[fail])) if fail < len(tries) else bad
        if bad - good <= 1 + good // _REACH_FRACTION:
            return good
        end = min(bad - 1, 4 * good)
        tries = np.unique(np.linspace(good + 1, end, 6).astype(np.int64))


def _chord_costs(ring: Floats, normal: Floats, bare: Bools, start: Ints, step: Ints) -> Floats:
    """Cost of each chord from points `start` (k,) over `step` (k,) edges."""
    count = len(ring)
    chord = ring[(start + step) % count] - ring[start]
    length = np.hypot(*chord.T)
    owner = np.repeat(np.arange(len(start)), step)
    first = np.cumsum(step) - step
    edge = (start[owner] + np.arange(len(owner)) - first[owner]) % count
    away = ring[edge] - ring[start[owner]]
    unit = (chord / np.maximum(length, 1e-300)[:, None])[owner]
    along = away[:, 0] * unit[:, 0] + away[:, 1] * unit[:, 1]
    beyond = along - np.clip(along, 0.0, length[owner])
    distance = np.hypot(cross(away, unit), beyond)
    turn = _normal_mismatch(normal[edge], np.stack([unit[:, 1], -unit[:, 0]], axis=1))
    cost = np.maximum(distance, np.where(bare[edge], 0.0, length[owner] / 4 * turn))
    result: Floats = np.maximum.reduceat(cost, first)
    return result


_MAX_HALVINGS = 24
_PIECES_AT_ONCE = 20_000
_FIRST_PIECES = 200
_SEARCH_RATIO = 3.0
"""Edges are looked for so many times further than they may be, to tell how much a slab is too high."""


@dataclass(frozen=True, eq=False)
class FacetPieces:
    """Convex pieces (k) of what a finger may touch: the hull of `points` (k, p, 2), mm.

    Normals turn left from `first` to `last` (k, 2), by less than 180°, unless a piece is `bare`.
    """

    points: Floats
    first: Floats
    last: Floats
    bare: Bools

    def __len__(self) -> int:
        return len(self.points)

    def select(self, rows: Ints | Bools) -> "FacetPieces":
        """Return the pieces at `rows` (indices or a mask)."""
        return FacetPieces(self.points[rows], self.first[rows], self.last[rows], self.bare[rows])

    def split(self) -> "FacetPieces":
        """Both halves of every one: the hull's fan is cut at its longest sides."""
        fan = self.points.shape[1] - 2
        if fan < 1:
            middle = self.points.mean(axis=1)
            halves = [np.stack([self.points[:, end], middle], axis=1) for end in (0, 1)]
            return self._like(np.stack(halves, axis=1))
        if fan > 1:
            triangles = [self.points[:, [0, k + 1, k + 2]] for k in range(fan)]
            return self._like(np.stack(triangles, axis=1))
        sides = np.hypot(*np.moveaxis(np.roll(self.points, -1, axis=1) - self.points, -1, 0))
        first = sides.argmax(axis=1)
        rows = np.arange(len(self))
        begin, end, rest = (self.points[rows, (first + k) % 3] for k in range(3))
        middle = (begin + end) / 2
        halves = [np.stack(corners, axis=1) for corners in ((begin, middle, rest), (middle, end, rest))]
        return self._like(np.stack(halves, axis=1))

    def _like(self, points: Floats) -> "FacetPieces":
        """Return c children of each piece, with `points` (k, c, p, 2)."""
        children = points.shape[1]
        return FacetPieces(
            points.reshape(-1, *points.shape[2:]),
            np.repeat(self.first, children, axis=0),
            np.repeat(self.last, children, axis=0),
            np.repeat(self.bare, children, axis=0),
        )


def _clip_facets(surface: RestingSurface, facets: Ints, from_mm: float, to_mm: float) -> Floats:
    """Projected corners (k, 6, 2), in order, of facets clipped to a range of heights; some are repeated."""
    corners = surface.vertices_mm[surface.faces[facets]]
    begin, end = _clip_segments(corners, np.roll(corners, -1, axis=1), from_mm, to_mm)
    points = np.stack([begin, end], axis=2).reshape(len(facets), 6, 3)
    # A side outside of the slab has no points of its own: it takes those of the side before.
    missing = np.isnan(points[:, :, 0])
    for _ in range(2):
        for k in range(6):
            points[:, k] = np.where(missing[:, k, None], points[:, k - 1], points[:, k])
        missing = np.isnan(points[:, :, 0])
    result: Floats = points[:, :, :2]
    return result


def facet_pieces(surface: RestingSurface, facets: Ints, from_mm: float, to_mm: float) -> FacetPieces:
    """Every edge of every section in the range lies in one of these."""
    points = _clip_facets(surface, facets, from_mm, to_mm)
    normal = surface.normal[facets]
    return FacetPieces(points, normal, normal, surface.bare[facets])


def corner_pieces(surface: RestingSurface, facets: Ints, from_mm: float, to_mm: float) -> FacetPieces:
    """Every convex corner of every section in the range lies on one of these: edges between `facets`."""
    edges = np.unique(surface.edges[facets])
    one, other = surface.sides[edges].T
    ends = surface.vertices_mm[surface.ends[edges]]
    # A section has its solid on the left, so it passes an edge that rises from the facet on its left.
    rises = ends[:, 1, 2] > ends[:, 0, 2]
    left, right = np.where(rises, one, other), np.where(rises, other, one)
    before, after = surface.normal[left], surface.normal[right]
    bend = cross(before, after)
    low, high = ends[:, :, 2].min(axis=1), ends[:, :, 2].max(axis=1)
    inside = (high > from_mm) & (low < to_mm) & (low < high)
    convex = (bend > 0) & inside & ~surface.bare[left] & ~surface.bare[right]
    begin, end = _clip_segments(ends[convex, 0], ends[convex, 1], from_mm, to_mm)
    return FacetPieces(
        np.stack([begin, end], axis=1)[:, :, :2],
        before[convex],
        after[convex],
        np.zeros(int(convex.sum()), dtype=bool),
    )


def _clip_segments(begin: Floats, end: Floats, from_mm: float, to_mm: float) -> tuple[Floats, Floats]:
    """Segments (..., 3) clipped to a range of heights: their ends, or nan."""
    rise = (end - begin)[..., 2]
    with np.errstate(divide="ignore", invalid="ignore"):
        at = (np.array([from_mm, to_mm]) - begin[..., 2, None]) / rise[..., None]
    level = rise == 0
    first = np.where(level, 0.0, np.clip(at.min(axis=-1), 0.0, 1.0))
    last = np.where(level, 1.0, np.clip(at.max(axis=-1), 0.0, 1.0))
    high, low = np.maximum(begin, end)[..., 2], np.minimum(begin, end)[..., 2]
    outside = ((high < from_mm) | (low > to_mm))[..., None]
    leg = end - begin
    ends = (np.where(share[..., None] == 1.0, end, begin + share[..., None] * leg) for share in (first, last))
    one, other = (np.where(outside, np.nan, point) for point in ends)
    return one, other


def distance_bound(
    pieces: FacetPieces, outline: EdgeRings, near: cKDTree, owner: Ints, target_mm: float, floor_mm: float
) -> tuple[float, bool]:
    """(How far the pieces are from the outline, whether that is within the target).

    `near` holds points near its edges, of which `owner` is the edge. A bound if within the target, else an
    estimate; pieces found within `floor_mm` are not looked at further.
    """
    if not len(pieces):
        return 0.0, True
    if not len(outline.start):
        return np.inf, False
    guess = owner[near.query(pieces.points.mean(axis=1))[1]]
    wanted = _edge_cost(pieces, outline, guess).max(axis=1)
    left = np.flatnonzero(wanted > floor_mm)
    most = float(wanted[wanted <= floor_mm].max(initial=0.0))
    left = left[np.argsort(-wanted[left])]
    tree = shapely.STRtree(
        shapely.linestrings(
            np.stack([outline.start, outline.start + outline.length[:, None] * outline.direction], axis=1)
        )
    )
    # The worst ones first: a slab that is too high shows at once.
    for rows in (
        left[:_FIRST_PIECES],
        *np.split(left[_FIRST_PIECES:], range(_PIECES_AT_ONCE, len(left), _PIECES_AT_ONCE)),
    ):
        found, good = _search_bound(pieces.select(rows), outline, tree, target_mm)
        if not good:
            return found, False
        most = max(most, found)
    return most, True


def _search_bound(
    pieces: FacetPieces, outline: EdgeRings, tree: shapely.STRtree, target_mm: float
) -> tuple[float, bool]:
    """Bound as that of `distance_bound`, with all edges nearby."""
    most = 0.0
    for _ in range(_MAX_HALVINGS):
        if not len(pieces):
            return most, True
        look = _SEARCH_RATIO * target_mm
        low, high = pieces.points.min(axis=1) - look, pieces.points.max(axis=1) + look
        piece, edge = tree.query(shapely.box(low[:, 0], low[:, 1], high[:, 0], high[:, 1]))
        some = pieces.select(piece)
        of_edge, of_vertex = _edge_cost(some, outline, edge), _vertex_cost(some, outline, edge)
        wanted = np.minimum(of_edge.max(axis=1), of_vertex.max(axis=1))
        each = np.full(len(pieces), np.inf)
        np.minimum.at(each, piece, wanted)
        points = np.full(pieces.points.shape[:2], np.inf)
        np.minimum.at(points, piece, np.minimum(of_edge, of_vertex))
        if points.max() > target_mm:
            return float(points.max()), False
        good = each <= target_mm
        most = max(most, float(each[good].max(initial=0.0)))
        pieces = pieces.select(~good).split()
    return float(each.max()), False


def _edge_cost(pieces: FacetPieces, outline: EdgeRings, edge: Ints) -> Floats:
    """Cost of each point (k, p) of each piece at one edge each."""
    away = pieces.points - outline.start[edge][:, None]
    length, unit = outline.length[edge], outline.direction[edge]
    along = away[:, :, 0] * unit[:, None, 0] + away[:, :, 1] * unit[:, None, 1]
    across = away[:, :, 0] * unit[:, None, 1] - away[:, :, 1] * unit[:, None, 0]
    beyond = along - np.minimum(np.maximum(along, 0.0), length[:, None])
    distance = np.sqrt(across**2 + beyond**2)
    normal = outline.normal[edge]
    tilt = (
        length / 4 * np.maximum(_normal_mismatch(normal, pieces.first), _normal_mismatch(normal, pieces.last))
    )
    result: Floats = np.maximum(distance, np.where(pieces.bare, 0.0, tilt)[:, None])
    return result


def _vertex_cost(pieces: FacetPieces, outline: EdgeRings, edge: Ints) -> Floats:
    """Cost of each point (k, p) of each piece at the vertex that one edge each starts from."""
    distance = np.hypot(*np.moveaxis(pieces.points - outline.start[edge][:, None], -1, 0))
    previous = outline.before[edge]
    begin = turn_between(outline.normal[previous], pieces.first)
    width = turn_between(pieces.first, pieces.last)
    end = begin + width - turn_between(outline.normal[previous], outline.normal[edge])
    tilt = np.maximum(
        outline.length[previous] * np.sin(np.clip(-begin, 0.0, np.pi / 2)),
        outline.length[edge] * np.sin(np.clip(end, 0.0, np.pi / 2)),
    )
    result: Floats = np.maximum(distance, np.where(pieces.bare, 0.0, tilt / 4)[:, None])
    return result


_QUARTER_CHORDS = 16
"""Chords per quarter circle in buffers: inscribed, so growing gives too little, and shrinking is enlarged."""
_TIGHT_RATIO, _WIDE_RATIO = 1.02, 4.0
"""Material may be so many times further off than edges are, if that is allowed."""
_COARSE_SHARE = 0.01
"""Of what is allowed, for simplifying what is solid at every height."""


def material_bound_mm(
    model: Sequence[Polygon],
    exact: Callable[[], Sequence[Polygon]],
    surface: RestingSurface,
    facets: Ints,
    slab_mm: tuple[float, float],
    off_mm: float,
    allowed_mm: float,
) -> float | None:
    """Bound on the distance of points of `model` from the solid, at any height of the slab, or None.

    `exact`: gives the section at one of its heights; `off_mm`: how far edges are from the model's at most.
    """
    whole = valid_region(model)
    deep = whole.buffer(
        -off_mm / math.cos(math.pi / 4 / _QUARTER_CHORDS) * (1 + 1e-9), quad_segs=_QUARTER_CHORDS
    )
    tight, wide = min(_TIGHT_RATIO * off_mm, allowed_mm), min(_WIDE_RATIO * off_mm, allowed_mm)
    for allowed in (tight, wide) if wide > _TIGHT_RATIO * tight else (tight,):
        lost = whole.difference(deep.buffer(allowed, quad_segs=_QUARTER_CHORDS))
        if lost.is_empty:
            return allowed
    # Heights are meant within HEIGHT_MM: at a peak in the very end of a slab there is no material left.
    least = min(SAME_HEIGHT_MM, (slab_mm[1] - slab_mm[0]) / 8)
    points = _clip_facets(surface, facets, slab_mm[0] + least, slab_mm[1] - least)
    bounds = shapely.bounds(shapely.get_parts(lost)) + 2 * allowed_mm * np.array([-1, -1, 1, 1])
    window = shapely.union_all(shapely.box(*bounds.T))
    swept = shapely.convex_hull(shapely.multipoints(points[_meets_box(points, bounds)]))
    shapely.prepare(window)
    swept = swept[(shapely.area(swept) > 0) & shapely.intersects(window, swept)]
    # On a grid, so that clipped facets that share a side leave no needles between them.
    coarse = _COARSE_SHARE * allowed_mm
    grid = coarse / 8
    touched = shapely.union_all(swept, grid_size=grid)
    near = _areas(shapely.intersection(valid_region(exact()), window, grid_size=grid))
    always = shapely.difference(near, touched, grid_size=grid)
    solid = always.simplify(coarse / 2)
    far = lost.difference(solid.buffer(allowed_mm - coarse, quad_segs=_QUARTER_CHORDS))
    return allowed_mm if far.is_empty else None


def _meets_box(points: Floats, bounds: Floats) -> Bools:
    """Mark clipped facets (k, 6, 2) that may meet a box (b, 4); none that was clipped away does."""
    low, high = points.min(axis=1), points.max(axis=1)
    apart = (low[:, None] > bounds[:, 2:]) | (high[:, None] < bounds[:, :2]) | np.isnan(low[:, None])
    result: Bools = (~apart.any(axis=2)).any(axis=1)
    return result


def valid_region(regions: Sequence[Polygon]) -> shapely.Geometry:
    """Region of disjoint polygons from a section, whose rings may touch themselves."""
    polygons = [shapely.Polygon(region.outer, region.holes) for region in regions]
    return _areas(shapely.make_valid(shapely.MultiPolygon(polygons)))


def _areas(region: shapely.Geometry) -> shapely.Geometry:
    """The region without lines and points, such as a slit without width leaves: they hold no material."""
    parts = shapely.get_parts(shapely.get_parts(region))
    return shapely.multipolygons(parts[shapely.area(parts) > 0])
