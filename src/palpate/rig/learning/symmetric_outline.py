"""Symmetric outline: an outline averaged over the turns that nearly bring it onto itself."""

import math

import numpy as np
import shapely

from palpate.base.geometry import Floats
from palpate.base.geometry.plane import rotate

SYMMETRY_ORDERS = 6, 4, 3, 2
"""Orders that are looked for, the largest first."""

_DIRECTIONS = 360  # a multiple of all orders


def symmetric_outline(outline: shapely.Polygon, order: int, simplified_mm: float) -> shapely.Polygon | None:
    """The outline about its centroid with the mean radius of all turns by 2π/order; exactly symmetric.

    None if it is not star-shaped about its centroid, as then some direction has several radii.
    """
    centre = np.array(outline.centroid.coords[0])
    radius = _radii(outline, centre)
    if radius is None:
        return None
    each = _DIRECTIONS // order
    mean = radius.reshape(order, each).mean(axis=0)
    angle = np.arange(each + 1) * (2 * math.pi / _DIRECTIONS)
    closed = np.append(mean, mean[0])
    sector = shapely.LineString(np.column_stack([closed * np.cos(angle), closed * np.sin(angle)]))
    corners = shapely.get_coordinates(sector.simplify(simplified_mm))[:-1]
    turns = np.arange(order) * (2 * math.pi / order)
    points = np.concatenate([rotate(corners, np.full(len(corners), turn)) for turn in turns])
    found = shapely.Polygon(points + centre)
    return found if found.is_valid else None


def _radii(outline: shapely.Polygon, centre: Floats) -> Floats | None:
    """Distance of the outline from its centroid in each direction; None if there are several in one."""
    angle = np.arange(_DIRECTIONS) * (2 * math.pi / _DIRECTIONS)
    far = float(shapely.hausdorff_distance(outline.exterior, shapely.Point(centre))) + 1.0
    ends = centre + far * np.column_stack([np.cos(angle), np.sin(angle)])
    rays = shapely.linestrings(np.stack([np.broadcast_to(centre, ends.shape), ends], axis=1))
    met = shapely.intersection(rays, outline.exterior)
    if not (shapely.get_type_id(met) == 0).all():
        return None
    result: Floats = np.hypot(*(shapely.get_coordinates(met) - centre).T)
    return result
