"""Outlines in other representations: shapely regions, and rings of edges as flat arrays.

The object model's polygons keep the order in which edges are counted. Regions are for areas, unions and
distances; `EdgeRings` is for computing with all edges at once.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Self

import numpy as np
import shapely
from shapely.geometry.polygon import orient

from palpate.base.geometry.object_model import Polygon
from palpate.base.geometry.plane import Floats, Ints


def region_of(polygons: Iterable[Polygon]) -> shapely.Geometry:
    """Union of polygons, which may touch or overlap; an empty region for none."""
    return shapely.union_all([shapely.Polygon(polygon.outer, polygon.holes) for polygon in polygons])


def polygons_of(region: shapely.Geometry) -> tuple[Polygon, ...]:
    """Polygons of a region, without its lines and points."""
    rings = ([_open(ring) for ring in (part.exterior, *part.interiors)] for part in _polygonal_parts(region))
    return tuple(Polygon(outer, tuple(holes)) for outer, *holes in rings)


def rings_of(region: shapely.Geometry) -> list[Floats]:
    """Open rings (n, 2) of a region, each outer one before its holes, in either direction."""
    return [ring for polygon in polygons_of(region) for ring in polygon.rings]


def oriented_rings_of(region: shapely.Geometry) -> list[Floats]:
    """Open rings (n, 2) of a region with the material on their left."""
    return [ring for part in _polygonal_parts(region) for ring in rings_of(orient(part))]


def _polygonal_parts(region: shapely.Geometry) -> list[shapely.Polygon]:
    return [part for part in shapely.get_parts(region) if part.geom_type == "Polygon" and not part.is_empty]


def _open(ring: shapely.LinearRing) -> Floats:
    points: Floats = np.asarray(ring.coords)[:-1]
    return points


@dataclass(frozen=True, eq=False)
class EdgeRings:
    """Edges (n) of closed rings, ring after ring: `start` (n, 2) mm, and the number of its `ring` (n,)."""

    start: Floats
    ring: Ints

    @classmethod
    def of(cls, rings: Sequence[Floats]) -> Self:
        """Make them of open rings (k, 2)."""
        counts = [len(ring) for ring in rings]
        return cls(np.concatenate([np.zeros((0, 2)), *rings]), np.repeat(np.arange(len(rings)), counts))

    @cached_property
    def first(self) -> Ints:
        """First edge of each ring."""
        return np.flatnonzero(np.diff(self.ring, prepend=-1))

    @cached_property
    def following(self) -> Ints:
        """Edge (n,) that begins where each one ends."""
        result = np.arange(1, len(self.ring) + 1)
        result[np.roll(self.first, -1) - 1] = self.first  # −1 is the last edge of all
        return result

    @cached_property
    def before(self) -> Ints:
        """Edge (n,) that ends where each one begins."""
        return np.argsort(self.following)

    @cached_property
    def end(self) -> Floats:
        """Ends (n, 2) mm."""
        return self.start[self.following]

    @cached_property
    def length(self) -> Floats:
        """Lengths (n,) mm."""
        length: Floats = np.hypot(*(self.end - self.start).T)
        return length

    @cached_property
    def direction(self) -> Floats:
        """Unit vectors (n, 2) from start to end; no edge may be without length."""
        direction: Floats = (self.end - self.start) / self.length[:, None]
        return direction

    @cached_property
    def normal(self) -> Floats:
        """Unit normals (n, 2) to the right of the edges: outward where the material is on the left."""
        return np.column_stack([self.direction[:, 1], -self.direction[:, 0]])
