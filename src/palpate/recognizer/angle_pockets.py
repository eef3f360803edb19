"""Angle pockets: directions from which a finger can reach an edge past the rest of the outline.

See the memo's §2.2.2 and Fig. 6. A pocket is a set of directions of travel η in the object's frame. A finger
that travels in direction φ of W and comes to rest on the edge leaves the orientations θ ∈ φ − η.
*Conservative* pockets hold for a whole edge, *exact* ones for one point of it.

What is not in a pocket is ruled out for certain, for a finger that came straight from outside of the
section's convex hull, or from as far as the pocket was made for. Proof: let q be the point of the edge where
the finger rests, ρ a bound on all errors together, and F a stretch of an outline that stays further than ρ
that it comes to lie on both sides of a direction δ: first at a point that is further than ρ to the one side
of the ray from q along δ, then at one as far to the other side. Move everything from where the model and the
stated path have it to where it truly is. No point of F is moved onto q and neither of the two points onto the
ray, because all are too far away. So the true stretch still leads from one side of the true path to the other
without going round the path's end: it crosses the path. Hence δ is no free direction, and it does not matter
what happens nearer to q than ρ, nor how thin F is. Where an outline that stays further than ρ from q goes
round it, no direction is free.

ρ is twice the allowance. Once, because the stated path is that far from where the true path is seen from the
modelled outline; once more, because the path's end is that far from the modelled edge. Of a path that may
have begun inside of the hull only its travel is known to be free. If F lies nearer to q than that travel less
ρ, it cannot go round the path's begin either.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from palpate.base.geometry import Bools, Floats, Ints
from palpate.base.geometry.plane import point_segment_distance, wrap_angle
from palpate.recognizer.edges import EdgeSet, ring_order
from palpate.recognizer.tables import Table, expand_ranges

_ROUNDING_RAD = 1e-9


@dataclass(frozen=True, eq=False)
class EdgePieces(Table):
    """m pieces of edges of one state: the result's `row`, `edge` (m,), both ends (m, 2) along the edge."""

    row: Ints
    edge: Ints
    begin: Floats
    end: Floats


@dataclass(frozen=True, eq=False)
class OutlineRings:
    """The N edges of a state, ring after ring in walking order.

    `edge` (N,): index of the edge at each position; `first` and `size` (N,): the ring of each position;
    `following` (N,): position of the next edge on the ring; `at` maps an edge, counted from the state's
    first, to its position.
    """

    edge: Ints
    first: Ints
    size: Ints
    following: Ints
    at: Ints


def _outline_rings(edges: EdgeSet, block: slice) -> OutlineRings | None:
    """The rings of a state, from neighbours that meet in the same numbers; None if that is ambiguous."""
    start, end = edges.start[block], edges.end[block]
    by_start, by_end = np.lexsort(start.T), np.lexsort(end.T)
    meeting = start[by_start]
    if not np.array_equal(meeting, end[by_end]) or bool(np.any(np.all(meeting[1:] == meeting[:-1], axis=1))):
        return None
    order, sizes = ring_order(start, end)
    size = np.repeat(sizes, sizes)
    first_of = np.repeat(np.cumsum([0, *sizes[:-1]]), sizes)
    position = np.arange(len(order))
    return OutlineRings(
        edge=order + block.start,
        first=first_of,
        size=size,
        following=first_of + (position - first_of + 1) % size,
        at=np.argsort(order),
    )


