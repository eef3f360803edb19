"""The memo's pruning statistics (Tables I and II): how many interpretations each test leaves at each level.

The counts are those of the memo's own algorithm, with distance and angle tests on their own and the model
test at the end, where `interpretation_tree` mixes them for speed. Angle pruning uses conservative pockets
and, where a contact has one, its range of normals.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from palpate.base.errors import InputError
from palpate.base.geometry import Bools, Floats, Ints
from palpate.base.geometry.plane import distance_range
from palpate.recognizer.angle_pockets import conservative_pockets
from palpate.recognizer.catalogue import Catalogue
from palpate.recognizer.contact import Contact
from palpate.recognizer.edges import EdgeSet
from palpate.recognizer.interpretations import Children, Interpretations, Query
from palpate.recognizer.pose_region import divide_orientations
from palpate.recognizer.steps import STEPS
from palpate.recognizer.tables import Table, expand_ranges, split_evenly

_CANDIDATES_AT_ONCE = 50_000
_MODELS_AT_ONCE = 256
_COARSE_PARTS, _FINER_PARTS = 64, 8  # two solutions of one interpretation come to lie in different parts
_CELL_RAD = 0.015
_ROUNDING_RAD = 1e-9


@dataclass(frozen=True)
class MemoLevel:
    """Counts at one level of the interpretation tree, from the second on.

    `after_both` is the same whichever of the two tests comes first; its children are the next candidates.
    """

    candidates: int
    after_distance: int
    after_angle: int
    after_both: int


@dataclass(frozen=True)
class MemoCounts:
    """Columns 1 and M of the memo's tables, and the levels between them."""

    first: int
    levels: tuple[MemoLevel, ...]
    model: int

    @property
    def distance_first(self) -> tuple[int, ...]:
        """Columns 1, 2, 2D, 2A, 3, 3D, 3A, …, M of the memo's Table I."""
        rows = [(level.candidates, level.after_distance, level.after_both) for level in self.levels]
        return (self.first, *(count for row in rows for count in row), self.model)

    @property
    def angle_first(self) -> tuple[int, ...]:
        """Columns 1, 2, 2A, 2D, 3, 3A, 3D, …, M of the memo's Table II."""
        rows = [(level.candidates, level.after_angle, level.after_both) for level in self.levels]
        return (self.first, *(count for row in rows for count in row), self.model)


def memo_counts(
    catalogue: Catalogue, contacts: Sequence[Contact], object_name: str | None = None
) -> MemoCounts:
    """Count what is left of the interpretation tree, of one object or of all that are in the catalogue.

    The first level holds one edge of each symmetric orbit and is not pruned. M counts the interpretations of
    all touches that the closed-form model test leaves, except for those that a free path, a miss's included,
    or an orientation set rules out throughout. Raises InputError without a touch or for an unknown object.
    """
    touched = [contact for contact in contacts if contact.touched]
    if not touched:
        raise InputError("no finger touched anything: there is nothing to count")
    chosen = _chosen_states(catalogue, object_name)
    edges = catalogue.edges(touched[0].finger)
    root = np.flatnonzero(edges.representative & chosen[edges.state])
    turn = np.full(len(root), np.pi)
    nodes = Interpretations(edges.state[root], root[:, None], -turn, turn)
    sets = [_orientation_sets(catalogue, contact) for contact in touched]
    levels = []
    for size in range(2, len(touched) + 1):
        nodes, level = _level(catalogue, nodes, touched[:size], sets)
        levels.append(level)
    paired = Query(catalogue, touched, np.mean([contact.end_mm for contact in touched], axis=0))
    left = _model_count(paired, nodes, replace(paired, contacts=contacts), sets)
    return MemoCounts(len(root), tuple(levels), left)


