"""Rings of a grown section: visible parts of offset curves joined end to end, arcs replaced by facets."""

import math
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from palpate.base.geometry import Floats, Ints
from palpate.recognizer.offset_curves import BoundaryEdges, OffsetParts
from palpate.recognizer.tables import Table, expand_ranges

__all__ = ["FacetedRings", "facet_turn", "faceted_rings"]

_NEIGHBOURS = 4  # as many ends may meet in a point where a section touches itself when grown


@dataclass(frozen=True, eq=False)
class FacetedRings(Table):
    """Edges (n) of closed rings, neighbours meeting in the same numbers.

    `part` (n,): which part an edge belongs to; `start`, `end` (n, 2) mm; `direction` (n, 2): of the part, or
    of the arc in the facet's middle; `bulge` (n,) mm of the arc over its facet; `half_turn` (n,) rad of its
    normal; `gap` (n,) mm: how far the part's ends have been moved to meet others.
    """

    part: Ints
    start: Floats
    end: Floats
    direction: Floats
    bulge: Floats
    half_turn: Floats
    gap: Floats


def facet_turn(radius_mm: float, facet_error_mm: float) -> float:
    """Largest turn (rad) that one facet may stand for."""
    if radius_mm <= facet_error_mm:
        return math.pi / 4
    return min(math.pi / 4, 2 * math.acos(1 - facet_error_mm / radius_mm))


def faceted_rings(
    edges: BoundaryEdges, parts: OffsetParts, radius_mm: float, facet_error_mm: float
) -> FacetedRings:
    """The parts as rings, with no arc further than `facet_error_mm` from its facet."""
    every = np.arange(len(parts))
    begin = parts.at(edges, radius_mm, parts.begin, every)
    end = parts.at(edges, radius_mm, parts.end, every)
    following = _successors(begin, end)
    corner = (end + begin[following]) / 2
    into = np.empty_like(corner)
    into[following] = corner
    moved = np.hypot(*(end - corner).T)
    gap = np.maximum(moved, np.hypot(*(begin - into).T))
    order = _ring_by_ring(following)
    turn = np.where(parts.arc > 0, parts.end - parts.begin, 0.0)
    count = np.maximum(np.ceil(turn / facet_turn(radius_mm, facet_error_mm) - 1e-9), 1).astype(np.int64)
    owner, facet = expand_ranges(np.zeros(len(parts), np.int64), count[order])
    part = order[owner]
    step = (turn / count)[part]
    start = parts.at(edges, radius_mm, parts.begin[part] + facet * step, part)
    start[facet == 0] = into[order]
    last = facet == count[part] - 1
    finish = np.empty_like(start)
    finish[:-1] = start[1:]
    finish[last] = corner[order]
    middle = parts.begin[part] + (facet + 0.5) * step
    arc = parts.arc[part] > 0
    tangent = np.column_stack([-np.sin(middle), np.cos(middle)])
    found = FacetedRings(
        part=part,
        start=start,
        end=finish,
        direction=np.where(arc[:, None], tangent, edges.direction[parts.source[part]]),
        bulge=np.where(arc, radius_mm * (1 - np.cos(step / 2)), 0.0),
        half_turn=np.where(arc, step / 2, 0.0),
        gap=gap[part],
    )
    return found.select(np.any(start != finish, axis=1))


def _successors(begin: Floats, end: Floats) -> Ints:
    """Of each part (n,) the one that begins where it ends; every part follows one."""
    ways, found = cKDTree(begin).query(end, k=np.arange(1, min(_NEIGHBOURS, len(begin)) + 1))
    away, near = np.asarray(ways), np.asarray(found)
    if len(np.unique(near[:, 0])) == len(near):
        return np.asarray(near[:, 0], dtype=np.int64)
    following = np.full(len(end), -1)
    free = np.ones(len(begin), dtype=bool)
    for flat in np.argsort(away, axis=None, kind="stable").tolist():
        row, to = flat // near.shape[1], int(near.flat[flat])
        if following[row] < 0 and free[to]:
            following[row], free[to] = to, False
    # What is left are slivers among slivers.
    following[following < 0] = np.flatnonzero(free)
    return following


def _ring_by_ring(following: Ints) -> Ints:
    """Parts (n,) ring after ring, each in the order in which they follow one another."""
    left, order = np.ones(len(following), dtype=bool), []
    follow = following.tolist()
    for first in range(len(following)):
        at = first
        while left[at]:
            left[at] = False
            order.append(at)
            at = follow[at]
    return np.array(order, dtype=np.int64)
