"""The panel right of the drawing: pose with bounds, facts, other hypotheses, legend, the table as a whole.

Called by `picture.draw`. All words that need room are here, so that the drawing stays a drawing.
"""

import math
from collections.abc import Callable

import numpy as np

from palpate.rig.picture_frame import View
from palpate.rig.picture_style import (
    AXIS,
    CARD,
    FOUND,
    FOUND_FILL,
    INK,
    LINE,
    MISS,
    MOST_OTHERS,
    MUTED,
    PAPER,
    RULE,
    THICK,
    THIN,
    TIP,
    TIP_FILL,
    TRUTH,
)
from palpate.rig.picture_values import Picture, Pose
from palpate.rig.picture_view import badge, sector, shows_base
from palpate.rig.svg import Floats, element, number, path_data, shorten, text, text_width

__all__ = ["PANEL_WIDTH", "draw_panel"]

PANEL_WIDTH = 330.0
_ROW = 20.0
_INSET = 170.0


def draw_panel(picture: Picture, view: View, left: float, top: float) -> tuple[str, float]:
    """The panel, and the y at which it ends; SVG units."""
    y = top
    shown = []
    for part in (_pose, _facts, _others, _legend, _inset):
        drawn, end = part(picture, view, left, y)
        shown.append(drawn)
        y = end + (16.0 if end > y else 0.0)
    return "".join(shown), y - 16.0


def _heading(content: str, left: float, y: float) -> str:
    rule = element("line", x1=left, y1=y + 7, x2=left + PANEL_WIDTH, y2=y + 7, stroke=RULE, stroke_width=THIN)
    return text(content, left, y, size=12, fill=MUTED, weight="bold") + rule


def _pose(picture: Picture, _view: View, left: float, y: float) -> tuple[str, float]:
    pose = picture.pose
    if pose is None:
        return "", y
    shown = [_heading("Configuration and certified bounds", left, y + 12)]
    y += 24
    for name, value, bound in _pose_rows(pose):
        y += _ROW + 2
        shown.append(text(name, left, y, size=15, fill=FOUND, weight="bold"))
        shown.append(text(value, left + 150, y, size=15, anchor="end"))
        shown.append(text(bound, left + 165, y, size=15, fill=MUTED))
    return "".join(shown), y + 6


def _pose_rows(pose: Pose) -> list[tuple[str, str, str]]:
    turned = tuple(math.degrees(value) for value in pose.theta_rad)
    return [
        (name, f"{_minus(values[0])}{unit}", f"± {_outward(values)}{unit}")
        for name, values, unit in (("x", pose.x_mm, " mm"), ("y", pose.y_mm, " mm"), ("θ", turned, "°"))
    ]


def _minus(value: float) -> str:
    shown = f"{value:.2f}"
    return "0.00" if shown == "-0.00" else shown.replace("-", "−")


def _outward(values: tuple[float, ...]) -> str:
    """The larger distance from the value as shown to a bound, rounded up: still certified as printed."""
    value, lo, hi = values
    shown = round(value, 2)
    return f"{math.ceil(max(hi - shown, shown - lo, 0.0) * 100 - 1e-6) / 100:.2f}"


def _facts(picture: Picture, _view: View, left: float, y: float) -> tuple[str, float]:
    if not picture.facts:
        return "", y
    shown = [_heading("Facts", left, y + 12)]
    y += 24
    for name, value in picture.facts:
        y += _ROW - 1
        label = shorten(name, 12.5, PANEL_WIDTH * 0.55)
        room = PANEL_WIDTH - text_width(label, 12.5) - 12
        shown.append(text(label, left, y, size=12.5, fill=MUTED))
        shown.append(text(shorten(value, 12.5, room), left + PANEL_WIDTH, y, size=12.5, anchor="end"))
    return "".join(shown), y + 6


def _others(picture: Picture, _view: View, left: float, y: float) -> tuple[str, float]:
    if not picture.others:
        return "", y
    shown = [_heading(f"Other hypotheses ({len(picture.others)})", left, y + 12)]
    y += 24
    for index, other in enumerate(picture.others[:MOST_OTHERS]):
        y += _ROW
        shown.append(badge(index, left + 9, y - 4.5))
        reason = shorten(other.reason, 12, 185)
        room = PANEL_WIDTH - 26 - text_width(reason, 12) - 10
        shown.append(text(shorten(other.label, 12.5, room), left + 26, y, size=12.5))
        shown.append(text(reason, left + PANEL_WIDTH, y, size=12, fill=MUTED, anchor="end"))
    hidden = len(picture.others) - MOST_OTHERS
    if hidden > 0:
        y += _ROW
        shown.append(text(f"and {hidden} more, not drawn", left + 26, y, size=12, fill=MUTED))
    return "".join(shown), y + 6


