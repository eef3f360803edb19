"""Witness candidates: cells that the free paths leave, with places where a witness may be.

Cells come from intervals of orientations, or from cells that are cut finer; the compiled kernel cuts and
tries likewise (`sift.c`).
"""

from dataclasses import dataclass

import numpy as np

from palpate.base.geometry import Bools, Floats, Ints
from palpate.base.geometry.segments import cross
from palpate.recognizer.compiled import KERNEL
from palpate.recognizer.compiled_cells import SiftedArrays, sifted_intervals, sifted_parts
from palpate.recognizer.constraints import Constraints
from palpate.recognizer.region import (
    Cells,
    Intervals,
    divide_longest,
    probe_cells,
    probed_intervals,
    refine_intervals,
)
from palpate.recognizer.tables import Table

__all__ = ["LEVER_MM", "PARTS", "WitnessedCells", "corner_means", "cut_finer", "find_witnesses"]

PARTS = 4
"""Into so many a cell is cut."""
LEVER_MM = 40.0
"""What a turn counts for against a shift, where sides of cells or configurations are compared."""
_COINCIDING_MM = 1e-9  # vertices as near as that are one
_OUT = 0.9  # of the way from the middle of the positions to their corners


@dataclass(frozen=True, eq=False)
class WitnessedCells(Table):
    """k cells; where `holds` (k,), position `spot` s (k, 2) and the middle orientation are a candidate."""

    cells: Cells
    spot: Floats
    holds: Bools


def find_witnesses(
    constraints: Constraints, intervals: Intervals, *, corners: bool = False
) -> WitnessedCells:
    """Cells of the intervals that the free paths leave, some of them with a candidate for a witness.

    What satisfies the contacts may still be blocked: tried are the middle of these positions and, with
    `corners`, places towards their corners as well.
    """
    if KERNEL is not None:
        tried = probed_intervals(intervals)
        asked = None if len(tried) == len(intervals) else np.bincount(tried, minlength=len(intervals)) > 0
        rows = (intervals.node, intervals.lo, intervals.hi)
        pairings, paths = constraints.compiled_pairings, constraints.compiled_paths
        sifted = sifted_intervals(KERNEL, pairings, paths, rows, asked, corners=corners)
        return _of_arrays(constraints, intervals.node[sifted.row], sifted)
    found = probe_cells(
        constraints.catalogue, constraints.nodes, constraints.touched, constraints.anchor_mm, intervals
    )
    return _witnessed(constraints, found.cells, found.tried, found.section, corners=corners)


def _of_arrays(constraints: Constraints, node: Ints, sifted: SiftedArrays) -> WitnessedCells:
    cells = Cells(node, constraints.nodes.state[node], sifted.lo, sifted.hi, sifted.polygon)
    return WitnessedCells(cells, sifted.spot, sifted.holds)


def _witnessed(
    constraints: Constraints, cells: Cells, probed: Ints, section: Floats, *, corners: bool
) -> WitnessedCells:
    """Cells that the free paths leave; of those `probed` (t,), places in a section (t, v, 2) are tried."""
    middle = corner_means(section)[:, None]
    places = np.concatenate([middle, middle + _OUT * (section - middle)], axis=1) if corners else middle
    spots = _cells_at(cells, np.repeat(probed, places.shape[1]), places.reshape(-1, 2))
    free = constraints.allow(Cells.joined([cells, spots]))
    count = len(cells)
    open_to = free[count:].reshape(places.shape[:2])
    holds, spot = np.zeros(count, dtype=bool), np.zeros((count, 2))
    holds[probed] = open_to.any(axis=1)
    spot[probed] = places[np.arange(len(places)), np.argmax(open_to, axis=1)]
    return WitnessedCells(cells, spot, holds).select(np.flatnonzero(free[:count]))


def corner_means(polygon: Floats) -> Floats:
    """Means (t, 2) of the corners of convex polygons (t, v, 2), whatever they are padded to.

    Of vertices that coincide one counts, and none that is on a straight side: a line that only touches a
    corner or a side may or may not leave a vertex there, by rounding.
    """
    real = np.abs(polygon - np.roll(polygon, 1, axis=1)).max(axis=2) > _COINCIDING_MM
    real[:, 0] |= ~real.any(axis=1)
    count, column = real.sum(axis=1)[:, None], np.arange(polygon.shape[1])
    row = np.arange(len(polygon))[:, None]
    vertex = polygon[row, np.argsort(~real, axis=1, kind="stable")]
    came, goes = vertex - vertex[row, (column - 1) % count], vertex[row, (column + 1) % count] - vertex
    off_line = np.abs(cross(came, goes)) > _COINCIDING_MM * np.linalg.norm(came + goes, axis=2)
    counts = (column < count) & (off_line | (np.sum(came * goes, axis=2) <= 0))
    result: Floats = np.einsum("tv,tvj->tj", counts, vertex) / counts.sum(axis=1)[:, None]
    return result


def _cells_at(cells: Cells, row: Ints, position: Floats) -> Cells:
    """Cells without extent at positions (n, 2) in the middle orientations of the cells `row` (n,)."""
    middle = cells.middle[row]
    return Cells(cells.node[row], cells.state[row], middle, middle, position[:, None])


def cut_finer(constraints: Constraints, cells: Cells, *, at_first: bool) -> WitnessedCells:
    """Cells in parts: at first by orientation and cut anew, then by whichever of their sides is longest."""
    if at_first:
        finer, _ = refine_intervals(
            constraints.catalogue,
            constraints.nodes,
            cells,
            constraints.touched,
            constraints.anchor_mm,
            PARTS,
        )
        return find_witnesses(constraints, finer, corners=True)
    if KERNEL is not None:
        rows = (cells.node, cells.state, cells.lo, cells.hi, cells.polygon)
        nodes = len(constraints.nodes)
        sifted = sifted_parts(KERNEL, rows, LEVER_MM, PARTS, constraints.compiled_paths, nodes)
        return _of_arrays(constraints, cells.node[sifted.row], sifted)
    parts, _ = divide_longest(cells, LEVER_MM, PARTS)
    return _witnessed(constraints, parts, np.arange(len(parts)), parts.polygon, corners=False)
