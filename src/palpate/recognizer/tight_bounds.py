"""Tight bounds: what the regions that are reported can be in, from cells cut as finely as it takes.

A cell takes every half-plane at its largest value over the cell's orientations. That is of no account while
hypotheses are told apart, but widens what is said of the last ones: these are enclosed once more, in narrower
cells, from which goes what cannot hold a configuration that satisfies every contact exactly.
"""

from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from palpate.base.geometry import Floats, Ints
from palpate.base.geometry.plane import rotate
from palpate.recognizer.constraints import Constraints
from palpate.recognizer.region import Cells, cut_cells, divide_longest, refine_intervals
from palpate.recognizer.witness_polish import can_be_verified
from palpate.recognizer.witness_search import Regions, position_boxes

__all__ = ["enclosures"]

_OF_ONE = 8  # so much of the budget's share of fine cells is one region's
_FINE_ENOUGH = 4  # times that share, of cells: to divide so many once more would take seconds
_PARTS = 4  # of these, along their longest sides
_LEVER_MM = 40.0  # what a turn counts for against a shift
_WORTH = 16  # cells of a region: with fewer little is gained


def enclosures(constraints: Constraints, regions: Regions) -> tuple[Floats, Floats]:
    """Least and largest x and y (mm) and θ (rad) of all regions, (h, 3) each, rounded outward.

    Of finer cells for those with a witness, where there are few.
    """
    lo, hi = _of_cells(constraints, regions.cells, regions.first)
    rows = np.flatnonzero(regions.verified)
    room = constraints.budget.fine
    if len(regions) * _WORTH > room or len(regions.cells) > _FINE_ENOUGH * room or not len(rows):
        return lo, hi
    fine = _refined(constraints, regions.select(rows))
    kept = np.flatnonzero(np.diff(fine.first))
    low, high = _of_cells(constraints, fine.cells, fine.first[np.append(kept, -1)])
    lo[rows[kept]] = np.maximum(lo[rows[kept]], low)
    hi[rows[kept]] = np.minimum(hi[rows[kept]], high)
    return lo, hi


@dataclass(frozen=True, eq=False)
class _FineCells:
    """`cells` ordered by region; those of region i from `first`[i] to `first`[i + 1]."""

    cells: Cells
    first: Ints


def _refined(constraints: Constraints, regions: Regions) -> _FineCells:
    """The regions' cells in so many narrower ones, on the regions' branches of the symmetry."""
    catalogue, nodes, touched = constraints.catalogue, constraints.nodes, constraints.touched
    size = np.diff(regions.first)
    region = np.repeat(np.arange(len(size)), size)
    room = constraints.budget.fine
    wanted = min(room // _OF_ONE, room // len(size))
    parts = np.ceil(wanted / size).astype(np.int64)[region]
    unturned, anchor = regions.unturned, constraints.anchor_mm
    intervals, owner = refine_intervals(catalogue, nodes, unturned, touched, anchor, parts)
    cells, of = cut_cells(catalogue, nodes, touched, anchor, intervals)
    cells, owner = _possible(constraints, cells, owner[of])
    cells, of = divide_longest(cells, _LEVER_MM, _PARTS)
    cells, owner = _possible(constraints, cells, owner[of])
    shift = (unturned.lo - regions.cells.lo)[owner]
    turned = replace(
        cells, lo=cells.lo - shift, hi=cells.hi - shift, polygon=rotate(cells.polygon, shift[:, None])
    )
    return _FineCells(turned, np.searchsorted(region[owner], np.arange(len(size) + 1)))


def _possible(constraints: Constraints, cells: Cells, owner: Ints) -> tuple[Cells, Ints]:
    """Those cells that may hold a configuration that satisfies everything."""
    for test in (constraints.allow, partial(can_be_verified, constraints)):
        left = np.flatnonzero(test(cells))
        cells, owner = cells.select(left), owner[left]
    return cells, owner


def _of_cells(constraints: Constraints, cells: Cells, first: Ints) -> tuple[Floats, Floats]:
    """Boxes of regions that all have cells."""
    low, high = position_boxes(cells, constraints.catalogue.origins_mm[cells.state], constraints.anchor_mm)
    lo = np.column_stack([low, cells.lo - 1e-12])
    hi = np.column_stack([high, cells.hi + 1e-12])
    begin = first[:-1]
    return (np.minimum.reduceat(lo, begin), np.maximum.reduceat(hi, begin)) if len(begin) else (lo, hi)
