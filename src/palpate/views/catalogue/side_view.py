"""The side view of a card: how the part rests on the table, so that one sees which side is down."""

import numpy as np
import shapely

from palpate.base.geometry import Floats, State
from palpate.views.catalogue.style import BAR_WIDTH, SIDE
from palpate.views.svg import element, path_data
from palpate.views.table_picture.style import FOUND, FOUND_FILL, INK, THIN

__all__ = ["draw_side", "side_rings"]

_EDGE = 4.0


def side_rings(state: State) -> tuple[Floats, ...]:
    """Rings (n, 2) of (across, z), mm: of the file, or what sections show that are known everywhere."""
    if state.side_mm or state.heights_mm is not None:
        return state.side_mm
    boxes = [
        shapely.box(x.min(), section.z_mm[0], x.max(), section.z_mm[1])
        for section in state.sections
        for polygon in section.polygons
        for x in (polygon.outer[:, 0],)
    ]
    parts = shapely.get_parts(shapely.union_all(boxes))
    rings = [ring for part in parts for ring in (part.exterior, *part.interiors)]
    return tuple(np.asarray(ring.coords)[:-1] for ring in rings)


def draw_side(rings: tuple[Floats, ...], left: float, top: float) -> str:
    """The view in a box as wide as the ladder of heights, on a line for the table."""
    points = np.concatenate(rings)
    low, high = points.min(axis=0), points.max(axis=0)
    wide, tall = max(high[0] - low[0], 1e-9), max(high[1], 1e-9)
    scale = min((BAR_WIDTH - 2 * _EDGE) / wide, (SIDE - 2 * _EDGE) / tall)
    middle, bottom = left + BAR_WIDTH / 2, top + SIDE - _EDGE
    origin = np.array([middle - scale * (low[0] + high[0]) / 2, bottom])
    drawn = [origin + ring * (scale, -scale) for ring in rings]
    part = element(
        "path",
        d=path_data(drawn),
        fill=FOUND_FILL,
        fill_rule="evenodd",
        stroke=FOUND,
        stroke_width=1.0,
        stroke_linejoin="round",
    )
    line = element("line", x1=left, y1=bottom, x2=left + BAR_WIDTH, y2=bottom, stroke=INK, stroke_width=THIN)
    return part + line
