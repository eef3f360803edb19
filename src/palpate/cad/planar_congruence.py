"""Planar congruence of two stacks of sections: all rigid motions in the plane that map one onto the other.

It finds duplicates among stable states and twins among objects. The search of the turn misses nothing: with
reference points together (`outline_stacks`) the outlines are within (1 + 4/π) of the wanted distance if any
shift brings them within it, and a turn by w moves no corner at radius r by more than 2 r sin(w/2), so a whole
interval of turns is ruled out by one corner that is too far away. Each local minimum that is left is refined
by shift and turn and measured exactly.

Refinement starts with least squares, then takes minimax steps. Both see the distances of all corners of each
stack from the outlines of the other, linearised about where the first stack lies now. Gauss–Newton gets exact
copies onto each other in a few steps; where outlines differ, what counts is the largest distance, and a
linear programme with a trust region lowers it (Madsen, An algorithm for minimax solution of overdetermined
systems, J. Inst. Maths Applics 16, 1975).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import shapely
from scipy.optimize import linprog
from shapely import affinity

from palpate.base.geometry import Floats, Ints
from palpate.base.geometry.plane import cross
from palpate.cad.outline_stacks import (
    STEINER_FACTOR,
    OutlineTree,
    Stack,
    could_match,
    furthest_distance_mm,
    round_bound_mm,
    stack_of,
)

_MAX_LEAST_SQUARES = 12
_MAX_PROGRAMMES = 12
_SETTLED_SHARE = 1e-9
"""A step this small beside the figure changes nothing more."""
_SLOW_DECREASE_RATIO = 0.9
"""Least squares that leave more than this share of a sum are near their end; exact copies drop far faster."""
_MAX_RESIDUALS = 60
"""Largest residuals that a programme sees; a step counts only if it lowers the largest of all."""
_LEAST_GAIN_SHARE = 1e-3
"""A programme that lowers the maximum by a smaller share was the last one."""
_HOPED_GAIN_SHARE = 0.05
"""Share by which each programme left is hoped to lower the maximum, unless the last one did by more."""


@dataclass(frozen=True, eq=False)
class PlanarPose:
    """A turn about the first stack's reference point, which goes to `centre_mm` (2,)."""

    turn_rad: float
    centre_mm: Floats


def _rotate_points(points_mm: Floats, turn_rad: float) -> Floats:
    """Points (n, 2) turned about the origin."""
    c, s = np.cos(turn_rad), np.sin(turn_rad)
    result: Floats = points_mm @ np.array([[c, s], [-s, c]])
    return result


def align(a: Stack, b: Stack, pose: PlanarPose, enough_mm: float) -> PlanarPose:
    """The pose near a given one at which corners of either stack are least far from the other's outlines.

    Given up early where programmes gain too little to come within `enough_mm`.
    """
    best, least = pose, _worst_corner_mm(a, b, pose)
    reach = max(a.reach_mm, b.reach_mm)
    squares = np.inf
    for _ in range(_MAX_LEAST_SQUARES):
        off, rows = _linearise(a, b, pose)
        step = np.asarray(np.linalg.lstsq(rows, -off)[0], dtype=np.float64)
        pose = _step_pose(pose, step, a.reach_mm)
        worst = _worst_corner_mm(a, b, pose)
        if worst < least:
            best, least = pose, worst
        squares, before = float(off @ off), squares
        if np.abs(step).max() <= _SETTLED_SHARE * reach or squares > _SLOW_DECREASE_RATIO * before:
            break
    return _least_maximum(a, b, best, least, enough_mm) if least > 10 * _SETTLED_SHARE * reach else best


def _largest_distance_mm(a: Stack, b: Stack, pose: PlanarPose) -> float:
    """Hausdorff distance of the outlines of all sections, rounded up (see `furthest_mm`)."""
    worst = 0.0
    for mine, its in zip(a.outlines, b.outlines, strict=True):
        p, q = _to_second(mine.start, a, pose), _to_second(mine.end, a, pose)
        r, s = _to_first(its.start, a, pose), _to_first(its.end, a, pose)
        worst = max(worst, furthest_distance_mm(p, q, its), furthest_distance_mm(r, s, mine))
    return worst


def _to_second(points: Floats, a: Stack, pose: PlanarPose) -> Floats:
    return _rotate_points(points - a.centre_mm, pose.turn_rad) + pose.centre_mm


def _to_first(points: Floats, a: Stack, pose: PlanarPose) -> Floats:
    return _rotate_points(points - pose.centre_mm, -pose.turn_rad) + a.centre_mm


def _step_pose(pose: PlanarPose, step: Floats, reach: float) -> PlanarPose:
    return PlanarPose(pose.turn_rad + float(step[2]) / reach, pose.centre_mm + step[:2])


def _worst_corner_mm(a: Stack, b: Stack, pose: PlanarPose) -> float:
    return max(
        max(
            float(its.nearest(_to_second(mine.start, a, pose))[0].max()),
            float(mine.nearest(_to_first(its.start, a, pose))[0].max()),
        )
        for mine, its in zip(a.outlines, b.outlines, strict=True)
    )


