"""Interpretation tree (memo §2): pairings of contacts with edges, grown level by level and pruned.

Breadth first, as whole-array operations over the whole catalogue. Each level is pruned by angle, by distance,
and by the closed-form model test on two and on three contacts.

*Branches.* In the null branch (Grimson and Lozano-Pérez) a contact is spurious. From the fourth contact on,
contacts are paired by pose region: a region says where in the object's frame the new contact must lie, which
prunes harder than distances to the earlier contacts and costs the same however many of those there are.
"""

from collections.abc import Sequence
from dataclasses import astuple, dataclass, replace

import numpy as np

from palpate.base.geometry import Bools, Floats
from palpate.recognizer.budget import BudgetSpentError
from palpate.recognizer.catalogue import Catalogue
from palpate.recognizer.contact import Contact, NormalRange
from palpate.recognizer.edges import NULL_EDGE, EdgeSet
from palpate.recognizer.interpretations import (
    Children,
    Interpretations,
    LevelCount,
    Query,
    intersect,
    orientation_range,
)
from palpate.recognizer.numpy_pairing import distances_fit, look_up
from palpate.recognizer.pose_region import Cells, divide_orientations
from palpate.recognizer.steps import STEPS
from palpate.recognizer.tables import expand_ranges


def first_level(catalogue: Catalogue, contact: Contact) -> tuple[Interpretations, LevelCount]:
    """Pair the first contact with one edge of every symmetric orbit in the catalogue (memo Fig. 4)."""
    edges = catalogue.edges(contact.finger)
    edge = np.flatnonzero(edges.representative)
    normals = contact.outward_normals()
    kept = edge if normals is not None else edge[:0]
    lo, hi = orientation_range(normals or NormalRange(0.0, 0.0), edges, kept)
    nodes = _narrow_by_pocket(
        catalogue, Interpretations(edges.state[kept], kept[:, None], lo, hi), 0, contact
    )
    return nodes, LevelCount(1, len(edge), len(nodes), len(nodes), len(nodes))


def second_level(query: Query, nodes: Interpretations) -> tuple[Interpretations, LevelCount]:
    """Both first contacts at once, the first on edges that it has in `nodes`.

    Raises BudgetSpentError where there are too many ways.
    """
    first, second = _only_in(nodes, query.edges[0]), query.edges[1]
    candidates = int(np.sum(first.representative * second.count[first.state]))
    if query.normals is None:
        return Interpretations.none(2), LevelCount(2, candidates, 0, 0, 0)
    pocketed = [
        level for level, contact in enumerate(query.contacts) if _has_pockets(query.catalogue, contact)
    ]
    most = query.budget.pairs if candidates > query.budget.pairs else None
    found = STEPS.second_level(query, query.normals, most, modelled=not pocketed, first=first)
    edge = found.children.parent
    pair = np.column_stack([edge, found.children.edge])
    nodes = Interpretations(first.state[edge], pair, found.children.lo, found.children.hi)
    for level in pocketed:
        nodes = _narrow_by_pocket(query.catalogue, nodes, level, query.contacts[level])
    unmodelled = len(nodes)
    if pocketed:
        nodes = narrow_by(query, nodes, 0)
    _check_room(query, nodes)
    return nodes, LevelCount(2, candidates, found.near, unmodelled, len(nodes))


def _only_in(nodes: Interpretations, edges: EdgeSet) -> EdgeSet:
    """A contact's edges, of which only those in `nodes` represent their orbits."""
    representative = np.zeros_like(edges.representative)
    representative[nodes.edges[:, 0]] = True
    if np.array_equal(representative, edges.representative):
        return edges
    return replace(edges, representative=representative)


def third_level(query: Query, nodes: Interpretations) -> tuple[Interpretations, LevelCount]:
    """Pair the last of three contacts under `nodes`, which pair both before it.

    Raises BudgetSpentError where there are too many ways.
    """
    candidates = int(query.edges[-1].count[nodes.state].sum())
    if query.normals is None:
        return Interpretations.none(3), LevelCount(3, candidates, 0, 0, 0)
    pocketed = _has_pockets(query.catalogue, query.contacts[-1])
    found = STEPS.third_level(query, query.normals, nodes, modelled=not pocketed)
    grown = nodes.extend(found.children)
    if pocketed:
        grown = _narrow_by_pocket(query.catalogue, grown, 2, query.contacts[-1])
        for group in ((0,), (1,), (0, 1)):
            grown = narrow_by(query, grown, *group)
    _check_room(query, grown)
    return grown, LevelCount(3, candidates, found.looked_up, found.near, len(grown))


def _check_room(query: Query, nodes: Interpretations) -> None:
    if len(nodes) > query.budget.interpretations:
        raise BudgetSpentError


