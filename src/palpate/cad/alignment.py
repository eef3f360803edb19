"""Alignment of two stacks of sections: local minimum of the largest distance, from a rough start.

Least squares come first, then a minimax step. Both see the distances of all corners of each stack from the
outlines of the other, linearised about where the first stack lies now. Gauss–Newton gets exact copies onto
each other in a few steps; where outlines differ, what counts is the largest distance, and a linear programme
with a trust region lowers it (Madsen, An algorithm for minimax solution of overdetermined systems, J. Inst.
Maths Applics 16, 1975).
"""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import linprog

from palpate.base.geometry import Floats
from palpate.cad.outline_distance import OutlineTree, furthest_mm
from palpate.cad.stacks import Stack

__all__ = ["PlanarPose", "align", "largest_mm", "moved"]

_SQUARES = 12
_PROGRAMMES = 12
_SETTLED = 1e-9
"""A step this small beside the figure changes nothing more."""
_SLOW = 0.9
"""Least squares that leave more than this share of a sum are near their end; exact copies drop far faster."""
_ACTIVE = 60
"""Largest residuals that a programme sees; a step counts only if it lowers the largest of all."""
_WORTH = 1e-3
"""A programme that lowers the maximum by a smaller share was the last one."""
_HOPE = 0.05
"""Share by which each programme left is hoped to lower the maximum, unless the last one did by more."""


@dataclass(frozen=True, eq=False)
class PlanarPose:
    """A turn about the first stack's reference point, which goes to `centre_mm` (2,)."""

    turn_rad: float
    centre_mm: Floats


def moved(points_mm: Floats, turn_rad: float) -> Floats:
    """Points (n, 2) turned about the origin."""
    c, s = np.cos(turn_rad), np.sin(turn_rad)
    result: Floats = points_mm @ np.array([[c, s], [-s, c]])
    return result


def align(a: Stack, b: Stack, pose: PlanarPose, enough_mm: float) -> PlanarPose:
    """The pose near a given one at which corners of either stack are least far from the other's outlines.

    Given up early where programmes gain too little to come within `enough_mm`.
    """
    best, least = pose, _worst(a, b, pose)
    reach = max(a.reach_mm, b.reach_mm)
    squares = np.inf
    for _ in range(_SQUARES):
        off, rows = _linearised(a, b, pose)
        step = np.asarray(np.linalg.lstsq(rows, -off)[0], dtype=np.float64)
        pose = _stepped(pose, step, a.reach_mm)
        worst = _worst(a, b, pose)
        if worst < least:
            best, least = pose, worst
        squares, before = float(off @ off), squares
        if np.abs(step).max() <= _SETTLED * reach or squares > _SLOW * before:
            break
    return _least_maximum(a, b, best, least, enough_mm) if least > 10 * _SETTLED * reach else best


def largest_mm(a: Stack, b: Stack, pose: PlanarPose) -> float:
    """Hausdorff distance of the outlines of all sections, rounded up (see `furthest_mm`)."""
    worst = 0.0
    for mine, its in zip(a.outlines, b.outlines, strict=True):
        p, q = _there(mine.starts_mm, a, pose), _there(mine.ends_mm, a, pose)
        r, s = _back(its.starts_mm, a, pose), _back(its.ends_mm, a, pose)
        worst = max(worst, furthest_mm(p, q, its), furthest_mm(r, s, mine))
    return worst


def _there(points: Floats, a: Stack, pose: PlanarPose) -> Floats:
    return moved(points - a.centre_mm, pose.turn_rad) + pose.centre_mm


def _back(points: Floats, a: Stack, pose: PlanarPose) -> Floats:
    return moved(points - pose.centre_mm, -pose.turn_rad) + a.centre_mm


def _stepped(pose: PlanarPose, step: Floats, reach: float) -> PlanarPose:
    return PlanarPose(pose.turn_rad + float(step[2]) / reach, pose.centre_mm + step[:2])


