"""Witness candidates: cells that the free paths leave, with configurations that are polished to fit.

Cells come from intervals of orientations, or from cells that are cut finer. Candidates in them satisfy
rectangles round edges; what counts is the distance from the true boundary. A few weighted Gauss-Newton steps
on these distances lead to where all contacts are within their bounds, if that is near by. Each result is
verified; it has to stay in a cell of its region. The compiled kernel cuts, tries and polishes likewise
(`sift.c`, `polish.c`).
"""

from dataclasses import dataclass

import numpy as np

from palpate.base.geometry import Bools, Floats, Ints
from palpate.base.geometry.plane import cross
from palpate.recognizer.compiled import KERNEL
from palpate.recognizer.compiled_judgement import polish_poses, poses_may_fit
from palpate.recognizer.compiled_search import SiftedArrays, sift_intervals, sift_parts
from palpate.recognizer.constraints import Constraints
from palpate.recognizer.pose_region import (
    Cells,
    Intervals,
    divide_longest,
    intervals_to_probe,
    probe_cells,
    refine_intervals,
)
from palpate.recognizer.tables import Table, expand_ranges
from palpate.recognizer.tree_branches import null_mask
from palpate.recognizer.verification import Poses, Verification, may_fit, verify

PARTS_PER_CELL = 4
"""Into so many a cell is cut."""
LEVER_MM = 40.0
"""What a turn counts for against a shift, where sides of cells or configurations are compared."""
_COINCIDING_MM = 1e-9  # vertices as near as that are one
_CORNER_SHARE = 0.9  # of the way from the middle of the positions to their corners


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
        tried = intervals_to_probe(intervals)
        asked = None if len(tried) == len(intervals) else np.bincount(tried, minlength=len(intervals)) > 0
        rows = (intervals.node, intervals.lo, intervals.hi)
        pairings, paths = constraints.compiled_pairings, constraints.compiled_paths
        sifted = sift_intervals(KERNEL, pairings, paths, rows, asked, corners=corners)
        return _from_arrays(constraints, intervals.node[sifted.row], sifted)
    found = probe_cells(
        constraints.catalogue, constraints.nodes, constraints.touched, constraints.anchor_mm, intervals
    )
    return _try_places(constraints, found.cells, found.tried, found.section, corners=corners)


def _from_arrays(constraints: Constraints, node: Ints, sifted: SiftedArrays) -> WitnessedCells:
    cells = Cells(node, constraints.nodes.state[node], sifted.lo, sifted.hi, sifted.polygon)
    return WitnessedCells(cells, sifted.spot, sifted.holds)


def _try_places(
    constraints: Constraints, cells: Cells, probed: Ints, section: Floats, *, corners: bool
) -> WitnessedCells:
    """Cells that the free paths leave; of those `probed` (t,), places in a section (t, v, 2) are tried."""
    middle = corner_means(section)[:, None]
    places = (
        np.concatenate([middle, middle + _CORNER_SHARE * (section - middle)], axis=1) if corners else middle
    )
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
            PARTS_PER_CELL,
        )
        return find_witnesses(constraints, finer, corners=True)
    if KERNEL is not None:
        rows = (cells.node, cells.state, cells.lo, cells.hi, cells.polygon)
        nodes = len(constraints.nodes)
        sifted = sift_parts(KERNEL, rows, LEVER_MM, PARTS_PER_CELL, constraints.compiled_paths, nodes)
        return _from_arrays(constraints, cells.node[sifted.row], sifted)
    parts, _ = divide_longest(cells, LEVER_MM, PARTS_PER_CELL)
    return _try_places(constraints, parts, np.arange(len(parts)), parts.polygon, corners=False)


_MAX_STEPS = 6
_RELAXATION = 0.6  # weights change with every step: whole ones would swing to and fro
_MAX_EXCESS_SHARE = 0.9  # of the excess over a bound at least so much has to be left less by every step
_LEVER_MM = 40.0  # what a turn counts for against a shift
_MAX_STEP_MM = 1.0
_DAMPING = 1e-4
_INNER_SHARE = 0.9  # of a cell's orientations: at its very ends normals have left their ranges by rounding
_LEAST_WEIGHT = 0.05
_EXACT_MM = 1e-3  # bounds below this weigh as this
_IN_CELL_MM2, _IN_CELL_RAD = 1e-9, 1e-12


@dataclass(frozen=True, eq=False)
class _Regions:
    """Where configurations have to stay: `cells` of regions, those of region i from `first`[i] on."""

    cells: Cells
    first: Ints
    null: Bools

    def hold(self, region: Ints, node: Ints, poses: Poses) -> Bools:
        """Poses (n,) in a cell of their region whose interpretation has the null contacts of `node` (n,)."""
        owner, cell = expand_ranges(self.first[region], np.diff(self.first)[region])
        cells, theta = self.cells, poses.theta[owner]
        near = (theta >= cells.lo[cell] - _IN_CELL_RAD) & (theta <= cells.hi[cell] + _IN_CELL_RAD)
        near &= np.all(self.null[cells.node[cell]] == self.null[node[owner]], axis=1)
        owner, cell = owner[near], cell[near]
        polygon = cells.polygon[cell]
        leg = np.roll(polygon, -1, axis=1) - polygon
        away = poses.position[owner][:, None] - polygon
        within = np.all(leg[..., 0] * away[..., 1] - leg[..., 1] * away[..., 0] >= -_IN_CELL_MM2, axis=1)
        return np.bincount(owner[within], minlength=len(poses)) > 0


