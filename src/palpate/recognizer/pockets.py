"""Angle pockets: directions from which a finger can reach an edge, with the rest of the outline in the way.

See the memo's §2.2.2 and Fig. 6. A pocket
is a set of directions of travel η in the object's frame. A finger that travels in direction φ of W and comes
to rest on the edge leaves the orientations θ ∈ φ − η. *Conservative* pockets hold for a whole edge, *exact*
ones for one point of it.

What is not in a pocket is ruled out for certain, for a finger that came straight from outside of the
section's convex hull, or from as far as the pocket was made for. Proof: let q be the point of the edge where
the finger rests, ρ a bound on all errors together, and F a stretch of an outline that stays further than ρ
from q. Follow the direction in which q sees a point of F as the point runs along F, without jumps of 2π. Say
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

from palpate.base.geometry import Floats, Ints
from palpate.recognizer.edges import EdgeSet
from palpate.recognizer.tables import expand_ranges
from palpate.recognizer.visibility import EdgePieces, blocked_directions, outline_rings

__all__ = [
    "Pockets",
    "conservative_pockets",
    "pockets_of",
]

_AT_ONCE = 200_000  # pieces times vertices in one go: bounds the temporary arrays to tens of MB
_MOST_PIECES, _PIECES_ROUND = 8, 100
_NEAR_MM = 1e-9
_STRIDE = 16.0  # rad between the angles of one group and those of the next


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
    step = max(float(length.sum()) / _PIECES_ROUND, 1e-9)
    count = np.clip(np.ceil(length / step), 1, _MOST_PIECES).astype(np.int64)
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
        for part in _free(edges, state, some, allowance_mm, travel_mm)
    ]
    none: tuple[Ints, Floats, Floats] = (np.empty(0, np.int64), np.empty(0), np.empty(0))
    row, lo, hi = (np.concatenate(column) for column in zip(none, *found, strict=True))
    row, lo, hi = _merged(row, lo, hi)
    base = edges.normal_rad[edge_of_row[row]] + np.pi / 2 - edges.span[edge_of_row[row]]
    return _by_row(len(edge_of_row), row, base + lo, base + hi)


def _free(
    edges: EdgeSet, state: int, pieces: EdgePieces, allowance_mm: float, travel_mm: float
) -> Iterator[tuple[Ints, Floats, Floats]]:
    """Free arcs (row, lo, hi) of the pieces, from the begin of each one's window on."""
    if not len(pieces.edge):
        return
    block = slice(int(edges.first[state]), int(edges.first[state + 1]))
    rho = max(2 * (allowance_mm + float(edges.slack_mm[block].max())), _NEAR_MM)
    outline = outline_rings(edges, block)
    chunk = max(1, _AT_ONCE // (block.stop - block.start))
    for begin in range(0, len(pieces.edge), chunk):
        part = pieces.select(slice(begin, begin + chunk))
        width = np.minimum(np.pi + 2 * edges.span[part.edge], 2 * np.pi)
        if outline is None:
            yield part.row, np.zeros(len(width)), width
            continue
        group = np.arange(len(width))
        shadows = blocked_directions(edges, outline, block.start, part, rho, travel_mm - rho)
        index, lo, hi = _gaps(group, width, *shadows)
        yield part.row[index], lo, hi


def _gaps(group: Ints, width: Floats, owner: Ints, lo: Floats, hi: Floats) -> tuple[Ints, Floats, Floats]:
    """What is left of [0, width] in each group after the given intervals: (group, lo, hi)."""
    # A wall at either end of each window makes every gap one between two neighbours.
    walls = np.concatenate([owner, group, group])
    lo = np.concatenate([np.clip(lo, -1.0, width[owner]), group * 0.0 - 1.0, width])
    hi = np.concatenate([np.clip(hi, -1.0, width[owner]), group * 0.0, width + 1.0])
    walls, lo, hi = _merged(walls, lo, hi)
    between = np.flatnonzero(walls[1:] == walls[:-1])
    return walls[between], hi[between], lo[between + 1]


def _merged(group: Ints, lo: Floats, hi: Floats) -> tuple[Ints, Floats, Floats]:
    """The union of intervals, group by group, sorted; all within a few turns of 0."""
    if not len(group):
        return group, lo, hi
    order = np.lexsort((lo, group))
    group, lo, hi = group[order], lo[order], hi[order]
    furthest = np.maximum.accumulate(hi + group * _STRIDE)
    begins = np.ones(len(group), dtype=bool)
    begins[1:] = (group[1:] != group[:-1]) | (lo[1:] + group[1:] * _STRIDE > furthest[:-1])
    first = np.flatnonzero(begins)
    return group[first], lo[first], np.maximum.reduceat(hi, first)


def _by_row(rows: int, row: Ints, lo: Floats, hi: Floats) -> Pockets:
    first = np.searchsorted(row, np.arange(rows + 1))
    return Pockets(first.astype(np.int64), lo, hi)
