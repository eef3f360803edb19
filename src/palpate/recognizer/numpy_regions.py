"""A round of the witness search with NumPy: connected cells, and a configuration in each region."""

from dataclasses import dataclass

import numpy as np

from palpate.base.geometry import Bools, Floats, Ints
from palpate.base.geometry.plane import rotate
from palpate.recognizer.catalogue import Catalogue
from palpate.recognizer.connected_components import component_labels, group_by_links, region_boxes
from palpate.recognizer.constraints import Constraints
from palpate.recognizer.numpy_cells import position_boxes
from palpate.recognizer.numpy_witnesses import can_be_verified, polish
from palpate.recognizer.pose_region import LEVER_MM, PARTS_PER_CELL, Cells, Regions, WitnessedCells
from palpate.recognizer.tables import round_to_nine_digits
from palpate.recognizer.verification import Poses

_REGION_DIVISOR = 16  # so much of the budget's share of cells that are cut finer may be one region's
_MAX_CANDIDATES = 4  # cells of a region in which a witness is looked for, if its best one has none


def search_round(
    constraints: Constraints, found: WitnessedCells, *, refinable: bool
) -> tuple[Regions, Cells]:
    """Regions that are done, and the cells of those that are to be cut finer: none unless `refinable`."""
    position = position_boxes(found.cells, np.zeros((len(found), 2)), constraints.anchor_mm)
    label = component_labels(region_boxes(constraints, found.cells, position), group_by_links)
    # By what they are, not by how they were found: which are tried must not depend on that.
    x, y = found.cells.centre.T.round(6)
    order = np.lexsort((y, x, found.cells.middle.round(9), label))
    found, label = found.select(order), label[order]
    cells = found.cells
    first = np.searchsorted(label, np.arange(int(label.max(initial=-1)) + 2))
    branch = _symmetry_shift(constraints.catalogue, cells, first, label)
    room = constraints.budget.refinements
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


def _regions_to_refine(wanted: Bools, size: Ints, room: int) -> Bools:
    """Mask of the regions (h,) that are cut finer: as many as there is room for, the smallest first."""
    order = np.argsort(np.where(wanted, size, np.iinfo(np.int64).max), kind="stable")
    result = wanted.copy()
    result[order] &= np.cumsum(np.where(wanted, size, 0)[order]) <= room
    return result


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
    turn = 2 * np.pi / catalogue.symmetry_orders[cells.state]
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
    """Candidates among the cells (n,) of each region, evenly up to `_CANDIDATES`; the best come first."""
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