def _blocked_directions(
    edges: EdgeSet, outline: OutlineRings, offset: int, pieces: EdgePieces, rho: float, reach_mm: float
) -> tuple[Ints, Floats, Floats]:
    """Arcs (piece, lo, hi) from the window's begin on, in each of which no point of the piece is free.

    Only edges that stay further than ρ from the piece and are wholly within `reach_mm` of all of it count.
    Seen from a point that moves straight ahead, a fixed point or a tangent to a fixed disc always turns the
    same way. So its extreme directions over a piece are those at the piece's ends.
    """
    position = _positions(outline, outline.at[pieces.edge - offset])
    far = ~_is_near(edges, outline.edge[position], pieces, rho)
    starts = edges.start[outline.edge[position]]
    views = [_directions_to(point, starts, rho) for point in (pieces.begin, pieces.end)]
    within = np.maximum(views[0][2], views[1][2]) <= reach_mm
    far &= within & within[:, outline.following]
    # The first edge of each stretch: the one before does not count, or it begins another ring.
    begins = far & ((np.arange(far.shape[1]) == outline.first) | ~np.roll(far, 1, axis=1))
    flat = np.flatnonzero(far)
    stretch = np.flatnonzero(begins.ravel()[flat])
    if not len(stretch):
        return np.empty(0, np.int64), np.empty(0), np.empty(0)
    last = np.append(stretch[1:], len(flat)) - 1
    columns = far.shape[1]
    row, column = flat // columns, flat % columns
    highest, lowest, turned = [], [], np.zeros(len(stretch))
    base = views[0][0][row[stretch], column[stretch]]
    for angle, loosening, _ in views:
        step = wrap_angle(angle[:, outline.following].ravel()[flat] - angle.ravel()[flat])
        total = np.cumsum(step)
        before = total[stretch] - step[stretch]
        here = angle[row[stretch], column[stretch]]
        # The piece's other end sees the stretch's first point within half a turn of where this one does.
        origin = base + wrap_angle(here - base) - before
        vertex = np.repeat(origin, last - stretch + 1) + total - step
        turned = total[last] - before
        end_loose = loosening[row[last], outline.following[column[last]]]
        loose = loosening.ravel()[flat]
        highest.append((vertex + loose, origin + total[last] + end_loose))
        lowest.append((vertex - loose, origin + total[last] - end_loose))
    upper = [np.maximum(one, two) for one, two in zip(*highest, strict=True)]
    lower = [np.minimum(one, two) for one, two in zip(*lowest, strict=True)]
    lo = np.minimum(np.minimum.reduceat(upper[0], stretch), upper[1])
    hi = np.maximum(np.maximum.reduceat(lower[0], stretch), lower[1])
    # A ring that counts as a whole and goes round the piece leaves no way out.
    whole = (last - stretch + 1 == outline.size[column[stretch]]) & (np.abs(turned) > np.pi)
    hi = np.where(whole, lo + 2 * np.pi, hi)
    owner = row[stretch]
    return _from_window(edges, pieces.edge[owner], owner, lo + _ROUNDING_RAD, hi - _ROUNDING_RAD, whole)


def _positions(outline: OutlineRings, own: Ints) -> Ints:
    """All positions (m, N), those of each piece's own ring from the edge after its own (m,) on."""
    every = np.arange(len(outline.edge))
    first, size = outline.first[own][:, None], outline.size[own][:, None]
    rolled = first + (every - first + own[:, None] - first + 1) % size
    return np.where(outline.first == first, rolled, every)


def _is_near(edges: EdgeSet, edge: Ints, pieces: EdgePieces, rho: float) -> Bools:
    """Mask of edges (m, N) that come within ρ of their piece (m,), as its own edge always does."""
    middle, half = (pieces.begin + pieces.end) / 2, np.hypot(*(pieces.end - pieces.begin).T) / 2
    away = (edges.start[edge] + edges.end[edge]) / 2 - middle[:, None]
    reach = edges.length[edge] / 2 + half[:, None] + rho
    near: Bools = np.sum(away * away, axis=2) <= reach * reach
    row, column = np.nonzero(near)
    other, own = edge[row, column], pieces.edge[row]
    ends = [pieces.begin[row], pieces.end[row]]
    length = 2 * half[row]
    gap = np.minimum.reduce(
        [
            *(
                point_segment_distance(end, edges.start[other], edges.direction[other], edges.length[other])
                for end in ends
            ),
            *(
                point_segment_distance(vertex[other], ends[0], edges.direction[own], length)
                for vertex in (edges.start, edges.end)
            ),
        ]
    )
    near[row, column] = (gap <= rho) | (other == own)
    return near


