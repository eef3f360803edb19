"""Rotational symmetry of a state, from all of its sections together (memo §2.1 and Fig. 4)."""

import math
from dataclasses import dataclass

import numpy as np
import shapely
from scipy.spatial import cKDTree
from shapely import affinity

from palpate.geometry import Floats, Section, State
from palpate.geometry.plane import rotation_matrix

__all__ = ["centroid", "symmetry_order"]

_STRAIGHT_MM = 1e-6  # a vertex nearer than this to its neighbours' line is none


def centroid(state: State) -> Floats:
    """Centre of area of all sections together, shape (2,), mm, in the frame of the object's file."""
    shapes = [_region(section) for section in state.sections]
    areas = np.array([shape.area for shape in shapes])
    centres = np.array([[shape.centroid.x, shape.centroid.y] for shape in shapes])
    result: Floats = areas @ centres / areas.sum()
    return result


def symmetry_order(state: State, about: Floats, tolerance_mm: float) -> int:
    """Largest n such that turning by 2π/n about `about` moves no boundary further than the tolerance."""
    shapes = [_Shape.of(_region(section), about) for section in state.sections]
    limit = min(shape.fewest_vertices for shape in shapes) * math.gcd(*[shape.parts for shape in shapes])
    for order in range(limit, 1, -1):
        if all(shape.turns_onto_itself(order, tolerance_mm) for shape in shapes):
            return order
    return 1


def _region(section: Section) -> shapely.Geometry:
    polygons = [shapely.Polygon(p.outer, p.holes) for p in section.polygons]
    return shapely.union_all(polygons).simplify(_STRAIGHT_MM)


@dataclass(frozen=True, eq=False)
class _Shape:
    """A section moved so that the centre of its possible symmetry is the origin, with its vertices."""

    region: shapely.Geometry
    points: Floats
    tree: cKDTree

    @classmethod
    def of(cls, region: shapely.Geometry, about: Floats) -> "_Shape":
        moved = affinity.translate(region, -float(about[0]), -float(about[1]))
        points = shapely.get_coordinates(moved)
        furthest_first = points[np.argsort(-np.hypot(*points.T), kind="stable")]
        return cls(moved, furthest_first, cKDTree(furthest_first))

    @property
    def parts(self) -> int:
        return max(1, len(shapely.get_parts(self.region)))

    @property
    def fewest_vertices(self) -> int:
        parts = shapely.get_parts(self.region)
        return min((len(part.exterior.coords) - 1 for part in parts), default=0)

    def turns_onto_itself(self, order: int, tolerance_mm: float) -> bool:
        """Whether vertices fall on vertices, the furthest of which settles nearly every order, and the areas
        agree: between vertices that fall on each other edges may still run differently.
        """
        angle = 2 * math.pi / order
        turn = rotation_matrix(-angle)
        for some in (self.points[:1], self.points):
            away, _ = self.tree.query(some @ turn, distance_upper_bound=2 * tolerance_mm)
            if not np.all(away <= tolerance_mm):
                return False
        image = affinity.rotate(self.region, angle, origin=(0, 0), use_radians=True)
        return bool(self.region.symmetric_difference(image).area <= tolerance_mm * self.region.length)
