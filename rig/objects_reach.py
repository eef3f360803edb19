"""Where no fingertip gets: slots that are too narrow, the insides of corners, holes. Regions in and out.

Between `objects_stack` and everything that compares or draws what fingers can feel. A tip comes from outside
and keeps its height, so it stays out of holes, and of pockets whose mouths are narrower than it is.
"""

import shapely

__all__ = ["filled", "unreached"]

_SLIVER_MM = 0.02  # what is nowhere wider than twice this is left alone: arcs are chords here
_QUARTER_CHORDS = 16


def unreached(region: shapely.Geometry, tip_radius_mm: float) -> shapely.Geometry:
    """The part of the plane outside of a region that no disc of the radius from far away can cover.

    Empty for a convex region. Pieces that are nowhere wider than 0.04 mm are left out.
    """
    if region.is_empty or shapely.equals(region, shapely.convex_hull(region)):
        return shapely.Polygon()
    grown = region.buffer(tip_radius_mm, quad_segs=_QUARTER_CHORDS)
    whole = shapely.union_all([shapely.Polygon(part.exterior) for part in shapely.get_parts(grown)])
    outside = whole.buffer(-tip_radius_mm, quad_segs=_QUARTER_CHORDS).difference(region)
    pieces = [part for part in shapely.get_parts(outside) if _is_wide(part)]
    return shapely.union_all(pieces)


def filled(region: shapely.Geometry, tip_radius_mm: float) -> shapely.Geometry:
    """The region with what no tip reaches added: two that agree in this feel the same all round."""
    more = unreached(region, tip_radius_mm)
    return region if more.is_empty else shapely.union_all([region, more])


def _is_wide(part: shapely.Geometry) -> bool:
    return part.geom_type == "Polygon" and not part.buffer(-_SLIVER_MM).is_empty
