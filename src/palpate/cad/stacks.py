"""Stacks: sections at several heights as one figure that is turned and shifted in the plane.

A stack has a reference point that moves with it and hardly moves when it is bent: the mean of the Steiner
points of the sections' convex hulls. If a motion brings every section of one stack within d of the other's,
the reference points come within 4/π · d of each other, and no point that follows every motion does better
(Aichholzer, Alt & Rote, Matching shapes with a reference point, Int. J. Computational Geometry and
Applications 7, 1997). `could_match` and `round_bound_mm` use nothing that can be wrong by more than they
allow for: what they rule out is out.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np
import shapely

from palpate.base.geometry import Floats
from palpate.cad.outline_distance import OutlineTree

__all__ = ["STEINER", "Stack", "could_match", "round_bound_mm", "stack_of"]

STEINER = 4 / math.pi
"""The Steiner point moves by at most so much of a Hausdorff distance."""


@dataclass(frozen=True, eq=False)
class Stack:
    """Sections and what is compared of them; empty sections are left out, `full` (k,) says which are not.

    `steiner_mm` (s, 2) of the hulls, `centre_mm` (2,) their mean, `reach_mm` the largest distance from
    it to an outline; per section `area_mm2`, `girth_mm` (the hull's perimeter), `perimeter_mm`, `parts`
    (s,).
    """

    full: tuple[bool, ...]
    regions: tuple[Any, ...]
    outlines: tuple[OutlineTree, ...]
    steiner_mm: Floats
    centre_mm: Floats
    reach_mm: float
    area_mm2: Floats
    girth_mm: Floats
    perimeter_mm: Floats
    parts: Floats


def stack_of(sections: Sequence[Any]) -> Stack:
    """A stack of polygonal shapely geometries; at least one is not empty."""
    full = tuple(not item.is_empty for item in sections)
    regions = tuple(item for item in sections if not item.is_empty)
    outlines = tuple(OutlineTree(item) for item in regions)
    hulls = shapely.convex_hull(np.array(regions, dtype=object))
    steiner = np.array([_steiner_point(item) for item in hulls])
    centre = steiner.mean(axis=0)
    reach = max(float(np.hypot(*(item.starts_mm - centre).T).max()) for item in outlines)
    return Stack(
        full,
        regions,
        outlines,
        steiner,
        centre,
        reach,
        shapely.area(regions),
        shapely.length(hulls),
        shapely.length(regions),
        shapely.get_num_geometries(regions).astype(float),
    )


def could_match(a: Stack, b: Stack, within_mm: float) -> bool:
    """False only where no motion brings every section of `a` within a distance of the one of `b`.

    A region that is widened by d gains at most d · perimeter + π d² for each of its parts, its hull's
    perimeter at most 2π d (both by Steiner's formula); distances between Steiner points change by 2 ·
    4/π d.
    """
    if a.full != b.full:
        return False
    d = within_mm + 1e-9 * max(a.reach_mm, b.reach_mm)

    def gain(stack: Stack) -> Floats:
        return d * stack.perimeter_mm + math.pi * d**2 * stack.parts

    smaller = a.area_mm2 > b.area_mm2 + gain(b)
    larger = b.area_mm2 > a.area_mm2 + gain(a)
    wider = np.abs(a.girth_mm - b.girth_mm) > 2 * math.pi * d
    if bool((smaller | larger | wider).any()):
        return False
    return all(
        abs(_apart(a.steiner_mm, k, m) - _apart(b.steiner_mm, k, m)) <= 2 * STEINER * d
        for k, m in combinations(range(len(a.regions)), 2)
    )


def round_bound_mm(a: Stack, b: Stack) -> float:
    """How far sections are apart at any turn at most, with reference points together; inf if unknown.

    Known where all rings go round the reference point: a ray from it meets each of them somewhere
    between its least and its largest radius, so two rings are no further apart than the range of both.
    """
    worst = 0.0
    for mine, its in zip(a.outlines, b.outlines, strict=True):
        rings_a, rings_b = _radii(mine, a.centre_mm), _radii(its, b.centre_mm)
        if rings_a is None or rings_b is None or len(rings_a) != len(rings_b):
            return math.inf
        low = np.minimum(rings_a[:, 0], rings_b[:, 0])
        high = np.maximum(rings_a[:, 1], rings_b[:, 1])
        worst = max(worst, float((high - low).max()))
    return worst


def _steiner_point(hull: Any) -> Floats:
    """Corners weighted with the turn of the outline at them."""
    ring = shapely.get_coordinates(hull)[:-1]
    after = np.roll(ring, -1, axis=0) - ring
    before = np.roll(after, 1, axis=0)
    cross = before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0]
    turn = np.abs(np.arctan2(cross, (before * after).sum(axis=1)))
    # Weighed from a corner, not from a far origin.
    point: Floats = ring[0] + turn @ (ring - ring[0]) / turn.sum()
    return point


def _apart(points: Floats, k: int, m: int) -> float:
    return float(np.hypot(*(points[k] - points[m])))


def _radii(outline: OutlineTree, centre: Floats) -> Floats | None:
    """Least and largest radius (r, 2) of every ring, inner rings first; None if one does not go round."""
    p, q = outline.starts_mm - centre, outline.ends_mm - centre
    _, first = np.unique(outline.ring, return_index=True)
    swept = np.arctan2(p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0], (p * q).sum(axis=1))
    if (np.abs(np.add.reduceat(swept, first)) < math.pi).any():
        return None
    along = q - p
    share = np.clip(-(p * along).sum(axis=1) / (along**2).sum(axis=1), 0.0, 1.0)
    nearest = np.hypot(*(p + share[:, None] * along).T)
    radii = np.stack(
        [np.minimum.reduceat(nearest, first), np.maximum.reduceat(np.hypot(*p.T), first)], axis=1
    )
    result: Floats = radii[np.argsort(radii[:, 0])]
    return result
