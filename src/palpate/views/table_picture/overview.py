"""The table as a whole, small, with the window that the drawing shows."""

import numpy as np

from palpate.base.geometry import Floats
from palpate.views.svg import element, path_data, shorten, text
from palpate.views.table_picture.frame import View
from palpate.views.table_picture.marks import arrow_head, heading
from palpate.views.table_picture.style import (
    AXIS,
    CARD,
    FOUND,
    FOUND_FILL,
    INK,
    LINE,
    MOST_OTHERS,
    RULE,
    THIN,
    Column,
)
from palpate.views.table_picture.values import Picture

__all__ = ["whole_table"]

_INSET = 170.0


def whole_table(picture: Picture, view: View, column: Column, y: float) -> tuple[str, float]:
    """The whole table, small: workspace, bases, the object, and the window of the drawing."""
    radius = picture.workspace_radius_mm
    if radius is None or not picture.bases:
        return "", y
    points = np.array([base.at_mm for base in picture.bases] + [(-radius, -radius), (radius, radius)])
    low, high = points.min(axis=0), points.max(axis=0)
    span = float((high - low).max())
    scale = (_INSET - 30) / span
    centre = (low + high) / 2
    title = heading("The table", column, y + 12)
    top = y + 28
    box = np.array([column.left + column.width / 2, top + _INSET / 2])

    def page(values: object) -> Floats:
        moved: Floats = (np.asarray(values, dtype=float) - centre) * (scale, -scale) + box
        return moved

    x, cy = page((0.0, 0.0)).tolist()
    corners = page([(view.x_mm[0], view.y_mm[1]), (view.x_mm[1], view.y_mm[0])])
    room = np.array([column.width, _INSET]) / 2
    window = np.clip(corners, box - room, box + room)
    size = window[1] - window[0]
    shown = [
        title,
        element(
            "rect",
            x=window[0, 0],
            y=window[0, 1],
            width=float(size[0]),
            height=float(size[1]),
            fill=CARD,
            stroke=RULE,
            stroke_width=THIN,
        ),
        element(
            "circle",
            cx=x,
            cy=cy,
            r=radius * scale,
            fill="none",
            stroke=AXIS,
            stroke_width=LINE,
            stroke_dasharray="1 4",
            stroke_linecap="round",
        ),
    ]
    if picture.found:
        rings = [page(ring) for ring in picture.found]
        shown.append(
            element(
                "path",
                d=path_data(rings),
                fill=FOUND_FILL,
                fill_rule="evenodd",
                stroke=FOUND,
                stroke_width=THIN,
            )
        )
    for other in picture.others[:MOST_OTHERS] if picture.approaches else ():
        rings = [page(ring) for ring in other.rings]
        shown.append(element("path", d=path_data(rings), fill="none", stroke=AXIS, stroke_width=0.6))
    shown += [_way(page(item.start_mm), page(item.at(item.travel_mm))) for item in picture.approaches]
    for base in picture.bases:
        at = page(base.at_mm)
        shown.append(element("rect", x=at[0] - 4, y=at[1] - 4, width=8.0, height=8.0, fill=INK))
        side = 1 if at[0] >= box[0] else -1
        free = (
            box[0] + column.width / 2 - at[0] - 10 if side > 0 else at[0] - 10 - (box[0] - column.width / 2)
        )
        shown.append(
            text(
                shorten(base.name, 11, float(free)),
                at[0] + 9 * side,
                at[1] + 4,
                size=11,
                anchor=None if side > 0 else "end",
            )
        )
    return "".join(shown), top + _INSET


def _way(start: Floats, end: Floats) -> str:
    """An approach of the next grip from its start to its end."""
    ends = {"x1": start[0], "y1": start[1], "x2": end[0], "y2": end[1]}
    dot = element("circle", cx=start[0], cy=start[1], r=2.2, fill=INK)
    along = (end - start) / max(float(np.hypot(*(end - start))), 1e-9)
    return element("line", **ends, stroke=INK, stroke_width=THIN) + dot + arrow_head(end, along, 7.0)
