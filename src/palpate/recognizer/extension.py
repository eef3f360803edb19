"""Pairing by region: further contacts under interpretations whose pose regions are already known.

Used from the fourth contact on. A region says where in the object's frame the new contact must lie, which
prunes harder than distances to the earlier contacts and costs the same however many of those there are.
"""

import numpy as np

from palpate.base.geometry import Bools, Floats, Ints
from palpate.base.geometry.segments import point_segment_distance
from palpate.recognizer.budget import STANDARD_BUDGET, Budget
from palpate.recognizer.catalogue import Catalogue
from palpate.recognizer.compiled import KERNEL
from palpate.recognizer.compiled_tree import further_children
from palpate.recognizer.contact import Contact
from palpate.recognizer.edge_lookup import matching_edges
from palpate.recognizer.region import Cells
from palpate.recognizer.tree import (
    Interpretations,
    LevelCount,
    intersect,
    orientation_range,
)

__all__ = ["contact_in_object", "extend_by_region", "split_into_runs"]


def extend_by_region(
    catalogue: Catalogue,
    nodes: Interpretations,
    cells: Cells,
    contact: Contact,
    level: int,
    anchor_mm: Floats,
    budget: Budget = STANDARD_BUDGET,
) -> tuple[Interpretations, LevelCount]:
    """Pair `contact`, the `level`-th, with every edge on which it may lie somewhere in the cells.

    Raises BudgetSpentError where there are too many to look at.
    """
    edges = catalogue.edges(contact.finger)
    candidates = int(np.sum(edges.count[nodes.state]))
    point, reach = contact_in_object(cells, contact, anchor_mm)

    normals = contact.outward_normals()
    if normals is None:
        none = np.empty(0, np.int64)
        return nodes.paired(none, none), LevelCount(level, candidates, 0, 0, 0)
    if KERNEL is not None:
        found = further_children(
            KERNEL,
            edges,
            contact,
            normals,
            (cells.state, cells.lo, cells.hi),
            (point, reach),
            budget.candidates,
        )
        after_angle = found.looked_up
        owner, edge, lo, hi = found.parent, found.edge, found.lo, found.hi
    else:
        owner, edge, after_angle = _near_edges(catalogue, cells, contact, point, reach, budget)
        lo, hi = intersect(cells.lo[owner], cells.hi[owner], *orientation_range(normals, edges, edge))
        meets = lo <= hi
        owner, edge, lo, hi = owner[meets], edge[meets], lo[meets], hi[meets]
    grown = _merged_cells(nodes, cells.node[owner], edge, lo, hi, len(edges.state))
    return grown, LevelCount(level, candidates, after_angle, len(grown), len(grown))


def _near_edges(
    catalogue: Catalogue, cells: Cells, contact: Contact, point: Floats, reach: Floats, budget: Budget
) -> tuple[Ints, Ints, int]:
    """Cells and edges (n,) within reach of points, seen from the object, and how many normals allowed."""
    edges = catalogue.edges(contact.finger)

    def near(query: Ints, start: Floats, end: Floats, stray: Floats) -> Bools:
        along = end - start
        length = np.hypot(along[:, 0], along[:, 1])
        direction = along / np.maximum(length, 1e-300)[:, None]
        away = point_segment_distance(point[query], start, direction, length)
        return away <= reach[query] + stray

    owner, edge = matching_edges(catalogue, cells.state, cells.lo, cells.hi, contact, near, budget.candidates)
    after_angle = len(owner)
    close = near(owner, edges.start[edge], edges.end[edge], edges.slack_mm[edge])
    return owner[close], edge[close], after_angle


def split_into_runs(nodes: Interpretations, cells: Cells) -> tuple[Interpretations, Cells]:
    """Narrow interpretations to their cells; one with a gap between its cells becomes one for each run.

    Cells must be ordered by interpretation and orientation, as they are built.
    """
    if not len(cells):
        return nodes.select(np.empty(0, np.int64)), cells
    begins = np.ones(len(cells), dtype=bool)
    begins[1:] = (np.diff(cells.node) != 0) | (cells.lo[1:] > cells.hi[:-1] + 1e-12)
    first = np.flatnonzero(begins)
    last = np.append(first[1:], len(cells)) - 1
    owner = cells.node[first]
    split = Interpretations(nodes.state[owner], nodes.edges[owner], cells.lo[first], cells.hi[last])
    renumbered = Cells(np.cumsum(begins) - 1, cells.state, cells.lo, cells.hi, cells.polygon)
    return split, renumbered


def contact_in_object(cells: Cells, contact: Contact, anchor_mm: Floats) -> tuple[Floats, Floats]:
    """Where the contact lies in the object's frame: within reach (k,) mm of a point (k, 2), in each cell."""
    x, y = np.asarray(contact.end_mm) - anchor_mm
    cos, sin = np.cos(cells.middle), np.sin(cells.middle)
    point = np.column_stack([cos * x + sin * y, cos * y - sin * x]) - cells.centre
    reach = cells.half_width * np.hypot(x, y) + cells.radius + contact.position_bound_mm
    return point, reach


def _merged_cells(
    nodes: Interpretations, node: Ints, edge: Ints, lo: Floats, hi: Floats, edges: int
) -> Interpretations:
    """One new interpretation for each pair of an old one and an edge, over the hull of its orientations."""
    key, inverse = np.unique(node * edges + edge, return_inverse=True)
    hull_lo, hull_hi = np.full(len(key), np.inf), np.full(len(key), -np.inf)
    np.minimum.at(hull_lo, inverse, lo)
    np.maximum.at(hull_hi, inverse, hi)
    return nodes.paired(key // edges, key % edges).narrowed(hull_lo, hull_hi)
