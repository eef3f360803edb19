"""Hausdorff bound between one outline and the surface in a slab of heights: the proof behind a cross section.

It bounds what the recogniser calls an object's tolerance. Every
facet is clipped to the slab and projected: all edges of all true sections in the slab lie in these pieces,
and all convex corners on the clipped edges between facets. The distance to one edge (or vertex) of the
outline is convex over a piece, so the greatest of its corners' distances bounds it. An edge of length L
passes for one whose normal differs by at most asin(4δ/L), so a piece needs δ = L/4 · sin(angle) of it, too;
a vertex passes for normals between those of its edges, tilted likewise. A piece needs the least that any edge
or vertex asks, and is halved where that is too much, because its ends may be near to different ones.

Facets without a normal of their own (level or thinner than 1 µm) need only be near.
"""

from dataclasses import dataclass

import numpy as np
import shapely
from scipy.spatial import cKDTree

from palpate.base.geometry import Bools, Floats, Ints
from palpate.cad.resting_surface import RestingSurface
from palpate.cad.simplify import turned

__all__ = [
    "FacetPieces",
    "OutlineEdges",
    "clip_facets",
    "corners_of",
    "distance_bound",
    "facets_of",
    "outline_of",
]

_HALVINGS = 24
_AT_ONCE = 20_000
_FIRST = 200
_LOOK = 3.0
"""Edges are looked for so many times further than they may be, to tell how much a slab is too high."""


@dataclass(frozen=True, eq=False)
class OutlineEdges:
    """The n edges of an outline's rings, and the vertices that they start from.

    `start` (n, 2) mm; `along`, `normal` (n, 2): unit vectors, the normal outwards; `length` (n,) mm;
    `before` (n,): the edge before.
    """

    start: Floats
    along: Floats
    normal: Floats
    length: Floats
    before: Ints


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
        """Those at `rows` (indices or a mask)."""
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
        """Of `points` (k, c, p, 2): c children of each."""
        children = points.shape[1]
        return FacetPieces(
            points.reshape(-1, *points.shape[2:]),
            np.repeat(self.first, children, axis=0),
            np.repeat(self.last, children, axis=0),
            np.repeat(self.bare, children, axis=0),
        )


def outline_of(rings: list[Floats]) -> OutlineEdges:
    """Edges of rings (n, 2) with the solid on their left."""
    start = np.concatenate(rings) if rings else np.zeros((0, 2))
    counts = [len(ring) for ring in rings]
    first = np.cumsum([0, *counts])[:-1]
    before = np.concatenate(
        [np.roll(np.arange(k, k + n), 1) for k, n in zip(first, counts, strict=True)]
        or [np.zeros(0, dtype=np.int64)]
    )
    leg = np.zeros_like(start)
    leg[before] = start - start[before]
    length = np.hypot(*leg.T)
    along = leg / length[:, None]
    return OutlineEdges(start, along, np.stack([along[:, 1], -along[:, 0]], axis=1), length, before)


def clip_facets(surface: RestingSurface, facets: Ints, from_mm: float, to_mm: float) -> Floats:
    """Projected corners (k, 6, 2), in order, of facets clipped to a range of heights; some are repeated."""
    corners = surface.vertices_mm[surface.faces[facets]]
    begin, end = _clip(corners, np.roll(corners, -1, axis=1), from_mm, to_mm)
    points = np.stack([begin, end], axis=2).reshape(len(facets), 6, 3)
    # A side outside of the slab has no points of its own: it takes those of the side before.
    missing = np.isnan(points[:, :, 0])
    for _ in range(2):
        for k in range(6):
            points[:, k] = np.where(missing[:, k, None], points[:, k - 1], points[:, k])
        missing = np.isnan(points[:, :, 0])
    result: Floats = points[:, :, :2]
    return result


def facets_of(surface: RestingSurface, facets: Ints, from_mm: float, to_mm: float) -> FacetPieces:
    """Every edge of every section in the range lies in one of these."""
    points = clip_facets(surface, facets, from_mm, to_mm)
    normal = surface.normal[facets]
    return FacetPieces(points, normal, normal, surface.bare[facets])