def _linearise(a: Stack, b: Stack, pose: PlanarPose) -> tuple[Floats, Floats]:
    """Distances (n,) of corners from outlines, signed along the rows' normals, and rows (n, 3).

    A row holds the derivatives by a shift in x and in y and by a turn times the first stack's reach.
    """
    off, rows = [], []
    for mine, its in zip(a.outlines, b.outlines, strict=True):
        here = _to_second(mine.start, a, pose)
        foot, normal = _foot_points(here, its)
        off.append(((here - foot) * normal).sum(axis=1))
        rows.append(_row(here - pose.centre_mm, normal, a.reach_mm))
        corner = its.start
        foot, normal = _foot_points(_to_first(corner, a, pose), mine)
        foot, normal = _to_second(foot, a, pose), _rotate_points(normal, pose.turn_rad)
        off.append(((foot - corner) * normal).sum(axis=1))
        rows.append(_row(foot - pose.centre_mm, normal, a.reach_mm))
    return np.concatenate(off), np.concatenate(rows)


def _row(arm: Floats, normal: Floats, reach: float) -> Floats:
    turn = cross(arm, normal) / reach
    return np.column_stack([normal, turn])


def _foot_points(points: Floats, outline: OutlineTree) -> tuple[Floats, Floats]:
    """Nearest points (n, 2) of an outline, and unit normals there: of the edge, or away from its end."""
    _, edge = outline.nearest(points)
    start = outline.start[edge]
    along = outline.end[edge] - start
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
    for left in reversed(range(_MAX_PROGRAMMES)):
        off, rows = _linearise(a, b, pose)
        step = _programme(off, rows, trust)
        there = _step_pose(pose, step, a.reach_mm)
        now = _worst_corner_mm(a, b, there)
        gain = 1 - now / worst
        if gain > 0:
            pose, worst = there, now
        else:
            trust /= 4
        settled = trust < _LEAST_GAIN_SHARE * worst if gain <= 0 else gain < _LEAST_GAIN_SHARE
        if settled or worst * (1 - max(gain, _HOPED_GAIN_SHARE) * left) > enough:
            break
    return pose


def _programme(off: Floats, rows: Floats, trust: float) -> Floats:
    """The step (3,) within ± trust that makes the largest |off + rows @ step| least."""
    own = np.argsort(-np.abs(off))[:_MAX_RESIDUALS]
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


_FIRST_INTERVALS = 32
"""Intervals of turn at the start; each division makes two of one."""
_NARROWEST_RAD = 0.004
_CORNERS_WIDE, _CORNERS_NARROW = 24, 120
"""So many corners of a section are asked in wider intervals, and in the narrowest."""


@dataclass(frozen=True, eq=False)
class PlanarMotion:
    """A point p goes to R(`turn_rad`) @ p + `shift_mm` (2,); turns are in (−π, π].

    `apart_mm`: the largest Hausdorff distance of outlines over all sections then, rounded up by at most
    1e-6 of itself and 1e-9 mm. `any_turn`: any other turn about the same centre keeps to the asked
    distance as well.
    """

    turn_rad: float
    shift_mm: Floats
    apart_mm: float
    any_turn: bool = False


def find_motions(
    a: Sequence[Any], b: Sequence[Any], within_mm: float, most: int | None = None
) -> list[PlanarMotion]:
    """Rigid motions, without reflection, that bring each section a[k] close to b[k]; best first.

    Sections are polygonal shapely geometries (mm) at the same heights; an empty one matches empty ones
    only. Outlines, holes too, are compared by Hausdorff distance; no point of a region may be further
    than that from the other region either. Motions come in neighbourhoods: one is returned for each
    local minimum of the distance over turns (closer than about 0.5° they count as one), or a single one
    that says `any_turn` for what is round. Sections that are all empty match at any turn. The search
    ends when `most` are found, likely ones first.
    """
    if len(a) != len(b):
        raise ValueError(f"stacks have {len(a)} and {len(b)} sections: they must be at the same heights")
    if all(item.is_empty for item in (*a, *b)):
        return [PlanarMotion(0.0, np.zeros(2), 0.0, any_turn=True)]
    if any(x.is_empty != y.is_empty for x, y in zip(a, b, strict=True)):
        return []
    mine, its = stack_of(a), stack_of(b)
    if not could_match(mine, its, within_mm):
        return []
    if round_bound_mm(mine, its) <= within_mm:
        return [_motion_of(mine, its, PlanarPose(0.0, its.centre_mm), any_turn=True)]
    found: list[PlanarMotion] = []
    for turn in _turns(mine, its, within_mm):
        pose = align(mine, its, PlanarPose(turn, its.centre_mm), within_mm)
        motion = _motion_of(mine, its, pose)
        if motion.apart_mm <= within_mm + 1e-8 * its.reach_mm and _regions_fit(mine, its, motion, within_mm):
            found.append(motion)
        if len(found) == most:
            break
    found.sort(key=lambda item: (item.apart_mm, abs(item.turn_rad)))
    return _without_duplicates(found)


