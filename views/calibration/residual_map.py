"""The residual map of a calibration: where references were touched, and how far each touch is off the fit.

Part of the calibration report. Places are in scale; residuals are arrows along the references' normals, drawn
larger by a factor that the legend states.
"""

import math
from collections.abc import Sequence

import numpy as np

from palpate.views.calibration.residual_map_panel import draw_panel
from palpate.views.calibration.residual_marks import LONGEST, arrow, hue, symbol, touches
from palpate.views.calibration.values import Mark, MarkMap
from palpate.views.label_placement import LabelPlacer
from palpate.views.scene.frame import View, grid, nice_step, scale_bar, ticks
from palpate.views.scene.marks import draw_base
from palpate.views.scene.style import CARD, MUTED, RULE, THIN, Column
from palpate.views.svg import element, escape, number, text

__all__ = ["draw_map"]

_WIDTH, _PANEL = 700.0, 270.0
_LEFT, _TOP, _GAP, _BELOW = 50.0, 10.0, 34.0, 46.0
_ASPECTS = (1.0, 1.5)
_AIR = 0.16  # of the larger side, around the touches
_TYPICAL = 40.0  # length of the arrow of a large, usual residual


def draw_map(values: MarkMap) -> str:
    """The map as an SVG document of its own, which may also be pasted into an HTML page."""
    view = _view(values)
    enlarged = _enlargement(values.marks, view)
    placer = LabelPlacer(view.frame)
    marks = [_mark(mark, view, enlarged, placer) for mark in values.marks]
    frame = {"x": view.left, "y": view.top, "width": view.width, "height": view.height}
    column = Column(view.left + view.width + _GAP, _PANEL)
    panel, panel_end = draw_panel(values, view, enlarged, column, _TOP)
    return element(
        "svg",
        element("title", "Residual map"),
        element("desc", escape(_description(values))),
        element("rect", **frame, fill=CARD),
        grid(view),
        element("rect", **frame, fill="none", stroke=RULE, stroke_width=THIN),
        *marks,
        *(draw_base(base, view, placer) for base in values.bases),
        _placings(values.marks, view, placer),
        ticks(view),
        scale_bar(view),
        panel,
        xmlns="http://www.w3.org/2000/svg",
        viewBox=f"0 0 {number(column.right + 2)} {number(max(view.top + view.height + _BELOW, panel_end))}",
        role="img",
        font_family="sans-serif",
    )


def _view(values: MarkMap) -> View:
    """The window that shows all touches with some air; bases that lie beyond are pointed at."""
    points = np.array([mark.at_mm for mark in values.marks] or [base.at_mm for base in values.bases])
    if not len(points):
        points = np.zeros((1, 2))
    low, high = points.min(axis=0), points.max(axis=0)
    middle, size = (low + high) / 2, np.maximum(high - low, 10.0)
    size = size + 2 * _AIR * size.max()
    width = max(float(size[0]), float(size[1]) * _ASPECTS[0])
    height = max(float(size[1]), width / _ASPECTS[1])
    x, y = middle.tolist()
    half = (width / 2, height / 2)
    return View((x - half[0], x + half[0]), (y - half[1], y + half[1]), _LEFT, _TOP, _WIDTH / width)


def _enlargement(marks: Sequence[Mark], view: View) -> float:
    """How much larger than in scale residuals are drawn: a round factor that makes most of them legible."""
    usual = np.array([abs(mark.residual_mm) for mark in marks if not mark.outlier])
    large = float(np.quantile(usual, 0.9)) if len(usual) else 0.0
    return nice_step(_TYPICAL / (large * view.scale), 1.0) if large > 0 else 1.0


def _mark(mark: Mark, view: View, enlarged: float, placer: LabelPlacer) -> str:
    at = view.at(mark.at_mm)
    along = np.array([math.cos(mark.normal_rad), -math.sin(mark.normal_rad)])
    length = mark.residual_mm * enlarged * view.scale
    cut = abs(length) > LONGEST
    end = at + along * float(np.clip(length, -LONGEST, LONGEST))
    placer.add_line(np.vstack([at, end]))
    placer.add_disc(at, 5.0)
    kind = "held out, " if mark.held_out else "left out as an outlier, " if mark.outlier else ""
    words = f"placing {mark.placing}, {kind}residual {mark.residual_mm:+.3f} mm".replace("-", "−")
    x, y = at.tolist()
    return element(
        "g",
        element("title", escape(words)),
        arrow(at, end, hue(mark.finger), cut=cut),
        symbol(mark, x, y),
    )


def _placings(marks: Sequence[Mark], view: View, placer: LabelPlacer) -> str:
    """The number of every placing in the middle of its touches, or next to it."""
    shown = []
    for placing in sorted({mark.placing for mark in marks}):
        middle = np.mean([mark.at_mm for mark in marks if mark.placing == placing], axis=0)
        content = str(placing)
        box = placer.place(view.to_page(middle), 20.0, 18.0, clear=0.0, towards=0.0)
        shown.append(text(content, box.x, box.y + 5, size=14, fill=MUTED, anchor="middle", weight="bold"))
    return "".join(shown)


def _description(values: MarkMap) -> str:
    """The map in words, for those who do not see it."""
    off = [abs(mark.residual_mm) for mark in values.marks if not mark.outlier]
    left_out = sum(mark.outlier for mark in values.marks)
    largest = f"; the largest residual is {max(off):.3f} mm" if off else ""
    return f"{touches(len(values.marks))} by {len(values.names)} fingers, {left_out} left out{largest}."
