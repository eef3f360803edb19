"""Witness search: connected regions of cells, each with a configuration that satisfies all constraints.

Everything is done for all regions at once. Cells are a little larger than what they enclose, so candidates
are judged by `verification`. If none in a region holds, cells that provably contain none are dropped and the
others are subdivided: a configuration is found, or nothing is left, or the region remains unverified.

A cell takes every half-plane at its largest value over the cell's orientations. That hardly matters while
hypotheses are being distinguished, but it widens the bounds of the last ones: these are enclosed again, in
narrower cells, without those that cannot contain a configuration which satisfies every contact exactly.
"""

from dataclasses import dataclass, replace

import numpy as np

from palpate.base.geometry import Floats, Ints
from palpate.base.geometry.plane import rotate
from palpate.recognizer.constraints import Constraints
from palpate.recognizer.pose_region import (
    LEVER_MM,
    PARTS_PER_CELL,
    Cells,
    Intervals,
    Regions,
    WitnessedCells,
)
from palpate.recognizer.steps import STEPS

_MAX_REFINEMENTS = 4
_REGION_DIVISOR = 8  # so much of the budget's share of fine cells is one region's
_MAX_BUDGET_SHARES = 4  # times that share, of cells: to divide so many once more would take seconds
_PARTS_PER_FINE_CELL = 4  # of these, along their longest sides
_CELLS_WORTH_REFINING = 16  # cells of a region: with fewer little is gained
_CELLS_AT_ONCE = 2048  # of a paving: the budget for pieces of the boundary is for each so many
_FINE_MM = 0.4  # of a paving's cells, radius and turn together: finer ones hardly bound anything better

PAVED_RAD = 0.1
"""Orientations of a paving's first cells."""


def connected_regions(constraints: Constraints, intervals: Intervals) -> Regions:
    """The connected regions of the intervals' cells, without those that prove to be empty."""
    found, done = _clipped(constraints, STEPS.sift_intervals(constraints, intervals, corners=False)), []
    if constraints.is_paved:
        found = _pave(constraints, found)
    for nth in range(_MAX_REFINEMENTS + 1):
        regions, again = STEPS.search_round(constraints, found, refinable=nth < _MAX_REFINEMENTS)
        done.append(regions)
        if not len(again):
            break
        anew = nth == 0 and not constraints.is_paved  # cells of a paving are narrower than what would be cut
        found = _clipped(constraints, cut_finer(constraints, again, at_first=anew))
    return Regions.join(done)


def _pave(constraints: Constraints, found: WitnessedCells) -> WitnessedCells:
    """Cells divided again and again, without those that cannot satisfy all contacts: a paving.

    Until they are fine, or as many as the budget allows.
    """
    while True:
        parts = [
            begin + np.flatnonzero(STEPS.can_be_verified(constraints, some.cells))
            for begin in range(0, len(found), _CELLS_AT_ONCE)
            if (some := found.select(slice(begin, begin + _CELLS_AT_ONCE)))
        ]
        found = found.select(np.concatenate(parts) if parts else np.empty(0, np.int64))
        cells = found.cells
        if not len(found) or PARTS_PER_CELL * len(found) > constraints.budget.paving:
            return found
        if np.median(cells.radius + LEVER_MM * cells.half_width) < _FINE_MM:
            return found
        found = _clipped(constraints, STEPS.sift_parts(constraints, cells))


def _clipped(constraints: Constraints, found: WitnessedCells) -> WitnessedCells:
    """What the carried region leaves of cells."""
    return found if constraints.carried is None else constraints.carried.clip_witnessed(found)


def cut_finer(constraints: Constraints, cells: Cells, *, at_first: bool) -> WitnessedCells:
    """Cells in parts: at first by orientation and cut anew, then by whichever of their sides is longest."""
    if not at_first:
        return STEPS.sift_parts(constraints, cells)
    parts = np.full(len(cells), PARTS_PER_CELL)
    finer, _ = STEPS.refine_intervals(constraints.paired, constraints.nodes, cells, parts)
    return STEPS.sift_intervals(constraints, finer, corners=True)


