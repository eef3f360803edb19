"""Congruence of two stacks of sections: all rigid motions in the plane that bring one onto the other.

It finds duplicates among stable states and twins among objects. The search of the turn misses nothing: with
reference points together (`stacks`) the outlines are within (1 + 4/π) of the wanted distance if any shift
brings them within it, and a turn by w moves no corner at radius r by more than 2 r sin(w/2), so a whole
interval of turns is ruled out by one corner that is too far away. Each local minimum that is left is refined
by shift and turn (`alignment`) and measured exactly.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import shapely
from shapely import affinity

from palpate.base.geometry import Floats, Ints
from palpate.cad.alignment import PlanarPose, align, largest_mm, moved
from palpate.cad.outline_distance import OutlineTree
from palpate.cad.stacks import STEINER, Stack, could_match, round_bound_mm, stack_of

__all__ = ["Motion", "apart_mm", "motions"]

_FIRST = 32
"""Intervals of turn at the start; each division makes two of one."""
_NARROWEST_RAD = 0.004
_FEW, _MANY = 24, 120
"""So many corners of a section are asked in wider intervals, and in the narrowest."""


@dataclass(frozen=True, eq=False)
class Motion:
    """A point p goes to R(`turn_rad`) @ p + `shift_mm` (2,); turns are in (−π, π].

    `apart_mm`: the largest Hausdorff distance of outlines over all sections then, rounded up by at most
    1e-6 of itself and 1e-9 mm. `any_turn`: any other turn about the same centre keeps to the asked
    distance as well.
    """

    turn_rad: float
    shift_mm: Floats
    apart_mm: float
    any_turn: bool = False


def motions(a: Sequence[Any], b: Sequence[Any], within_mm: float, most: int | None = None) -> list[Motion]:
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
        return [Motion(0.0, np.zeros(2), 0.0, any_turn=True)]
    if any(x.is_empty != y.is_empty for x, y in zip(a, b, strict=True)):
        return []
    mine, its = stack_of(a), stack_of(b)
    if not could_match(mine, its, within_mm):
        return []
    if round_bound_mm(mine, its) <= within_mm:
        return [_motion(mine, its, PlanarPose(0.0, its.centre_mm), any_turn=True)]
    found: list[Motion] = []
    for turn in _turns(mine, its, within_mm):
        pose = align(mine, its, PlanarPose(turn, its.centre_mm), within_mm)
        motion = _motion(mine, its, pose)
        if motion.apart_mm <= within_mm + 1e-8 * its.reach_mm and _fills(mine, its, motion, within_mm):
            found.append(motion)
        if len(found) == most:
            break
    found.sort(key=lambda item: (item.apart_mm, abs(item.turn_rad)))
    return _distinct(found)


def apart_mm(a: Sequence[Any], b: Sequence[Any], turn_rad: float, shift_mm: Floats) -> float:
    """Largest Hausdorff distance between the outlines of a[k], moved, and b[k]; inf if just one is empty."""
    if any(x.is_empty != y.is_empty for x, y in zip(a, b, strict=True)):
        return math.inf
    if all(item.is_empty for item in a):
        return 0.0
    mine, its = stack_of(a), stack_of(b)
    centre = moved(mine.centre_mm[None], turn_rad)[0] + shift_mm
    return largest_mm(mine, its, PlanarPose(turn_rad, centre))


def _motion(a: Stack, b: Stack, pose: PlanarPose, any_turn: bool = False) -> Motion:
    turn = math.remainder(pose.turn_rad, 2 * math.pi)
    shift = pose.centre_mm - moved(a.centre_mm[None], turn)[0]
    return Motion(turn, shift, largest_mm(a, b, pose), any_turn)


def _turns(a: Stack, b: Stack, within: float) -> Floats:
    """Turns (t,) to refine, likely ones first: local minima of the corners' largest distance."""
    reach = max(a.reach_mm, b.reach_mm)
    limit = (1 + STEINER) * within + 1e-8 * reach
    narrowest = max(_NARROWEST_RAD, within / (2 * reach))
    half, number = math.pi / _FIRST, np.arange(_FIRST)
    while True:
        last = half <= narrowest
        turn = np.asarray((2 * number + 1) * half, dtype=np.float64)
        worst, kept = _ruled(a, b, turn, half, limit, _MANY if last else _FEW)
        number, turn = number[kept], turn[kept]
        if last or not len(number):
            break
        half, number = half / 2, (2 * number[:, None] + np.arange(2)).ravel()
    minima = _local_minima(number, worst, round(math.pi / half))
    result: Floats = turn[minima[np.argsort(worst[minima], kind="stable")]]
    return result


def _ruled(a: Stack, b: Stack, turn: Floats, half: float, limit: float, most: int) -> tuple[Floats, Ints]:
    """Largest corner distances of the turns that are not ruled out, and which turns these are."""
    kept = np.arange(len(turn))
    worst = np.zeros(len(turn))
    for mine, its in zip(a.outlines, b.outlines, strict=True):
        for points, outline, sign, here, there in (
            (mine.starts_mm, its, 1.0, a.centre_mm, b.centre_mm),
            (its.starts_mm, mine, -1.0, b.centre_mm, a.centre_mm),
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


def _fills(a: Stack, b: Stack, motion: Motion, within: float) -> bool:
    """Whether no point of a region is further than about `within` from the other region.

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


def _distinct(found: list[Motion]) -> list[Motion]:
    """Without those that refinement brought to the same turn as a better one."""
    kept: list[Motion] = []
    for motion in found:
        turns = (math.remainder(motion.turn_rad - other.turn_rad, 2 * math.pi) for other in kept)
        if all(abs(turn) > 2 * _NARROWEST_RAD for turn in turns):
            kept.append(motion)
    return kept