def stack_distance_mm(a: Sequence[Any], b: Sequence[Any], turn_rad: float, shift_mm: Floats) -> float:
    """Largest Hausdorff distance between the outlines of a[k], moved, and b[k]; inf if just one is empty."""
    if any(x.is_empty != y.is_empty for x, y in zip(a, b, strict=True)):
        return math.inf
    if all(item.is_empty for item in a):
        return 0.0
    mine, its = stack_of(a), stack_of(b)
    centre = _rotate_points(mine.centre_mm[None], turn_rad)[0] + shift_mm
    return _largest_distance_mm(mine, its, PlanarPose(turn_rad, centre))


def _motion_of(a: Stack, b: Stack, pose: PlanarPose, any_turn: bool = False) -> PlanarMotion:
    turn = math.remainder(pose.turn_rad, 2 * math.pi)
    shift = pose.centre_mm - _rotate_points(a.centre_mm[None], turn)[0]
    return PlanarMotion(turn, shift, _largest_distance_mm(a, b, pose), any_turn)


def _turns(a: Stack, b: Stack, within: float) -> Floats:
    """Turns (t,) to refine, likely ones first: local minima of the corners' largest distance."""
    reach = max(a.reach_mm, b.reach_mm)
    limit = (1 + STEINER_FACTOR) * within + 1e-8 * reach
    narrowest = max(_NARROWEST_RAD, within / (2 * reach))
    half, number = math.pi / _FIRST_INTERVALS, np.arange(_FIRST_INTERVALS)
    while True:
        last = half <= narrowest
        turn = np.asarray((2 * number + 1) * half, dtype=np.float64)
        worst, kept = _rule_out(a, b, turn, half, limit, _CORNERS_NARROW if last else _CORNERS_WIDE)
        number, turn = number[kept], turn[kept]
        if last or not len(number):
            break
        half, number = half / 2, (2 * number[:, None] + np.arange(2)).ravel()
    minima = _local_minima(number, worst, round(math.pi / half))
    result: Floats = turn[minima[np.argsort(worst[minima], kind="stable")]]
    return result


def _rule_out(a: Stack, b: Stack, turn: Floats, half: float, limit: float, most: int) -> tuple[Floats, Ints]:
    """Largest corner distances of the turns that are not ruled out, and which turns these are."""
    kept = np.arange(len(turn))
    worst = np.zeros(len(turn))
    for mine, its in zip(a.outlines, b.outlines, strict=True):
        for points, outline, sign, here, there in (
            (mine.start, its, 1.0, a.centre_mm, b.centre_mm),
            (its.start, mine, -1.0, b.centre_mm, a.centre_mm),
        ):
            own = points[:: -(-len(points) // most)] - here
            off = _distances(own, outline, sign * turn[kept], there)
            swing = 2 * math.sin(half / 2) * np.hypot(*own.T)
            left = (off - swing).max(axis=1, initial=0.0) <= limit
            kept, worst = kept[left], np.maximum(worst[left], off[left].max(axis=1, initial=0.0))
    return worst, kept


def _distances(points: Floats, outline: OutlineTree, turn: Floats, centre: Floats) -> Floats:
    """Distance (t, p) from an outline of points (p, 2) about the origin, turned and brought to a centre."""
    c, s = np.cos(turn)[:, None], np.sin(turn)[:, None]
    x = c * points[:, 0] - s * points[:, 1] + centre[0]
    y = s * points[:, 0] + c * points[:, 1] + centre[1]
    return outline.nearest(np.column_stack([x.ravel(), y.ravel()]))[0].reshape(x.shape)


def _local_minima(number: Ints, worst: Floats, count: int) -> Ints:
    """Indices of numbers in a cycle of `count` whose neighbours are ruled out or not better."""
    cycle = np.full(count, math.inf)
    cycle[number] = worst
    before, after = np.roll(cycle, 1), np.roll(cycle, -1)
    result: Ints = np.flatnonzero((worst <= before[number]) & (worst < after[number]))
    if not len(result) and len(number):
        return np.array([int(worst.argmin())])
    return result


def _regions_fit(a: Stack, b: Stack, motion: PlanarMotion, within: float) -> bool:
    """Test that no point of a region is further than about `within` from the other region.

    Outlines can be close where regions are not: a disc against a thin ring. Buffers' arcs are inscribed
    by up to half a percent, hence the share on top.
    """
    c, s = math.cos(motion.turn_rad), math.sin(motion.turn_rad)
    wide = 1.01 * within + 1e-8 * b.reach_mm
    for mine, its in zip(a.regions, b.regions, strict=True):
        there = affinity.affine_transform(mine, (c, -s, s, c, *motion.shift_mm))
        if not (shapely.covers(its.buffer(wide), there) and shapely.covers(there.buffer(wide), its)):
            return False
    return True


def _without_duplicates(found: list[PlanarMotion]) -> list[PlanarMotion]:
    """Without those that refinement brought to the same turn as a better one."""
    kept: list[PlanarMotion] = []
    for motion in found:
        turns = (math.remainder(motion.turn_rad - other.turn_rad, 2 * math.pi) for other in kept)
        if all(abs(turn) > 2 * _NARROWEST_RAD for turn in turns):
            kept.append(motion)
    return kept
