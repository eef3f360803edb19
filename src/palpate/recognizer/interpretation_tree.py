"""Interpretation tree (memo §2): pairings of contacts with edges, grown level by level and pruned.

Breadth first, as whole-array operations over the whole catalogue. Each level is pruned by angle, by distance,
and by the closed-form model test on two and on three contacts.
"""

import numpy as np

from palpate.recognizer.budget import BudgetSpentError
from palpate.recognizer.catalogue import Catalogue
from palpate.recognizer.contact import Contact, NormalRange
from palpate.recognizer.interpretations import (
    Children,
    Interpretations,
    LevelCount,
    Query,
    intersect,
    orientation_range,
)
from palpate.recognizer.numpy_pairing import distances_fit, look_up
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


def second_level(query: Query) -> tuple[Interpretations, LevelCount]:
    """Both first contacts at once. Raises BudgetSpentError where there are too many ways."""
    first, second = query.edges
    candidates = int(np.sum(first.representative * second.count[first.state]))
    if query.normals is None:
        return Interpretations.none(2), LevelCount(2, candidates, 0, 0, 0)
    pocketed = [
        level for level, contact in enumerate(query.contacts) if _has_pockets(query.catalogue, contact)
    ]
    most = query.budget.pairs if candidates > query.budget.pairs else None
    found = STEPS.second_level(query, query.normals, most, modelled=not pocketed)
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
