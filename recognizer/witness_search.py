"""Witness search: connected regions of cells, each with a configuration that satisfies everything exactly.

Everything is done for all regions at once. Cells are a little larger than
what they enclose. Where no configuration in a region is found to hold, its cells are cut finer: one comes to
light, or nothing is left, or the doubt stays and the region remains unverified.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from palpate.geometry import Bools, Floats, Ints
from palpate.geometry.plane import rotate
from palpate.recognizer.catalogue import Catalogue
from palpate.recognizer.contact import Contact
from palpate.recognizer.grouping import Boxes, connected
from palpate.recognizer.null_branch import null_mask
from palpate.recognizer.region import Cells, Intervals, probe_cells, refine_intervals
from palpate.recognizer.sinusoid_bounds import sinusoid_maximum
from palpate.recognizer.sweep import free_path_test, path_outside_outline
from palpate.recognizer.tables import Table, expand_ranges
from palpate.recognizer.tree import Interpretations

__all__ = ["Constraints", "Regions", "connected_regions", "find_witnesses", "position_boxes"]

_REFINEMENTS, _PARTS, _MOST_REFINED = 2, 4, 2048
_LEVER_MM = 40.0  # what a turn counts for against a shift, when the middle of a region is sought
_OUT = 0.9  # of the way from the middle of the positions to their corners


@dataclass(frozen=True, eq=False)
class Constraints:
    """Constraints on every region: pairings of `touched`, and free paths of all contacts and misses.

    A contact that an interpretation takes as spurious is no evidence for its cells.
    """

    catalogue: Catalogue
    nodes: Interpretations
    touched: list[Contact]
    evidence: list[Contact]
    anchor_mm: Floats

    @cached_property
    def nulls(self) -> Ints:
        """Number of null contacts of each interpretation, (n,)."""
        count: Ints = np.count_nonzero(self.nodes.edges < 0, axis=1)
        return count

    def allow(self, cells: Cells) -> Bools:
        """Cells (k,) that the free paths do not rule out."""
        skipped = null_mask(self.nodes, cells.node, self.evidence)
        if skipped is None:
            skipped = np.zeros((len(cells), len(self.evidence)), dtype=bool)
        columns = [column for column, contact in enumerate(self.evidence) if contact.touched]
        skipped[:, columns] |= path_outside_outline(
            self.catalogue, cells, self.anchor_mm, self.nodes.edges[cells.node], self.touched
        )
        return free_path_test(self.catalogue, cells, self.anchor_mm, self.evidence, skipped)


@dataclass(frozen=True, eq=False)
class Regions:
    """h regions: `cells` (k) ordered by region, each on one branch of the symmetry; region i has those from
    `first`[i] to `first`[i + 1]. `theta` (h,) rad and `position` s (h, 2) mm of a configuration in it, which
    satisfies everything exactly where `verified` (h,), except for what its interpretation, `node` (h,), takes
    as spurious.
    """

    cells: Cells
    first: Ints
    theta: Floats
    position: Floats
    verified: Bools
    node: Ints

    def __len__(self) -> int:
        return len(self.theta)

    def select(self, rows: Ints) -> "Regions":
        """Those at `rows` (n,), in that order."""
        count = np.diff(self.first)[rows]
        _, cell = expand_ranges(self.first[rows], count)
        return Regions(
            self.cells.select(cell),
            np.cumsum(np.append(0, count)),
            self.theta[rows],
            self.position[rows],
            self.verified[rows],
            self.node[rows],
        )


@dataclass(frozen=True, eq=False)
class WitnessedCells(Table):
    """k cells; where `holds` (k,), everything does at position `spot` s (k, 2) and the middle orientation."""

    cells: Cells
    spot: Floats
    holds: Bools


def find_witnesses(
    constraints: Constraints, intervals: Intervals, *, corners: bool = False
) -> WitnessedCells:
    """Cells of the intervals that the free paths leave, some of them with a position that holds.

    What satisfies the contacts may still be blocked: tried are the middle of these positions and, with
    `corners`, places towards their corners as well.
    """
    found = probe_cells(
        constraints.catalogue, constraints.nodes, constraints.touched, constraints.anchor_mm, intervals
    )
    cells = found.cells
    middle = found.section.mean(axis=1, keepdims=True)
    places = np.concatenate([middle, middle + _OUT * (found.section - middle)], axis=1) if corners else middle
    spots = _cells_at(cells, np.repeat(found.tried, places.shape[1]), places.reshape(-1, 2))
    free = constraints.allow(Cells.joined([cells, spots]))
    count = len(cells)
    open_to = free[count:].reshape(places.shape[:2])
    holds, spot = np.zeros(count, dtype=bool), np.zeros((count, 2))
    holds[found.tried] = open_to.any(axis=1)
    spot[found.tried] = places[np.arange(len(places)), np.argmax(open_to, axis=1)]
    return WitnessedCells(cells, spot, holds).select(np.flatnonzero(free[:count]))


def _cells_at(cells: Cells, row: Ints, position: Floats) -> Cells:
    """Cells without extent at positions (n, 2) in the middle orientations of the cells `row` (n,)."""
    middle = cells.middle[row]
    return Cells(cells.node[row], cells.state[row], middle, middle, position[:, None])


def connected_regions(
    constraints: Constraints, found: WitnessedCells, refinements: int = _REFINEMENTS
) -> Regions:
    """The connected regions of cells, without those that prove to be empty."""
    label = connected(_boxes(constraints, found.cells))
    order = np.argsort(label, kind="stable")
    found, label = found.select(order), label[order]
    cells = found.cells
    first = np.searchsorted(label, np.arange(int(label.max(initial=-1)) + 2))
    branch = _symmetry_shift(constraints.catalogue, cells, first, label)
    refinable = (np.diff(first) * _PARTS <= _MOST_REFINED) & (refinements > 0)
    regions = _with_witnesses(
        found, first, label, branch, _witness_priority(constraints, found, first, label, refinable)
    )
    doubtful = ~regions.verified & refinable
    if not doubtful.any():
        return regions
    again = cells.select(doubtful[label])
    finer = refine_intervals(
        constraints.catalogue, constraints.nodes, again, constraints.touched, constraints.anchor_mm, _PARTS
    )
    rest = connected_regions(constraints, find_witnesses(constraints, finer, corners=True), refinements - 1)
    return _joined_regions(regions.select(np.flatnonzero(~doubtful)), rest)


def _joined_regions(one: Regions, two: Regions) -> Regions:
    return Regions(
        Cells.joined([one.cells, two.cells]),
        np.concatenate([one.first, one.first[-1] + two.first[1:]]),
        np.concatenate([one.theta, two.theta]),
        np.concatenate([one.position, two.position]),
        np.concatenate([one.verified, two.verified]),
        np.concatenate([one.node, two.node]),
    )


def _boxes(constraints: Constraints, cells: Cells) -> Boxes:
    lo, hi = position_boxes(cells, np.zeros((len(cells), 2)), constraints.anchor_mm)
    return Boxes(
        cells.state, cells.middle, cells.half_width, _symmetry_turn(constraints.catalogue, cells), lo, hi
    )


def _symmetry_turn(catalogue: Catalogue, cells: Cells) -> Floats:
    """Smallest turn (k,) rad that leaves each cell's state as it was."""
    return 2 * np.pi / catalogue.symmetry_orders[cells.state]


