"""How far the surface in a slab of heights is from one outline: the proof behind a cross section.

From a `Surface`, a range of heights and an outline to a bound on what the recogniser calls being off. Every
facet is clipped to the slab and projected: all edges of all true sections in the slab lie in these pieces,
and all convex corners on the clipped edges between facets. The distance to one edge (or vertex) of the outline
is convex over a piece, so the greatest of its corners' distances bounds it. An edge of length L passes for one
whose normal differs by at most asin(4δ/L), so a piece needs δ = L/4 · sin(angle) of it, too; a vertex passes
for normals between those of its edges, tilted likewise. A piece needs the least that any edge or vertex asks,
and is halved where that is too much, because its ends may be near to different ones.

Facets without a normal of their own (level or thinner than 1 µm) need only be near.
"""

from dataclasses import dataclass

import numpy as np
import shapely
from scipy.spatial import cKDTree

from palpate.cad.simplify import turned, wrapped
from palpate.cad.surface import Bools, Surface
from palpate.cad.values import Floats, Ints

__all__ = ["Outline", "Pieces", "clipped", "corners_of", "facets_of", "need", "outline_of"]

_HALVINGS = 24
_AT_ONCE = 20_000
_FIRST = 200
_LOOK = 3.0
"""Edges are looked for so many times further than they may be, to tell how much a slab is too high."""


@dataclass(frozen=True, eq=False)
class Outline:
    """The n edges of an outline's rings, and the vertices that they start from.

    `start`, `leg` (n, 2) mm; `length` (n,); `heading` (n,) rad of the outward normal; `before` (n,): the edge
    before; `bend` (n,) rad: left turn at the start.
    """

    start: Floats
    leg: Floats
    length: Floats
    heading: Floats
    before: Ints
    bend: Floats


@dataclass(frozen=True, eq=False)
class Pieces:
    """Convex pieces (k) of what a finger may touch: the hull of `points` (k, p, 2), mm.

    Normals head from `heading` (k,) counter-clockwise over `width` (k,) rad, unless a piece is `bare`.
    """

    points: Floats
    heading: Floats
    width: Floats
    bare: Bools

    def __len__(self) -> int:
        return len(self.points)

    def select(self, rows: Ints | Bools) -> "Pieces":
        """Those at `rows` (indices or a mask)."""
        return Pieces(self.points[rows], self.heading[rows], self.width[rows], self.bare[rows])

    def split(self) -> "Pieces":
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

    def _like(self, points: Floats) -> "Pieces":
        """Of `points` (k, c, p, 2): c children of each."""
        children = points.shape[1]
        return Pieces(
            points.reshape(-1, *points.shape[2:]),
            *(np.repeat(values, children) for values in (self.heading, self.width, self.bare)),
        )


def outline_of(rings: list[Floats]) -> Outline:
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
    heading = np.arctan2(-leg[:, 0], leg[:, 1])
    return Outline(
        start, leg, np.hypot(*leg.T), heading, before, wrapped(heading - heading[before])
    )


def clipped(surface: Surface, facets: Ints, from_mm: float, to_mm: float) -> Floats:
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


def facets_of(surface: Surface, facets: Ints, from_mm: float, to_mm: float) -> Pieces:
    """Every edge of every section in the range lies in one of these."""
    points = clipped(surface, facets, from_mm, to_mm)
    return Pieces(points, surface.heading[facets], np.zeros(len(facets)), surface.bare[facets])


