"""Exact contacts by shapely: where a disc on a straight path stops, and with which normal.

Sharper than `stop` and `outward_normal` of shapely_bench: also where a path only grazes, and at vertices.
"""

import math

import numpy as np
import shapely

from palpate.base.geometry import Floats

_GRAZING_MM = 3e-9  # no approach is drawn to pass at just this distance


def first_contact(
    shape: shapely.Geometry, start: Floats, heading: Floats, radius: float, reach: float
) -> float:
    """Travel at which a disc on a straight path first touches the shape; infinite if it passes by.

    The distance of the path so far to the shape only falls with the travel: halving finds where it reaches
    the radius, however flatly the path grazes the shape. Give or take: GEOS may take a path through a
    vertex for one that passes it 1e-15 mm away.
    """

    def met(travel: float) -> bool:
        path = shapely.LineString([start, start + travel * heading])
        return bool(shapely.distance(shape, path) <= radius + _GRAZING_MM)

    if not met(reach):
        return math.inf
    free, touching = 0.0, reach
    while touching - free > 1e-12 * reach:
        middle = (free + touching) / 2
        free, touching = (free, middle) if met(middle) else (middle, touching)
    return touching


def true_normal(shape: shapely.Geometry, centre: Floats, radius: float, rng: np.random.Generator) -> float:
    """Direction of an outward normal where a tip at `centre` touches.

    For a disc: of the edge that it is on, or from the vertex that it is at (shapely's nearest point is not
    exact enough near the end of an edge). For a point (r = 0): of the edge that it is on; at a vertex, of
    either of the two edges there, also of the one that faces away from where the point came.
    """
    begin, end = edges_of(shape)
    along = end - begin
    away = centre - begin
    free = np.sum(away * along, axis=1) / np.sum(along * along, axis=1)
    from_foot = away - np.clip(free, 0.0, 1.0)[:, None] * along
    gap = np.linalg.norm(from_foot, axis=1)
    outward = np.column_stack([along[:, 1], -along[:, 0]])
    if radius > 0:
        near = np.flatnonzero(gap <= gap.min() + 1e-12)
        faced = near[(free[near] >= 0.0) & (free[near] <= 1.0)]
        normal = outward[faced[0]] if len(faced) else from_foot[near[0]]
    else:
        normal = outward[rng.choice(np.flatnonzero(gap <= gap.min() + 2 * _GRAZING_MM))]
    return math.atan2(normal[1], normal[0])


def edges_of(shape: shapely.Geometry) -> tuple[Floats, Floats]:
    """Begins and ends (n, 2) of all edges of a shape, the solid on their left."""
    begins, ends = [], []
    for part in shapely.get_parts(shape):
        oriented = shapely.geometry.polygon.orient(part)
        for ring in (oriented.exterior, *oriented.interiors):
            points = shapely.get_coordinates(ring)
            begins.append(points[:-1])
            ends.append(points[1:])
    return np.concatenate(begins), np.concatenate(ends)
