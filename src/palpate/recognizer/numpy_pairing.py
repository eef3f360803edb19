"""Pairing of contacts with edges with NumPy: by normal, by distance and by the model test.

Normals are a range look-up among those that are sorted, or a descent of the strip tree for states with very
many edges (memo §3.3).
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np

from palpate.base.geometry import Bools, Floats, Ints
from palpate.base.geometry.plane import distance_range, point_segment_distance, wrap_angle
from palpate.recognizer.catalogue import Catalogue
from palpate.recognizer.contact import Finger, NormalRange
from palpate.recognizer.edges import ROUNDING_MM, EdgeSet
from palpate.recognizer.interpretations import (
    Children,
    Interpretations,
    Query,
    TreeLevel,
    intersect,
    orientation_range,
)
from palpate.recognizer.model_test import narrow
from palpate.recognizer.pose_region import Cells
from palpate.recognizer.tables import split_evenly

NearTest = Callable[[Ints, Floats, Floats, Floats], Bools]
"""True if, for query (n,), the contact may lie within stray (n,) mm of segments from start to end (n, 2)."""

_ROUNDING_RAD = 1e-9
_CHILDREN_AT_ONCE = 1_000_000


def matching_edges(
    catalogue: Catalogue,
    rows: tuple[Ints, Floats, Floats],
    finger: Finger,
    normals: NormalRange,
    near: NearTest,
    most: int | None = None,
) -> tuple[Ints, Ints]:
    """Edges whose normals fit at some θ, for m queries `rows`: state, lo and hi of θ, each (m,).

    Where there are so many that a strip tree is descended, `near` holds as well. Returns (query, edge), flat.
    Raises BudgetSpentError where there are more than `most`.
    """
    state, lo, hi = rows
    edges, strips = catalogue.edges(finger), catalogue.strips(finger)
    large = strips.root[state] >= 0
    small = np.flatnonzero(~large)
    margin = float(np.max(edges.span, initial=0.0))
    width = np.minimum(normals.hi_rad - normals.lo_rad + 2 * margin + (hi - lo)[small], 2 * np.pi)
    owner, edge = edges.by_normal(state[small], normals.lo_rad - margin - hi[small], width, most)
    owner = small[owner]
    if not large.any():
        return owner, edge
    some = np.flatnonzero(large)
    middle = (normals.lo_rad + normals.hi_rad - lo - hi)[some] / 2
    half = (normals.hi_rad - normals.lo_rad + hi - lo)[some] / 2 + _ROUNDING_RAD

    def keep(query: Ints, strip: Ints) -> Bools:
        off = np.abs(wrap_angle(strips.normal[strip] - middle[query]))
        kept: Bools = off <= half[query] + strips.half_turn[strip]
        turned = np.flatnonzero(kept)
        at = strip[turned]
        kept[turned] = near(some[query[turned]], strips.start[at], strips.end[at], strips.stray[at])
        return kept

    query, found = strips.descend(state[some], keep, None if most is None else most - len(owner))
    return np.concatenate([owner, some[query]]), np.concatenate([edge, found])


def look_up(
    query: Query, normals: NormalRange, nodes: Interpretations, most: int | None = None
) -> tuple[Ints, Ints]:
    """Rows of `nodes` and edges (n,) that the last contact may be paired with, as far as normals say.

    Raises BudgetSpentError where there are more than `most`.
    """

    def near(row: Ints, start: Floats, end: Floats, stray: Floats) -> Bools:
        fits = np.ones(len(row), dtype=bool)
        for level in range(len(query.contacts) - 1):
            edge = nodes.edges[row, level]
            fits &= _distances_fit(query, level, edge, (start, end), stray)
        return fits

    rows, finger = (nodes.state, nodes.lo, nodes.hi), query.contacts[-1].finger
    return matching_edges(query.catalogue, rows, finger, normals, near, most)


def distances_fit(query: Query, level: int, paired: Ints, edge: Ints) -> Bools:
    """True where edges `edge` (n,) may be as far from `paired` (n,) as their contacts are from each other.

    They are of the query's last contact and of the one at `level` (memo §2.2.1).
    """
    last = query.edges[-1]
    return _distances_fit(query, level, paired, (last.start[edge], last.end[edge]), last.slack_mm[edge])


def _distances_fit(
    query: Query, level: int, paired: Ints, segment: tuple[Floats, Floats], stray: Floats
) -> Bools:
    first, other, contact = query.edges[level], query.contacts[level], query.contacts[-1]
    ends = (first.start[paired], first.end[paired], *segment)
    bound = other.position_bound_mm + contact.position_bound_mm + ROUNDING_MM
    slack = stray + first.slack_mm[paired] + bound
    measured = np.hypot(contact.end_mm[0] - other.end_mm[0], contact.end_mm[1] - other.end_mm[1])
    # The distance of the middles, give or take half of both lengths, settles most at a third of the cost.
    gap, one, two = (ends[2] + ends[3] - ends[0] - ends[1]) / 2, ends[1] - ends[0], ends[3] - ends[2]
    half = (np.hypot(*one.T) + np.hypot(*two.T)) / 2
    fits: Bools = np.abs(np.hypot(*gap.T) - measured) <= half + slack
    rows = np.flatnonzero(fits)
    shortest, longest = distance_range(*(end[rows] for end in ends))
    slack = slack[rows]
    fits[rows] = (measured >= shortest - slack) & (measured <= longest + slack)
    return fits


def second_level(
    query: Query,
    normals: Sequence[NormalRange],
    most: int | None,
    *,
    modelled: bool,
    first: EdgeSet | None = None,
) -> TreeLevel:
    """Pairings of the second contact under each representative edge of the first, which is their `parent`.

    Unless they are `modelled`, the model test is left out. `first`: the first contact's edges, some of which
    only may represent their orbits; None: as the catalogue has them. Raises BudgetSpentError if more than
    `most` are to be looked at; None: there cannot be too many.
    """
    first = first or query.edges[0]
    edge = np.flatnonzero(first.representative)
    lo, hi = orientation_range(normals[0], first, edge)
    found = _level(
        query, normals[1], Interpretations(first.state[edge], edge[:, None], lo, hi), most, modelled=modelled
    )
    return replace(found, children=replace(found.children, parent=edge[found.children.parent]))


def third_level(
    query: Query, normals: Sequence[NormalRange], nodes: Interpretations, *, modelled: bool
) -> TreeLevel:
    """Pairings of the third contact under interpretations of two; otherwise like `second_level`."""
    return _level(query, normals[2], nodes, query.budget.candidates, modelled=modelled)


def _level(
    query: Query, normals: NormalRange, nodes: Interpretations, most: int | None, *, modelled: bool
) -> TreeLevel:
    edges, looked_up, near, parts = query.edges[-1], 0, 0, []
    candidates = int(edges.count[nodes.state].sum())
    earlier = range(len(query.contacts) - 1)
    for rows in split_evenly(len(nodes), candidates // _CHILDREN_AT_ONCE + 1):
        room = None if most is None else most - looked_up
        owner, edge = look_up(query, normals, nodes.select(rows), room)
        looked_up += len(owner)
        parent = rows[owner]
        found = Children(parent, edge, nodes.lo[parent], nodes.hi[parent])
        # Normals are looked up for a whole range of θ; the exact ranges meet for those that distances leave.
        for level in earlier:
            found = found.select(distances_fit(query, level, nodes.edges[found.parent, level], found.edge))
        found = found.narrow(*intersect(found.lo, found.hi, *orientation_range(normals, edges, found.edge)))
        near += len(found)
        if modelled:
            for group in (*combinations(earlier, 1), *combinations(earlier, 2)):
                paired = np.column_stack([nodes.edges[found.parent][:, group], found.edge])
                some = query.select([*group, len(earlier)])
                found = found.narrow(*narrow(some, paired, found.lo, found.hi))
        parts.append(found)
    found = Children.join(parts)
    return TreeLevel(found.select(np.lexsort((found.edge, found.parent))), looked_up, near)


def extend(query: Query, normals: NormalRange, cells: Cells, point: Floats, reach: Floats) -> TreeLevel:
    """Pairings of the last contact under k cells, which are their `parent`.

    In the object's frame it lies within `reach` (k,) mm of `point` (k, 2). Raises BudgetSpentError where
    there are too many to look at.
    """
    finger, edges, most = query.contacts[-1].finger, query.edges[-1], query.budget.candidates

    def near(cell: Ints, start: Floats, end: Floats, stray: Floats) -> Bools:
        along = end - start
        length = np.hypot(along[:, 0], along[:, 1])
        direction = along / np.maximum(length, 1e-300)[:, None]
        away = point_segment_distance(point[cell], start, direction, length)
        return away <= reach[cell] + stray

    rows = cells.state, cells.lo, cells.hi
    cell, edge = matching_edges(query.catalogue, rows, finger, normals, near, most)
    looked_up = len(cell)
    close = near(cell, edges.start[edge], edges.end[edge], edges.slack_mm[edge])
    cell, edge = cell[close], edge[close]
    found = Children(cell, edge, cells.lo[cell], cells.hi[cell])
    found = found.narrow(*intersect(found.lo, found.hi, *orientation_range(normals, edges, edge)))
    return TreeLevel(found, looked_up, len(cell))
