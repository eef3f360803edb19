"""Branches of the interpretation tree: which contacts are paired and which are null, contact by contact.

In the null branch (Grimson and Lozano-Pérez) a contact is spurious. From the fourth contact on, contacts are
paired by pose region: a region says where in the object's frame the new contact must lie, which prunes harder
than distances to the earlier contacts and costs the same however many of those there are.
"""

from collections.abc import Sequence
from dataclasses import astuple, dataclass, replace

import numpy as np

from palpate.base.geometry import Bools, Floats, Ints
from palpate.base.geometry.plane import point_segment_distance
from palpate.recognizer.budget import STANDARD_BUDGET, Budget
from palpate.recognizer.catalogue import Catalogue
from palpate.recognizer.compiled import KERNEL
from palpate.recognizer.compiled_search import further_children
from palpate.recognizer.contact import Contact
from palpate.recognizer.edges import NULL_EDGE
from palpate.recognizer.interpretation_tree import (
    Interpretations,
    LevelCount,
    first_level,
    intersect,
    matching_edges,
    next_level,
    orientation_range,
    second_level,
)
from palpate.recognizer.pose_region import Cells, build_cells, divide_orientations


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
    grown = _merge_by_pairing(nodes, cells.node[owner], edge, lo, hi, len(edges.state))
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


def _merge_by_pairing(
    nodes: Interpretations, node: Ints, edge: Ints, lo: Floats, hi: Floats, edges: int
) -> Interpretations:
    """One new interpretation for each pair of an old one and an edge, over the hull of its orientations."""
    key, inverse = np.unique(node * edges + edge, return_inverse=True)
    hull_lo, hull_hi = np.full(len(key), np.inf), np.full(len(key), -np.inf)
    np.minimum.at(hull_lo, inverse, lo)
    np.maximum.at(hull_hi, inverse, hi)
    return nodes.paired(key // edges, key % edges).narrowed(hull_lo, hull_hi)


TREE_LEVELS = 3  # from the fourth contact on, pose regions prune better than tests on triples
COARSE_RAD = 0.015


@dataclass(frozen=True, eq=False)
class Branch:
    """Interpretations of the touched contacts at `paired`, in order; all others are null.

    `nodes` has a column for each paired contact. `cells`: their region, or None if it is not known yet.
    """

    paired: tuple[int, ...]
    nodes: Interpretations
    cells: Cells | None = None


ROOT_BRANCH = Branch(
    (), Interpretations(np.empty(0, np.int64), np.empty((0, 0), np.int64), np.empty(0), np.empty(0))
)
"""The branch with which a search begins: nothing is paired."""


def grow_branches(
    catalogue: Catalogue,
    branches: Sequence[Branch],
    touched: Sequence[Contact],
    anchor_mm: Floats,
    max_spurious: int,
    budget: Budget = STANDARD_BUDGET,
) -> tuple[list[Branch], LevelCount]:
    """The branches with the last of `touched` paired, and with it null where fewer than `max_spurious` are.

    Also the counts of the level, over all branches. Raises BudgetSpentError where there are too many ways.
    """
    new = len(touched) - 1
    found, counts = [], []
    for branch in branches:
        nodes, count = _pair_last(catalogue, branch, touched, anchor_mm, budget)
        found.append(Branch((*branch.paired, new), nodes))
        counts.append(count)
        if new - len(branch.paired) < max_spurious:
            found.append(branch)
    if len(counts) == 1:
        return found, replace(counts[0], level=len(touched))
    columns = zip(*(astuple(count)[1:] for count in counts), strict=True)
    return found, LevelCount(len(touched), *(sum(column) for column in columns))


def _pair_last(
    catalogue: Catalogue, branch: Branch, touched: Sequence[Contact], anchor_mm: Floats, budget: Budget
) -> tuple[Interpretations, LevelCount]:
    """The branch's interpretations with one more pairing, that of the last contact."""
    earlier, new = [touched[k] for k in branch.paired], touched[-1]
    if not earlier:
        return first_level(catalogue, new)
    if len(earlier) == 1:
        return second_level(catalogue, [*earlier, new], budget)
    if len(earlier) < TREE_LEVELS:
        return next_level(catalogue, branch.nodes, [*earlier, new], anchor_mm, budget)
    cells = branch.cells
    if cells is None:
        cells = build_cells(
            catalogue,
            branch.nodes,
            earlier,
            anchor_mm,
            divide_orientations(branch.nodes, step_rad=COARSE_RAD, least=1),
        )
    return extend_by_region(catalogue, branch.nodes, cells, new, len(touched), anchor_mm, budget)


def join_branches(branches: Sequence[Branch], contacts: int) -> Interpretations:
    """Interpretations of all branches in one, a column for each of `contacts`: null where not paired."""
    parts = []
    for branch in branches:
        columns = np.full((len(branch.nodes), contacts), NULL_EDGE)
        columns[:, list(branch.paired)] = branch.nodes.edges
        parts.append(replace(branch.nodes, edges=columns))
    return Interpretations.joined(parts)


def branches_of(nodes: Interpretations, cells: Cells) -> list[Branch]:
    """The branches that were joined to `nodes`, each with its share of the cells. Empty ones are left out."""
    null = nodes.edges < 0
    if not null.any():
        return [Branch(tuple(range(nodes.edges.shape[1])), nodes, cells)]
    patterns, member = np.unique(null, axis=0, return_inverse=True)
    member = member.ravel()
    return [_select_branch(nodes, cells, pattern, member == k) for k, pattern in enumerate(patterns)]


def _select_branch(nodes: Interpretations, cells: Cells, null: Bools, chosen: Bools) -> Branch:
    columns = np.flatnonzero(~null)
    part = nodes.select(np.flatnonzero(chosen))
    some = cells.select(chosen[cells.node])
    number = np.cumsum(chosen) - 1
    return Branch(
        tuple(int(column) for column in columns),
        replace(part, edges=part.edges[:, columns]),
        replace(some, node=number[some.node]),
    )


def null_mask(nodes: Interpretations, node: Ints, contacts: Sequence[Contact]) -> Bools | None:
    """Which of m contacts, misses included, are null in the interpretations `node` (k,): (k, m).

    None if none of them is. Misses are never null.
    """
    null = nodes.edges[node] < 0
    if not null.any():
        return None
    result = np.zeros((len(node), len(contacts)), dtype=bool)
    result[:, [k for k, contact in enumerate(contacts) if contact.touched]] = null
    return result
