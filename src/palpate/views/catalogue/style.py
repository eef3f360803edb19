"""Sizes and colours of the picture of objects: one place, so that all of its parts agree. SVG units."""

__all__ = [
    "BAR_WIDTH",
    "BOTTOM",
    "CONCAVE",
    "GAP",
    "HEIGHT",
    "LINES",
    "MARGIN",
    "ROOM",
    "SHADES",
    "SIDE",
    "UNREACHED",
    "UNREACHED_LINE",
    "WIDTH",
]

MARGIN, GAP = 14.0, 14.0
ROOM = 190.0
"""Side of the square in which a section is drawn."""
BAR_WIDTH = 78.0
"""Width of the ladder of heights with its numbers."""
SIDE = 76.0
"""Height of the side view, beneath the ladder."""
WIDTH = 2 * MARGIN + ROOM + 12 + BAR_WIDTH
LINES, BOTTOM = 102.0, 102.0
HEIGHT = LINES + ROOM + BOTTOM

CONCAVE = "#f6ecd4"
UNREACHED, UNREACHED_LINE = "#e6cfdd", "#8f5a7e"
SHADES = ((0x9C, 0xC9, 0xE8), (0x08, 0x2F, 0x5C))
"""Colours of the lowest and of the highest section."""