@dataclass(frozen=True, eq=False)
class _Arcs(Table):
    """Arcs of θ, up to a for each of n edges: `lo`, `width` (n, a) rad; no arc is a width of −1."""

    lo: Floats
    width: Floats

    def meet(self, lo: Floats, hi: Floats) -> Bools:
        """Mask (n, m) of intervals [lo, hi], none of them empty, that some arc of their row meets."""
        lo, hi = lo[..., None], hi[..., None]
        arc, width = self.lo[:, None], self.width[:, None]
        ahead = (arc - lo + _ROUNDING_RAD) % (2 * np.pi) <= hi - lo + 2 * _ROUNDING_RAD
        behind = (lo - arc + _ROUNDING_RAD) % (2 * np.pi) <= width + 2 * _ROUNDING_RAD
        result: Bools = np.any((ahead | behind) & (width >= 0), axis=2)
        return result


def _chosen_states(catalogue: Catalogue, object_name: str | None) -> Bools:
    names = [state.object_name for state in catalogue.states]
    if object_name is not None and object_name not in names:
        raise InputError(f"there is no object {object_name} in the catalogue")
    return np.array([object_name in (None, name) for name in names])


def _orientation_sets(catalogue: Catalogue, contact: Contact) -> list[_Arcs]:
    """Arcs of θ that the approach, and the normal if there is one, leave to each edge (memo §2.2.2)."""
    edges = catalogue.edges(contact.finger)
    sets = []
    # Edges that overlap, as those of objects with a tolerance do, have no pockets. A point on a vertex may
    # have the normal of the edge that it cannot come to.
    on_edge = contact.finger.tip_radius_mm > 0 or contact.normal is None
    if on_edge and edges is catalogue.outlines(contact.finger):
        sets.append(_from_approach(edges, contact))
    if contact.normal is not None:
        lo = contact.normal.lo_rad - edges.normal_rad - edges.span
        width = contact.normal.hi_rad - contact.normal.lo_rad + 2 * edges.span
        sets.append(_Arcs(lo[:, None], np.minimum(width, 2 * np.pi)[:, None]))
    return sets


def _from_approach(edges: EdgeSet, contact: Contact) -> _Arcs:
    """θ ∈ φ − η for the directions η of each edge's pocket, give or take the error of φ."""
    bound = max(contact.free_path_bound_mm, contact.position_bound_mm)
    pockets = conservative_pockets(edges, bound, contact.travel_mm)
    row = pockets.row
    column = np.arange(len(row)) - pockets.first[row]
    shape = (len(pockets), int(column.max(initial=0)) + 1)
    lo, width = np.zeros(shape), np.full(shape, -1.0)
    error = contact.direction_bound_rad
    lo[row, column] = contact.direction_rad - pockets.hi_rad - error
    width[row, column] = np.minimum(pockets.hi_rad - pockets.lo_rad + 2 * error, 2 * np.pi)
    return _Arcs(lo, width)


def _level(
    catalogue: Catalogue, nodes: Interpretations, touched: list[Contact], sets: list[list[_Arcs]]
) -> tuple[Interpretations, MemoLevel]:
    """Pair the last of `touched` with every edge of each node's state, and count."""
    kept, counts = [Interpretations.none(len(touched))], np.zeros(4, np.int64)
    for paired in _candidates(catalogue, nodes, touched[-1]):
        by_distance = _distances_possible(catalogue, paired, touched)
        by_angle = _orientations_meet(paired, sets)
        both = by_distance & by_angle
        counts += [len(paired), int(by_distance.sum()), int(by_angle.sum()), int(both.sum())]
        kept.append(paired.select(np.flatnonzero(both)))
    return Interpretations.join(kept), MemoLevel(*(int(count) for count in counts))


