"""The marks of a residual map: touches by kind and finger, and the arrows of their residuals.

Shared by the map and its legend.
"""

import numpy as np

from palpate.views.calibration.values import FINGER_HUES, Mark
from palpate.views.scene.style import LINE, PAPER, TRUTH
from palpate.views.svg import Floats, element, number, path_data

__all__ = ["LONGEST", "arrow", "fitted", "held_out", "hue", "outlier", "symbol", "touches"]

LONGEST = 80.0
"""Length of the longest arrow, SVG units; longer ones are cut and dashed."""


def hue(finger: int) -> str:
    """Colour of a finger."""
    return FINGER_HUES[finger % len(FINGER_HUES)]


def arrow(at: Floats, end: Floats, hue: str, *, cut: bool) -> str:
    """A line from a touch to where its residual ends, with a head if there is room for one."""
    away = end - at
    length = float(np.hypot(*away))
    line = element(
        "line",
        x1=at[0],
        y1=at[1],
        x2=end[0],
        y2=end[1],
        stroke=hue,
        stroke_width=LINE,
        stroke_dasharray="4 3" if cut else None,
    )
    if length < 9.0:
        return line
    along = away / length
    back, across = end - 6.5 * along, 2.6 * np.array([-along[1], along[0]])
    return line + element("path", d=path_data([np.array([end, back + across, back - across])]), fill=hue)


def fitted(x: float, y: float, hue: str) -> str:
    """A touch that was fitted."""
    return element("circle", cx=x, cy=y, r=3.2, fill=hue)


def held_out(x: float, y: float, hue: str) -> str:
    """A touch that was only foretold."""
    return element("circle", cx=x, cy=y, r=4.2, fill=PAPER, stroke=hue, stroke_width=2.0)


def outlier(x: float, y: float, hue: str) -> str:
    """A touch that was left out."""
    cross = element(
        "path",
        d=f"M{number(x - 5)},{number(y - 5)}l10,10m0,-10l-10,10",
        stroke=TRUTH,
        stroke_width=2.4,
        fill="none",
    )
    return cross + element("circle", cx=x, cy=y, r=2.4, fill=hue)


def symbol(mark: Mark, x: float, y: float) -> str:
    """A touch's mark at a place of the page."""
    draw = outlier if mark.outlier else held_out if mark.held_out else fitted
    return draw(x, y, hue(mark.finger))


def touches(count: int) -> str:
    """A number of touches in words."""
    return "1 touch" if count == 1 else f"{count} touches"