def _legend(picture: Picture, view: View, left: float, y: float) -> tuple[str, float]:
    touched = [touch for touch in picture.touches if touch.touched]
    entries: list[tuple[bool, Callable[[float, float], str], str]] = [
        (bool(picture.found), _found_key, "object found"),
        (picture.pose is not None, _pose_key, "its frame: origin and x axis"),
        (bool(picture.truth), _truth_key, "where it really is (emulated)"),
        (bool(picture.others), _other_key, "other hypothesis, by letter"),
        (bool(touched), _touch_key, "approach, and the tip in contact"),
        (any(t.normal_rad for t in touched), _normal_key, "range of the outward normal"),
        (len(touched) < len(picture.touches), _miss_key, "approach that touched nothing"),
        (any(not shows_base(b, view) for b in picture.bases), _beyond_key, "finger's base, beyond the frame"),
        (any(shows_base(b, view) for b in picture.bases), _base_key, "finger's base"),
        (picture.workspace_radius_mm is not None, _workspace_key, "workspace"),
    ]
    shown = [_heading("Legend", left, y + 12)]
    y += 24
    for wanted, key, meaning in entries:
        if wanted:
            y += _ROW
            shown.append(key(left + 20, y - 4.5) + text(meaning, left + 50, y, size=12.5))
    if picture.touches:
        y += _ROW
        first = picture.touches[0]
        sample = f"{shorten(first.finger, 12, 70, bold=True)} · {first.grip}"
        width = text_width(sample, 12, bold=True)
        shown.append(text(sample, left, y, size=12, fill=TIP if first.touched else MISS, weight="bold"))
        shown.append(text("finger and number of the grip", left + max(50.0, width + 10), y, size=12.5))
    return "".join(shown), y + 6


def _line_key(x: float, y: float, colour: str, width: float, dash: str | None = None) -> str:
    return element(
        "line", x1=x - 16, y1=y, x2=x + 16, y2=y, stroke=colour, stroke_width=width, stroke_dasharray=dash
    )


def _found_key(x: float, y: float) -> str:
    return element(
        "rect", x=x - 16, y=y - 6, width=32.0, height=12.0, fill=FOUND_FILL, stroke=FOUND, stroke_width=THICK
    )


def _pose_key(x: float, y: float) -> str:
    line = element("line", x1=x - 8, y1=y, x2=x + 14, y2=y, stroke=FOUND, stroke_width=THICK)
    return line + element("circle", cx=x - 8, cy=y, r=4.0, fill=PAPER, stroke=FOUND, stroke_width=THICK)


def _truth_key(x: float, y: float) -> str:
    return _line_key(x, y, TRUTH, LINE)


def _other_key(x: float, y: float) -> str:
    return _line_key(x, y, MUTED, THIN, "5 3")


def _touch_key(x: float, y: float) -> str:
    line = element("line", x1=x - 16, y1=y, x2=x + 8, y2=y, stroke=TIP, stroke_width=LINE)
    tip = element("circle", cx=x + 9, cy=y, r=7.0, fill=TIP_FILL, stroke=TIP, stroke_width=LINE)
    start = element("circle", cx=x - 16, cy=y, r=2.2, fill=TIP)
    return line + start + tip + element("circle", cx=x + 9, cy=y, r=2.6, fill=TIP)


def _normal_key(x: float, y: float) -> str:
    wedge = sector(np.array([x + 14, y]), 28.0, math.pi - 0.25, math.pi + 0.25)
    return element(
        "path", d=wedge, fill=TIP, fill_opacity=0.3, stroke=TIP, stroke_width=THIN, stroke_opacity=0.7
    )


def _miss_key(x: float, y: float) -> str:
    swept = element(
        "line",
        x1=x - 10,
        y1=y,
        x2=x + 10,
        y2=y,
        stroke=MISS,
        stroke_opacity=0.12,
        stroke_width=13.0,
        stroke_linecap="round",
    )
    cross = element(
        "path",
        d=f"M{number(x + 6)},{number(y - 4)}l8,8m0,-8l-8,8",
        stroke=MISS,
        stroke_width=LINE,
        fill="none",
    )
    return swept + _line_key(x, y, MISS, LINE, "6 4") + cross


def _beyond_key(x: float, y: float) -> str:
    head = np.array([[x + 8, y], [x - 8, y - 6], [x - 4, y], [x - 8, y + 6]])
    return element("path", d=path_data([head]), fill=INK)


def _base_key(x: float, y: float) -> str:
    return element("rect", x=x - 5, y=y - 5, width=10.0, height=10.0, fill=INK)


def _workspace_key(x: float, y: float) -> str:
    return element(
        "line",
        x1=x - 16,
        y1=y,
        x2=x + 16,
        y2=y,
        stroke=AXIS,
        stroke_width=LINE,
        stroke_dasharray="1 4",
        stroke_linecap="round",
    )


def _inset(picture: Picture, view: View, left: float, y: float) -> tuple[str, float]:
    """The whole table, small: workspace, bases, the object, and the window of the drawing."""
    radius = picture.workspace_radius_mm
    if radius is None or not picture.bases:
        return "", y
    points = np.array([base.at_mm for base in picture.bases] + [(-radius, -radius), (radius, radius)])
    low, high = points.min(axis=0), points.max(axis=0)
    span = float((high - low).max())
    scale = (_INSET - 30) / span
    centre = (low + high) / 2
    heading = _heading("The table", left, y + 12)
    top = y + 28
    box = np.array([left + PANEL_WIDTH / 2, top + _INSET / 2])

    def page(values: object) -> Floats:
        moved: Floats = (np.asarray(values, dtype=float) - centre) * (scale, -scale) + box
        return moved

    x, cy = page((0.0, 0.0)).tolist()
    corners = page([(view.x_mm[0], view.y_mm[1]), (view.x_mm[1], view.y_mm[0])])
    room = np.array([PANEL_WIDTH, _INSET]) / 2
    window = np.clip(corners, box - room, box + room)
    size = window[1] - window[0]
    shown = [
        heading,
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
    for base in picture.bases:
        at = page(base.at_mm)
        shown.append(element("rect", x=at[0] - 4, y=at[1] - 4, width=8.0, height=8.0, fill=INK))
        side = 1 if at[0] >= box[0] else -1
        free = box[0] + PANEL_WIDTH / 2 - at[0] - 10 if side > 0 else at[0] - 10 - (box[0] - PANEL_WIDTH / 2)
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
