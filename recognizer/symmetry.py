"""Rotational symmetry of a state, from all of its sections together (used as in memo §2.1 and Fig. 4)."""

import math

import numpy as np
import shapely
from shapely import affinity

from palpate.recognizer.arrays import Floats
from palpate.recognizer.model import Section, State

__all__ = ["centroid", "symmetry_order"]


def centroid(state: State) -> Floats:
    """Centre of area of all sections together, shape (2,), mm, in the frame of the object's file."""
    shapes = [_region(section) for section in state.sections]
    areas = np.array([shape.area for shape in shapes])
    centres = np.array([[shape.centroid.x, shape.centroid.y] for shape in shapes])
    result: Floats = areas @ centres / areas.sum()
    return result


def symmetry_order(state: State, about: Floats, tolerance_mm: float) -> int:
    """Largest n such that turning by 2π/n about `about` moves no boundary further than the tolerance."""
    shapes = [_region(section) for section in state.sections]
    vertices = min(
        len(ring.coords) - 1
        for shape in shapes
        for part in shapely.get_parts(shape)
        for ring in [part.exterior]
    )
    parts = math.gcd(*[len(shapely.get_parts(shape)) for shape in shapes])
    limit = vertices * max(parts, 1)
    centre = (float(about[0]), float(about[1]))
    for order in range(limit, 1, -1):
        if all(_turns_onto_itself(shape, order, centre, tolerance_mm) for shape in shapes):
            return order
    return 1


def _region(section: Section) -> shapely.Geometry:
    polygons = [shapely.Polygon(p.outer, p.holes) for p in section.polygons]
    return shapely.union_all(polygons).simplify(0.0)


def _turns_onto_itself(
    shape: shapely.Geometry, order: int, centre: tuple[float, float], tolerance_mm: float
) -> bool:
    points = shapely.get_coordinates(shape) - np.asarray(centre)
    if len(points) == 0:
        return False
    # The furthest vertices come in orbits; a quick look at them settles nearly every order.
    reach = np.hypot(*points.T)
    far = points[np.argmax(reach)]
    angle = 2 * math.pi / order
    turned = np.array(
        [
            far[0] * math.cos(angle) - far[1] * math.sin(angle),
            far[0] * math.sin(angle) + far[1] * math.cos(angle),
        ]
    )
    if float(np.min(np.hypot(*(points - turned).T))) > tolerance_mm:
        return False
    image = affinity.rotate(shape, angle, origin=centre, use_radians=True)
    # The Hausdorff distance looks at vertices only; the area between the two sees the edges as well.
    if shapely.hausdorff_distance(shape.boundary, image.boundary) > tolerance_mm:
        return False
    return bool(shape.symmetric_difference(image).area <= tolerance_mm * shape.length)
