"""Interpretation tree (memo §2): pairings of contacts with edges, grown level by level and pruned.

Every interpretation has an interval of orientations. Breadth first, as whole-array operations over the whole
catalogue. Each level is pruned by angle (a range look-up in the sorted normals, or a descent of the strip
tree for states with very many edges, memo §3.3), by distance, and by the closed-form model test on two and on
three contacts.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import combinations
from types import ModuleType

import numpy as np

from palpate.base.geometry import Bools, Floats, Ints
from palpate.base.geometry.plane import distance_range, wrap_angle
from palpate.recognizer.budget import STANDARD_BUDGET, Budget, BudgetSpentError
from palpate.recognizer.catalogue import Catalogue
from palpate.recognizer.compiled import KERNEL
from palpate.recognizer.compiled_search import second_level_children, third_level_children
from palpate.recognizer.contact import Contact, NormalRange
from palpate.recognizer.edges import EdgeSet
from palpate.recognizer.model_test import three_contact_hull, two_contact_hull
from palpate.recognizer.tables import Table, expand_ranges

NearTest = Callable[[Ints, Floats, Floats, Floats], Bools]
"""Whether, for query (n,), the contact may lie within stray (n,) mm of segments from start to end (n, 2)."""

_ROUNDING_RAD = 1e-9


def matching_edges(
    catalogue: Catalogue,
    state: Ints,
    lo: Floats,
    hi: Floats,
    contact: Contact,
    near: NearTest,
    most: int | None = None,
) -> tuple[Ints, Ints]:
    """Edges of `state` (m,) whose normals fit `contact` at some θ in [lo, hi] (m,), for m queries.

    Where there are so many that a strip tree is descended, `near` holds as well. Returns (query, edge), flat.
    Raises BudgetSpentError where there are more than `most`.
    """
    normals = contact.outward_normals()
    if normals is None:
        return np.empty(0, np.int64), np.empty(0, np.int64)
    edges, strips = catalogue.edges(contact.finger), catalogue.strips(contact.finger)
    large = strips.root[state] >= 0
    small = np.flatnonzero(~large)
    margin = float(np.max(edges.span, initial=0.0))
    width = np.minimum(normals.hi_rad - normals.lo_rad + 2 * margin + (hi - lo)[small], 2 * np.pi)
    owner, edge = edges.by_normal(state[small], normals.lo_rad - margin - hi[small], width, most)
    owner = small[owner]
    if not large.any():
        return owner, edge
    rows = np.flatnonzero(large)
    middle = (normals.lo_rad + normals.hi_rad - lo - hi)[rows] / 2
    half = (normals.hi_rad - normals.lo_rad + hi - lo)[rows] / 2 + _ROUNDING_RAD

    def keep(query: Ints, strip: Ints) -> Bools:
        kept = (
            np.abs(wrap_angle(strips.normal[strip] - middle[query])) <= half[query] + strips.half_turn[strip]
        )
        some = np.flatnonzero(kept)
        at = strip[some]
        kept[some] = near(rows[query[some]], strips.start[at], strips.end[at], strips.stray[at])
        return kept

    query, found = strips.descend(state[rows], keep, None if most is None else most - len(owner))
    return np.concatenate([owner, rows[query]]), np.concatenate([edge, found])


_CHILDREN_AT_ONCE = 1_000_000
_NODES_AT_ONCE = 8192  # interpretations tested at once: keeps the largest temporary array near 20 MB


@dataclass(frozen=True)
class LevelCount:
    """How many interpretations a level of the tree had at each step (the memo's columns n, nA, nD, M)."""

    level: int
    candidates: int
    after_angle: int
    after_distance: int
    after_model: int


@dataclass(frozen=True, eq=False)
class Interpretations(Table):
    """n k-interpretations: `state` (n,), `edges` (n, k) in contact order, θ within [`lo`, `hi`] (n,) rad."""

    state: Ints
    edges: Ints
    lo: Floats
    hi: Floats

    def paired(self, owner: Ints, edge: Ints) -> "Interpretations":
        """(k + 1)-interpretations: those at `owner` (m,), each with one more pairing, `edge` (m,)."""
        edges = np.column_stack([self.edges[owner], edge])
        return Interpretations(self.state[owner], edges, self.lo[owner], self.hi[owner])

    def turned(self, bound_rad: Floats) -> "Interpretations":
        """The same after turns of up to `bound_rad` (n,); those of one pairing that meet become one."""
        pairings = np.column_stack([self.state, self.edges])
        key = np.unique(pairings, axis=0, return_inverse=True)[1].ravel()
        order = np.lexsort((self.lo, key))
        key, lo, hi = key[order], (self.lo - bound_rad)[order], (self.hi + bound_rad)[order]
        begins = np.ones(len(key), dtype=bool)
        begins[1:] = (key[1:] != key[:-1]) | (lo[1:] > hi[:-1])
        first = np.flatnonzero(begins)
        if not len(first):
            return self
        hi = np.minimum(np.maximum.reduceat(hi, first), lo[first] + 2 * np.pi)
        return replace(self.select(order[first]), lo=lo[first], hi=hi)

    def narrowed(self, lo: Floats, hi: Floats) -> "Interpretations":
        """The same with other orientation intervals; those with none left are dropped."""
        return replace(self, lo=lo, hi=hi).select(np.flatnonzero(lo <= hi))


def orientation_range(normals: NormalRange, edges: EdgeSet, edge: Ints) -> tuple[Floats, Floats]:
    """Orientations (lo, hi), each (n,), that turn an edge's normal into the given range (memo §2.2.2)."""
    psi, span = edges.normal_rad[edge], edges.span[edge]
    lo = normals.lo_rad - psi - span
    width = np.minimum(normals.hi_rad - normals.lo_rad + 2 * span, 2 * np.pi)
    return lo, lo + width


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


def second_level(
    catalogue: Catalogue, contacts: list[Contact], budget: Budget = STANDARD_BUDGET
) -> tuple[Interpretations, LevelCount]:
    """Both first contacts at once, by look-up: the same as `next_level` after `first_level`."""
    one, two = contacts
    first, second = catalogue.edges(one.finger), catalogue.edges(two.finger)
    candidates = int(np.sum(first.representative * second.count[first.state]))
    normals_1, normals_2 = one.outward_normals(), two.outward_normals()
    if normals_1 is None or normals_2 is None:
        nothing = np.empty(0, np.int64)
        none = Interpretations(nothing, np.empty((0, 2), np.int64), np.empty(0), np.empty(0))
        return none, LevelCount(2, candidates, 0, 0, 0)
    pocketed = [level for level, contact in enumerate(contacts) if _has_pockets(catalogue, contact)]
    if KERNEL is not None:
        found = second_level_children(
            KERNEL,
            (first, second),
            contacts,
            (normals_1, normals_2),
            budget.pairs if candidates > budget.pairs else None,
            modelled=not pocketed,
        )
        pair = np.column_stack([found.parent, found.edge])
        paired = Interpretations(first.state[found.parent], pair, found.lo, found.hi)
        after_distance = found.near
    else:
        paired, after_distance = _second_level_pairs(catalogue, contacts, normals_1, normals_2, budget)
    for level in pocketed:
        paired = _narrow_by_pocket(catalogue, paired, level, contacts[level])
    after_angle = len(paired)
    if KERNEL is None or pocketed:
        paired = narrow_by_two(catalogue, paired, 0, contacts)
    if len(paired) > budget.interpretations:
        raise BudgetSpentError
    return paired, LevelCount(2, candidates, after_distance, after_angle, len(paired))


def _second_level_pairs(
    catalogue: Catalogue,
    contacts: list[Contact],
    normals_1: NormalRange,
    normals_2: NormalRange,
    budget: Budget,
) -> tuple[Interpretations, int]:
    """Pairs that angle and distance leave, by look-up in the table of pairs, and how many distance left."""
    one, two = contacts
    first, second = catalogue.edges(one.finger), catalogue.edges(two.finger)
    edge_a, edge_b = catalogue.pairs(one.finger, two.finger).between(
        normals_1,
        normals_2,
        (two.end_mm[0] - one.end_mm[0], two.end_mm[1] - one.end_mm[1]),
        one.position_bound_mm + two.position_bound_mm,
        budget.pairs,
    )
    lo, hi = orientation_range(normals_1, first, edge_a)
    lo, hi = intersect(lo, hi, *orientation_range(normals_2, second, edge_b))
    paired = Interpretations(first.state[edge_a], np.column_stack([edge_a, edge_b]), lo, hi)
    return _sort_by_edge(paired.narrowed(lo, hi)), len(paired)


def _sort_by_edge(nodes: Interpretations) -> Interpretations:
    """The kernel's order: where not all regions can be cut finer, it decides between those of equal size."""
    return nodes.select(np.lexsort(nodes.edges.T[::-1]))


def next_level(
    catalogue: Catalogue,
    nodes: Interpretations,
    contacts: list[Contact],
    anchor_mm: Floats,
    budget: Budget = STANDARD_BUDGET,
) -> tuple[Interpretations, LevelCount]:
    """Pair the last of `contacts` with edges, under `nodes`, which pair all those before it.

    Raises BudgetSpentError where there are too many ways.
    """
    contact = contacts[-1]
    candidates = int(catalogue.edges(contact.finger).count[nodes.state].sum())
    if KERNEL is not None and len(contacts) == 3:
        grown, after_angle, after_distance = _third_level(
            KERNEL, catalogue, nodes, contacts, anchor_mm, budget
        )
    else:
        grown, after_angle, after_distance = _level_by_parts(catalogue, nodes, contacts, anchor_mm, budget)
    if len(grown) > budget.interpretations:
        raise BudgetSpentError
    return grown, LevelCount(len(contacts), candidates, after_angle, after_distance, len(grown))


def _level_by_parts(
    catalogue: Catalogue, nodes: Interpretations, contacts: list[Contact], anchor_mm: Floats, budget: Budget
) -> tuple[Interpretations, int, int]:
    """Children, and how many angle, and then distance, left."""
    contact = contacts[-1]
    candidates = int(catalogue.edges(contact.finger).count[nodes.state].sum())
    after_angle, after_distance, parts = 0, 0, []
    for rows in np.array_split(np.arange(len(nodes)), candidates // _CHILDREN_AT_ONCE + 1):
        # Normals are looked up for a whole range of θ; the exact ranges meet for those that distances leave.
        room = budget.candidates - after_angle
        grown = _look_up(catalogue, nodes.select(rows), contacts[:-1], contact, room)
        after_angle += len(grown)
        for level, earlier in enumerate(contacts[:-1]):
            grown = filter_by_distance(catalogue, grown, level, earlier, contact)
        grown = _fit_orientations(catalogue, grown, contact)
        after_distance += len(grown)
        parts.append(_narrow_by_model(catalogue, grown, contacts, anchor_mm))
    return _sort_by_edge(Interpretations.joined(parts)), after_angle, after_distance


def _third_level(
    kernel: ModuleType,
    catalogue: Catalogue,
    nodes: Interpretations,
    contacts: list[Contact],
    anchor_mm: Floats,
    budget: Budget,
) -> tuple[Interpretations, int, int]:
    """The same by the compiled kernel."""
    normals = [contact.outward_normals() for contact in contacts]
    if None in normals:
        return nodes.paired(np.empty(0, np.int64), np.empty(0, np.int64)), 0, 0
    one, two, three = (catalogue.edges(contact.finger) for contact in contacts)
    pocketed = _has_pockets(catalogue, contacts[-1])
    found = third_level_children(
        kernel,
        (one, two, three),
        contacts,
        [item for item in normals if item],
        anchor_mm,
        (nodes.state, nodes.edges, nodes.lo, nodes.hi),
        budget.candidates,
        modelled=not pocketed,
    )
    grown = replace(nodes.paired(found.parent, found.edge), lo=found.lo, hi=found.hi)
    if pocketed:
        grown = _narrow_by_pocket(catalogue, grown, 2, contacts[-1])
        grown = _narrow_by_model(catalogue, grown, contacts, anchor_mm)
    return grown, found.looked_up, found.near


def pair_by_angle(
    catalogue: Catalogue, nodes: Interpretations, earlier: list[Contact], contact: Contact
) -> Interpretations:
    """Pair `contact` with every edge whose normal it allows, under `nodes`, which pair the `earlier` ones."""
    return _fit_orientations(catalogue, _look_up(catalogue, nodes, earlier, contact), contact)


def _look_up(
    catalogue: Catalogue,
    nodes: Interpretations,
    earlier: list[Contact],
    contact: Contact,
    most: int | None = None,
) -> Interpretations:
    def near(query: Ints, start: Floats, end: Floats, stray: Floats) -> Bools:
        fits = np.ones(len(query), dtype=bool)
        for level, other in enumerate(earlier):
            first, edge = catalogue.edges(other.finger), nodes.edges[query, level]
            shortest, longest = distance_range(first.start[edge], first.end[edge], start, end)
            slack = stray + first.slack_mm[edge] + other.position_bound_mm + contact.position_bound_mm
            measured = np.hypot(contact.end_mm[0] - other.end_mm[0], contact.end_mm[1] - other.end_mm[1])
            fits &= (measured >= shortest - slack) & (measured <= longest + slack)
        return fits

    owner, edge = matching_edges(catalogue, nodes.state, nodes.lo, nodes.hi, contact, near, most)
    return nodes.paired(owner, edge)


def _fit_orientations(catalogue: Catalogue, paired: Interpretations, contact: Contact) -> Interpretations:
    """Orientations at which `contact`, the last that is paired, has a normal and a path that it allows."""
    normals = contact.outward_normals()
    if normals is None:
        return paired
    edges, edge = catalogue.edges(contact.finger), paired.edges[:, -1]
    paired = paired.narrowed(*intersect(paired.lo, paired.hi, *orientation_range(normals, edges, edge)))
    return _narrow_by_pocket(catalogue, paired, paired.edges.shape[1] - 1, contact)


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
    return reached.narrowed(*intersect(reached.lo, reached.hi, lo, hi))


def _has_pockets(catalogue: Catalogue, contact: Contact) -> bool:
    """Edges that overlap have none: the exact test of the path sees to it."""
    return contact.normal is None and catalogue.edges(contact.finger) is catalogue.outlines(contact.finger)


def intersect(lo: Floats, hi: Floats, other_lo: Floats, other_hi: Floats) -> tuple[Floats, Floats]:
    """Hull of the part of [lo, hi] inside [other_lo, other_hi] modulo 2π; lo > hi where there is none."""
    width, other_width = hi - lo, other_hi - other_lo
    begin = (other_lo - lo) % (2 * np.pi)
    tail = begin - 2 * np.pi + other_width
    first = np.where(tail >= 0, 0.0, np.where(begin <= width, begin, np.inf))
    last = np.where(begin <= width, np.minimum(width, begin + other_width), np.minimum(width, tail))
    return lo + first, lo + last


def filter_by_distance(
    catalogue: Catalogue, nodes: Interpretations, level: int, earlier: Contact, contact: Contact
) -> Interpretations:
    """Those whose last edge may be as far from the one at `level` as `contact` is from the `earlier` one."""
    shortest, longest = catalogue.pairs(earlier.finger, contact.finger).ranges(
        nodes.state, nodes.edges[:, level], nodes.edges[:, -1]
    )
    measured = np.hypot(contact.end_mm[0] - earlier.end_mm[0], contact.end_mm[1] - earlier.end_mm[1])
    bound = earlier.position_bound_mm + contact.position_bound_mm
    return nodes.select(np.flatnonzero((measured >= shortest - bound) & (measured <= longest + bound)))


def _narrow_by_model(
    catalogue: Catalogue, nodes: Interpretations, contacts: list[Contact], anchor_mm: Floats
) -> Interpretations:
    """Narrow by the closed-form test of the new contact with each earlier one and with each earlier pair."""
    for old in range(len(contacts) - 1):
        nodes = narrow_by_two(catalogue, nodes, old, contacts)
    for pair in combinations(range(len(contacts) - 1), 2):
        nodes = narrow_by_three(catalogue, nodes, pair, contacts, anchor_mm)
    return nodes


def narrow_by_two(
    catalogue: Catalogue, nodes: Interpretations, old: int, contacts: list[Contact]
) -> Interpretations:
    """Narrow by the model test of two contacts, the last of `contacts` and the one at `old`."""
    paired, some = nodes.edges[:, [old, -1]], [contacts[old], contacts[-1]]
    return nodes.narrowed(*two_contact_hull(catalogue, paired, some, nodes.lo, nodes.hi))


def narrow_by_three(
    catalogue: Catalogue,
    nodes: Interpretations,
    pair: tuple[int, ...],
    contacts: list[Contact],
    anchor_mm: Floats,
) -> Interpretations:
    """Narrow by the model test of three contacts, the last of `contacts` and the `pair`."""
    group = [*pair, len(contacts) - 1]
    some = [contacts[k] for k in group]
    parts = []
    for rows in np.array_split(np.arange(len(nodes)), len(nodes) // _NODES_AT_ONCE + 1):
        part = nodes.select(rows)
        hull = three_contact_hull(catalogue, part.edges[:, group], some, anchor_mm, part.lo, part.hi)
        parts.append(part.narrowed(*hull))
    return Interpretations.joined(parts)
