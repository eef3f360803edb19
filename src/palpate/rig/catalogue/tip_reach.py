"""Tip reach: the places that no fingertip gets to, such as narrow slots, inner corners and holes.

A tip comes from outside and keeps its height, so it stays out of holes, and of pockets whose mouths are
narrower than it is.
"""

import math
from collections.abc import Sequence

import shapely

from palpate.base.vocabulary import LEAST_BALL_SHARE

__all__ = ["beside_ball", "filled", "unreached"]

_SHALLOW_MM = 0.02  # what is nowhere deeper than this is left alone: arcs are chords here
_QUARTER_CHORDS = 16
_STEP_MM = 0.5  # between the points of a piece whose depth is asked


def unreached(region: shapely.Geometry, tip_radius_mm: float) -> shapely.Geometry:
    """The part of the plane outside of a region that no disc of the radius from far away can cover.

    Empty for a convex region. Pieces that are nowhere deeper than 0.02 mm behind what tips can cover are left
    out; slits count however narrow they are.
    """
    if region.is_empty or shapely.equals(region, shapely.convex_hull(region)):
        return shapely.Polygon()
    grown = region.buffer(tip_radius_mm, quad_segs=_QUARTER_CHORDS)
    whole = shapely.union_all([shapely.Polygon(part.exterior) for part in shapely.get_parts(grown)])
    closed = whole.buffer(-tip_radius_mm, quad_segs=_QUARTER_CHORDS)
    pieces = [part for part in shapely.get_parts(closed.difference(region)) if _is_deep(part, closed)]
    return shapely.union_all(pieces)


def filled(region: shapely.Geometry, tip_radius_mm: float) -> shapely.Geometry:
    """The region with what no tip reaches added: two that agree in this feel the same all round."""
    more = unreached(region, tip_radius_mm)
    return region if more.is_empty else shapely.union_all([region, more])


def beside_ball(
    levels: Sequence[tuple[tuple[float, float], shapely.Geometry]], height_mm: float, radius_mm: float
) -> shapely.Geometry:
    """What a ball with its equator at a height meets of regions from some heights to others, filled.

    They are grown by what the ball's circle beside them has more than the least that may touch: two that
    agree in this feel the same to the ball.
    """
    least, grown = LEAST_BALL_SHARE * radius_mm, []
    for (low, high), region in levels:
        away = max(low - height_mm, height_mm - high, 0.0)
        if away < radius_mm:
            circle = math.sqrt(radius_mm**2 - away**2)
            grown.append(region.buffer(circle - least, quad_segs=_QUARTER_CHORDS))
    return filled(shapely.union_all(grown), least)


def _is_deep(part: shapely.Geometry, closed: shapely.Geometry) -> bool:
    along = shapely.points(shapely.get_coordinates(shapely.segmentize(part, _STEP_MM)))
    depth = shapely.distance(along, shapely.boundary(closed)).max(initial=0.0)
    return part.geom_type == "Polygon" and bool(depth > _SHALLOW_MM)
