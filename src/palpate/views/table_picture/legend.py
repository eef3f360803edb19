"""The legend: what the marks of the picture mean."""

import math
from collections.abc import Callable

import numpy as np

from palpate.views import svg
from palpate.views.table_picture.frame import (
    View,
    arrow_head,
    end_cross,
    heading,
    is_base_visible,
    normal_wedge,
)
from palpate.views.table_picture.values import Picture

_ROW = 20.0


def legend(picture: Picture, view: View, column: svg.Column, y: float) -> tuple[str, float]:
    """Draw what the marks in the drawing mean; only those that are there."""
    planned = bool(picture.approaches)
    predicted = [item for approach in picture.approaches for item in approach.predictions]
    other = "other " if picture.found else ""
    touched = [touch for touch in picture.touches if touch.touched]
    is_round = picture.pose is not None and picture.pose.turns_freely
    entries: list[tuple[bool, Callable[[float, float], str], str]] = [
        (bool(picture.found), _found_key, "object found"),
        (picture.pose is not None and not is_round, _pose_key, "its frame: origin and x axis"),
        (is_round, _origin_key, "its origin"),
        (bool(picture.truth), _truth_key, "where it really is (emulated)"),
        (bool(picture.others) and not planned, _other_key, f"{other}hypothesis, by letter"),
        (planned, _hypothesis_key, "hypothesis, by letter and colour"),
        (planned, _approach_key, "approach of the next grip"),
        (any(item.stop_mm for item in predicted), _stop_key, "predicted stop of a hypothesis"),
        (any(item.may_miss for item in predicted), _end_key, "where it ends if nothing stops it"),
        (any(not t.has_face for t in touched), _touch_key, "approach, and the tip in contact"),
        (any(t.has_face for t in touched), _pad_key, "approach, pad, and where it was touched"),
        (any(t.normal_rad for t in touched), _normal_key, "range of the outward normal"),
        (len(touched) < len(picture.touches), _miss_key, "approach that touched nothing"),
        (
            any(not is_base_visible(b, view) for b in picture.bases),
            _beyond_key,
            "finger's base, beyond the frame",
        ),
        (any(is_base_visible(b, view) for b in picture.bases), _base_key, "finger's base"),
        (picture.workspace_radius_mm is not None, _workspace_key, "workspace"),
    ]
    shown = [heading("Legend", column, y + 12)]
    y += 24
    for wanted, key, meaning in entries:
        if wanted:
            y += _ROW
            shown.append(key(column.left + 20, y - 4.5) + svg.text(meaning, column.left + 50, y, size=12.5))
    if picture.touches:
        y += _ROW
        first = picture.touches[0]
        sample = f"{svg.shorten(first.finger, 12, 70, bold=True)} · {first.grip}"
        width = svg.text_width(sample, 12, bold=True)
        shown.append(
            svg.text(
                sample, column.left, y, size=12, fill=svg.TIP if first.touched else svg.MISS, weight="bold"
            )
        )
        shown.append(
            svg.text("finger and number of the grip", column.left + max(50.0, width + 10), y, size=12.5)
        )
    return "".join(shown), y + 6


def _line_key(
    x: float, y: float, colour: str, width: float, dash: str | None = None, cap: str | None = None
) -> str:
    return svg.segment(
        (x - 16, y), (x + 16, y), stroke=colour, stroke_width=width, stroke_dasharray=dash, stroke_linecap=cap
    )


def _found_key(x: float, y: float) -> str:
    return svg.rectangle(
        (x - 16, y - 6), (32.0, 12.0), fill=svg.FOUND_FILL, stroke=svg.FOUND, stroke_width=svg.THICK
    )


def _pose_key(x: float, y: float) -> str:
    line = svg.segment((x - 8, y), (x + 14, y), stroke=svg.FOUND, stroke_width=svg.THICK)
    return line + _origin_key(x - 8, y)


def _origin_key(x: float, y: float) -> str:
    return svg.circle((x, y), 4.0, fill=svg.PAPER, stroke=svg.FOUND, stroke_width=svg.THICK)


def _truth_key(x: float, y: float) -> str:
    return _line_key(x, y, svg.TRUTH, svg.LINE)


def _other_key(x: float, y: float) -> str:
    return _line_key(x, y, svg.MUTED, svg.THIN, "5 3")


def _hypothesis_key(x: float, y: float) -> str:
    lines = [
        svg.segment((x - 16, at), (x + 16, at), stroke=hue, stroke_width=svg.LINE, stroke_opacity=0.7)
        for at, hue in ((y - 4, svg.HUES[0]), (y, svg.HUES[1]), (y + 4, svg.HUES[2]))
    ]
    return "".join(lines)


def _approach_key(x: float, y: float) -> str:
    return _line_key(x, y, svg.INK, svg.LINE) + arrow_head(np.array([x + 8, y]), np.array([1.0, 0.0]))


def _stop_key(x: float, y: float) -> str:
    ends = [
        svg.circle((at, y), 7.0, fill="none", stroke=svg.HUES[0], stroke_width=svg.THIN)
        for at in (x - 8, x + 8)
    ]
    return "".join(ends) + svg.segment((x - 8, y), (x + 8, y), stroke=svg.HUES[0], stroke_width=4.5)


def _end_key(x: float, y: float) -> str:
    return _line_key(x - 6, y, svg.INK, svg.LINE, "2 4") + end_cross(np.array([x + 10, y]))


def _touch_key(x: float, y: float) -> str:
    line = svg.segment((x - 16, y), (x + 8, y), stroke=svg.TIP, stroke_width=svg.LINE)
    tip = svg.circle((x + 9, y), 7.0, fill=svg.TIP_FILL, stroke=svg.TIP, stroke_width=svg.LINE)
    start = svg.circle((x - 16, y), 2.2, fill=svg.TIP)
    return line + start + tip + svg.circle((x + 9, y), 2.6, fill=svg.TIP)


def _pad_key(x: float, y: float) -> str:
    line = svg.segment((x - 16, y), (x + 9, y), stroke=svg.TIP, stroke_width=svg.LINE)
    face = svg.segment((x + 9, y - 8), (x + 9, y + 8), stroke=svg.TIP, stroke_width=3.0)
    start = svg.circle((x - 16, y), 2.2, fill=svg.TIP)
    return line + start + face + svg.circle((x + 9, y + 5), 2.6, fill=svg.TIP)


def _normal_key(x: float, y: float) -> str:
    return normal_wedge(np.array([x + 14, y]), 28.0, math.pi - 0.25, math.pi + 0.25)


def _miss_key(x: float, y: float) -> str:
    swept = svg.segment(
        (x - 10, y),
        (x + 10, y),
        stroke=svg.MISS,
        stroke_opacity=0.12,
        stroke_width=13.0,
        stroke_linecap="round",
    )
    return swept + _line_key(x, y, svg.MISS, svg.LINE, "6 4") + end_cross(np.array([x + 10, y]), svg.MISS)


def _beyond_key(x: float, y: float) -> str:
    head = np.array([[x + 8, y], [x - 8, y - 6], [x - 4, y], [x - 8, y + 6]])
    return svg.closed_path([head], fill=svg.INK)


def _base_key(x: float, y: float) -> str:
    return svg.rectangle((x - 5, y - 5), (10.0, 10.0), fill=svg.INK)


def _workspace_key(x: float, y: float) -> str:
    return _line_key(x, y, svg.AXIS, svg.LINE, "1 4", "round")
