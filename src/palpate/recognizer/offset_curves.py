"""Offset curves: a section's edges moved outwards, arcs about its convex vertices, and the rings they make.

What is visible of the curves is found in closed form: a curve is hidden where it is nearer than the radius to
another edge. Visible parts are joined end to end to closed rings, with facets in place of arcs.
"""

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import shapely
from scipy.spatial import cKDTree

from palpate.base.geometry import Bools, Floats, Ints
from palpate.base.geometry.plane import capsule_interval, point_segment_distance, wrap_angle
from palpate.recognizer.tables import Table, expand_ranges

_HIDDEN_DEPTH_MM = 1e-11  # than this a curve has to be below another one to be hidden
_SHORTEST_INTERVAL = 1e-12  # an interval (mm or rad) that is shorter is none
_ARC_STEP_RAD = 0.1  # of the polylines by which an arc's neighbours are sought
_MAX_HULL_ARC_RAD = 3.0
_BREAKS_PER_EDGE = 12  # of a circle: two at each end and side of an edge, and at the circle about each end


@dataclass(frozen=True, eq=False)
class BoundaryEdges(Table):
    """Edges (n) of a section's boundary, ring after ring, the solid on the left.

    `start`, `end` (n, 2) mm; `direction` (n, 2) unit; `length` (n,) mm; `lean` (n,) rad: by how much what an
    edge stands for may turn from it; `previous` (n,): the edge before; `edge`, `vertex` (n,): the numbers of
    edge and start in the section.
    """

    start: Floats
    end: Floats
    direction: Floats
    length: Floats
    lean: Floats
    previous: Ints
    edge: Ints
    vertex: Ints

    @property
    def normal(self) -> Floats:
        """Outward unit normals (n, 2)."""
        return np.column_stack([self.direction[:, 1], -self.direction[:, 0]])


@dataclass(frozen=True, eq=False)
class OffsetParts(Table):
    """Visible parts (n) of offset curves.

    `source` (n,): the edge, or for an arc that which begins at its vertex; `arc` (n,): whether it is one;
    `begin`, `end` (n,): along the edge (mm), or directions from the vertex (rad).
    """

    source: Ints
    arc: Ints
    begin: Floats
    end: Floats

    def at(self, edges: BoundaryEdges, radius_mm: float, place: Floats, rows: Ints) -> Floats:
        """Points (m, 2) of the parts `rows` (m,) at places (m,) between their begin and end."""
        source = self.source[rows]
        straight = edges.start[source] + radius_mm * edges.normal[source]
        straight = straight + place[:, None] * edges.direction[source]
        round_ = edges.start[source] + radius_mm * _unit(place)
        result: Floats = np.where(self.arc[rows, None] > 0, round_, straight)
        return result


def visible_parts(edges: BoundaryEdges, radius_mm: float) -> OffsetParts:
    """Visible parts of all offset curves."""
    tree = shapely.STRtree(shapely.linestrings(np.stack([edges.start, edges.end], axis=1)))
    every = np.arange(len(edges))
    owner, begin, end = _remaining_intervals(*_hidden_of_lines(edges, tree, radius_mm), edges.length)
    lines = OffsetParts(every[owner], np.zeros(len(owner), np.int64), begin, end)
    normal_rad = np.arctan2(edges.normal[:, 1], edges.normal[:, 0])
    first = normal_rad[edges.previous]
    turn = wrap_angle(normal_rad - first)
    convex = np.flatnonzero(turn > _SHORTEST_INTERVAL)
    hidden = _hidden_of_arcs(edges, tree, radius_mm, convex, first[convex], turn[convex])
    owner, begin, end = _remaining_intervals(*hidden, turn[convex])
    source = convex[owner]
    arcs = OffsetParts(source, np.ones(len(owner), np.int64), first[source] + begin, first[source] + end)
    return OffsetParts.join([lines, arcs])


def _hidden_of_lines(
    edges: BoundaryEdges, tree: shapely.STRtree, radius_mm: float
) -> tuple[Ints, Floats, Floats]:
    """Intervals (m,) in which edges, moved outwards, are nearer to another one: edge, from, to (mm)."""
    origin = edges.start + radius_mm * edges.normal
    ends = np.stack([origin, edges.end + radius_mm * edges.normal], axis=1)
    wholly, by = _wholly_hidden(edges, tree, radius_mm, ends)
    some = np.flatnonzero(~wholly)
    line, other = tree.query(shapely.linestrings(ends[some]), predicate="dwithin", distance=radius_mm - 1e-9)
    # Neighbours at a bend that is hardly one would be missed.
    every = np.arange(len(edges))
    line = np.concatenate([some[line], every, edges.previous, every])
    other = np.concatenate([other, edges.previous, every, by])
    enter, leave = capsule_interval(
        origin[line],
        edges.direction[line],
        edges.start[other],
        edges.direction[other],
        edges.length[other],
        np.full(len(line), radius_mm - _HIDDEN_DEPTH_MM),
    )
    return line, enter, leave


