"""The panel right of the drawing: pose with bounds, facts, hypotheses, predictions, legend, whole table."""

import math
from collections.abc import Callable

import numpy as np

from palpate.base.geometry import Floats
from palpate.views import svg
from palpate.views.numerals import at_most, decimal
from palpate.views.table_picture.frame import (
    View,
    arrow_head,
    badge,
    end_cross,
    heading,
    is_base_visible,
    normal_wedge,
)
from palpate.views.table_picture.values import ApproachArrow, BoundedPose, OtherHypothesis, Picture

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


_INSET_SIZE = 170.0


def _whole_table(picture: Picture, view: View, column: svg.Column, y: float) -> tuple[str, float]:
    """The whole table, small: workspace, bases, the object, and the window of the drawing."""
    radius = picture.workspace_radius_mm
    if radius is None or not picture.bases:
        return "", y
    points = np.array([base.at_mm for base in picture.bases] + [(-radius, -radius), (radius, radius)])
    low, high = points.min(axis=0), points.max(axis=0)
    span = float((high - low).max())
    scale = (_INSET_SIZE - 30) / span
    centre = (low + high) / 2
    title = heading("The table", column, y + 12)
    top = y + 28
    box = np.array([column.left + column.width / 2, top + _INSET_SIZE / 2])

    def page(values: object) -> Floats:
        moved: Floats = (np.asarray(values, dtype=float) - centre) * (scale, -scale) + box
        return moved

    x, cy = page((0.0, 0.0)).tolist()
    corners = page([(view.x_mm[0], view.y_mm[1]), (view.x_mm[1], view.y_mm[0])])
    room = np.array([column.width, _INSET_SIZE]) / 2
    window = np.clip(corners, box - room, box + room)
    size = window[1] - window[0]
    shown = [
        title,
        svg.rectangle(
            (window[0, 0], window[0, 1]),
            (float(size[0]), float(size[1])),
            fill=svg.CARD,
            stroke=svg.RULE,
            stroke_width=svg.THIN,
        ),
        svg.circle(
            (x, cy),
            radius * scale,
            fill="none",
            stroke=svg.AXIS,
            stroke_width=svg.LINE,
            stroke_dasharray="1 4",
            stroke_linecap="round",
        ),
    ]
    if picture.found:
        rings = [page(ring) for ring in picture.found]
        shown.append(
            svg.closed_path(
                rings, fill=svg.FOUND_FILL, fill_rule="evenodd", stroke=svg.FOUND, stroke_width=svg.THIN
            )
        )
    for other in picture.others[: svg.MAX_OTHERS] if picture.approaches else ():
        rings = [page(ring) for ring in other.rings]
        shown.append(svg.closed_path(rings, fill="none", stroke=svg.AXIS, stroke_width=0.6))
    shown += [
        _approach_line(page(item.start_mm), page(item.at(item.travel_mm))) for item in picture.approaches
    ]
    for base in picture.bases:
        at = page(base.at_mm)
        shown.append(svg.rectangle((at[0] - 4, at[1] - 4), (8.0, 8.0), fill=svg.INK))
        side = 1 if at[0] >= box[0] else -1
        free = (
            box[0] + column.width / 2 - at[0] - 10 if side > 0 else at[0] - 10 - (box[0] - column.width / 2)
        )
        shown.append(
            svg.text(
                svg.shorten(base.name, 11, float(free)),
                at[0] + 9 * side,
                at[1] + 4,
                size=11,
                anchor=None if side > 0 else "end",
            )
        )
    return "".join(shown), top + _INSET_SIZE


def _approach_line(start: Floats, end: Floats) -> str:
    """An approach of the next grip from its start to its end."""
    dot = svg.circle(start, 2.2, fill=svg.INK)
    along = (end - start) / max(float(np.hypot(*(end - start))), 1e-9)
    line = svg.segment(start, end, stroke=svg.INK, stroke_width=svg.THIN)
    return line + dot + arrow_head(end, along, 7.0)


