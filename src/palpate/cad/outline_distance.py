"""Hausdorff distance of outlines in the plane, exact along edges.

Distances from points to an outline find their nearest edge in shapely's STRtree; the largest distance from an
edge is bounded from both sides and the edge halved until the bounds meet, since the furthest point of an edge
need not be one of its ends (as `shapely.hausdorff_distance` has it).
"""

from functools import cached_property
from typing import Any

import numpy as np
import shapely

from palpate.base.geometry import Floats, Ints

__all__ = ["OutlineTree", "distance_to_edges", "furthest_mm"]

_SHARE = 1e-6
_ROUNDING_MM = 1e-9
"""The two bounds of a largest distance may differ by this much."""
_HALVINGS = 48


class OutlineTree:
    """All rings of a shapely geometry as edges from `starts_mm` (n, 2) to `ends_mm` (n, 2).

    `ring` (n,): the ring that each edge is of; edges without length are left out.
    """

    def __init__(self, geometry: Any) -> None:
        rings = shapely.get_rings(shapely.get_parts(geometry))
        points, ring = shapely.get_coordinates(rings, return_index=True)
        same = (ring[1:] == ring[:-1]) & (points[1:] != points[:-1]).any(axis=1)
        self.starts_mm: Floats = points[:-1][same]
        self.ends_mm: Floats = points[1:][same]
        self.ring: Ints = ring[1:][same]

    @cached_property
    def _tree(self) -> Any:
        return shapely.STRtree(shapely.linestrings(np.stack([self.starts_mm, self.ends_mm], axis=1)))

    def nearest(self, points_mm: Floats) -> tuple[Floats, Ints]:
        """Distance (p,) of points (p, 2) from the outline, and the edge (p,) that is nearest."""
        edge: Ints = self._tree.query_nearest(shapely.points(points_mm), all_matches=False)[1]
        return distance_to_edges(points_mm, self.starts_mm[edge], self.ends_mm[edge]), edge


def distance_to_edges(points_mm: Floats, starts_mm: Floats, ends_mm: Floats) -> Floats:
    """Distance (n,) of each point (n, 2) from the edge with the same number."""
    along = ends_mm - starts_mm
    share = ((points_mm - starts_mm) * along).sum(axis=1) / (along**2).sum(axis=1)
    off = points_mm - starts_mm - np.clip(share, 0.0, 1.0)[:, None] * along
    result: Floats = np.hypot(off[:, 0], off[:, 1])
    return result


def furthest_mm(starts_mm: Floats, ends_mm: Floats, other: OutlineTree) -> float:
    """Upper bound of the largest distance of points on edges (n, 2) → (n, 2) from an outline.

    At most 1e-6 of itself and 1e-9 mm too large. Why the bound from above holds: the distance from one
    edge of the outline is convex along a piece, so it is nowhere larger than at the ends of the piece;
    the distance from the outline is no larger.
    """

    def at(points: Floats, edges: Ints) -> Floats:
        return distance_to_edges(points, other.starts_mm[edges], other.ends_mm[edges])

    p, q = starts_mm, ends_mm
    (at_p, edge_p), (at_q, edge_q) = other.nearest(p), other.nearest(q)
    reached = max(float(at_p.max()), float(at_q.max()))
    for _ in range(_HALVINGS):
        upper = np.minimum(np.maximum(at_p, at(q, edge_p)), np.maximum(at(p, edge_q), at_q))
        vague = upper > reached * (1 + _SHARE) + _ROUNDING_MM
        if not vague.any():
            return reached * (1 + _SHARE) + _ROUNDING_MM
        p, q, at_p, at_q = p[vague], q[vague], at_p[vague], at_q[vague]
        edge_p, edge_q = edge_p[vague], edge_q[vague]
        middle = (p + q) / 2
        at_m, edge_m = other.nearest(middle)
        reached = max(reached, float(at_m.max()))
        p, q = np.concatenate([p, middle]), np.concatenate([middle, q])
        at_p, at_q = np.concatenate([at_p, at_m]), np.concatenate([at_m, at_q])
        edge_p, edge_q = np.concatenate([edge_p, edge_m]), np.concatenate([edge_m, edge_q])
    return float(upper.max())
