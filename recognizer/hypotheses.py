"""Hypotheses: overlapping pose regions of one state, taken together; the recogniser's answer.

From cells to what a person or the planner is told: object, state, configuration, certified bounds, weight
(docs/recogniser.md, "Hypotheses"). Configurations that differ by a symmetry of the state are one.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from palpate.recognizer.arcs import largest
from palpate.recognizer.arrays import Floats, Ints, expand_ranges
from palpate.recognizer.catalogue import Catalogue, CatalogueState
from palpate.recognizer.contact import Contact
from palpate.recognizer.region import Cells, exact_position, refined
from palpate.recognizer.sweep import unblocked
from palpate.recognizer.tree import Interpretations

__all__ = ["Bounds", "Configuration", "Hypothesis", "hypotheses_of"]

_WITNESS_TRIES = 12
_REFINEMENTS, _PARTS, _MOST_REFINED = 3, 4, 2048
_PAIRS_AT_ONCE = 2_000_000
_FIRST_NEIGHBOURS = 32


@dataclass(frozen=True)
class Configuration:
    """Maps object coordinates as given in the objects file to W: x ↦ R(θ) x + (x, y); mm, rad."""

    x_mm: float
    y_mm: float
    theta_rad: float


@dataclass(frozen=True)
class Bounds:
    """Intervals (lo, hi) that contain the true configuration if every error is within its bound."""

    x_mm: tuple[float, float]
    y_mm: tuple[float, float]
    theta_rad: tuple[float, float]

    @property
    def position_half_mm(self) -> float:
        """Larger half-width of the two position intervals."""
        return max(self.x_mm[1] - self.x_mm[0], self.y_mm[1] - self.y_mm[0]) / 2

    @property
    def orientation_half_rad(self) -> float:
        """Half-width of the orientation interval."""
        return (self.theta_rad[1] - self.theta_rad[0]) / 2


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """One way to understand all contacts.

    `verified`: `configuration` satisfies every contact and every free path exactly; `witness_mm` (2,) is its
    position s as in `cells`, the region itself. `weight`: share of the feasible volume of all hypotheses.
    `features` lists the paired edge features (see `GrownSection`) of each interpretation.
    """

    state_index: int
    state: CatalogueState
    configuration: Configuration
    witness_mm: Floats
    bounds: Bounds
    weight: float
    verified: bool
    features: tuple[tuple[int, ...], ...]
    cells: Cells


def hypotheses_of(
    catalogue: Catalogue,
    nodes: Interpretations,
    cells: Cells,
    touched: list[Contact],
    evidence: list[Contact],
    anchor_mm: Floats,
) -> tuple[Hypothesis, ...]:
    """Group the cells into hypotheses, heaviest first."""
    found = []
    for group in _groups(catalogue, cells, anchor_mm):
        found += _settled(catalogue, nodes, group, touched, evidence, anchor_mm, _REFINEMENTS)
    total = sum(item.weight for item in found) or 1.0
    shares = [replace(item, weight=item.weight / total) for item in found]
    return tuple(sorted(shares, key=lambda item: (-item.weight, item.state_index)))


def _settled(
    catalogue: Catalogue,
    nodes: Interpretations,
    group: Cells,
    touched: list[Contact],
    evidence: list[Contact],
    anchor_mm: Floats,
    refinements: int,
) -> list[Hypothesis]:
    """The hypothesis of one connected region, weighted by its volume; none if it proves to be empty.

    Cells are a little larger than what they enclose. Where no configuration in them is found to hold, they
    are cut finer: one comes to light, or nothing is left, or the doubt stays and it remains unverified.
    """
    part = _on_one_branch(catalogue, group)
    state = catalogue.states[int(part.state[0])]
    configuration, position, verified = _witness(catalogue, nodes, part, touched, evidence, anchor_mm)
    if not verified and refinements and len(group) * _PARTS <= _MOST_REFINED:
        finer = refined(catalogue, nodes, group, touched, anchor_mm, _PARTS)
        for contact in evidence:
            finer = finer.select(unblocked(catalogue, finer, anchor_mm, contact))
        rest = refinements - 1
        return [
            item
            for piece in _groups(catalogue, finer, anchor_mm)
            for item in _settled(catalogue, nodes, piece, touched, evidence, anchor_mm, rest)
        ]
    return [
        Hypothesis(
            state_index=int(part.state[0]),
            state=state,
            configuration=configuration,
            witness_mm=position,
            bounds=_bounds(part, state.origin_mm, anchor_mm),
            weight=float(part.volume.sum()),
            verified=verified,
            features=_features(catalogue, nodes, part, touched),
            cells=part,
        )
    ]


def _groups(catalogue: Catalogue, cells: Cells, anchor_mm: Floats) -> Iterator[Cells]:
    """Cells of one state whose boxes in (x, y, θ modulo the symmetry) are connected."""
    corner_lo, corner_hi = _position_boxes(cells, np.zeros(2), anchor_mm)
    for state in np.unique(cells.state):
        rows = np.flatnonzero(cells.state == state)
        turn = 2 * np.pi / catalogue.states[int(state)].symmetry_order
        lo, hi = corner_lo[rows], corner_hi[rows]
        label = _connected(cells.middle[rows], cells.half_width[rows], turn, lo, hi)
        for group in range(int(label.max()) + 1):
            yield cells.select(rows[label == group])


def _connected(middle: Floats, half_width: Floats, turn: float, lo: Floats, hi: Floats) -> Ints:
    """Component (k,) of each of k boxes: θ within `half_width` of `middle` modulo `turn`, position lo to hi.

    Links among near neighbours in θ join nearly everything that belongs together. The rest is done for cells
    outside of the largest component only, so that wide regions do not cost the square of their cells.
    """
    size = len(middle)
    order = np.argsort(middle % turn, kind="stable")
    folded = (middle % turn)[order]
    keys = np.concatenate([folded - turn, folded, folded + turn])
    reach = min(2 * float(half_width.max()) + 1e-9, turn)
    at = np.arange(size) + size
    before = np.minimum(at - np.searchsorted(keys, folded - reach, side="left"), size)
    after = np.minimum(np.searchsorted(keys, folded + reach, side="right") - at - 1, size)
    left: list[Ints] = []
    right: list[Ints] = []

    def link(cell: Ints, begin: Ints, count: Ints) -> None:
        pieces = np.array_split(np.arange(len(cell)), int(count.sum()) // _PAIRS_AT_ONCE + 1)
        for piece in pieces:
            owner, key = expand_ranges(begin[piece], count[piece])
            one, two = cell[piece][owner], order[key % size]
            apart = np.abs(keys[key] - folded[rank[one]])
            meets = apart <= half_width[one] + half_width[two] + 1e-9
            one, two = one[meets], two[meets]
            meets = np.all((lo[one] <= hi[two]) & (lo[two] <= hi[one]), axis=1)
            left.append(one[meets])
            right.append(two[meets])

    def components() -> Ints:
        a, b = np.concatenate(left), np.concatenate(right)
        links = coo_array((np.ones(len(a), dtype=np.int8), (a, b)), shape=(size, size))
        label: Ints = connected_components(links, directed=False)[1].astype(np.int64)
        return label

    rank = np.empty(size, dtype=np.int64)
    rank[order] = np.arange(size)
    link(order, at + 1, np.minimum(after, _FIRST_NEIGHBOURS))
    label = components()
    outside = np.flatnonzero(label[order] != np.argmax(np.bincount(label)))
    if len(outside) and int(after.max()) > _FIRST_NEIGHBOURS:
        link(order[outside], at[outside] - before[outside], (before + after + 1)[outside])
        label = components()
    return label


def _on_one_branch(catalogue: Catalogue, cells: Cells) -> Cells:
    """The same region with each cell turned by the symmetry so that all orientations lie together.

    The reference is the largest cell, brought into [−π, π).
    """
    order = catalogue.states[int(cells.state[0])].symmetry_order
    turn = 2 * np.pi / order
    middle = cells.middle
    reference = middle[int(np.argmax(cells.volume))]
    whole = 2 * np.pi * np.floor((reference + np.pi) / (2 * np.pi))
    steps = np.round((middle - reference) / turn)
    # p = R(θ) s is the same for θ − kτ and R(kτ) s.
    angle = steps * turn
    cos, sin = np.cos(angle)[:, None], np.sin(angle)[:, None]
    x, y = cells.polygon[..., 0], cells.polygon[..., 1]
    polygon = np.stack([cos * x - sin * y, sin * x + cos * y], axis=2)
    shift = angle + whole
    return Cells(cells.node, cells.state, cells.lo - shift, cells.hi - shift, polygon)


def _position_boxes(cells: Cells, origin_mm: Floats, anchor_mm: Floats) -> tuple[Floats, Floats]:
    """Smallest boxes (k, 2) in W that contain every position of each cell, rounded outward."""
    rel = cells.polygon - origin_mm
    x, y = rel[..., 0], rel[..., 1]
    lo, hi = cells.lo[:, None], cells.hi[:, None]
    zero = np.zeros_like(x)
    across, upward = np.stack([zero, x, -y], axis=2), np.stack([zero, y, x], axis=2)
    least = np.column_stack([-largest(-part, lo, hi).max(axis=1) for part in (across, upward)])
    most = np.column_stack([largest(part, lo, hi).max(axis=1) for part in (across, upward)])
    return least + anchor_mm - 1e-9, most + anchor_mm + 1e-9


def _bounds(cells: Cells, origin_mm: Floats, anchor_mm: Floats) -> Bounds:
    least, most = _position_boxes(cells, origin_mm, anchor_mm)
    lo, hi = least.min(axis=0), most.max(axis=0)
    theta = (float(cells.lo.min()) - 1e-12, float(cells.hi.max()) + 1e-12)
    return Bounds((float(lo[0]), float(hi[0])), (float(lo[1]), float(hi[1])), theta)


def _witness(
    catalogue: Catalogue,
    nodes: Interpretations,
    cells: Cells,
    touched: list[Contact],
    evidence: list[Contact],
    anchor_mm: Floats,
) -> tuple[Configuration, Floats, bool]:
    """A configuration that satisfies everything exactly, near the middle of the region if one is there.

    Tried at the region's mean orientation and at the largest cells' middles; if none holds, the middle of
    the largest cell is given, unverified.
    """
    volume = cells.volume
    mean = float(np.average(cells.middle, weights=volume + 1e-300))
    by_size = np.argsort(-volume, kind="stable")
    holding = [k for k in by_size if cells.lo[k] <= mean <= cells.hi[k]][: _WITNESS_TRIES // 2]
    tries = [(int(k), mean) for k in holding]
    tries += [(int(k), float(cells.middle[k])) for k in by_size[:_WITNESS_TRIES]]
    chosen = np.array([k for k, _ in tries])
    theta = np.array([angle for _, angle in tries])
    # Interpretations know their own branch of the symmetry; the cells may have been turned to another.
    state = catalogue.states[int(cells.state[0])]
    turn = 2 * np.pi / state.symmetry_order
    owner = nodes.select(cells.node[chosen])
    steps = np.round(((owner.lo + owner.hi) / 2 - theta) / turn) * turn
    position, found = exact_position(catalogue, owner, touched, anchor_mm, theta + steps)
    points = Cells(cells.node[chosen], cells.state[chosen], theta + steps, theta + steps, position[:, None])
    for contact in evidence:
        found &= unblocked(catalogue, points, anchor_mm, contact)
    best = int(np.argmax(found))
    if not found[best]:
        best = len(holding)
        position[best], steps[best] = cells.centre[by_size[0]], 0.0
    here = _turned(position[best], float(steps[best]))
    centre = _turned(here, float(theta[best])) + anchor_mm
    return _configuration(centre, float(theta[best]), state), here, bool(found.any())


def _configuration(centre_mm: Floats, theta: float, state: CatalogueState) -> Configuration:
    """Configuration in the file's frame of an object whose centroid lies at `centre_mm` in W."""
    x, y = centre_mm - _turned(state.origin_mm, theta)
    return Configuration(float(x), float(y), theta)


def _turned(vector: Floats, angle: float) -> Floats:
    cos, sin = np.cos(angle), np.sin(angle)
    return np.array([cos * vector[0] - sin * vector[1], sin * vector[0] + cos * vector[1]])


def _features(
    catalogue: Catalogue, nodes: Interpretations, cells: Cells, touched: list[Contact]
) -> tuple[tuple[int, ...], ...]:
    pairings: Ints = nodes.edges[np.unique(cells.node)]
    columns = [
        catalogue.edges(contact.finger).feature[pairings[:, level]] for level, contact in enumerate(touched)
    ]
    return tuple(sorted({tuple(int(value) for value in row) for row in np.column_stack(columns)}))
