"""The panel beside a residual map: the arrows' scale, what marks mean, the fingers, the bench as a whole."""

from collections.abc import Callable

import numpy as np

from palpate.views.calibration.residual_marks import LONGEST, arrow, fitted, held_out, hue, outlier, touches
from palpate.views.calibration.values import MarkMap
from palpate.views.scene.frame import View, nice_step
from palpate.views.scene.marks import heading, shows_base
from palpate.views.scene.style import AXIS, CARD, INK, MUTED, THIN, Column
from palpate.views.svg import element, path_data, shorten, text, wrap

__all__ = ["draw_panel"]

_ROW = 20.0
_INSET = 190.0


def draw_panel(values: MarkMap, view: View, enlarged: float, column: Column, top: float) -> tuple[str, float]:
    """Right of the map: what the marks mean; and the y at which it ends."""
    y = top + 12
    shown = [heading("Residuals", column, y)]
    per_mm = enlarged * view.scale
    unit = nice_step(LONGEST / per_mm, 1.0)
    y += 34
    start, end = np.array([column.left, y]), np.array([column.left + unit * per_mm, y])
    shown.append(arrow(start, end, INK, cut=False) + fitted(column.left, y, INK))
    shown.append(text(f"{unit:g} mm", float(end[0]) + 10, y + 4.5, size=12.5))
    words = (
        f"Arrows are drawn {enlarged:g} times as long. They point outwards where the tip stood further out "
        "than the fit says, inwards where it stood further in."
    )
    for line in wrap(words, 12.5, column.width, most_lines=6):
        y += _ROW - 1
        shown.append(text(line, column.left, y + 5, size=12.5, fill=MUTED))
    y += 34
    drawn, y = _legend(values, view, per_mm, column, y)
    bench, y = _bench(values, view, column, y + 34)
    return "".join(shown) + drawn + bench, y + 8


def _legend(values: MarkMap, view: View, per_mm: float, column: Column, y: float) -> tuple[str, float]:
    """What the marks in the map mean; only those that are there."""
    marks = values.marks
    rows: list[tuple[Callable[[float, float], str], str]] = []
    if any(not mark.held_out and not mark.outlier for mark in marks):
        rows.append((lambda x, at: fitted(x, at, INK), "touch that was fitted"))
    if any(mark.held_out and not mark.outlier for mark in marks):
        rows.append((lambda x, at: held_out(x, at, INK), "held out: foretold by the fit only"))
    if any(mark.outlier for mark in marks):
        rows.append((lambda x, at: outlier(x, at, INK), "outlier: left out of the fit"))
    if any(abs(mark.residual_mm) * per_mm > LONGEST for mark in marks):
        rows.append((_cut_key, "residual longer than drawn"))
    rows.append((_placing_key, "number of the placing"))
    if values.bases:
        beyond = not all(shows_base(base, view) for base in values.bases)
        rows.append((_base_key, "finger's base" + (", beyond the frame" if beyond else "")))
    shown = [heading("Legend", column, y)]
    y += 12
    for key, meaning in rows:
        y += _ROW
        shown.append(key(column.left + 14, y - 4.5) + text(meaning, column.left + 36, y, size=12.5))
    y += 32
    shown.append(heading("Fingers", column, y))
    y += 12
    for index, name in enumerate(values.names):
        y += _ROW
        count = sum(mark.finger == index for mark in marks)
        swatch = element("circle", cx=column.left + 14, cy=y - 4.5, r=5.0, fill=hue(index))
        shown.append(swatch + text(shorten(name, 12.5, 130), column.left + 40, y, size=12.5))
        shown.append(text(touches(count), column.right, y, size=12.5, fill=MUTED, anchor="end"))
    return "".join(shown), y


def _cut_key(x: float, y: float) -> str:
    return arrow(np.array([x - 14, y]), np.array([x + 14, y]), INK, cut=True)


def _placing_key(x: float, y: float) -> str:
    return text("1", x, y + 5, size=14, fill=MUTED, anchor="middle", weight="bold")


def _base_key(x: float, y: float) -> str:
    head = np.array([[x + 8, y], [x - 8, y - 6], [x - 4, y], [x - 8, y + 6]])
    return element("path", d=path_data([head]), fill=INK)


def _bench(values: MarkMap, view: View, column: Column, y: float) -> tuple[str, float]:
    """All fingers' bases, small, with the map's window and the touches in it."""
    corners = [(view.x_mm[0], view.y_mm[1]), (view.x_mm[1], view.y_mm[0])]
    points = np.array(corners + [base.at_mm for base in values.bases])  # all touches are in the window
    low, high = points.min(axis=0), points.max(axis=0)
    scale = (_INSET - 16) / float((high - low).max())
    middle = np.array([column.left + column.width / 2, y + 20 + _INSET / 2])

    def page(point: tuple[float, float]) -> tuple[float, float]:
        x, at = ((np.array(point) - (low + high) / 2) * (scale, -scale) + middle).tolist()
        return x, at

    left, top = page((view.x_mm[0], view.y_mm[1]))
    size = {"width": view.width / view.scale * scale, "height": view.height / view.scale * scale}
    shown = [
        heading("The bench", column, y),
        element("rect", x=left, y=top, **size, fill=CARD, stroke=AXIS, stroke_width=THIN),
    ]
    for mark in values.marks:
        x, at = page(mark.at_mm)
        shown.append(element("circle", cx=x, cy=at, r=1.3, fill=hue(mark.finger)))
    for base in values.bases:
        x, at = page(base.at_mm)
        shown.append(element("rect", x=x - 4, y=at - 4, width=8.0, height=8.0, fill=INK))
        right = x >= middle[0]
        words = shorten(base.name, 11, float(column.right - x if right else x - column.left) - 10)
        shown.append(text(words, x + (9 if right else -9), at + 4, size=11, anchor=None if right else "end"))
    return "".join(shown), y + 20 + _INSET