def corners_of(surface: Surface, facets: Ints, from_mm: float, to_mm: float) -> Pieces:
    """Every convex corner of every section in the range lies on one of these: edges between `facets`."""
    edges = np.unique(surface.edges[facets])
    one, other = surface.sides[edges].T
    ends = surface.vertices_mm[surface.ends[edges]]
    # A section has its solid on the left, so it passes an edge that rises from the facet on its left.
    rises = ends[:, 1, 2] > ends[:, 0, 2]
    left, right = np.where(rises, one, other), np.where(rises, other, one)
    width = wrapped(surface.heading[right] - surface.heading[left])
    low, high = ends[:, :, 2].min(axis=1), ends[:, :, 2].max(axis=1)
    inside = (high > from_mm) & (low < to_mm) & (low < high)
    convex = (width > 0) & inside & ~surface.bare[left] & ~surface.bare[right]
    begin, end = _clip(ends[convex, 0], ends[convex, 1], from_mm, to_mm)
    return Pieces(
        np.stack([begin, end], axis=1)[:, :, :2],
        surface.heading[left[convex]],
        width[convex],
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


def need(
    pieces: Pieces, outline: Outline, near: cKDTree, owner: Ints, target_mm: float, floor_mm: float
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
    wanted, _ = _asked(pieces, outline, guess)
    left = np.flatnonzero(wanted > floor_mm)
    most = float(wanted[wanted <= floor_mm].max(initial=0.0))
    left = left[np.argsort(-wanted[left])]
    tree = shapely.STRtree(
        shapely.linestrings(np.stack([outline.start, outline.start + outline.leg], axis=1))
    )
    # The worst ones first: a slab that is too high shows at once.
    for rows in (left[:_FIRST], *np.split(left[_FIRST:], range(_AT_ONCE, len(left), _AT_ONCE))):
        found, good = _searched(pieces.select(rows), outline, tree, target_mm)
        if not good:
            return found, False
        most = max(most, found)
    return most, True


def _searched(
    pieces: Pieces, outline: Outline, tree: shapely.STRtree, target_mm: float
) -> tuple[float, bool]:
    """As `need`, with all edges nearby."""
    most = 0.0
    for _ in range(_HALVINGS):
        if not len(pieces):
            return most, True
        look = _LOOK * target_mm
        low, high = pieces.points.min(axis=1) - look, pieces.points.max(axis=1) + look
        piece, edge = tree.query(shapely.box(low[:, 0], low[:, 1], high[:, 0], high[:, 1]))
        wanted, of_points = _asked(pieces.select(piece), outline, edge)
        each = np.full(len(pieces), np.inf)
        np.minimum.at(each, piece, wanted)
        points = np.full(pieces.points.shape[:2], np.inf)
        np.minimum.at(points, piece, of_points)
        if points.max() > target_mm:
            return float(points.max()), False
        good = each <= target_mm
        most = max(most, float(each[good].max(initial=0.0)))
        pieces = pieces.select(~good).split()
    return float(each.max()), False


def _asked(pieces: Pieces, outline: Outline, edge: Ints) -> tuple[Floats, Floats]:
    """What each piece (k,) and each of its points (k, p) asks of an edge each, or of the vertex it starts."""
    start = outline.start[edge][:, None]
    away = pieces.points - start
    length = outline.length[edge]
    unit = outline.leg[edge] / length[:, None]
    along = np.clip(np.einsum("kpc,kc->kp", away, unit), 0.0, length[:, None])
    to_edge = away - along[:, :, None] * unit[:, None]
    from_edge = np.sqrt(to_edge[:, :, 0] ** 2 + to_edge[:, :, 1] ** 2)
    from_vertex = np.sqrt(away[:, :, 0] ** 2 + away[:, :, 1] ** 2)
    turn = wrapped(pieces.heading - outline.heading[edge])
    tilt = length / 4 * turned(np.maximum(np.abs(turn), np.abs(wrapped(turn + pieces.width))))
    previous = outline.before[edge]
    begin = wrapped(pieces.heading - outline.heading[previous])
    beyond = begin + pieces.width - outline.bend[edge]
    tilt_vertex = np.maximum(
        outline.length[previous] / 4 * turned(np.maximum(-begin, 0.0)),
        length / 4 * turned(np.maximum(beyond, 0.0)),
    )
    tilt, tilt_vertex = (np.where(pieces.bare, 0.0, part)[:, None] for part in (tilt, tilt_vertex))
    of_edge, of_vertex = np.maximum(from_edge, tilt), np.maximum(from_vertex, tilt_vertex)
    return np.minimum(of_edge.max(axis=1), of_vertex.max(axis=1)), np.minimum(of_edge, of_vertex)