def pair_by_angle(query: Query, nodes: Interpretations) -> Interpretations:
    """Pair the last contact with every edge whose normal it allows, under `nodes`, which pair the others."""
    contact, edges = query.contacts[-1], query.edges[-1]
    normals = contact.outward_normals()
    if normals is None:
        return Interpretations.none(len(query.contacts))
    parent, edge = look_up(query, normals, nodes)
    found = Children(parent, edge, nodes.lo[parent], nodes.hi[parent])
    found = found.narrow(*intersect(found.lo, found.hi, *orientation_range(normals, edges, edge)))
    return _narrow_by_pocket(query.catalogue, nodes.extend(found), len(query.contacts) - 1, contact)


def _narrow_by_pocket(
    catalogue: Catalogue, nodes: Interpretations, level: int, contact: Contact
) -> Interpretations:
    """Orientations at which the finger could reach its edge from where it came (memo §2.2.2).

    A pocket of several arcs makes several interpretations of one. Pockets are looked at only where no normal
    is known: a measured one says more, and the exact test of the path comes later for all.
    """
    if not len(nodes) or not _has_pockets(catalogue, contact):
        return nodes
    pockets = catalogue.pockets(
        contact.finger, max(contact.position_bound_mm, contact.free_path_bound_mm), contact.travel_mm
    )
    edge = nodes.edges[:, level]
    owner, arc = expand_ranges(pockets.first[edge], np.diff(pockets.first)[edge])
    error = contact.direction_bound_rad
    lo = contact.direction_rad - pockets.hi_rad[arc] - error
    hi = np.minimum(contact.direction_rad - pockets.lo_rad[arc] + error, lo + 2 * np.pi)
    reached = nodes.select(owner)
    return reached.narrow(*intersect(reached.lo, reached.hi, lo, hi))


def _has_pockets(catalogue: Catalogue, contact: Contact) -> bool:
    """Edges that overlap have none: the exact test of the path sees to it."""
    return contact.normal is None and catalogue.edges(contact.finger) is catalogue.outlines(contact.finger)


def filter_by_distance(query: Query, nodes: Interpretations, level: int) -> Interpretations:
    """Interpretations whose last edge may be as far from the one at `level` as the contacts are apart."""
    return nodes.select(distances_fit(query, level, nodes.edges[:, level], nodes.edges[:, -1]))


def narrow_by(query: Query, nodes: Interpretations, *earlier: int) -> Interpretations:
    """Narrow by the model test of the last contact and one or two `earlier` ones."""
    group = [*earlier, len(query.contacts) - 1]
    return nodes.narrow(*STEPS.narrow(query.select(group), nodes.edges[:, group], nodes.lo, nodes.hi))


def _extend_by_region(query: Query, branch: "Branch", cells: Cells) -> "Growth":
    """Pair the last contact with every edge on which it may lie somewhere in the cells of a branch.

    Raises BudgetSpentError where there are too many to look at.
    """
    contact, edges, level, nodes = query.contacts[-1], query.edges[-1], len(query.contacts), branch.nodes
    candidates = int(np.sum(edges.count[nodes.state]))
    normals = contact.outward_normals()
    if normals is None:
        none = np.empty(0, np.int64)
        count = LevelCount(level, candidates, 0, 0, 0)
        return Growth(Interpretations.none(level), count, replace(branch, nodes=nodes.select(none)))
    found = STEPS.extend(query, normals, cells, *contact_in_object(cells, contact, query.anchor_mm))
    paired = _merge_by_pairing(found.children, cells, len(edges.state))
    count = LevelCount(level, candidates, found.looked_up, len(paired), len(paired))
    return Growth(nodes.extend(paired), count, _narrow_to_children(branch, cells, paired, found.children))


def _narrow_to_children(branch: "Branch", cells: Cells, paired: Children, of_cells: Children) -> "Branch":
    """The branch with its cells, without interpretations and cells that a further contact rules out."""
    nodes = branch.nodes
    lo, hi = np.full(len(nodes), np.inf), np.full(len(nodes), -np.inf)
    np.minimum.at(lo, paired.parent, paired.lo)
    np.maximum.at(hi, paired.parent, paired.hi)
    alive = lo <= hi
    kept = np.zeros(len(cells), dtype=bool)
    kept[of_cells.parent] = True
    some = cells.select(kept)
    number = np.cumsum(alive) - 1
    return Branch(branch.paired, nodes.narrow(lo, hi), replace(some, node=number[some.node]))