def _hidden_of_arcs(
    edges: BoundaryEdges, tree: shapely.STRtree, radius_mm: float, at: Ints, first: Floats, turn: Floats
) -> tuple[Ints, Floats, Floats]:
    """Intervals (m,) in which arcs about the starts of the edges `at` (n,) are nearer to an edge.

    `first`, `turn` (n,): where the arcs begin, and their angles. Returns arc, from, to (rad from `first`).
    """
    hull = _hull(edges.start[at], radius_mm, first, turn)
    wholly, _ = _wholly_hidden(edges, tree, radius_mm, hull)
    wholly &= turn < _MAX_HULL_ARC_RAD
    some = np.flatnonzero(~wholly)
    line, off = _polylines(edges.start[at[some]], radius_mm, first[some], turn[some])
    row, other = tree.query(line, predicate="dwithin", distance=radius_mm + off)
    lo, width = _elementary(edges, radius_mm, at[some[row]], other)
    arc, other = np.repeat(some[row], _BREAKS_PER_EDGE), np.repeat(other, _BREAKS_PER_EDGE)
    lo, width = lo.ravel(), width.ravel()
    point = edges.start[at[arc]] + radius_mm * _unit(lo + width / 2)
    away = point_segment_distance(point, edges.start[other], edges.direction[other], edges.length[other])
    below = (away < radius_mm - _HIDDEN_DEPTH_MM) & (width > 0)
    arc, width = arc[below], width[below]
    begin = (lo[below] - first[arc]) % (2 * np.pi)
    gone = np.flatnonzero(wholly)
    return (
        np.concatenate([arc, arc, gone]),
        np.concatenate([begin, begin - 2 * np.pi, np.zeros(len(gone))]),
        np.concatenate([begin + width, begin - 2 * np.pi + width, turn[gone]]),
    )


def _hull(centre: Floats, radius_mm: float, first: Floats, turn: Floats) -> Floats:
    """Triangles (n, 3, 2) that hold arcs of less than _HULL_RAD: their ends and where their tangents meet."""
    far = 1 / np.cos(np.minimum(turn, _MAX_HULL_ARC_RAD) / 2)
    rays = [_unit(first), far[:, None] * _unit(first + turn / 2), _unit(first + turn)]
    return np.stack([centre + radius_mm * ray for ray in rays], axis=1)


def _polylines(centre: Floats, radius_mm: float, first: Floats, turn: Floats) -> tuple[Any, Floats]:
    """Lines (n,) from point to point of arcs, and how far (n,) mm the arcs are from them."""
    count = np.maximum(np.ceil(turn / _ARC_STEP_RAD), 1).astype(np.int64)
    arc, place = expand_ranges(np.zeros(len(turn), np.int64), count + 1)
    rim = centre[arc] + radius_mm * _unit(first[arc] + turn[arc] * place / count[arc])
    return shapely.linestrings(rim, indices=arc), radius_mm * (1 - np.cos(turn / count / 2))


