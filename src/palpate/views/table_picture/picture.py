"""The picture of a recognition: contacts, the object found, and the other hypotheses.

The drawing in W is on the left, everything that needs words in a panel on the right. Pure and deterministic:
equal values give equal text.
"""

import zlib

from palpate.views.svg import element, escape, number, text, wrap
from palpate.views.table_picture.drawing import draw_view
from palpate.views.table_picture.frame import view_of
from palpate.views.table_picture.panel import draw_panel, panel_width
from palpate.views.table_picture.style import INK, MUTED, PAPER, Column
from palpate.views.table_picture.values import (
    ApproachArrow,
    BoundedPose,
    FingerBase,
    OtherHypothesis,
    Picture,
    PredictedStop,
    TouchMark,
)

__all__ = [
    "ApproachArrow",
    "BoundedPose",
    "FingerBase",
    "OtherHypothesis",
    "Picture",
    "PredictedStop",
    "TouchMark",
    "draw",
]

_EDGE = 28.0
_TICKS = 44.0  # left of the drawing
_GAP = 36.0
_BELOW = 46.0


def draw(picture: Picture) -> str:
    """The picture as an SVG document of its own, which may also be pasted into an HTML page."""
    left = _EDGE + _TICKS
    title = wrap(picture.title, 24, 1080, most_lines=2, bold=True)
    subtitle = [part for line in picture.subtitle for part in wrap(line, 13.5, 1080, most_lines=2)]
    y = _EDGE - 6
    head = []
    for line in title:
        y += 30
        head.append(text(line, left, y, size=24, fill=INK, weight="bold"))
    for line in subtitle:
        y += 21
        head.append(text(line, left, y, size=13.5, fill=MUTED))
    top = y + 24
    view = view_of(picture, left, top)
    column = Column(left + view.width + _GAP, panel_width(picture))
    _, panel_end = draw_panel(picture, view, column, top - 2)
    view = view.taller(panel_end - _BELOW - top)
    panel, panel_end = draw_panel(picture, view, column, top - 2)
    width = column.right + _EDGE
    height = max(top + view.height + _BELOW, panel_end) + _EDGE - 8
    clip = f"window-{zlib.crc32(repr((view, picture.title)).encode()):08x}"
    return (
        element(
            "svg",
            element("title", escape(picture.title or "Recognition")),
            element("desc", escape(_description(picture))),
            element("rect", width=width, height=height, fill=PAPER),
            *head,
            draw_view(picture, view, clip),
            panel,
            xmlns="http://www.w3.org/2000/svg",
            viewBox=f"0 0 {number(width)} {number(height)}",
            role="img",
            font_family="sans-serif",
        )
        + "\n"
    )


def _description(picture: Picture) -> str:
    """The picture in words, for those who do not see it."""
    touched = sum(touch.touched for touch in picture.touches)
    grips = len({touch.grip for touch in picture.touches})
    words = [*picture.subtitle]
    missed = len(picture.touches) - touched
    words.append(f"Grips: {grips}; contacts: {touched}; approaches that touched nothing: {missed}.")
    words.append(f"{'Hypotheses' if picture.approaches else 'Other hypotheses'}: {len(picture.others)}.")
    words += [f"Next, {item.finger}: {', '.join(item.words)}." for item in picture.approaches]
    if picture.pose is not None:
        x, y, theta = picture.pose.x_mm[0], picture.pose.y_mm[0], picture.pose.theta_rad[0]
        angle = "any" if picture.pose.turns_freely else f"{theta:.4f} rad"
        words.append(f"Configuration: x {x:.2f} mm, y {y:.2f} mm, θ {angle}.")
    return " ".join(words)