def _directions_to(point: Floats, vertex: Floats, rho: float) -> tuple[Floats, Floats, Floats]:
    """Directions (m, N) from points (m, 2) to vertices (m, N, 2), half angles of discs ρ there, distances."""
    away = vertex - point[:, None]
    distance = np.hypot(away[..., 0], away[..., 1])
    ratio = np.minimum(rho / np.maximum(distance, 1e-300), 1.0)
    return np.arctan2(away[..., 1], away[..., 0]), np.arcsin(ratio), distance


def _from_window(
    edges: EdgeSet, edge: Ints, owner: Ints, lo: Floats, hi: Floats, whole: Bools
) -> tuple[Ints, Floats, Floats]:
    """Blocked directions out of the edge as arcs from the window's begin on, without empty ones."""
    begin = edges.normal_rad[edge] - np.pi / 2 - edges.span[edge]
    width = np.where(whole | (hi - lo >= 2 * np.pi), 4 * np.pi, hi - lo)
    lo = (lo - begin) % (2 * np.pi)
    kept = width > 0
    owner, lo, hi = owner[kept], lo[kept], (lo + width)[kept]
    return np.tile(owner, 2), np.append(lo, lo - 2 * np.pi), np.append(hi, hi - 2 * np.pi)


_VIEWS_AT_ONCE = 200_000  # pieces times vertices in one go: bounds the temporary arrays to tens of MB
_MAX_PIECES_PER_EDGE, _PIECES_PER_OUTLINE = 8, 100
_LEAST_RHO_MM = 1e-9
_KEY_STRIDE_RAD = 16.0  # rad between the angles of one group and those of the next


@dataclass(frozen=True, eq=False)
class Pockets:
    """Arcs of directions of travel, in rad in the object's frame, for n edges or points.

    Row k has the arcs first[k] to first[k + 1] of the flat `lo_rad` and `hi_rad`, counter-clockwise from lo
    to hi, apart from each other, hi − lo ≤ 2π. A row without arcs cannot be reached.
    """

    first: Ints
    lo_rad: Floats
    hi_rad: Floats

    def __len__(self) -> int:
        return len(self.first) - 1

    @property
    def row(self) -> Ints:
        """The row that each arc belongs to."""
        return np.repeat(np.arange(len(self)), np.diff(self.first))


def conservative_pockets(edges: EdgeSet, allowance_mm: float, travel_mm: float = math.inf) -> Pockets:
    """Pocket of every edge: never smaller than the union of the exact pockets of its points.

    `allowance_mm`: how far the stated path may be from the true one, its end included. The outlines' own
    slack, with the bulge of arcs, is added to it here. Where nothing is in the way the pocket is the half
    turn into the edge, widened by the edge's `span`; the error of the direction is left to the caller.
    `travel_mm`: how far the finger is known to have come straight at least; infinite for one that came from
    outside of the hull. Only what lies within that distance of the edge can be in the way.
    Long edges are cut into pieces, of which each is either blocked by a stretch as a whole or not. A state
    whose outlines meet in single points has half turns everywhere.
    """
    pieces = [_edge_pieces(edges, state) for state in range(len(edges.first) - 1)]
    return pockets_of(edges, pieces, allowance_mm, travel_mm, np.arange(len(edges.state)))


def _edge_pieces(edges: EdgeSet, state: int) -> EdgePieces:
    """Every edge of a state, the long ones in pieces of about a hundredth of the whole outline."""
    block = np.arange(edges.first[state], edges.first[state + 1])
    length = edges.length[block]
    step = max(float(length.sum()) / _PIECES_PER_OUTLINE, 1e-9)
    count = np.clip(np.ceil(length / step), 1, _MAX_PIECES_PER_EDGE).astype(np.int64)
    owner, part = expand_ranges(np.zeros_like(count), count)
    edge = block[owner]
    along = edges.end[edge] - edges.start[edge]
    begin, end = part / count[owner], (part + 1) / count[owner]
    return EdgePieces(
        edge, edge, edges.start[edge] + begin[:, None] * along, edges.start[edge] + end[:, None] * along
    )