@dataclass(frozen=True, eq=False)
class _SymmetryShift:
    """Shift of each cell to its region's symmetry branch: θ less `shift` (k,), s turned by `angle` (k,).

    p = R(θ) s is the same for θ − kτ and R(kτ) s.
    """

    shift: Floats
    angle: Floats


def _symmetry_shift(catalogue: Catalogue, cells: Cells, first: Ints, label: Ints) -> _SymmetryShift:
    """The reference of a region is its largest cell, brought into [−π, π)."""
    turn = _symmetry_turn(catalogue, cells)
    middle = cells.middle
    reference = middle[_best_by_region(cells.volume, first, label)][label]
    angle = np.rint((middle - reference) / turn) * turn
    whole = 2 * np.pi * np.floor((reference + np.pi) / (2 * np.pi))
    return _SymmetryShift(angle + whole, angle)


def _best_by_region(value: Floats, first: Ints, label: Ints) -> Ints:
    """Row (h,) with the largest value (k,) in each run of labels; of equals the first."""
    most = np.maximum.reduceat(value, first[:-1]) if len(first) > 1 else np.empty(0)
    rows = np.flatnonzero(value >= most[label]) if len(most) else np.empty(0, np.int64)
    return rows[np.searchsorted(label[rows], np.arange(len(first) - 1))]