@dataclass(frozen=True, eq=False)
class Enclosures:
    """Least and largest x and y (mm) and θ (rad) of h regions, `lo` and `hi` (h, 3), rounded outward.

    `cells`: all of their configurations, on the branches of their interpretations.
    """

    lo: Floats
    hi: Floats
    cells: Cells


def enclosures(constraints: Constraints, regions: Regions) -> Enclosures:
    """Enclosures of all regions, of finer cells for those with a witness, where there are few."""
    lo, hi = _region_boxes(constraints, regions.cells, regions.first)
    rows = np.flatnonzero(regions.verified)
    room = constraints.budget.fine
    if (
        len(regions) * _CELLS_WORTH_REFINING > room
        or len(regions.cells) > _MAX_BUDGET_SHARES * room
        or not len(rows)
    ):
        return Enclosures(lo, hi, regions.unturned)
    fine = _refine_cells(constraints, regions.select(rows))
    kept = np.flatnonzero(np.diff(fine.first))
    low, high = _region_boxes(constraints, fine.turned, fine.first[np.append(kept, -1)])
    lo[rows[kept]] = np.maximum(lo[rows[kept]], low)
    hi[rows[kept]] = np.minimum(hi[rows[kept]], high)
    others = regions.select(np.setdiff1d(np.arange(len(regions)), rows[kept]))
    return Enclosures(lo, hi, Cells.join([fine.cells, others.unturned]))


@dataclass(frozen=True, eq=False)
class _FineCells:
    """Narrower `cells` of regions, ordered by region: region i's begin at `first`[i].

    `turned`: the same on the regions' branches of the symmetry.
    """

    cells: Cells
    turned: Cells
    first: Ints


def _refine_cells(constraints: Constraints, regions: Regions) -> _FineCells:
    """The regions' cells in so many narrower ones."""
    size = np.diff(regions.first)
    region = np.repeat(np.arange(len(size)), size)
    room = constraints.budget.fine
    wanted = min(room // _REGION_DIVISOR, room // len(size))
    parts = np.ceil(wanted / size).astype(np.int64)[region]
    paired, nodes, unturned = constraints.paired, constraints.nodes, regions.unturned
    intervals, owner = STEPS.refine_intervals(paired, nodes, unturned, parts)
    cells, of = STEPS.cut_cells(paired, nodes, intervals)
    if constraints.carried is not None:
        cells, rows = constraints.carried.clip(cells)
        of = of[rows]
    cells, owner = _drop_empty_cells(constraints, cells, owner[of])
    cells, of = STEPS.divide_cells(cells, LEVER_MM, _PARTS_PER_FINE_CELL)
    cells, owner = _drop_empty_cells(constraints, cells, owner[of])
    shift = (unturned.lo - regions.cells.lo)[owner]
    turned = replace(
        cells, lo=cells.lo - shift, hi=cells.hi - shift, polygon=rotate(cells.polygon, shift[:, None])
    )
    return _FineCells(cells, turned, np.searchsorted(region[owner], np.arange(len(size) + 1)))


def _drop_empty_cells(constraints: Constraints, cells: Cells, owner: Ints) -> tuple[Cells, Ints]:
    """Cells that may hold a configuration that satisfies everything."""
    skipped = constraints.null_rows(cells.node)
    free = np.flatnonzero(STEPS.free_cells(constraints.evidence, cells, skipped))
    cells, owner = cells.select(free), owner[free]
    left = np.flatnonzero(STEPS.can_be_verified(constraints, cells))
    return cells.select(left), owner[left]


def _region_boxes(constraints: Constraints, cells: Cells, first: Ints) -> tuple[Floats, Floats]:
    """Boxes of regions that all have cells."""
    low, high = STEPS.position_boxes(
        cells, constraints.catalogue.origins_mm[cells.state], constraints.anchor_mm
    )
    lo = np.column_stack([low, cells.lo - 1e-12])
    hi = np.column_stack([high, cells.hi + 1e-12])
    begin = first[:-1]
    return (np.minimum.reduceat(lo, begin), np.maximum.reduceat(hi, begin)) if len(begin) else (lo, hi)
