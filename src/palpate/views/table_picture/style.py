"""Colours, line weights and distances of the picture: one place, so that all of its parts agree.

Hues are from Okabe and Ito's palette for all kinds of colour vision; every kind of thing differs from the
others in shape or dash as well.
"""

from dataclasses import dataclass

__all__ = [
    "AXIS",
    "BADGES",
    "CARD",
    "DASHES",
    "FAINT",
    "FOUND",
    "FOUND_FILL",
    "HUES",
    "INK",
    "LABEL",
    "LINE",
    "MISS",
    "MOST_OTHERS",
    "MUTED",
    "PAPER",
    "RULE",
    "THICK",
    "THIN",
    "TIP",
    "TIP_FILL",
    "TRUTH",
    "Column",
]

PAPER, CARD, RULE, FAINT = "#ffffff", "#fbfcfd", "#d5dce3", "#eaeef2"
INK, MUTED, AXIS = "#1f2933", "#5b6874", "#8a96a3"
FOUND, FOUND_FILL = "#0072b2", "#d6e8f4"
TRUTH = "#d55e00"
TIP, TIP_FILL = "#007a5a", "#bfe5d8"
MISS = "#8f5a7e"
THIN, LINE, THICK = 1.0, 1.4, 3.0
LABEL = 11.5

MOST_OTHERS = 12
HUES = (
    "#0072b2",
    "#d55e00",
    "#6a3d9a",
    "#b8860b",
    "#c2407a",
    "#2a9bd0",
    "#8b2f2f",
    "#5b7f00",
    "#4a4e9e",
    "#a0612a",
    "#7a6f9b",
    "#5b6874",
)
"""One for each hypothesis that is drawn, where their predictions are drawn as well."""
BADGES = ("#5b6874", "#8c6a1f", "#6a5aa8", "#7a4a3a")
DASHES = ("5 3", "2 3", "8 3", "8 3 2 3")


@dataclass(frozen=True)
class Column:
    """Where a panel stands in the picture, SVG units."""

    left: float
    width: float

    @property
    def right(self) -> float:
        """Right side."""
        return self.left + self.width
