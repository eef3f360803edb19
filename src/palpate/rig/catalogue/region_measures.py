"""Measures of regions that bound their distance: most pairs are distinguished by them alone.

Where A lies within L of B, A's area is at most what B's becomes when B is grown by L: area + L · perimeter +
n π L² for n parts (Steiner's formula, an upper bound where B is not convex). The same holds for the convex
hulls, whose perimeters grow by 2 π L, and for the smallest discs that hold them, whose radii grow by L. None
of them depends on place and turn.
"""

from collections.abc import Sequence

import numpy as np
import shapely

from palpate.base.geometry import Bools, Floats

__all__ = ["measures", "within_reach"]


_ROUNDING = 1e-9


def measures(regions: Sequence[shapely.Geometry]) -> Floats:
    """Area, perimeter, parts, the hull's area and perimeter, smallest disc: (n, 6), mm; 0 for nothing."""
    shapes = np.array(regions, dtype=object)
    hulls = shapely.convex_hull(shapes)
    columns = [
        shapely.area(shapes),
        shapely.length(shapes),
        shapely.get_num_geometries(shapes).astype(float),
        shapely.area(hulls),
        shapely.length(hulls),
        shapely.minimum_bounding_radius(shapes),
    ]
    empty = shapely.is_empty(shapes)
    result: Floats = np.where(empty[:, None], 0.0, np.column_stack(columns))
    return result


def within_reach(first: Floats, second: Floats, within_mm: Floats) -> Bools:
    """Whether some motion may bring two regions within a distance of each other; False is certain.

    `first` and `second` (..., 6) of `measures`, `within_mm` (...). Nothing and something never are.
    """
    fits = _holds(first, second, within_mm) & _holds(second, first, within_mm)
    both: Bools = fits & ((first[..., 2] == 0) == (second[..., 2] == 0))
    return both


def _holds(inner: Floats, outer: Floats, within_mm: Floats) -> Bools:
    """Whether the measures leave room for `inner` inside of `outer` grown by a distance."""
    area, perimeter, parts, hull_area, hull_perimeter, radius = np.moveaxis(outer, -1, 0)
    disc = np.pi * within_mm**2
    most = np.stack(
        [
            area + within_mm * perimeter + parts * disc,
            hull_area + within_mm * hull_perimeter + disc,
            hull_perimeter + 2 * np.pi * within_mm,
            radius + within_mm,
        ],
        axis=-1,
    )
    result: Bools = np.all(inner[..., [0, 3, 4, 5]] <= most * (1 + _ROUNDING) + _ROUNDING, axis=-1)
    return result