def corners_of(surface: RestingSurface, facets: Ints, from_mm: float, to_mm: float) -> FacetPieces:
    """Every convex corner of every section in the range lies on one of these: edges between `facets`."""
    edges = np.unique(surface.edges[facets])
    one, other = surface.sides[edges].T
    ends = surface.vertices_mm[surface.ends[edges]]
    # A section has its solid on the left, so it passes an edge that rises from the facet on its left.
    rises = ends[:, 1, 2] > ends[:, 0, 2]
    left, right = np.where(rises, one, other), np.where(rises, other, one)
    before, after = surface.normal[left], surface.normal[right]
    bend = before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0]
    low, high = ends[:, :, 2].min(axis=1), ends[:, :, 2].max(axis=1)
    inside = (high > from_mm) & (low < to_mm) & (low < high)
    convex = (bend > 0) & inside & ~surface.bare[left] & ~surface.bare[right]
    begin, end = _clip(ends[convex, 0], ends[convex, 1], from_mm, to_mm)
    return FacetPieces(
        np.stack([begin, end], axis=1)[:, :, :2],
        before[convex],
        after[convex],
        np.zeros(int(convex.sum()), dtype=bool),
    )


def _clip(begin: Floats, end: Floats, from_mm: float, to_mm: float) -> tuple[Floats, Floats]:
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
    pieces: FacetPieces, outline: OutlineEdges, near: cKDTree, owner: Ints, target_mm: float, floor_mm: float
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
    wanted = _asked_of_edge(pieces, outline, guess).max(axis=1)
    left = np.flatnonzero(wanted > floor_mm)
    most = float(wanted[wanted <= floor_mm].max(initial=0.0))
    left = left[np.argsort(-wanted[left])]
    tree = shapely.STRtree(
        shapely.linestrings(
            np.stack([outline.start, outline.start + outline.length[:, None] * outline.along], axis=1)
        )
    )
    # The worst ones first: a slab that is too high shows at once.
    for rows in (left[:_FIRST], *np.split(left[_FIRST:], range(_AT_ONCE, len(left), _AT_ONCE))):
        found, good = _searched(pieces.select(rows), outline, tree, target_mm)
        if not good:
            return found, False
        most = max(most, found)
    return most, True


def _searched(
    pieces: FacetPieces, outline: OutlineEdges, tree: shapely.STRtree, target_mm: float
) -> tuple[float, bool]:
    """As `distance_bound`, with all edges nearby."""
    most = 0.0
    for _ in range(_HALVINGS):
        if not len(pieces):
            return most, True
        look = _LOOK * target_mm
        low, high = pieces.points.min(axis=1) - look, pieces.points.max(axis=1) + look
        piece, edge = tree.query(shapely.box(low[:, 0], low[:, 1], high[:, 0], high[:, 1]))
        some = pieces.select(piece)
        of_edge, of_vertex = _asked_of_edge(some, outline, edge), _asked_of_vertex(some, outline, edge)
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


def _asked_of_edge(pieces: FacetPieces, outline: OutlineEdges, edge: Ints) -> Floats:
    """What each point (k, p) of each piece asks of an edge each."""
    away = pieces.points - outline.start[edge][:, None]
    length, unit = outline.length[edge], outline.along[edge]
    along = away[:, :, 0] * unit[:, None, 0] + away[:, :, 1] * unit[:, None, 1]
    across = away[:, :, 0] * unit[:, None, 1] - away[:, :, 1] * unit[:, None, 0]
    beyond = along - np.minimum(np.maximum(along, 0.0), length[:, None])
    distance = np.sqrt(across**2 + beyond**2)
    normal = outline.normal[edge]
    tilt = length / 4 * np.maximum(turned(normal, pieces.first), turned(normal, pieces.last))
    result: Floats = np.maximum(distance, np.where(pieces.bare, 0.0, tilt)[:, None])
    return result


def _asked_of_vertex(pieces: FacetPieces, outline: OutlineEdges, edge: Ints) -> Floats:
    """What each point (k, p) of each piece asks of the vertex that an edge each starts from."""
    distance = np.hypot(*np.moveaxis(pieces.points - outline.start[edge][:, None], -1, 0))
    previous = outline.before[edge]
    begin = _left_turn(outline.normal[previous], pieces.first)
    width = _left_turn(pieces.first, pieces.last)
    end = begin + width - _left_turn(outline.normal[previous], outline.normal[edge])
    tilt = np.maximum(
        outline.length[previous] * np.sin(np.clip(-begin, 0.0, np.pi / 2)),
        outline.length[edge] * np.sin(np.clip(end, 0.0, np.pi / 2)),
    )
    result: Floats = np.maximum(distance, np.where(pieces.bare, 0.0, tilt / 4)[:, None])
    return result


def _left_turn(normal: Floats, other: Floats) -> Floats:
    """Angles from one unit vector (n, 2) to another, in [−π, π]."""
    across = normal[:, 0] * other[:, 1] - normal[:, 1] * other[:, 0]
    result: Floats = np.arctan2(across, np.sum(normal * other, axis=1))
    return result