def split_into_runs(nodes: Interpretations, cells: Cells) -> tuple[Interpretations, Cells]:
    """Narrow interpretations to their cells; one with a gap between its cells becomes one for each run.

    Cells must be ordered by interpretation and least orientation. Finer ones may lie within wider ones.
    """
    if not len(cells):
        return nodes.select(np.empty(0, np.int64)), cells
    order = np.lexsort((cells.hi, cells.node))
    rank = np.empty(len(cells), np.int64)
    rank[order] = np.arange(len(cells))
    reach = cells.hi[order[np.maximum.accumulate(rank)]]  # of all cells of the interpretation so far
    begins = np.ones(len(cells), dtype=bool)
    begins[1:] = (np.diff(cells.node) != 0) | (cells.lo[1:] > reach[:-1] + 1e-12)
    first = np.flatnonzero(begins)
    last = np.append(first[1:], len(cells)) - 1
    owner = cells.node[first]
    split = Interpretations(nodes.state[owner], nodes.edges[owner], cells.lo[first], reach[last])
    renumbered = Cells(np.cumsum(begins) - 1, cells.state, cells.lo, cells.hi, cells.polygon)
    return split, renumbered


def contact_in_object(cells: Cells, contact: Contact, anchor_mm: Floats) -> tuple[Floats, Floats]:
    """Place of the contact in the object's frame, in each cell: within reach (k,) mm of a point (k, 2)."""
    x, y = np.asarray(contact.end_mm) - anchor_mm
    cos, sin = np.cos(cells.middle), np.sin(cells.middle)
    point = np.column_stack([cos * x + sin * y, cos * y - sin * x]) - cells.centre
    reach = cells.half_width * np.hypot(x, y) + cells.radius + contact.position_bound_mm
    return point, reach


def _merge_by_pairing(found: Children, cells: Cells, edges: int) -> Children:
    """One pairing for each interpretation and edge (of so many), over the hull of its orientations."""
    key, inverse = np.unique(cells.node[found.parent] * edges + found.edge, return_inverse=True)
    lo, hi = np.full(len(key), np.inf), np.full(len(key), -np.inf)
    np.minimum.at(lo, inverse, found.lo)
    np.maximum.at(hi, inverse, found.hi)
    return Children(key // edges, key % edges, lo, hi)


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


ROOT_BRANCH = Branch((), Interpretations.none(0))
"""The branch with which a search begins: nothing is paired."""


@dataclass(frozen=True, eq=False)
class Growth:
    """Interpretations of a branch with one more pairing; and `narrowed`, the branch without that pairing.

    What is narrowed lies where the contact can be on some edge, unless the contact may be spurious.
    """

    nodes: Interpretations
    count: LevelCount
    narrowed: Branch


def grow_branches(
    query: Query, branches: Sequence[Branch], max_spurious: int
) -> tuple[list[Branch], list[Branch], LevelCount]:
    """The branches with the last contact paired, and with it null where fewer than `max_spurious` are.

    Also the branches without it, narrowed by it where it is not spurious, and the counts of the level over
    all branches. Raises BudgetSpentError where there are too many ways.
    """
    new = len(query.contacts) - 1
    found, narrowed, counts = [], [], []
    for branch in branches:
        growth = _pair_last(query, branch)
        found.append(Branch((*branch.paired, new), growth.nodes))
        narrowed.append(branch if max_spurious else growth.narrowed)
        counts.append(growth.count)
        if new - len(branch.paired) < max_spurious:
            found.append(branch)
    if len(counts) == 1:
        return found, narrowed, replace(counts[0], level=len(query.contacts))
    columns = zip(*(astuple(count)[1:] for count in counts), strict=True)
    return found, narrowed, LevelCount(len(query.contacts), *(sum(column) for column in columns))


def _pair_last(query: Query, branch: Branch) -> Growth:
    """The branch's interpretations with one more pairing, that of the last contact."""
    paired = query.select([*branch.paired, len(query.contacts) - 1])
    if not branch.paired:
        return Growth(*first_level(query.catalogue, query.contacts[-1]), branch)
    if len(branch.paired) == 1:
        return Growth(*second_level(paired, branch.nodes), branch)
    if len(branch.paired) < TREE_LEVELS:
        return Growth(*third_level(paired, branch.nodes), branch)
    cells = branch.cells
    if cells is None:
        nodes = branch.nodes
        step_rad = max(COARSE_RAD, float(np.sum(nodes.hi - nodes.lo)) / query.budget.pairing_cells)
        intervals = divide_orientations(nodes, step_rad=step_rad, least=1)
        cells, _ = STEPS.cut_cells(query.select(branch.paired), nodes, intervals)
    return _extend_by_region(paired, branch, cells)


def join_branches(branches: Sequence[Branch], contacts: int) -> Interpretations:
    """Interpretations of all branches in one, a column for each of `contacts`: null where not paired."""
    parts = []
    for branch in branches:
        columns = np.full((len(branch.nodes), contacts), NULL_EDGE)
        columns[:, list(branch.paired)] = branch.nodes.edges
        parts.append(replace(branch.nodes, edges=columns))
    return Interpretations.join(parts)


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
