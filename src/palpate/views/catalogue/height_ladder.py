"""The ladder of heights beside a section: where it begins and ends, and at which heights fingers are."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from palpate.rig.catalogue.finger_model import RigFingers
from palpate.rig.catalogue.section_stack import Level, Range
from palpate.views.catalogue.layout import Card
from palpate.views.catalogue.style import SHADES
from palpate.views.svg import element, path_data, text
from palpate.views.table_picture.style import AXIS, FAINT, FOUND, INK, MUTED, PAPER, RULE, THIN, TIP

__all__ = ["draw_ladder", "shade"]

_WIDE, _BEFORE = 14.0, 32.0
_APART = 13.0  # of numbers beneath each other
_NUMBER = 11.0
_THIN_BAND = 3.0


def shade(z_mm: float, top_mm: float) -> str:
    """Colour of a height: the higher, the darker."""
    share = min(max(z_mm / top_mm, 0.0), 1.0)
    low, high = SHADES
    return "#" + "".join(f"{round(a + share * (b - a)):02x}" for a, b in zip(low, high, strict=True))


def draw_ladder(card: Card, fingers: RigFingers, left: float, top: float, room: float) -> str:
    """The ladder, as high as its `room`, with its upper left corner at `left`, `top`."""
    heights = [at.height_mm for at in fingers.at]
    high = card.state.state.top_mm
    ladder = _Ladder(left + _BEFORE, top + room - 4, (room - 14) / max(high, *heights))
    drawn = [ladder.band((0.0, high), PAPER, AXIS, "2 2")]
    drawn += [ladder.band(run, FAINT, RULE) for run in _runs(card.state.levels, ladder.scale)]
    if card.is_stack:
        for run in _runs(card.state.levels, ladder.scale):
            drawn.append(ladder.band(run, shade(run[0], high), None))
    else:
        drawn += [ladder.band(found, FOUND, None) for found in card.ranges_mm]
    ends = {"x1": ladder.left - 14, "x2": ladder.right + 14, "y1": ladder.bottom, "y2": ladder.bottom}
    drawn.append(element("line", **ends, stroke=INK, stroke_width=THIN))
    beside, above = ladder.left - 4, ladder.y(high) + 4
    drawn.append(
        text(f"{high:.4g}", beside, min(above, ladder.bottom - 3), size=_NUMBER, fill=MUTED, anchor="end")
    )
    if above < ladder.bottom - _APART - 3:
        drawn.append(text("0", beside, ladder.bottom - 3, size=_NUMBER, fill=MUTED, anchor="end"))
    return "".join(drawn) + _fingers(heights, ladder)


@dataclass(frozen=True)
class _Ladder:
    """Where heights (mm) are on the page."""

    left: float
    bottom: float
    scale: float

    @property
    def right(self) -> float:
        """Right side of the bar."""
        return self.left + _WIDE

    def y(self, z_mm: float) -> float:
        """A height on the page."""
        return self.bottom - self.scale * z_mm

    def band(self, z_mm: Range, fill: str, stroke: str | None, dash: str | None = None) -> str:
        """A part of the bar; never too thin to be seen."""
        low, up = self.y(z_mm[0]), self.y(z_mm[1])
        return element(
            "rect",
            x=self.left,
            y=up,
            width=_WIDE,
            height=max(low - up, 0.5),
            fill=fill,
            stroke=stroke,
            stroke_width=None if stroke is None else 0.8,
            stroke_dasharray=dash,
        )


def _runs(levels: Sequence[Level], scale: float) -> list[Range]:
    """The levels' ranges, with those that would be thinner than a few units joined to the one above."""
    runs: list[Range] = []
    for level in levels:
        low, high = level.z_mm
        if runs and runs[-1][1] == low and scale * (runs[-1][1] - runs[-1][0]) < _THIN_BAND:
            runs[-1] = (runs[-1][0], high)
        else:
            runs.append((low, high))
    return runs


def _fingers(heights_mm: Sequence[float], ladder: _Ladder) -> str:
    """A pointer at each height of fingers, with its number; numbers that are too near move up."""
    drawn = []
    below = math.inf
    for height in heights_mm:
        y = ladder.y(height)
        tip = np.array([[ladder.right + 1, y], [ladder.right + 8, y - 4], [ladder.right + 8, y + 4]])
        drawn.append(element("path", d=path_data([tip]), fill=TIP))
        below = min(y + 4, below - _APART)
        drawn.append(text(f"{height:.4g}", ladder.right + 11, below, size=_NUMBER, fill=TIP))
    return "".join(drawn)