def _worst(a: Stack, b: Stack, pose: PlanarPose) -> float:
    return max(
        max(
            float(its.nearest(_there(mine.starts_mm, a, pose))[0].max()),
            float(mine.nearest(_back(its.starts_mm, a, pose))[0].max()),
        )
        for mine, its in zip(a.outlines, b.outlines, strict=True)
    )


def _linearised(a: Stack, b: Stack, pose: PlanarPose) -> tuple[Floats, Floats]:
    """Distances (n,) of corners from outlines, signed along the rows' normals, and rows (n, 3).

    A row holds the derivatives by a shift in x and in y and by a turn times the first stack's reach.
    """
    off, rows = [], []
    for mine, its in zip(a.outlines, b.outlines, strict=True):
        here = _there(mine.starts_mm, a, pose)
        foot, normal = _feet(here, its)
        off.append(((here - foot) * normal).sum(axis=1))
        rows.append(_row(here - pose.centre_mm, normal, a.reach_mm))
        corner = its.starts_mm
        foot, normal = _feet(_back(corner, a, pose), mine)
        foot, normal = _there(foot, a, pose), moved(normal, pose.turn_rad)
        off.append(((foot - corner) * normal).sum(axis=1))
        rows.append(_row(foot - pose.centre_mm, normal, a.reach_mm))
    return np.concatenate(off), np.concatenate(rows)


def _row(arm: Floats, normal: Floats, reach: float) -> Floats:
    turn = (arm[:, 0] * normal[:, 1] - arm[:, 1] * normal[:, 0]) / reach
    return np.column_stack([normal, turn])


def _feet(points: Floats, outline: OutlineTree) -> tuple[Floats, Floats]:
    """Nearest points (n, 2) of an outline, and unit normals there: of the edge, or away from its end."""
    _, edge = outline.nearest(points)
    start = outline.starts_mm[edge]
    along = outline.ends_mm[edge] - start
    length = np.hypot(*along.T)
    share = ((points - start) * along).sum(axis=1) / length**2
    foot = start + np.clip(share, 0.0, 1.0)[:, None] * along
    normal = np.column_stack([along[:, 1], -along[:, 0]]) / length[:, None]
    away = points - foot
    far = np.hypot(*away.T)
    at_end = (share != np.clip(share, 0.0, 1.0)) & (far > 1e-12 * length)
    normal[at_end] = away[at_end] / far[at_end, None]
    return foot, normal


def _least_maximum(a: Stack, b: Stack, pose: PlanarPose, worst: float, enough: float) -> PlanarPose:
    trust = worst
    for left in reversed(range(_PROGRAMMES)):
        off, rows = _linearised(a, b, pose)
        step = _programme(off, rows, trust)
        there = _stepped(pose, step, a.reach_mm)
        now = _worst(a, b, there)
        gain = 1 - now / worst
        if gain > 0:
            pose, worst = there, now
        else:
            trust /= 4
        settled = trust < _WORTH * worst if gain <= 0 else gain < _WORTH
        if settled or worst * (1 - max(gain, _HOPE) * left) > enough:
            break
    return pose


def _programme(off: Floats, rows: Floats, trust: float) -> Floats:
    """The step (3,) within ± trust that makes the largest |off + rows @ step| least."""
    own = np.argsort(-np.abs(off))[:_ACTIVE]
    off, rows = off[own], rows[own]
    ones = np.ones((len(off), 1))
    limits = np.vstack([np.hstack([rows, -ones]), np.hstack([-rows, -ones])])
    found = linprog(
        [0.0, 0.0, 0.0, 1.0],
        A_ub=limits,
        b_ub=np.concatenate([-off, off]),
        bounds=[(-trust, trust)] * 3 + [(0.0, None)],
    )
    # Staying here is always allowed: a programme that fails (rounding) means no step.
    return np.zeros(3) if found.x is None else np.asarray(found.x[:3], dtype=float)
