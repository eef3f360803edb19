"""Stacks of outlines: sections at several heights as one figure that can be rotated and shifted in the plane.

A stack has a reference point that moves with it and hardly moves when it is bent: the mean of the Steiner
points of the sections' convex hulls. If a motion brings every section of one stack within d of the other's,
the reference points come within 4/π · d of each other, and no point that follows every motion does better
(Aichholzer, Alt & Rote, Matching shapes with a reference point, Int. J. Computational Geometry and
Applications 7, 1997). `could_match` and `round_bound_mm` use nothing that can be wrong by more than they
allow for: what they rule out is out.

Hausdorff distances of outlines are exact along edges. Distances from points find their nearest edge in
shapely's STRtree; the largest distance from an edge is bounded from both sides and the edge halved until the
bounds meet, since the furthest point of an edge need not be one of its ends (as `shapely.hausdorff_distance`
has it).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations
from typing import Any

import numpy as np
import shapely

from palpate.base.geometry import Floats, Ints
from palpate.base.geometry.outlines import EdgeRings, rings_of
from palpate.base.geometry.plane import segment_distance, turn_between

_GAP_SHARE = 1e-6
_ROUNDING_MM = 1e-9
"""The two bounds of a largest distance may differ by this much."""
_MAX_HALVINGS = 48


class OutlineTree(EdgeRings):
    """All rings of a shapely geometry; edges without length are left out."""

    @classmethod
    def of_region(cls, region: Any) -> "OutlineTree":
        """Make them of a polygonal shapely geometry."""
        rings = rings_of(region)
        return cls.of([ring[(ring != np.roll(ring, 1, axis=0)).any(axis=1)] for ring in rings])

    @cached_property
    def _tree(self) -> Any:
        return shapely.STRtree(shapely.linestrings(np.stack([self.start, self.end], axis=1)))

    def nearest(self, points_mm: Floats) -> tuple[Floats, Ints]:
        """Distance (p,) of points (p, 2) from the outline, and the edge (p,) that is nearest."""
        edge: Ints = self._tree.query_nearest(shapely.points(points_mm), all_matches=False)[1]
        return segment_distance(points_mm, self.start[edge], self.end[edge]), edge


def furthest_distance_mm(starts_mm: Floats, ends_mm: Floats, other: OutlineTree) -> float:
    """Upper bound of the largest distance of points on edges (n, 2) → (n, 2) from an outline.

    At most 1e-6 of itself and 1e-9 mm too large. Why the bound from above holds: the distance from one
    edge of the outline is convex along a piece, so it is nowhere larger than at the ends of the piece;
    the distance from the outline is no larger.
    """

    def at(points: Floats, edges: Ints) -> Floats:
        return segment_distance(points, other.start[edges], other.end[edges])

    p, q = starts_mm, ends_mm
    (at_p, edge_p), (at_q, edge_q) = other.nearest(p), other.nearest(q)
    reached = max(float(at_p.max()), float(at_q.max()))
    for _ in range(_MAX_HALVINGS):
        upper = np.minimum(np.maximum(at_p, at(q, edge_p)), np.maximum(at(p, edge_q), at_q))
        vague = upper > reached * (1 + _GAP_SHARE) + _ROUNDING_MM
        if not vague.any():
            return reached * (1 + _GAP_SHARE) + _ROUNDING_MM
        p, q, at_p, at_q = p[vague], q[vague], at_p[vague], at_q[vague]
        edge_p, edge_q = edge_p[vague], edge_q[vague]
        middle = (p + q) / 2
        at_m, edge_m = other.nearest(middle)
        reached = max(reached, float(at_m.max()))
        p, q = np.concatenate([p, middle]), np.concatenate([middle, q])
        at_p, at_q = np.concatenate([at_p, at_m]), np.concatenate([at_m, at_q])
        edge_p, edge_q = np.concatenate([edge_p, edge_m]), np.concatenate([edge_m, edge_q])
    return float(upper.max())


STEINER_FACTOR = 4 / math.pi
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
    outlines = tuple(OutlineTree.of_region(item) for item in regions)
    hulls = shapely.convex_hull(np.array(regions, dtype=object))
    steiner = np.array([_steiner_point(item) for item in hulls])
    centre = steiner.mean(axis=0)
    reach = max(float(np.hypot(*(item.start - centre).T).max()) for item in outlines)
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
        abs(_separation_mm(a.steiner_mm, k, m) - _separation_mm(b.steiner_mm, k, m)) <= 2 * STEINER_FACTOR * d
        for k, m in combinations(range(len(a.regions)), 2)
    )


def round_bound_mm(a: Stack, b: Stack) -> float:
    """Bound on the distance of sections at any turn, reference points together; inf if unknown.

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
    turn = np.abs(turn_between(before, after))
    # Weighed from a corner, not from a far origin.
    point: Floats = ring[0] + turn @ (ring - ring[0]) / turn.sum()
    return point


def _separation_mm(points: Floats, k: int, m: int) -> float:
    return float(np.hypot(*(points[k] - points[m])))


def _radii(outline: OutlineTree, centre: Floats) -> Floats | None:
    """Least and largest radius (r, 2) of every ring, inner rings first; None if one does not go round."""
    p, q = outline.start - centre, outline.end - centre
    first = outline.first
    if (np.abs(np.add.reduceat(turn_between(p, q), first)) < math.pi).any():
        return None
    nearest = segment_distance(np.zeros(2), p, q)
    radii = np.stack(
        [np.minimum.reduceat(nearest, first), np.maximum.reduceat(np.hypot(*p.T), first)], axis=1
    )
    result: Floats = radii[np.argsort(radii[:, 0])]
    return result