def pockets_of(
    edges: EdgeSet, pieces: list[EdgePieces], allowance_mm: float, travel_mm: float, edge_of_row: Ints
) -> Pockets:
    """Pockets of the rows that the pieces belong to; row k is of edge `edge_of_row[k]`."""
    found = [
        part
        for state, some in enumerate(pieces)
        for part in _free_arcs(edges, state, some, allowance_mm, travel_mm)
    ]
    none: tuple[Ints, Floats, Floats] = (np.empty(0, np.int64), np.empty(0), np.empty(0))
    row, lo, hi = (np.concatenate(column) for column in zip(none, *found, strict=True))
    row, lo, hi = _merge_intervals(row, lo, hi)
    base = edges.normal_rad[edge_of_row[row]] + np.pi / 2 - edges.span[edge_of_row[row]]
    return _by_row(len(edge_of_row), row, base + lo, base + hi)


def _free_arcs(
    edges: EdgeSet, state: int, pieces: EdgePieces, allowance_mm: float, travel_mm: float
) -> Iterator[tuple[Ints, Floats, Floats]]:
    """Free arcs (row, lo, hi) of the pieces, from the begin of each one's window on."""
    if not len(pieces.edge):
        return
    block = slice(int(edges.first[state]), int(edges.first[state + 1]))
    rho = max(2 * (allowance_mm + float(edges.slack_mm[block].max())), _LEAST_RHO_MM)
    outline = _outline_rings(edges, block)
    chunk = max(1, _VIEWS_AT_ONCE // (block.stop - block.start))
    for begin in range(0, len(pieces.edge), chunk):
        part = pieces.select(slice(begin, begin + chunk))
        width = np.minimum(np.pi + 2 * edges.span[part.edge], 2 * np.pi)
        if outline is None:
            yield part.row, np.zeros(len(width)), width
            continue
        group = np.arange(len(width))
        shadows = _blocked_directions(edges, outline, block.start, part, rho, travel_mm - rho)
        index, lo, hi = _gaps(group, width, *shadows)
        yield part.row[index], lo, hi


def _gaps(group: Ints, width: Floats, owner: Ints, lo: Floats, hi: Floats) -> tuple[Ints, Floats, Floats]:
    """Intervals of [0, width] left in each group after the given intervals: (group, lo, hi)."""
    # A wall at either end of each window makes every gap one between two neighbours.
    walls = np.concatenate([owner, group, group])
    lo = np.concatenate([np.clip(lo, -1.0, width[owner]), group * 0.0 - 1.0, width])
    hi = np.concatenate([np.clip(hi, -1.0, width[owner]), group * 0.0, width + 1.0])
    walls, lo, hi = _merge_intervals(walls, lo, hi)
    between = np.flatnonzero(walls[1:] == walls[:-1])
    return walls[between], hi[between], lo[between + 1]


def _merge_intervals(group: Ints, lo: Floats, hi: Floats) -> tuple[Ints, Floats, Floats]:
    """The union of intervals, group by group, sorted; all within a few turns of 0."""
    if not len(group):
        return group, lo, hi
    order = np.lexsort((lo, group))
    group, lo, hi = group[order], lo[order], hi[order]
    furthest = np.maximum.accumulate(hi + group * _KEY_STRIDE_RAD)
    begins = np.ones(len(group), dtype=bool)
    begins[1:] = (group[1:] != group[:-1]) | (lo[1:] + group[1:] * _KEY_STRIDE_RAD > furthest[:-1])
    first = np.flatnonzero(begins)
    return group[first], lo[first], np.maximum.reduceat(hi, first)


def _by_row(rows: int, row: Ints, lo: Floats, hi: Floats) -> Pockets:
    first = np.searchsorted(row, np.arange(rows + 1))
    return Pockets(first.astype(np.int64), lo, hi)
