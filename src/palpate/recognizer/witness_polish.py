"""Witness polishing: a candidate configuration is moved until every contact is within its bound.

Candidates satisfy rectangles round edges; what counts is the distance from the true boundary. A few weighted
Gauss-Newton steps on these distances lead to where all are within their bounds, if that is near by. Each
result is verified; it has to stay in a cell of its region.
"""

from dataclasses import dataclass

import numpy as np

from palpate.base.geometry import Bools, Floats, Ints
from palpate.recognizer.compiled import KERNEL
from palpate.recognizer.compiled_verification import polished, which_may_fit
from palpate.recognizer.constraints import Constraints
from palpate.recognizer.null_branch import null_mask
from palpate.recognizer.region import Cells
from palpate.recognizer.tables import expand_ranges
from palpate.recognizer.verification import Poses, Verification, may_fit, verify

__all__ = ["can_be_verified", "polish"]

_STEPS = 6
_RELAXATION = 0.6  # weights change with every step: whole ones would swing to and fro
_GAIN = 0.9  # of the excess over a bound at least so much has to be left less by every step
_LEVER_MM = 40.0  # what a turn counts for against a shift
_LARGEST_STEP_MM = 1.0
_DAMPING = 1e-4
_INNER = 0.9  # of a cell's orientations: at its very ends normals have left their ranges by rounding
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
        theta, position, holds = polished(
            KERNEL, constraints.compiled_evidence, cells, first, null, region, cell, rows, skipped
        )
        return Poses(poses.state, theta, position), holds
    regions, inner = _Regions(cells, first, null), _INNER * cells.half_width[cell]
    lo, hi = cells.middle[cell] - inner, cells.middle[cell] + inner
    theta, position, holds = poses.theta.copy(), poses.position.copy(), np.zeros(len(poses), dtype=bool)
    bound = np.array([contact.position_bound_mm for contact in constraints.evidence])
    left, worst = np.arange(len(poses)), np.full(len(poses), np.inf)
    for step in range(_STEPS + 1):
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
        going = ~good & (excess > 0) & (excess < _GAIN * worst[left])
        worst[left] = excess
        left, found, some = left[going], found.select(going), some.select(going)
        if step == _STEPS or not len(left):
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
    shift = step[:, :2] * np.minimum(1.0, _LARGEST_STEP_MM / np.maximum(size, 1e-300))[:, None]
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
        return which_may_fit(
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