_NAME_WIDTH, _OUTCOME_WIDTH = 136.0, 106.0
_MAX_ABREAST = 3  # approaches beside each other
_LINE_HEIGHT = 14.5
_TEXT_SIZE = 11.5
_HEADS = ("from x, y (mm)", "along", "at most (mm)", "stop (mm), normal")


def _prediction_width(picture: Picture) -> float:
    """Width (SVG units) that the table needs; 0 without approaches."""
    if not picture.approaches:
        return 0.0
    return _NAME_WIDTH + _OUTCOME_WIDTH * min(len(picture.approaches), _MAX_ABREAST)


def _prediction_table(picture: Picture, _view: View, column: svg.Column, y: float) -> tuple[str, float]:
    """A row for each hypothesis that is drawn, a column for each approach; the y at which it ends."""
    if not picture.approaches:
        return "", y
    count = len(picture.others)
    title = f"Predictions of the hypotheses ({count})" if count > 1 else "Predictions of the hypothesis"
    shown = [heading(title, column, y + 12)]
    y += 22
    for first in range(0, len(picture.approaches), _MAX_ABREAST):
        part, y = _block(picture, picture.approaches[first : first + _MAX_ABREAST], column, y)
        shown.append(part)
    hidden = len(picture.others) - svg.MAX_OTHERS
    if hidden > 0:
        y += _LINE_HEIGHT + 2
        shown.append(svg.text(f"and {hidden} more, not drawn", column.left + 26, y, size=12, fill=svg.MUTED))
    return "".join(shown), y + 6


def _block(
    picture: Picture, approaches: tuple[ApproachArrow, ...], column: svg.Column, y: float
) -> tuple[str, float]:
    at = [column.right - _OUTCOME_WIDTH * (len(approaches) - k) for k in range(len(approaches))]
    shown = [_lines((item.finger,), x, y, bold=True) for item, x in zip(approaches, at, strict=True)]
    shown.append(_lines(_HEADS, column.left, y + _LINE_HEIGHT, room=_NAME_WIDTH))
    shown += [_lines(item.words, x, y + _LINE_HEIGHT) for item, x in zip(approaches, at, strict=True)]
    y += _LINE_HEIGHT * (1 + len(_HEADS)) + 5
    for index, other in enumerate(picture.others[: svg.MAX_OTHERS]):
        shown.append(
            svg.segment((column.left, y), (column.right, y), stroke=svg.RULE, stroke_width=svg.THIN / 2)
        )
        shown.append(_name(picture, index, other, column.left, at[0], y))
        outcomes = [item.predictions[index].words for item in approaches]
        shown += [_outcome(words, x, y) for words, x in zip(outcomes, at, strict=True)]
        y += _LINE_HEIGHT * max(2, *(len(words) for words in outcomes)) + 6
    return "".join(shown), y


def _name(picture: Picture, index: int, other: OtherHypothesis, left: float, right: float, y: float) -> str:
    room = right - left - 34
    return (
        badge(index, picture.colour(index), left + 9, y + 17)
        + svg.text(svg.shorten(other.label, 12, room), left + 26, y + _LINE_HEIGHT, size=12)
        + svg.text(
            svg.shorten(other.reason, 11, room), left + 26, y + 2 * _LINE_HEIGHT, size=11, fill=svg.MUTED
        )
    )


def _outcome(words: tuple[str, ...], left: float, y: float) -> str:
    return _lines(words[:1], left, y, colour=svg.INK) + _lines(words[1:], left, y + _LINE_HEIGHT)


def _lines(
    words: tuple[str, ...],
    left: float,
    y: float,
    *,
    colour: str = svg.MUTED,
    bold: bool = False,
    room: float = _OUTCOME_WIDTH,
) -> str:
    return "".join(
        svg.text(
            svg.shorten(line, _TEXT_SIZE, room - 6, bold=bold),
            left,
            y + _LINE_HEIGHT * (k + 1),
            size=_TEXT_SIZE,
            fill=svg.INK if bold else colour,
            weight="bold" if bold else None,
        )
        for k, line in enumerate(words)
    )