def polish(
    constraints: Constraints, cells: Cells, first: Ints, region: Ints, cell: Ints, poses: Poses
) -> tuple[Poses, Bools]:
    """Candidates of regions (n,) in some of their `cells`, `cell` (n,), polished; and which are verified.

    Orientations stay in the cell: beyond it normals would leave their ranges.
    """
    node, null = cells.node[cell], constraints.nodes.edges < 0
    skipped = null_mask(constraints.nodes, node, constraints.evidence)
    if KERNEL is not None:
        rows = (poses.state, poses.theta, poses.position)
        theta, position, holds = polish_poses(
            KERNEL, constraints.compiled_evidence, cells, first, null, region, cell, rows, skipped
        )
        return Poses(poses.state, theta, position), holds
    regions, inner = _Regions(cells, first, null), _INNER_SHARE * cells.half_width[cell]
    lo, hi = cells.middle[cell] - inner, cells.middle[cell] + inner
    theta, position, holds = poses.theta.copy(), poses.position.copy(), np.zeros(len(poses), dtype=bool)
    bound = np.array([contact.position_bound_mm for contact in constraints.evidence])
    left, worst = np.arange(len(poses)), np.full(len(poses), np.inf)
    for step in range(_MAX_STEPS + 1):
        some = Poses(poses.state[left], theta[left], position[left])
        found = verify(
            constraints.catalogue,
            some,
            constraints.evidence,
            constraints.anchor_mm,
            None if skipped is None else skipped[left],
        )
        good = found.holds
        if step > 0:
            good &= regions.hold(region[left], node[left], some)
        holds[left[good]] = True
        # Where the contact that is worst off gains little, nothing is to be hoped for.
        excess = np.where(found.fits, 0.0, found.gap - bound).max(axis=1)
        going = ~good & (excess > 0) & (excess < _MAX_EXCESS_SHARE * worst[left])
        worst[left] = excess
        left, found, some = left[going], found.select(going), some.select(going)
        if step == _MAX_STEPS or not len(left):
            break
        turn, shift = _step(constraints, some, found, lo[left], hi[left])
        theta[left] += turn if step == 0 else _RELAXATION * turn
        position[left] += shift if step == 0 else _RELAXATION * shift
    return Poses(poses.state, theta, position), holds


def _step(
    constraints: Constraints, poses: Poses, found: Verification, lo: Floats, hi: Floats
) -> tuple[Floats, Floats]:
    """How far to turn (n,), within [lo, hi], and shift (n, 2) configurations towards the contacts' places.

    Least squares, with the more weight the further a contact is beyond its bound; damped where the contacts
    leave a direction free.
    """
    contacts = constraints.evidence
    known = np.isfinite(found.gap)
    away = np.where(known, found.gap, 0.0)
    towards = np.where(
        away[..., None] > 1e-9, found.offset / np.maximum(away, 1e-300)[..., None], found.normal
    )
    bound = np.array([max(contact.position_bound_mm, _EXACT_MM) for contact in contacts])
    weight = np.where(known, np.maximum(away / bound, _LEAST_WEIGHT) / bound, 0.0)
    seen = poses.seen(np.array([contact.end_mm for contact in contacts]), constraints.anchor_mm)
    # At the end of the contact's range it is the point that is touched that the surface has to reach.
    radius = np.column_stack(
        [constraints.catalogue.boundary(item.finger).radius_mm[poses.state] for item in contacts]
    )
    foot = np.where(found.limited, radius, 0.0)[..., None] * found.normal
    lever = seen - foot + poses.position[:, None]
    turning = (towards[..., 0] * lever[..., 1] - towards[..., 1] * lever[..., 0]) / _LEVER_MM
    rows = np.concatenate([-towards, turning[..., None]], axis=2) * weight[..., None]
    step = _least_squares(rows, away * weight)
    turn = np.clip(poses.theta + step[:, 2] / _LEVER_MM, lo, hi) - poses.theta
    stopped = np.flatnonzero(np.abs(turn * _LEVER_MM - step[:, 2]) > 1e-12)
    fixed = rows[stopped]
    rest = (away * weight)[stopped] - fixed[..., 2] * (turn[stopped] * _LEVER_MM)[:, None]
    step[stopped, :2] = _least_squares(fixed[..., :2], rest)
    size = np.hypot(step[:, 0], step[:, 1])
    shift = step[:, :2] * np.minimum(1.0, _MAX_STEP_MM / np.maximum(size, 1e-300))[:, None]
    return turn, shift


def _least_squares(rows: Floats, right: Floats) -> Floats:
    """Damped solutions (n, k) of rows (n, m, k) · x = right (n, m)."""
    square = np.einsum("nmi,nmj->nij", rows, rows)
    damping = _DAMPING * np.trace(square, axis1=1, axis2=2) + 1e-12
    square += damping[:, None, None] * np.eye(rows.shape[2])
    solved: Floats = np.linalg.solve(square, np.einsum("nmi,nm->ni", rows, right)[..., None])[..., 0]
    return solved


def can_be_verified(constraints: Constraints, cells: Cells) -> Bools:
    """Cells (k,) that may hold a configuration which satisfies all contacts; in the others none does."""
    poses = Poses(cells.state, cells.middle, cells.centre)
    skipped = null_mask(constraints.nodes, cells.node, constraints.evidence)
    if KERNEL is not None:
        return poses_may_fit(
            KERNEL,
            constraints.compiled_evidence,
            *(poses.state, poses.theta, poses.position),
            cells.half_width,
            cells.radius,
            skipped,
            constraints.budget.pieces,
        )
    return may_fit(
        constraints.catalogue,
        poses,
        constraints.evidence,
        constraints.anchor_mm,
        cells.half_width,
        cells.radius,
        skipped,
        constraints.budget.pieces,
    )
