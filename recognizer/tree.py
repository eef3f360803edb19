"""The interpretation tree (memo §2): pairings of contacts with edges, grown level by level and pruned.

From contacts to surviving interpretations, each with an interval of orientations. Breadth first, as
whole-array operations over the whole catalogue. Each level is pruned by angle (a range look-up in the sorted
normals), by distance, and by the closed-form model test on two and on three contacts.
"""

from dataclasses import dataclass
from itertools import combinations

import numpy as np

from palpate.recognizer.arcs import TRIPLE_TRIPLES, all_half_planes, arc_hull, triple_arcs
from palpate.recognizer.arrays import Bools, Floats, Ints
from palpate.recognizer.candidates import paired_edges
from palpate.recognizer.catalogue import Catalogue
from palpate.recognizer.chord import chord_hull
from palpate.recognizer.contact import Contact, NormalRange
from palpate.recognizer.edges import EdgeSet
from palpate.recognizer.segments import distance_range

__all__ = [
    "Interpretations",
    "LevelCount",
    "by_angle",
    "by_chord",
    "by_distance",
    "by_triple",
    "first_level",
    "intersect",
    "next_level",
    "orientation_range",
    "second_level",
]

_CHUNK = 8192  # interpretations tested at once: keeps the largest temporary array near 20 MB


@dataclass(frozen=True)
class LevelCount:
    """How many interpretations a level of the tree had at each step (the memo's columns n, nA, nD, M)."""

    level: int
    candidates: int
    after_angle: int
    after_distance: int
    after_model: int


@dataclass(frozen=True, eq=False)
class Interpretations:
    """n k-interpretations: `state` (n,), `edges` (n, k) in contact order, θ within [`lo`, `hi`] (n,) rad."""

    state: Ints
    edges: Ints
    lo: Floats
    hi: Floats

    def __len__(self) -> int:
        return len(self.state)

    def select(self, index: Ints) -> "Interpretations":
        """Those at `index` (integers or a mask)."""
        return Interpretations(self.state[index], self.edges[index], self.lo[index], self.hi[index])

    def paired(self, owner: Ints, edge: Ints) -> "Interpretations":
        """(k + 1)-interpretations: those at `owner` (m,), each with one more pairing, `edge` (m,)."""
        edges = np.column_stack([self.edges[owner], edge])
        return Interpretations(self.state[owner], edges, self.lo[owner], self.hi[owner])

    def narrowed(self, lo: Floats, hi: Floats) -> "Interpretations":
        """The same with other orientation intervals; those with none left are dropped."""
        narrowed = Interpretations(self.state, self.edges, lo, hi)
        return narrowed.select(np.flatnonzero(lo <= hi))


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
    count = LevelCount(1, len(edge), len(kept), len(kept), len(kept))
    return Interpretations(edges.state[kept], kept[:, None], lo, hi), count


def second_level(catalogue: Catalogue, contacts: list[Contact]) -> tuple[Interpretations, LevelCount]:
    """Both first contacts at once, by look-up: the same as `next_level` after `first_level`."""
    one, two = contacts
    first, second = catalogue.edges(one.finger), catalogue.edges(two.finger)
    candidates = int(np.sum(first.representative * second.count[first.state]))
    normals_1, normals_2 = one.outward_normals(), two.outward_normals()
    if normals_1 is None or normals_2 is None:
        nothing = np.empty(0, np.int64)
        none = Interpretations(nothing, np.empty((0, 2), np.int64), np.empty(0), np.empty(0))
        return none, LevelCount(2, candidates, 0, 0, 0)
    edge_a, edge_b = catalogue.pairs(one.finger, two.finger).between(
        normals_2.lo_rad - normals_1.hi_rad,
        normals_2.hi_rad - normals_1.lo_rad,
        float(np.hypot(two.end_mm[0] - one.end_mm[0], two.end_mm[1] - one.end_mm[1])),
        one.position_bound_mm + two.position_bound_mm,
    )
    lo, hi = orientation_range(normals_1, first, edge_a)
    lo, hi = intersect(lo, hi, *orientation_range(normals_2, second, edge_b))
    paired = Interpretations(first.state[edge_a], np.column_stack([edge_a, edge_b]), lo, hi)
    after_distance = len(paired)
    paired = paired.narrowed(lo, hi)
    after_angle = len(paired)
    paired = paired.narrowed(
        *chord_hull(first, paired.edges[:, 0], one, second, paired.edges[:, 1], two, paired.lo, paired.hi)
    )
    return paired, LevelCount(2, candidates, after_distance, after_angle, len(paired))


def next_level(
    catalogue: Catalogue, nodes: Interpretations, contacts: list[Contact], anchor_mm: Floats
) -> tuple[Interpretations, LevelCount]:
    """Pair the last of `contacts` with edges, under `nodes`, which pair all those before it."""
    contact = contacts[-1]
    edges = catalogue.edges(contact.finger)
    candidates = int(np.sum(edges.count[nodes.state]))
    grown = by_angle(catalogue, nodes, contacts[:-1], contact)
    after_angle = len(grown)
    for level, earlier in enumerate(contacts[:-1]):
        grown = by_distance(catalogue, grown, level, earlier, contact)
    after_distance = len(grown)
    grown = _by_model(catalogue, grown, contacts, anchor_mm)
    return grown, LevelCount(len(contacts), candidates, after_angle, after_distance, len(grown))


