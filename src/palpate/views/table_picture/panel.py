"""The panel right of the drawing: pose with bounds, facts, other hypotheses, legend, the table as a whole.

All words that need room are here, so that the drawing stays a drawing.
"""

import math

from palpate.views.svg import shorten, text, text_width
from palpate.views.table_picture.frame import View
from palpate.views.table_picture.legend import legend
from palpate.views.table_picture.marks import badge, heading
from palpate.views.table_picture.overview import whole_table
from palpate.views.table_picture.predictions import prediction_table, prediction_width
from palpate.views.table_picture.style import FOUND, MOST_OTHERS, MUTED, Column
from palpate.views.table_picture.values import BoundedPose, Picture

__all__ = ["draw_panel", "panel_width"]

_WIDTH = 330.0
_ROW = 20.0


def panel_width(picture: Picture) -> float:
    """Width of the panel, SVG units."""
    return max(_WIDTH, prediction_width(picture))


def draw_panel(picture: Picture, view: View, column: Column, top: float) -> tuple[str, float]:
    """The panel, and the y at which it ends; SVG units."""
    y = top
    shown = []
    for part in (_pose, _facts, _others, prediction_table, legend, whole_table):
        drawn, end = part(picture, view, column, y)
        shown.append(drawn)
        y = end + (16.0 if end > y else 0.0)
    return "".join(shown), y - 16.0


def _pose(picture: Picture, _view: View, column: Column, y: float) -> tuple[str, float]:
    pose = picture.pose
    if pose is None:
        return "", y
    shown = [heading("Configuration and certified bounds", column, y + 12)]
    y += 24
    for name, value, bound in _pose_rows(pose):
        y += _ROW + 2
        shown.append(text(name, column.left, y, size=15, fill=FOUND, weight="bold"))
        shown.append(text(value, column.left + 150, y, size=15, anchor="end"))
        shown.append(text(bound, column.left + 165, y, size=15, fill=MUTED))
    return "".join(shown), y + 6


def _pose_rows(pose: BoundedPose) -> list[tuple[str, str, str]]:
    turned = tuple(math.degrees(value) for value in pose.theta_rad)
    rows = [
        (name, f"{_minus(values[0])}{unit}", f"± {_outward(values)}{unit}")
        for name, values, unit in (("x", pose.x_mm, " mm"), ("y", pose.y_mm, " mm"), ("θ", turned, "°"))
    ]
    return [*rows[:2], ("θ", "any", "")] if pose.turns_freely else rows


def _minus(value: float) -> str:
    shown = f"{value:.2f}"
    return "0.00" if shown == "-0.00" else shown.replace("-", "−")


def _outward(values: tuple[float, ...]) -> str:
    """The larger distance from the value as shown to a bound, rounded up: still certified as printed."""
    value, lo, hi = values
    shown = round(value, 2)
    return f"{math.ceil(max(hi - shown, shown - lo, 0.0) * 100 - 1e-6) / 100:.2f}"


def _facts(picture: Picture, _view: View, column: Column, y: float) -> tuple[str, float]:
    if not picture.facts:
        return "", y
    shown = [heading("Facts", column, y + 12)]
    y += 24
    for name, value in picture.facts:
        y += _ROW - 1
        label = shorten(name, 12.5, column.width * 0.55)
        room = column.width - text_width(label, 12.5) - 12
        shown.append(text(label, column.left, y, size=12.5, fill=MUTED))
        shown.append(text(shorten(value, 12.5, room), column.right, y, size=12.5, anchor="end"))
    return "".join(shown), y + 6


def _others(picture: Picture, _view: View, column: Column, y: float) -> tuple[str, float]:
    if not picture.others or picture.approaches:
        return "", y
    title = "Other hypotheses" if picture.found else "Hypotheses"
    shown = [heading(f"{title} ({len(picture.others)})", column, y + 12)]
    y += 24
    for index, other in enumerate(picture.others[:MOST_OTHERS]):
        y += _ROW
        shown.append(badge(index, picture.colour(index), column.left + 9, y - 4.5))
        reason = shorten(other.reason, 12, 185)
        room = column.width - 26 - text_width(reason, 12) - 10
        shown.append(text(shorten(other.label, 12.5, room), column.left + 26, y, size=12.5))
        shown.append(text(reason, column.right, y, size=12, fill=MUTED, anchor="end"))
    hidden = len(picture.others) - MOST_OTHERS
    if hidden > 0:
        y += _ROW
        shown.append(text(f"and {hidden} more, not drawn", column.left + 26, y, size=12, fill=MUTED))
    return "".join(shown), y + 6
