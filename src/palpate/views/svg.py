"""SVG written as text: elements, rounding, escaping, widths of text, and the colours of all pictures.

Only presentation attributes, no style sheet and no scripts, so that a picture can be pasted into a page
beside others and looks the same in a browser, a mail and a converter.
"""

import unicodedata
from collections.abc import Sequence
from dataclasses import dataclass

from palpate.base.geometry import Floats

_NARROW = frozenset("fijlrtI.,:;'|!()[]{}-/ ·")
_WIDE = frozenset("mwMW@%—…")
_ESCAPES = {"&": "&amp;", "<": "&lt;", ">": "&gt;", '"': "&quot;"}


Style = str | float | None
"""Value of an attribute; None leaves it out."""
_Point = Floats | tuple[float, float]


def escape(value: str) -> str:
    """Text that is safe between tags and in quotes; characters that XML cannot hold become U+FFFD."""
    if value.isascii() and value.isprintable() and not any(c in value for c in _ESCAPES):
        return value  # as nearly all is, and long paths are
    return "".join(_ESCAPES.get(c, c if _allowed(c) else "\ufffd") for c in value)


def _allowed(character: str) -> bool:
    return character in "\t\n" or unicodedata.category(character) not in {"Cc", "Cs", "Cn"}


def number(value: float) -> str:
    """A coordinate with at most two decimals and no negative zero."""
    rounded = f"{value:.2f}".rstrip("0").rstrip(".")
    return "0" if rounded in {"-0", ""} else rounded


def element(tag: str, *children: str, **attributes: Style) -> str:
    """One element. `stroke_width` becomes `stroke-width`; attributes that are None are left out."""
    words = [tag]
    for name, value in attributes.items():
        if value is not None:
            shown = escape(value) if isinstance(value, str) else number(value)
            words.append(f'{name.rstrip("_").replace("_", "-")}="{shown}"')
    head = " ".join(words)
    return f"<{head}>{''.join(children)}</{tag}>" if children else f"<{head}/>"


def document(size: _Point, *parts: str, title: str, description: str = "", is_sized: bool = False) -> str:
    """A document of a width and a height on white paper; `is_sized`: these are its size on a page, too."""
    width, height = size
    words = [element("title", escape(title))]
    words += [element("desc", escape(description))] if description else []
    return (
        element(
            "svg",
            *words,
            element("rect", width=width, height=height, fill=PAPER),
            *parts,
            xmlns="http://www.w3.org/2000/svg",
            viewBox=f"0 0 {number(width)} {number(height)}",
            width=width if is_sized else None,
            height=height if is_sized else None,
            role="img",
            font_family="sans-serif",
        )
        + "\n"
    )


def text(
    content: str,
    x: float,
    y: float,
    *,
    size: float = 12.0,
    fill: str = "#1f2933",
    anchor: str | None = None,
    weight: str | None = None,
) -> str:
    """One line of text with its baseline at y; `anchor` is start (None), middle or end."""
    return element(
        "text",
        escape(content),
        x=x,
        y=y,
        font_size=size,
        fill=fill,
        text_anchor=anchor,
        font_weight=weight,
    )


def circle(middle: _Point, radius: float, **style: Style) -> str:
    """A circle about a point."""
    return element("circle", cx=middle[0], cy=middle[1], r=radius, **style)


def segment(start: _Point, end: _Point, **style: Style) -> str:
    """A straight line from point to point."""
    return element("line", x1=start[0], y1=start[1], x2=end[0], y2=end[1], **style)


def rectangle(corner: _Point, size: _Point, **style: Style) -> str:
    """An upright rectangle by its upper left corner, its width and its height."""
    return element("rect", x=corner[0], y=corner[1], width=size[0], height=size[1], **style)


def closed_path(rings: Sequence[Floats], **style: Style) -> str:
    """Closed rings, each (n, 2), as one path."""
    return element("path", d=path_data(rings), **style)


def path_data(rings: Sequence[Floats]) -> str:
    """Closed rings, each (n, 2) in SVG units, as the data of one path."""
    parts = []
    for ring in rings:
        points = " ".join(f"{number(x)},{number(y)}" for x, y in ring.tolist())
        parts.append(f"M{points}Z")
    return "".join(parts)


def text_width(content: str, size: float, *, bold: bool = False) -> float:
    """Width of a line in a wide sans-serif face, on the safe side: real faces come out narrower."""
    ems = 0.0
    for c in content:
        if c in _NARROW:
            ems += 0.43
        elif c in _WIDE or unicodedata.east_asian_width(c) in "FW":
            ems += 1.02
        else:
            ems += 0.74 if c.isupper() else 0.645
    return ems * size * (1.12 if bold else 1.0)


def shorten(content: str, size: float, room: float, *, bold: bool = False) -> str:
    """The text, or as much of its beginning as fits into `room` with an ellipsis."""
    if text_width(content, size, bold=bold) <= room:
        return content
    while content and text_width(content + "…", size, bold=bold) > room:
        content = content[:-1]
    return content.rstrip() + "…"


def shorten_middle(content: str, size: float, room: float, *, bold: bool = False) -> str:
    """The text, or its beginning and end with an ellipsis between: names of parts often differ at the end."""
    if text_width(content, size, bold=bold) <= room:
        return content
    kept = len(content)
    while kept and text_width(f"{content[:kept]}…", size, bold=bold) > room:
        kept -= 1
    for keep in range(kept, 0, -1):
        short = f"{content[: keep - keep // 3].rstrip()}…{content[len(content) - keep // 3 :].lstrip()}"
        if text_width(short, size, bold=bold) <= room:
            return short
    return "…"


def wrap(content: str, size: float, room: float, *, most_lines: int, bold: bool = False) -> list[str]:
    """The text in at most `most_lines` lines no wider than `room`; an ellipsis stands for the rest."""
    lines: list[str] = []
    for word in content.split():
        if lines and text_width(f"{lines[-1]} {word}", size, bold=bold) <= room:
            lines[-1] += f" {word}"
        else:
            lines.append(word)
    kept = lines[:most_lines]
    if len(lines) > most_lines:
        kept[-1] = " ".join(lines[most_lines - 1 :])
    return [shorten(line, size, room, bold=bold) for line in kept]


PAPER, CARD, RULE, FAINT = "#ffffff", "#fbfcfd", "#d5dce3", "#eaeef2"
INK, MUTED, AXIS = "#1f2933", "#5b6874", "#8a96a3"
FOUND, FOUND_FILL = "#0072b2", "#d6e8f4"
TRUTH = "#d55e00"
TIP, TIP_FILL = "#007a5a", "#bfe5d8"
MISS = "#8f5a7e"
THIN, LINE, THICK = 1.0, 1.4, 3.0
LABEL_SIZE = 11.5

MAX_OTHERS = 12
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
    """Place of a panel in the picture, SVG units."""

    left: float
    width: float

    @property
    def right(self) -> float:
        """Right side."""
        return self.left + self.width
