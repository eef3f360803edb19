"""Thin features: material of an outline is near to material at every height of its slab.

The other half of the proof in `hausdorff_bound`. Every edge of a true section in the slab is within `off` of
the outline's, so what lies deeper than that in the outline is solid at every height. Where this is not enough
(at sharp corners and in thin fins), what the slab's clipped facets do not touch of the exact section is solid
at every height, because the surface crosses no vertical line elsewhere.
"""

import math
from collections.abc import Callable, Sequence

import numpy as np
import shapely

from palpate.base.geometry import Bools, Floats, Ints
from palpate.cad.hausdorff_bound import clip_facets
from palpate.cad.resting_surface import HEIGHT_MM, RestingSurface
from palpate.cad.values import Region

__all__ = ["material_bound_mm"]

_QUARTER = 16
"""Chords per quarter circle in buffers: inscribed, so growing gives too little, and shrinking is enlarged."""
_TIGHT, _WIDE = 1.02, 4.0
"""Material may be so many times further off than edges are, if that is allowed."""
_COARSE = 0.01
"""Of what is allowed, for simplifying what is solid at every height."""


def material_bound_mm(
    model: Sequence[Region],
    exact: Callable[[], Sequence[Region]],
    surface: RestingSurface,
    facets: Ints,
    slab_mm: tuple[float, float],
    off_mm: float,
    allowed_mm: float,
) -> float | None:
    """How far a point of `model` is at most from the solid at any height of the slab; None if too far.

    `exact`: gives the section at one of its heights; `off_mm`: how far edges are from the model's at most.
    """
    whole = _polygons(model)
    deep = whole.buffer(-off_mm / math.cos(math.pi / 4 / _QUARTER) * (1 + 1e-9), quad_segs=_QUARTER)
    tight, wide = min(_TIGHT * off_mm, allowed_mm), min(_WIDE * off_mm, allowed_mm)
    for allowed in (tight, wide) if wide > _TIGHT * tight else (tight,):
        lost = whole.difference(deep.buffer(allowed, quad_segs=_QUARTER))
        if lost.is_empty:
            return allowed
    # Heights are meant within HEIGHT_MM: at a peak in the very end of a slab there is no material left.
    least = min(HEIGHT_MM, (slab_mm[1] - slab_mm[0]) / 8)
    points = clip_facets(surface, facets, slab_mm[0] + least, slab_mm[1] - least)
    bounds = shapely.bounds(shapely.get_parts(lost)) + 2 * allowed_mm * np.array([-1, -1, 1, 1])
    window = shapely.union_all(shapely.box(*bounds.T))
    swept = shapely.convex_hull(shapely.multipoints(points[_meeting(points, bounds)]))
    shapely.prepare(window)
    swept = swept[(shapely.area(swept) > 0) & shapely.intersects(window, swept)]
    # On a grid, so that clipped facets that share a side leave no needles between them.
    coarse = _COARSE * allowed_mm
    grid = coarse / 8
    touched = shapely.union_all(swept, grid_size=grid)
    always = shapely.difference(_polygons(exact()).intersection(window), touched, grid_size=grid)
    solid = always.simplify(coarse / 2)
    far = lost.difference(solid.buffer(allowed_mm - coarse, quad_segs=_QUARTER))
    return allowed_mm if far.is_empty else None


def _meeting(points: Floats, bounds: Floats) -> Bools:
    """Which of the clipped facets (k, 6, 2) may meet a box (b, 4); none that was clipped away does."""
    low, high = points.min(axis=1), points.max(axis=1)
    apart = (low[:, None] > bounds[:, 2:]) | (high[:, None] < bounds[:, :2]) | np.isnan(low[:, None])
    result: Bools = (~apart.any(axis=2)).any(axis=1)
    return result


def _polygons(regions: Sequence[Region]) -> shapely.Geometry:
    return shapely.make_valid(
        shapely.MultiPolygon([shapely.Polygon(region.outer, region.holes) for region in regions])
    )
