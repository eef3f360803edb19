"""Witness candidates with NumPy: cells that free paths leave, with configurations refined to fit.

Cells come from intervals of orientations, or from cells that are cut finer. Candidates in them satisfy
rectangles round edges; what counts is the distance from the true boundary. A few weighted Gauss-Newton steps
on these distances lead to where all contacts are within their bounds, if that is near by. Each result is
verified; it has to stay in a cell of its region.
"""

from dataclasses import dataclass

import numpy as np

from palpate.base.geometry import Bools, Floats, Ints
from palpate.base.geometry.plane import cross
from palpate.recognizer.constraints import Constraints
from palpate.recognizer.interpretations import Interpretations, Query
from palpate.recognizer.numpy_cells import cut_cells, divide_cells, free_cells
from palpate.recognizer.pose_region import (
    LEVER_MM,
    PARTS_PER_CELL,
    Cells,
    Intervals,
    WitnessedCells,
    intervals_to_probe,
)
from palpate.recognizer.tables import expand_ranges
from palpate.recognizer.verification import Nearness, Poses, Verification, may_fit, verify

_COINCIDING_MM = 1e-9  # vertices as near as that are one
_CORNER_SHARE = 0.9  # of the way from the middle of the positions to their corners


@dataclass(frozen=True, eq=False)
class ProbedCells:
    """k cells, t of which were looked at in their middle.

    `section` (t, v, 2) mm: the polygon of positions s that satisfy every contact at exactly the middle
    orientation of the cells `tried` (t,).
    """

    cells: Cells
    tried: Ints
    section: Floats


def probe_cells(query: Query, nodes: Interpretations, intervals: Intervals) -> ProbedCells:
    """Cut the intervals, and at exactly their middle orientations as well.

    Where there are many, only the middle one of each few of an interpretation is looked at in its middle.
    """
    count = len(intervals.node)
    middle = (intervals.lo + intervals.hi) / 2
    tried = intervals_to_probe(intervals)
    found, alive = cut_cells(
        query,
        nodes,
        Intervals.join([intervals, Intervals(intervals.node[tried], middle[tried], middle[tried])]),
    )
    whole = alive < count
    place = np.full(count, -1)
    place[alive[whole]] = np.arange(int(whole.sum()))
    # A cell that is not empty in its middle is not empty.
    return ProbedCells(found.select(whole), place[tried[alive[~whole] - count]], found.polygon[~whole])


def sift_intervals(constraints: Constraints, intervals: Intervals, *, corners: bool) -> WitnessedCells:
    """Cells of the intervals that the free paths leave, some of them with a candidate for a witness.

    What satisfies the contacts may still be blocked: tried are the middle of these positions and, with
    `corners`, places towards their corners as well.
    """
    found = probe_cells(constraints.paired, constraints.nodes, intervals)
    return _try_places(constraints, found.cells, found.tried, found.section, corners=corners)


def sift_parts(constraints: Constraints, cells: Cells) -> WitnessedCells:
    """Cells in parts along whichever of their sides is longest: those that the free paths leave."""
    parts, _ = divide_cells(cells, LEVER_MM, PARTS_PER_CELL)
    return _try_places(constraints, parts, np.arange(len(parts)), parts.polygon, corners=False)


def _try_places(
    constraints: Constraints, cells: Cells, probed: Ints, section: Floats, *, corners: bool
) -> WitnessedCells:
    """Cells that the free paths leave; of those `probed` (t,), places in a section (t, v, 2) are tried."""
    middle = corner_means(section)[:, None]
    places = (
        np.concatenate([middle, middle + _CORNER_SHARE * (section - middle)], axis=1) if corners else middle
    )
    spots = _cells_at(cells, np.repeat(probed, places.shape[1]), places.reshape(-1, 2))
    both = Cells.join([cells, spots])
    free = free_cells(constraints.evidence, both, constraints.null_rows(both.node))
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


_MAX_STEPS = 6
_RELAXATION = 0.6  # weights change with every step: whole ones would swing to and fro
_MAX_EXCESS_SHARE = 0.9  # of the excess over a bound at least so much has to be left less by every step
_MAX_STEP_MM = 1.0
_DAMPING = 1e-4
_INNER_SHARE = 0.9  # of a cell's orientations: at its very ends normals have left their ranges by rounding
_LEAST_WEIGHT = 0.05
_EXACT_MM = 1e-3  # bounds below this weigh as this
_IN_CELL_MM2, _IN_CELL_RAD = 1e-9, 1e-12


@dataclass(frozen=True, eq=False)
class _Regions:
    """Regions in which configurations have to stay: their `cells`, those of region i from `first`[i] on."""

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
    node = cells.node[cell]
    skipped = constraints.null_rows(node)
    contacts = constraints.evidence.contacts
    regions, inner = (
        _Regions(cells, first, constraints.nodes.edges < 0),
        _INNER_SHARE * cells.half_width[cell],
    )
    lo, hi = cells.middle[cell] - inner, cells.middle[cell] + inner
    theta, position, holds = poses.theta.copy(), poses.position.copy(), np.zeros(len(poses), dtype=bool)
    bound = np.array([contact.position_bound_mm for contact in contacts])
    left, worst = np.arange(len(poses)), np.full(len(poses), np.inf)
    for step in range(_MAX_STEPS + 1):
        some = Poses(poses.state[left], theta[left], position[left])
        found = verify(constraints.evidence, some, None if skipped is None else skipped[left])
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
    """Turns (n,), within [lo, hi], and shifts (n, 2) of configurations towards the contacts' places.

    Least squares, with the more weight the further a contact is beyond its bound; damped where the contacts
    leave a direction free.
    """
    contacts = constraints.evidence.contacts
    known = np.isfinite(found.gap)
    away = np.where(known, found.gap, 0.0)
    towards = np.where(
        away[..., None] > 1e-9, found.offset / np.maximum(away, 1e-300)[..., None], found.normal
    )
    bound = np.array([max(contact.position_bound_mm, _EXACT_MM) for contact in contacts])
    weight = np.where(known, np.maximum(away / bound, _LEAST_WEIGHT) / bound, 0.0)
    seen = poses.to_objects(np.array([contact.end_mm for contact in contacts]), constraints.anchor_mm)
    # At the end of the contact's range it is the point that is touched that the surface has to reach.
    radius = np.column_stack(
        [constraints.catalogue.boundary(item.finger).radius_mm[poses.state] for item in contacts]
    )
    foot = np.where(found.limited, radius, 0.0)[..., None] * found.normal
    lever = seen - foot + poses.position[:, None]
    turning = (towards[..., 0] * lever[..., 1] - towards[..., 1] * lever[..., 0]) / LEVER_MM
    rows = np.concatenate([-towards, turning[..., None]], axis=2) * weight[..., None]
    step = _least_squares(rows, away * weight)
    turn = np.clip(poses.theta + step[:, 2] / LEVER_MM, lo, hi) - poses.theta
    stopped = np.flatnonzero(np.abs(turn * LEVER_MM - step[:, 2]) > 1e-12)
    fixed = rows[stopped]
    rest = (away * weight)[stopped] - fixed[..., 2] * (turn[stopped] * LEVER_MM)[:, None]
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
    return may_fit(
        constraints.evidence,
        Poses(cells.state, cells.middle, cells.centre),
        Nearness(cells.half_width, cells.radius),
        constraints.null_rows(cells.node),
        constraints.budget.pieces,
    )
