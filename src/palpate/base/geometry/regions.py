"""Conversions between the object model's polygons and shapely's regions, and the rings of either.

Regions are for areas, unions and distances; polygons keep the order in which edges are counted.
"""

from collections.abc import Iterable

import numpy as np
import shapely
from shapely.geometry.polygon import orient

from palpate.base.geometry.object_model import Polygon
from palpate.base.geometry.plane import Floats


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
