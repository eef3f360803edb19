"""Marks that several parts of the picture share: wedges, badges, leaders, fingers' bases."""

import math

import numpy as np

from palpate.base.geometry import Floats
from palpate.views.label_placement import Box, LabelPlacer
from palpate.views.svg import element, number, path_data, shorten, text, text_width
from palpate.views.table_picture.frame import View
from palpate.views.table_picture.style import INK, LABEL, LINE, MUTED, PAPER, RULE, THIN, TIP, Column
from palpate.views.table_picture.values import FingerBase

__all__ = [
    "arrow_head",
    "badge",
    "draw_base",
    "end_cross",
    "heading",
    "last_shown",
    "leader",
    "normal_wedge",
    "shows_base",
]


def normal_wedge(centre: Floats, radius: float, lo_rad: float, hi_rad: float) -> str:
    """Range of a normal: sector of a disc, counter-clockwise on the page from lo to hi; SVG units."""
    count = max(2, math.ceil((hi_rad - lo_rad) / 0.12) + 1)
    angle = np.linspace(lo_rad, hi_rad, count)
    rim = centre + radius * np.column_stack([np.cos(angle), -np.sin(angle)])
    wedge = path_data([np.vstack([centre, rim])])
    return element(
        "path", d=wedge, fill=TIP, fill_opacity=0.3, stroke=TIP, stroke_width=THIN, stroke_opacity=0.7
    )


def last_shown(start: Floats, end: Floats, view: View) -> Floats | None:
    """The last point of a path that lies well within the window, if any does."""
    frame = view.frame
    path = end + np.linspace(0.0, 1.0, 200)[:, None] * (start - end)
    room = np.array([frame.width, frame.height]) / 2 - 6
    seen = np.all(np.abs(path - (frame.x, frame.y)) <= room, axis=1)
    if not seen.any():
        return None
    last: Floats = path[int(np.argmax(seen))]
    return last


def leader(anchor: Floats, box: Box, clear: float, colour: str) -> str:
    """A thin line from a label to what it names, where they are not next to each other."""
    near = np.clip(anchor, (box.left, box.top), (box.left + box.width, box.top + box.height))
    away = near - anchor
    distance = float(np.hypot(*away))
    if distance < clear + 14:
        return ""
    begin = anchor + away * ((clear - 3) / distance)
    return element(
        "line",
        x1=begin[0],
        y1=begin[1],
        x2=near[0],
        y2=near[1],
        stroke=colour,
        stroke_width=0.8,
        stroke_opacity=0.6,
    )


def heading(content: str, column: Column, y: float) -> str:
    """A heading of a part of the panel, ruled below."""
    rule = element(
        "line", x1=column.left, y1=y + 7, x2=column.right, y2=y + 7, stroke=RULE, stroke_width=THIN
    )
    return text(content, column.left, y, size=12, fill=MUTED, weight="bold") + rule


def arrow_head(tip: Floats, along: Floats, size: float = 11.0) -> str:
    """A head that ends at `tip` (2,) and points along a unit vector (2,), SVG units."""
    back, across = tip - size * along, 0.36 * size * np.array([-along[1], along[0]])
    return element("path", d=path_data([np.array([tip, back + across, back - across])]), fill=INK)


def end_cross(at: Floats, colour: str = INK) -> str:
    """Where an approach ends that nothing stopped."""
    x, y = at.tolist()
    return element(
        "path",
        d=f"M{number(x - 4)},{number(y - 4)}l8,8m0,-8l-8,8",
        stroke=colour,
        stroke_width=LINE,
        fill="none",
    )


def badge(index: int, colour: str, x: float, y: float) -> str:
    """The letter of the index-th other hypothesis, in a disc of its outline's colour."""
    disc = element("circle", cx=x, cy=y, r=8.0, fill=PAPER, stroke=colour, stroke_width=THIN)
    letter = text(chr(ord("a") + index), x, y + 3.8, size=11, fill=colour, anchor="middle", weight="bold")
    return disc + letter


def shows_base(base: FingerBase, view: View) -> bool:
    """Whether a finger's base lies within the window with its mark whole."""
    away = np.abs(view.at(base.at_mm) - (view.frame.x, view.frame.y))
    return bool(np.all(away <= np.array([view.width, view.height]) / 2 - 8))


def draw_base(base: FingerBase, view: View, placer: LabelPlacer) -> str:
    """A finger's base, or an arrowhead on the frame where it lies beyond."""
    at, frame = view.at(base.at_mm), view.frame
    middle = np.array([frame.x, frame.y])
    away = at - middle
    half = np.array([frame.width, frame.height]) / 2
    beyond = float(np.max(np.abs(away) / half))
    if shows_base(base, view):
        mark = element("rect", x=at[0] - 5, y=at[1] - 5, width=10.0, height=10.0, fill=INK)
    else:
        at = middle + away / beyond
        along = away / np.hypot(*away)
        across = np.array([-along[1], along[0]])
        mark = element(
            "path",
            d=path_data(
                [np.array([at, at - 16 * along + 6 * across, at - 12 * along, at - 16 * along - 6 * across])]
            ),
            fill=INK,
        )
    placer.add_disc(at, 12.0, 4.0)
    content = shorten(base.name, LABEL, 90)
    inward = math.atan2(away[1], -away[0])
    box = placer.place(at, text_width(content, LABEL) + 4, 15.0, clear=13.0, towards=inward)
    return mark + text(content, box.x, box.y + 4, size=LABEL, fill=INK, anchor="middle")