_WIDTH = 330.0


def panel_width(picture: Picture) -> float:
    """Width of the panel, SVG units."""
    return max(_WIDTH, _prediction_width(picture))


def draw_panel(picture: Picture, view: View, column: svg.Column, top: float) -> tuple[str, float]:
    """The panel, and the y at which it ends; SVG units."""
    y = top
    shown = []
    parts = [_pose, _facts, _others, _prediction_table, *([legend, _whole_table] * picture.has_legend)]
    for part in parts:
        drawn, end = part(picture, view, column, y)
        shown.append(drawn)
        y = end + (16.0 if end > y else 0.0)
    return "".join(shown), y - 16.0


def _pose(picture: Picture, _view: View, column: svg.Column, y: float) -> tuple[str, float]:
    pose = picture.pose
    if pose is None:
        return "", y
    shown = [heading("Configuration and certified bounds", column, y + 12)]
    y += 24
    for name, value, bound in _pose_rows(pose):
        y += _ROW + 2
        shown.append(svg.text(name, column.left, y, size=15, fill=svg.FOUND, weight="bold"))
        shown.append(svg.text(value, column.left + 150, y, size=15, anchor="end"))
        shown.append(svg.text(bound, column.left + 165, y, size=15, fill=svg.MUTED))
    return "".join(shown), y + 6


def _pose_rows(pose: BoundedPose) -> list[tuple[str, str, str]]:
    turned = tuple(math.degrees(value) for value in pose.theta_rad)
    rows = [
        (name, f"{decimal(values[0])}{unit}", f"± {_certified_half_width(values)}{unit}")
        for name, values, unit in (("x", pose.x_mm, " mm"), ("y", pose.y_mm, " mm"), ("θ", turned, "°"))
    ]
    return [*rows[:2], ("θ", "any", "")] if pose.turns_freely else rows


def _certified_half_width(values: tuple[float, ...]) -> str:
    """The larger distance from the value as shown to a bound, rounded up: still certified as printed."""
    value, lo, hi = values
    shown = round(value, 2)
    return at_most(max(hi - shown, shown - lo, 0.0))


def _facts(picture: Picture, _view: View, column: svg.Column, y: float) -> tuple[str, float]:
    if not picture.facts:
        return "", y
    shown = [heading("Facts", column, y + 12)]
    y += 24
    for name, value in picture.facts:
        y += _ROW - 1
        label = svg.shorten(name, 12.5, column.width * 0.55)
        room = column.width - svg.text_width(label, 12.5) - 12
        shown.append(svg.text(label, column.left, y, size=12.5, fill=svg.MUTED))
        shown.append(svg.text(svg.shorten(value, 12.5, room), column.right, y, size=12.5, anchor="end"))
    return "".join(shown), y + 6


def _others(picture: Picture, _view: View, column: svg.Column, y: float) -> tuple[str, float]:
    if not picture.others or picture.approaches:
        return "", y
    title = "Other hypotheses" if picture.found else "Hypotheses"
    shown = [heading(f"{title} ({len(picture.others)})", column, y + 12)]
    y += 24
    for index, other in enumerate(picture.others[: svg.MAX_OTHERS]):
        y += _ROW
        shown.append(badge(index, picture.colour(index), column.left + 9, y - 4.5))
        reason = svg.shorten(other.reason, 12, 185)
        room = column.width - 26 - svg.text_width(reason, 12) - 10
        shown.append(svg.text(svg.shorten(other.label, 12.5, room), column.left + 26, y, size=12.5))
        shown.append(svg.text(reason, column.right, y, size=12, fill=svg.MUTED, anchor="end"))
    hidden = len(picture.others) - svg.MAX_OTHERS
    if hidden > 0:
        y += _ROW
        shown.append(svg.text(f"and {hidden} more, not drawn", column.left + 26, y, size=12, fill=svg.MUTED))
    return "".join(shown), y + 6
