"""Visibility: directions that an outline blocks, as seen from pieces of its own edges.

What counts as blocked, and why that holds under bounded errors, is proved in `pockets`.
"""

from dataclasses import dataclass

import numpy as np

from palpate.base.geometry import Bools, Floats, Ints
from palpate.base.geometry.plane import wrap_angle
from palpate.base.geometry.segments import point_segment_distance
from palpate.recognizer.edges import EdgeSet, ring_order
from palpate.recognizer.tables import Table

__all__ = ["EdgePieces", "OutlineRings", "blocked_directions", "outline_rings"]

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


def outline_rings(edges: EdgeSet, block: slice) -> OutlineRings | None:
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


def blocked_directions(
    edges: EdgeSet, outline: OutlineRings, offset: int, pieces: EdgePieces, rho: float, reach_mm: float
) -> tuple[Ints, Floats, Floats]:
    """Arcs (piece, lo, hi) from the window's begin on, in each of which no point of the piece is free.

    Only edges that stay further than ρ from the piece and are wholly within `reach_mm` of all of it count.
    Seen from a point that moves straight ahead, a fixed point or a tangent to a fixed disc always turns the
    same way. So its extreme directions over a piece are those at the piece's ends.
    """
    position = _positions(outline, outline.at[pieces.edge - offset])
    far = ~_near(edges, outline.edge[position], pieces, rho)
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


def _near(edges: EdgeSet, edge: Ints, pieces: EdgePieces, rho: float) -> Bools:
    """Whether each edge (m, N) comes within ρ of its piece (m,); always so for the piece's own edge."""
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