def _shifted_cells(cells: Cells, branch: _SymmetryShift) -> Cells:
    polygon = cells.polygon
    if np.any(branch.angle != 0):
        polygon = rotate(polygon, branch.angle[:, None])
    return Cells(cells.node, cells.state, cells.lo - branch.shift, cells.hi - branch.shift, polygon)


def _witness_priority(
    constraints: Constraints, found: WitnessedCells, first: Ints, label: Ints, refinable: Bools
) -> Ints:
    """Priority of each cell (k,) as its region's witness (2 preferred, 0 not eligible).

    First come interpretations with the fewest null contacts. Others follow if they hold, and only where the
    region (h,) is not `refinable`: finer cells may show a witness of the first, or that they are empty.
    """
    nulls = constraints.nulls[found.cells.node]
    if not nulls.any():
        return np.full(len(label), 2)
    fewest = np.minimum.reduceat(nulls, first[:-1])[label]
    return np.where(nulls == fewest, 2, np.where(found.holds & ~refinable[label], 1, 0))


def _with_witnesses(
    found: WitnessedCells, first: Ints, label: Ints, branch: _SymmetryShift, eligible: Ints
) -> Regions:
    """Regions with a configuration that satisfies everything exactly, as near their middle as there is one.

    If none was found, the middle of the largest cell is given, unverified. `eligible` (k,): priorities of
    `_witness_priority`.
    """
    turned = _shifted_cells(found.cells, branch)
    begin = first[:-1]
    share = turned.volume + 1e-300
    if not len(begin):
        none = np.empty(0, np.int64)
        return Regions(turned, first, np.empty(0), np.empty((0, 2)), np.empty(0, dtype=bool), none)
    middle = turned.middle
    spot = rotate(np.where(found.holds[:, None], found.spot, found.cells.centre), branch.angle)
    place = np.column_stack([middle * _LEVER_MM, rotate(turned.centre, middle)])
    mean = np.add.reduceat(share[:, None] * place, begin) / np.add.reduceat(share, begin)[:, None]
    tried = np.column_stack([middle * _LEVER_MM, rotate(spot, middle)])
    off = np.linalg.norm(tried - mean[label], axis=1)
    # Any cell that holds comes before all that do not; of those the largest comes first.
    rank = np.where(found.holds, 1.0 + eligible - off / (1.0 + off), share / (1.0 + share))
    chosen = _best_by_region(np.where(eligible > 0, rank, -1.0), first, label)
    verified = found.holds[chosen]
    return Regions(turned, first, middle[chosen], spot[chosen], verified, found.cells.node[chosen])


def position_boxes(cells: Cells, origin_mm: Floats, anchor_mm: Floats) -> tuple[Floats, Floats]:
    """Smallest boxes (k, 2) in W that contain every position of `origin_mm` (k, 2), rounded outward.

    The origin is a point of the object, seen from its centroid, that stands for its position.
    """
    rel = cells.polygon - origin_mm[:, None]
    x, y = rel[..., 0], rel[..., 1]
    lo, hi = cells.lo[:, None], cells.hi[:, None]
    # x of R(θ) s is x cos θ − y sin θ, and y is y cos θ + x sin θ.
    across, upward = np.stack([x, y, -x, -y]), np.stack([-y, x, y, -x])
    furthest = sinusoid_maximum(across, upward, lo, hi).max(axis=2, initial=-np.inf).T
    return anchor_mm - furthest[:, 2:] - 1e-9, anchor_mm + furthest[:, :2] + 1e-9