def by_angle(
    catalogue: Catalogue, nodes: Interpretations, earlier: list[Contact], contact: Contact
) -> Interpretations:
    """Pair `contact` with every edge whose normal it allows, under `nodes`, which pair the `earlier` ones."""
    normals = contact.outward_normals()

    def near(query: Ints, start: Floats, end: Floats, stray: Floats) -> Bools:
        fits = np.ones(len(query), dtype=bool)
        for level, other in enumerate(earlier):
            first, edge = catalogue.edges(other.finger), nodes.edges[query, level]
            shortest, longest = distance_range(first.start[edge], first.end[edge], start, end)
            slack = stray + first.slack_mm[edge] + other.position_bound_mm + contact.position_bound_mm
            measured = np.hypot(contact.end_mm[0] - other.end_mm[0], contact.end_mm[1] - other.end_mm[1])
            fits &= (measured >= shortest - slack) & (measured <= longest + slack)
        return fits

    owner, edge = paired_edges(catalogue, nodes.state, nodes.lo, nodes.hi, contact, near)
    paired = nodes.paired(owner, edge)
    if normals is None:
        return paired
    edges = catalogue.edges(contact.finger)
    return paired.narrowed(*intersect(paired.lo, paired.hi, *orientation_range(normals, edges, edge)))


def intersect(lo: Floats, hi: Floats, other_lo: Floats, other_hi: Floats) -> tuple[Floats, Floats]:
    """Hull of the part of [lo, hi] inside [other_lo, other_hi] modulo 2π; lo > hi where there is none."""
    width, other_width = hi - lo, other_hi - other_lo
    begin = (other_lo - lo) % (2 * np.pi)
    tail = begin - 2 * np.pi + other_width
    first = np.where(tail >= 0, 0.0, np.where(begin <= width, begin, np.inf))
    last = np.where(begin <= width, np.minimum(width, begin + other_width), np.minimum(width, tail))
    return lo + first, lo + last


def by_distance(
    catalogue: Catalogue, nodes: Interpretations, level: int, earlier: Contact, contact: Contact
) -> Interpretations:
    """Those whose last edge may be as far from the one at `level` as `contact` is from the `earlier` one."""
    shortest, longest = catalogue.pairs(earlier.finger, contact.finger).ranges(
        nodes.state, nodes.edges[:, level], nodes.edges[:, -1]
    )
    measured = np.hypot(contact.end_mm[0] - earlier.end_mm[0], contact.end_mm[1] - earlier.end_mm[1])
    bound = earlier.position_bound_mm + contact.position_bound_mm
    return nodes.select(np.flatnonzero((measured >= shortest - bound) & (measured <= longest + bound)))


def _by_model(
    catalogue: Catalogue, nodes: Interpretations, contacts: list[Contact], anchor_mm: Floats
) -> Interpretations:
    """Narrow by the closed-form test of the new contact with each earlier one and with each earlier pair."""
    for old in range(len(contacts) - 1):
        nodes = by_chord(catalogue, nodes, old, contacts)
    for pair in combinations(range(len(contacts) - 1), 2):
        nodes = by_triple(catalogue, nodes, pair, contacts, anchor_mm)
    return nodes


def by_chord(
    catalogue: Catalogue, nodes: Interpretations, old: int, contacts: list[Contact]
) -> Interpretations:
    """Narrow by the model test of two contacts, the last of `contacts` and the one at `old`."""
    lo, hi = chord_hull(
        catalogue.edges(contacts[old].finger),
        nodes.edges[:, old],
        contacts[old],
        catalogue.edges(contacts[-1].finger),
        nodes.edges[:, -1],
        contacts[-1],
        nodes.lo,
        nodes.hi,
    )
    return nodes.narrowed(lo, hi)


def by_triple(
    catalogue: Catalogue,
    nodes: Interpretations,
    pair: tuple[int, ...],
    contacts: list[Contact],
    anchor_mm: Floats,
) -> Interpretations:
    """Narrow by the model test of three contacts, the last of `contacts` and the `pair`."""
    group = [*pair, len(contacts) - 1]
    some = [contacts[k] for k in group]
    parts = [
        _by_triple(catalogue, nodes.select(rows), group, some, anchor_mm)
        for rows in np.array_split(np.arange(len(nodes)), len(nodes) // _CHUNK + 1)
    ]
    return parts[0] if len(parts) == 1 else _joined(parts)


def _by_triple(
    catalogue: Catalogue, nodes: Interpretations, group: list[int], some: list[Contact], anchor_mm: Floats
) -> Interpretations:
    g, coefficients = all_half_planes(catalogue, nodes.edges[:, group], some, anchor_mm)
    return nodes.narrowed(*arc_hull(nodes.lo, nodes.hi, triple_arcs(g, coefficients, TRIPLE_TRIPLES)))


def _joined(parts: list[Interpretations]) -> Interpretations:
    return Interpretations(
        np.concatenate([part.state for part in parts]),
        np.concatenate([part.edges for part in parts]),
        np.concatenate([part.lo for part in parts]),
        np.concatenate([part.hi for part in parts]),
    )
