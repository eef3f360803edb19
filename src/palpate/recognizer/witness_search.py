"""Witness search: connected regions of cells, each with a configuration that satisfies everything exactly.

Everything is done for all regions at once. Cells are a little larger than what they enclose, so candidates
are judged by `verification`. Where none in a region holds, cells that prove to hold none are dropped and the
others are cut finer: a configuration comes to light, or nothing is left, or the region remains unverified.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from palpate.base.geometry import Bools, Floats, Ints
from palpate.base.geometry.plane import rotate
from palpate.recognizer.catalogue import Catalogue
from palpate.recognizer.compiled import KERNEL, furthest_along_axes
from palpate.recognizer.compiled_judgement import search_regions
from palpate.recognizer.connected_components import Boxes, component_labels, few_in_each
from palpate.recognizer.constraints import Constraints
from palpate.recognizer.model_test import sinusoid_maximum
from palpate.recognizer.pose_region import Cells
from palpate.recognizer.tables import expand_ranges
from palpate.recognizer.verification import Poses
from palpate.recognizer.witness_candidates import (
    LEVER_MM,
    PARTS_PER_CELL,
    WitnessedCells,
    can_be_verified,
    cut_finer,
    polish,
)


def round_to_nine_digits(value: Floats) -> Floats:
    """Values (n,) to nine digits, however large or small they are."""
    share, power = np.frexp(value)
    return np.ldexp(share.round(9), power)


_MAX_REFINEMENTS = 4
_REGION_DIVISOR = 16  # so much of the budget's share of cells that are cut finer may be one region's
_MAX_CANDIDATES = 4  # cells of a region in which a witness is looked for, if its best one has none


@dataclass(frozen=True, eq=False)
class Regions:
    """h regions: `cells` (k) ordered by region, each on one branch of the symmetry; region i has those from
    `first`[i] to `first`[i + 1]. `unturned` (k): the same on the branches of their interpretations. `theta`
    (h,) rad and `position` s (h, 2) mm of a configuration in it, which satisfies everything exactly where
    `verified` (h,), except for what its interpretation, `node` (h,), takes as spurious.
    """

    cells: Cells
    unturned: Cells
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
        return replace(
            self,
            theta=self.theta[rows],
            position=self.position[rows],
            verified=self.verified[rows],
            node=self.node[rows],
            cells=self.cells.select(cell),
            unturned=self.unturned.select(cell),
            first=np.cumsum(np.append(0, count)),
        )

    @classmethod
    def joined(cls, parts: "Sequence[Regions]") -> "Regions":
        """The regions of all parts, one part after the other."""
        if len(parts) == 1:
            return parts[0]
        before = np.cumsum([0, *(part.first[-1] for part in parts)])
        begins = [part.first[:-1] + cells for part, cells in zip(parts, before[:-1], strict=True)]
        return cls(
            Cells.joined([part.cells for part in parts]),
            Cells.joined([part.unturned for part in parts]),
            np.concatenate([*begins, before[-1:]]),
            np.concatenate([part.theta for part in parts]),
            np.concatenate([part.position for part in parts]),
            np.concatenate([part.verified for part in parts]),
            np.concatenate([part.node for part in parts]),
        )

    def with_cells(self, kept: Bools) -> "Regions":
        """The same with only some of the cells (k,); regions that have none left are gone."""
        size = np.add.reduceat(kept, self.first[:-1], dtype=np.int64) if len(self) else np.empty(0, np.int64)
        rows = np.flatnonzero(kept)
        some = replace(
            self,
            cells=self.cells.select(rows),
            unturned=self.unturned.select(rows),
            first=np.cumsum(np.append(0, size)),
        )
        return some.select(np.flatnonzero(size))


def connected_regions(constraints: Constraints, found: WitnessedCells) -> Regions:
    """The connected regions of cells, without those that prove to be empty."""
    done = []
    for nth in range(_MAX_REFINEMENTS + 1):
        regions, again = search_round(constraints, found, refinable=nth < _MAX_REFINEMENTS)
        done.append(regions)
        if not len(again):
            break
        found = cut_finer(constraints, again, at_first=nth == 0)
    return Regions.joined(done)


def search_round(
    constraints: Constraints, found: WitnessedCells, *, refinable: bool
) -> tuple[Regions, Cells]:
    """Regions that are done, and the cells of those that are to be cut finer: none unless `refinable`."""
    if KERNEL is not None:
        return _compiled_round(constraints, found, refinable=refinable)
    label = component_labels(_boxes(constraints, found.cells))
    # By what they are, not by how they were found: which are tried must not depend on that.
    x, y = found.cells.centre.T.round(6)
    order = np.lexsort((y, x, found.cells.middle.round(9), label))
    found, label = found.select(order), label[order]
    cells = found.cells
    first = np.searchsorted(label, np.arange(int(label.max(initial=-1)) + 2))
    branch = _symmetry_shift(constraints.catalogue, cells, first, label)
    room = constraints.budget.refined
    may_be_cut = (np.diff(first) * PARTS_PER_CELL <= room // _REGION_DIVISOR) & refinable
    regions, kept = _with_witnesses(
        constraints,
        found,
        first,
        label,
        branch,
        _witness_priority(constraints, found, first, label, may_be_cut),
    )
    size = np.bincount(label[kept], minlength=len(may_be_cut))
    doubtful = _regions_to_refine(
        may_be_cut & ~regions.verified, size * max(len(constraints.touched), 1), room
    )
    return regions.with_cells(kept & ~doubtful[label]), cells.select(kept & doubtful[label])


def _compiled_round(
    constraints: Constraints, found: WitnessedCells, *, refinable: bool
) -> tuple[Regions, Cells]:
    assert KERNEL is not None
    cells = found.cells
    rows = (cells.node, cells.state, cells.lo, cells.hi, cells.polygon, found.spot, found.holds)
    component = None if few_in_each(cells.state) else component_labels(_boxes(constraints, cells))
    evidence, rules, room = (
        constraints.compiled_evidence,
        constraints.compiled_rules,
        constraints.budget.refined,
    )
    of = search_regions(KERNEL, evidence, rules, rows, component, room, refinable=refinable)
    unturned = cells.select(of.row)
    turned = replace(unturned, lo=of.lo, hi=of.hi, polygon=of.polygon)
    regions = Regions(turned, unturned, of.first, of.theta, of.position, of.verified, of.node)
    return regions, cells.select(of.again)


def _regions_to_refine(wanted: Bools, size: Ints, room: int) -> Bools:
    """Those of the regions (h,) that are cut finer: as many as there is room for, the smallest first."""
    order = np.argsort(np.where(wanted, size, np.iinfo(np.int64).max), kind="stable")
    result = wanted.copy()
    result[order] &= np.cumsum(np.where(wanted, size, 0)[order]) <= room
    return result


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
    """The reference of a region is its largest cell, brought into [−π, π).

    A region that reaches all the way round has cells half a turn from there: which way they are turned must
    not hang on rounding.
    """
    turn = _symmetry_turn(catalogue, cells)
    middle = cells.middle
    reference = middle[_best_by_region(round_to_nine_digits(cells.volume), first, label)][label]
    angle = np.rint(((middle - reference) / turn).round(9)) * turn
    whole = 2 * np.pi * np.floor(((reference + np.pi) / (2 * np.pi)).round(9))
    return _SymmetryShift(angle + whole, angle)


def _best_by_region(value: Floats, first: Ints, label: Ints) -> Ints:
    """Row (h,) with the largest value (k,) in each run of labels; of equals the first."""
    most = np.maximum.reduceat(value, first[:-1]) if len(first) > 1 else np.empty(0)
    rows = np.flatnonzero(value >= most[label]) if len(most) else np.empty(0, np.int64)
    return rows[np.searchsorted(label[rows], np.arange(len(first) - 1))]


def _shift_cells(cells: Cells, branch: _SymmetryShift) -> Cells:
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
    constraints: Constraints,
    found: WitnessedCells,
    first: Ints,
    label: Ints,
    branch: _SymmetryShift,
    eligible: Ints,
) -> tuple[Regions, Bools]:
    """Regions with a configuration that is verified, as near their middle as there is one.

    If none of those tried is, the middle of the largest cell is given, unverified. `eligible` (k,):
    priorities of `_witness_priority`. Also returned: which cells (k,) may hold one, as far as it was asked.
    """
    turned = _shift_cells(found.cells, branch)
    begin, kept = first[:-1], np.ones(len(label), dtype=bool)
    share = turned.volume + 1e-300
    if not len(begin):
        none = np.empty(0, np.int64)
        no = np.empty(0, dtype=bool)
        return Regions(turned, found.cells, first, np.empty(0), np.empty((0, 2)), no, none), kept
    middle = turned.middle
    spot = rotate(np.where(found.holds[:, None], found.spot, found.cells.centre), branch.angle)
    place = np.column_stack([middle * LEVER_MM, rotate(turned.centre, middle)])
    mean = np.add.reduceat(share[:, None] * place, begin) / np.add.reduceat(share, begin)[:, None]
    tried = np.column_stack([middle * LEVER_MM, rotate(spot, middle)])
    # Rounded: of cells that are as near or as large, the first is taken.
    off, size = np.linalg.norm(tried - mean[label], axis=1).round(6), round_to_nine_digits(share)
    # Any cell that may hold comes before all that do not; of those the largest comes first.
    rank = np.where(found.holds, 1.0 + eligible - off / (1.0 + off), size / (1.0 + size))
    rank = np.where(eligible > 0, rank, -1.0)
    chosen = _best_by_region(rank, first, label)
    regions = Regions(
        turned,
        found.cells,
        first,
        middle[chosen],
        spot[chosen],
        np.zeros(len(begin), dtype=bool),
        turned.node[chosen],
    )
    search = _Search(constraints, regions, label)
    search.try_cells(chosen, spot[chosen])
    some = np.flatnonzero(~regions.verified[label] | constraints.has_unpaired)
    kept[some] = can_be_verified(constraints, found.cells.select(some))
    some = some[kept[some] & ~regions.verified[label[some]]]
    search.place(_best_by_region(np.where(kept, rank, -2.0), first, label), middle, spot)
    some = some[rank[some] >= 0]
    other = _spread_candidates(label[some], rank[some], some)
    search.try_cells(np.tile(other, 2), np.concatenate([spot[other], turned.centre[other]]))
    return regions, kept


@dataclass(frozen=True, eq=False)
class _Search:
    """The search for witnesses of `regions`; `label` (k,): the region of each of their cells."""

    constraints: Constraints
    regions: Regions
    label: Ints

    def try_cells(self, cell: Ints, spot: Floats) -> None:
        """Take for each region the first of its candidates that is verified once it is polished.

        They are in the middle orientations of cells (n,), at positions `spot` (n, 2).
        """
        regions, cells = self.regions, self.regions.cells
        region = self.label[cell]
        poses = Poses(cells.state[cell], cells.middle[cell], spot)
        polished, holds = polish(self.constraints, cells, regions.first, region, cell, poses)
        good = np.flatnonzero(holds)
        rows, nth = np.unique(region[good], return_index=True)
        good = good[nth]
        regions.theta[rows], regions.position[rows] = polished.theta[good], polished.position[good]
        regions.verified[rows], regions.node[rows] = True, cells.node[cell[good]]

    def place(self, cell: Ints, theta: Floats, spot: Floats) -> None:
        """Put regions without a witness where one of their cells (h,) is; angles (k,), positions (k, 2)."""
        rows = np.flatnonzero(~self.regions.verified)
        cell = cell[rows]
        self.regions.theta[rows], self.regions.position[rows] = theta[cell], spot[cell]
        self.regions.node[rows] = self.regions.cells.node[cell]


def _spread_candidates(label: Ints, rank: Floats, cell: Ints) -> Ints:
    """Up to `_CANDIDATES` of the cells (n,) of each region, evenly among its rows; the best come first."""
    first = np.flatnonzero(np.diff(label, prepend=-1))
    size = np.diff(np.append(first, len(label)))
    owner = np.repeat(np.arange(len(first)), size)
    nth = np.arange(len(label)) - first[owner]
    # The nth is taken where a multiple of size / _CANDIDATES is passed.
    share = np.minimum(size, _MAX_CANDIDATES)[owner]
    taken = (nth * share) // size[owner] != ((nth - 1) * share) // size[owner]
    kept = np.flatnonzero(taken)
    order = np.lexsort((-rank[kept], label[kept]))
    return cell[kept[order]]


def position_boxes(cells: Cells, origin_mm: Floats, anchor_mm: Floats) -> tuple[Floats, Floats]:
    """Smallest boxes (k, 2) in W that contain every position of `origin_mm` (k, 2), rounded outward.

    The origin is a point of the object, seen from its centroid, that stands for its position.
    """
    if KERNEL is not None:
        furthest = furthest_along_axes(KERNEL, cells.polygon, origin_mm, cells.lo, cells.hi)
        return anchor_mm - furthest[:, 2:] - 1e-9, anchor_mm + furthest[:, :2] + 1e-9
    rel = cells.polygon - origin_mm[:, None]
    x, y = rel[..., 0], rel[..., 1]
    lo, hi = cells.lo[:, None], cells.hi[:, None]
    # x of R(θ) s is x cos θ − y sin θ, and y is y cos θ + x sin θ.
    across, upward = np.stack([x, y, -x, -y]), np.stack([-y, x, y, -x])
    furthest = sinusoid_maximum(across, upward, lo, hi).max(axis=2, initial=-np.inf).T
    return anchor_mm - furthest[:, 2:] - 1e-9, anchor_mm + furthest[:, :2] + 1e-9