def _candidates(catalogue: Catalogue, nodes: Interpretations, contact: Contact) -> Iterator[Interpretations]:
    edges = catalogue.edges(contact.finger)
    count = edges.count[nodes.state]
    for piece in split_evenly(len(nodes), int(count.sum()) // _CANDIDATES_AT_ONCE + 1):
        owner, edge = expand_ranges(edges.first[nodes.state[piece]], count[piece])
        owner = piece[owner]
        yield nodes.extend(Children(owner, edge, nodes.lo[owner], nodes.hi[owner]))


def _distances_possible(catalogue: Catalogue, nodes: Interpretations, touched: list[Contact]) -> Bools:
    """Mask of pairings (n,) whose edges allow the last contact's distance from each earlier one."""
    last = touched[-1]
    second, edge_b = catalogue.edges(last.finger), nodes.edges[:, -1]
    possible = np.ones(len(nodes), dtype=bool)
    for level, contact in enumerate(touched[:-1]):
        first, edge_a = catalogue.edges(contact.finger), nodes.edges[:, level]
        shortest, longest = distance_range(
            first.start[edge_a], first.end[edge_a], second.start[edge_b], second.end[edge_b]
        )
        slack = first.slack_mm[edge_a] + second.slack_mm[edge_b]
        slack = slack + contact.position_bound_mm + last.position_bound_mm
        measured = np.hypot(last.end_mm[0] - contact.end_mm[0], last.end_mm[1] - contact.end_mm[1])
        possible &= (measured >= shortest - slack) & (measured <= longest + slack)
    return possible


def _orientations_meet(nodes: Interpretations, sets: list[list[_Arcs]]) -> Bools:
    """Mask of pairings (n,) whose orientation sets all have an orientation in common."""
    arcs = [
        part.select(nodes.edges[:, level]) for level in range(nodes.edges.shape[1]) for part in sets[level]
    ]
    # What sets of arcs have in common begins where one of the arcs begins.
    begins = np.concatenate([part.lo for part in arcs], axis=1)
    common = np.concatenate([part.width for part in arcs], axis=1) >= 0
    for part in arcs:
        common &= part.meet(begins, begins)
    result: Bools = np.any(common, axis=1)
    return result


def _model_count(paired: Query, nodes: Interpretations, evidence: Query, sets: list[list[_Arcs]]) -> int:
    """Number of interpretations that have cells which no orientation set and no free path rules out."""
    found = 0
    for piece in split_evenly(len(nodes), len(nodes) // _MODELS_AT_ONCE + 1):
        parts, owner = nodes.select(piece), np.arange(len(piece))
        for count in (_COARSE_PARTS, _FINER_PARTS):
            parts, owner = _split(parts, owner, count)
            parts, owner = _narrow_by_model(paired, parts, owner)
            for level, arcs in enumerate(sets):
                for some in arcs:
                    met = some.select(parts.edges[:, level]).meet(parts.lo[:, None], parts.hi[:, None])[:, 0]
                    parts, owner = parts.select(np.flatnonzero(met)), owner[met]
        intervals = divide_orientations(parts, step_rad=_CELL_RAD, least=1)
        cells, _ = STEPS.cut_cells(paired, parts, intervals)
        cells = cells.select(STEPS.free_cells(evidence, cells, None))
        found += len(np.unique(owner[cells.node]))
    return found


def _split(nodes: Interpretations, owner: Ints, count: int) -> tuple[Interpretations, Ints]:
    """Every orientation interval in `count` parts, with the owner (n,) of each."""
    source, part = expand_ranges(np.zeros(len(nodes), np.int64), np.full(len(nodes), count))
    width = ((nodes.hi - nodes.lo) / count)[source]
    lo = nodes.lo[source] + part * width
    hi = np.where(part == count - 1, nodes.hi[source], lo + width)
    return Interpretations(nodes.state[source], nodes.edges[source], lo, hi), owner[source]


def _narrow_by_model(query: Query, nodes: Interpretations, owner: Ints) -> tuple[Interpretations, Ints]:
    """Orientations that the closed-form test leaves for every two and every three contacts."""
    for size in (2, 3):
        for group in combinations(range(len(query.contacts)), size):
            lo, hi = STEPS.narrow(query.select(group), nodes.edges[:, group], nodes.lo, nodes.hi)
            nodes, owner = nodes.narrow(lo, hi), owner[lo <= hi]
    return nodes, owner