def _wholly_hidden(
    edges: BoundaryEdges, tree: shapely.STRtree, radius_mm: float, hull: Floats
) -> tuple[Bools, Ints]:
    """Mask of curves (n,), each in the hull of points (n, k, 2), that one edge hides; and the edge."""
    by: Ints = tree.nearest(shapely.points(hull[:, hull.shape[1] // 2])).astype(np.int64)
    away = point_segment_distance(
        hull, edges.start[by, None], edges.direction[by, None], edges.length[by, None]
    )
    hidden: Bools = np.all(away < radius_mm - _HIDDEN_DEPTH_MM, axis=1)
    return hidden, by


def _unit(angle_rad: Floats) -> Floats:
    return np.stack([np.cos(angle_rad), np.sin(angle_rad)], axis=-1)


def _elementary(edges: BoundaryEdges, radius_mm: float, at: Ints, other: Ints) -> tuple[Floats, Floats]:
    """Directions (m, 12) in which circles about vertices come to be as near to edges as r, and the turns on.

    Between two of them a circle is nearer all the way, or nowhere. `at`, `other` (m,): edges that begin at
    the vertices, and the other edges.
    """
    reach, r = radius_mm - _HIDDEN_DEPTH_MM, radius_mm
    rel = edges.start[at] - edges.start[other]
    along, normal = edges.direction[other], edges.normal[other]
    bearing = np.arctan2(along[:, 1], along[:, 0])
    a, b = np.sum(rel * along, axis=1), -np.sum(rel * normal, axis=1)
    # cos and sin, seen from the edge's direction, at its ends and on its two sides
    ends = [_arccos(-a / r), _arccos((edges.length[other] - a) / r)]
    sides = [_arcsin((reach - b) / r), _arcsin((-reach - b) / r)]
    breaks = [bearing + sign * angle for angle in ends for sign in (-1, 1)]
    breaks += [bearing + angle for angle in sides] + [bearing + np.pi - angle for angle in sides]
    for end in (edges.start[other], edges.end[other]):
        to = end - edges.start[at]
        gap = np.hypot(*to.T)
        half = _arccos((gap**2 + r**2 - reach**2) / np.maximum(2 * gap * r, 1e-300))
        breaks += [np.arctan2(to[:, 1], to[:, 0]) + sign * half for sign in (-1, 1)]
    ordered = np.sort(np.stack(breaks, axis=1) % (2 * np.pi), axis=1)
    following = np.column_stack([ordered[:, 1:], ordered[:, 0] + 2 * np.pi])
    return ordered, following - ordered


def _arccos(value: Floats) -> Floats:
    return np.arccos(np.clip(value, -1.0, 1.0))


def _arcsin(value: Floats) -> Floats:
    return np.arcsin(np.clip(value, -1.0, 1.0))


def _remaining_intervals(owner: Ints, lo: Floats, hi: Floats, length: Floats) -> tuple[Ints, Floats, Floats]:
    """Parts of [0, length] (n,) that intervals (m,) leave: owner, begin, end."""
    some = (lo < length[owner]) & (hi > 0) & (hi > lo)
    every = np.arange(len(length))
    owner = np.concatenate([owner[some], every, every])
    lo = np.concatenate([lo[some], np.full(len(length), -math.inf), length])
    hi = np.concatenate([hi[some], np.zeros(len(length)), np.full(len(length), math.inf)])
    order = np.lexsort((lo, owner))
    owner, lo, hi = owner[order], lo[order], hi[order]
    # The furthest end so far, for each owner by itself: ranks are whole numbers, so nothing is rounded.
    by_end = np.argsort(hi, kind="stable")
    rank = np.empty(len(hi), np.int64)
    rank[by_end] = np.arange(len(hi))
    covered = hi[by_end[np.maximum.accumulate(owner * len(hi) + rank) % len(hi)]]
    gap = (owner[1:] == owner[:-1]) & (lo[1:] > covered[:-1] + _SHORTEST_INTERVAL)
    rows = np.flatnonzero(gap)
    return owner[rows], covered[rows], lo[rows + 1]


_MAX_NEIGHBOURS = 4  # as many ends may meet in a point where a section touches itself when grown


@dataclass(frozen=True, eq=False)
class GrownSection(Table):
    """Edges of a grown section in the object's frame; n edges, the solid on the left of each.

    `start` and `end` (n, 2) mm, `direction` (n, 2) unit, `length` (n,) mm, `bulge` and `dent` (n,) mm: how
    far the true boundary may stand out over the edge, or back behind it, `span` (n,) rad: half of the turn of
    the true normal along the edge. `feature` (n,): edge k of the section is k, an arc about vertex k is
    −1 − k; edges are counted through the section's polygons in the order given, outer ring first.
    """

    start: Floats
    end: Floats
    direction: Floats
    length: Floats
    bulge: Floats
    dent: Floats
    span: Floats
    feature: Ints

    def translate(self, by_mm: Floats) -> "GrownSection":
        """The same, moved by (2,) mm."""
        return replace(self, start=self.start + by_mm, end=self.end + by_mm)


def facet_turn(radius_mm: float, facet_error_mm: float) -> float:
    """Largest turn (rad) that one facet may stand for."""
    if radius_mm <= facet_error_mm:
        return math.pi / 4
    return min(math.pi / 4, 2 * math.acos(1 - facet_error_mm / radius_mm))


def faceted_rings(
    edges: BoundaryEdges, parts: OffsetParts, radius_mm: float, facet_error_mm: float
) -> GrownSection:
    """The parts as rings, neighbours meeting in the same numbers, with no arc further than `facet_error_mm`
    from its facet.
    """
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
    arc, source = parts.arc[part] > 0, parts.source[part]
    tangent = np.column_stack([-np.sin(middle), np.cos(middle)])
    lean = np.where(arc, np.maximum(edges.lean, edges.lean[edges.previous])[source], edges.lean[source])
    found = GrownSection(
        start=start,
        end=finish,
        direction=np.where(arc[:, None], tangent, edges.direction[source]),
        length=np.hypot(*(finish - start).T),
        bulge=np.where(arc, radius_mm * (1 - np.cos(step / 2)), 0.0) + gap[part],
        dent=gap[part],
        span=np.where(arc, step / 2, 0.0) + lean,
        feature=np.where(arc, -1 - edges.vertex[source], edges.edge[source]),
    )
    return found.select(np.any(start != finish, axis=1))


def _successors(begin: Floats, end: Floats) -> Ints:
    """Successor of each part (n,), which begins where it ends; every part follows one."""
    ways, found = cKDTree(begin).query(end, k=np.arange(1, min(_MAX_NEIGHBOURS, len(begin)) + 1))
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
