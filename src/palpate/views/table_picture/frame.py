"""The window on W that the picture shows, with what frames it: grid, ticks in mm, scale bar.

Line weights and letters have the same size whether the part is 20 or 200 mm long; only what is measured in
mm scales.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from palpate.base.geometry import Floats
from palpate.views.label_placement import Box
from palpate.views.svg import element, number, text
from palpate.views.table_picture.style import FAINT, INK, LINE, MOST_OTHERS, MUTED, THIN
from palpate.views.table_picture.values import ApproachArrow, Picture, TouchMark

__all__ = ["View", "grid", "nice_step", "scale_bar", "ticks", "view_of"]

_WIDTH = 780.0
_ASPECTS = (0.95, 1.35)  # width over height
_MISS_AIR = 0.2  # of the longer side, for the sake of misses
_MARGIN = 0.09  # of the longer side, around what must be seen


@dataclass(frozen=True)
class View:
    """Where W lies in the picture: an upright window, drawn at (`left`, `top`) with `scale` units per mm."""

    x_mm: tuple[float, float]
    y_mm: tuple[float, float]
    left: float
    top: float
    scale: float

    @property
    def width(self) -> float:
        """Width in SVG units."""
        return (self.x_mm[1] - self.x_mm[0]) * self.scale

    @property
    def height(self) -> float:
        """Height in SVG units."""
        return (self.y_mm[1] - self.y_mm[0]) * self.scale

    def taller(self, height: float) -> "View":
        """The window with as much more above and below as makes it `height` units high."""
        more = max(0.0, height - self.height) / self.scale / 2
        return replace(self, y_mm=(self.y_mm[0] - more, self.y_mm[1] + more))

    @property
    def frame(self) -> Box:
        """The window in SVG units."""
        return Box(self.left + self.width / 2, self.top + self.height / 2, self.width, self.height)

    def to_page(self, points_mm: Floats) -> Floats:
        """From W (…, 2) mm to SVG units, y downwards."""
        offset = np.asarray(points_mm, dtype=float) - (self.x_mm[0], self.y_mm[1])
        result: Floats = offset * (self.scale, -self.scale) + (self.left, self.top)
        return result

    def at(self, point_mm: tuple[float, float]) -> Floats:
        """One point of W in SVG units."""
        return self.to_page(np.array(point_mm))

    def holds(self, point_mm: tuple[float, float]) -> bool:
        """Whether a point of W is within the window."""
        return self.x_mm[0] <= point_mm[0] <= self.x_mm[1] and self.y_mm[0] <= point_mm[1] <= self.y_mm[1]


def view_of(picture: Picture, left: float, top: float) -> View:
    """The window that shows all outlines and contacts with some air, and as much of the table as fits."""
    parts = [*picture.found, *picture.truth]
    parts += [ring for other in picture.others[:MOST_OTHERS] for ring in other.rings]
    parts += [_around(touch) for touch in picture.touches if touch.touched]
    parts += _nearest_part(parts, [_around(touch) for touch in picture.touches if not touch.touched])
    parts += [_stops(item) for item in picture.approaches]
    if not any(len(part) for part in parts):
        reach = picture.workspace_radius_mm or 50.0
        parts = [np.array([[-reach, -reach], [reach, reach]])]
    points = np.vstack(parts)
    low, high = points.min(axis=0), points.max(axis=0)
    middle, size = (low + high) / 2, np.maximum(high - low, 1.0)
    size = size + 2 * _MARGIN * size.max()
    # labels need some 25 units around the contacts
    size = np.maximum(size, (high - low) / (1 - 110 / _WIDTH))
    aspect = float(np.clip(size[0] / size[1], *_ASPECTS))
    width = max(float(size[0]), float(size[1]) * aspect)
    half = np.array([width, width / aspect]) / 2
    return View(
        (float(middle[0] - half[0]), float(middle[0] + half[0])),
        (float(middle[1] - half[1]), float(middle[1] + half[1])),
        left,
        top,
        _WIDTH / width,
    )


def _around(touch: TouchMark) -> Floats:
    centre = np.array([touch.end_mm])
    return np.vstack([centre - touch.tip_radius_mm, centre + touch.tip_radius_mm])


def _stops(item: ApproachArrow) -> Floats:
    """Where the tip may be stopped (n, 2), with its radius around; n may be 0."""
    ends = [
        end for stop in item.predictions[:MOST_OTHERS] if stop.stop_mm is not None for end in stop.stop_mm
    ]
    centres = np.array([item.at(end) for end in ends]).reshape(-1, 2)
    return np.vstack([centres - item.tip_radius_mm, centres + item.tip_radius_mm])


def _nearest_part(seen: list[Floats], missed: list[Floats]) -> list[Floats]:
    """What of the missed tips is worth showing: misses end far away, and must not make the object small."""
    if not seen:
        return missed
    points = np.vstack(seen)
    low, high = points.min(axis=0), points.max(axis=0)
    air = _MISS_AIR * float((high - low).max())
    return [np.clip(tip, low - air, high + air) for tip in missed]


def nice_step(span: float, parts: float) -> float:
    """The largest of 1, 2, 5 times a power of ten that fits into `span` at least `parts` times."""
    rough = span / parts
    power = 10.0 ** math.floor(math.log10(rough))
    return max(factor * power for factor in (1.0, 2.0, 5.0) if factor * power <= rough * (1 + 1e-9))


def _lines_of(span: tuple[float, float], step: float) -> list[float]:
    return [k * step for k in range(math.ceil(span[0] / step), math.floor(span[1] / step) + 1)]


def _tick_step(view: View) -> float:
    return nice_step(view.x_mm[1] - view.x_mm[0], 4.5)


def grid(view: View) -> str:
    """Faint lines at the ticks."""
    step = _tick_step(view)
    rules = []
    for x in _lines_of(view.x_mm, step):
        at = view.at((x, 0.0))[0]
        rules.append(f"M{number(at)},{number(view.top)}V{number(view.top + view.height)}")
    for y in _lines_of(view.y_mm, step):
        at = view.at((0.0, y))[1]
        rules.append(f"M{number(view.left)},{number(at)}H{number(view.left + view.width)}")
    return element("path", d="".join(rules) or "M0,0", stroke=FAINT, stroke_width=THIN, fill="none")


def ticks(view: View) -> str:
    """Coordinates in W below and left of the window."""
    step = _tick_step(view)
    decimals = max(0, -math.floor(math.log10(step) + 1e-9))
    bottom = view.top + view.height
    shown = [
        text(_signed(x, decimals), view.at((x, 0.0))[0], bottom + 16, fill=MUTED, anchor="middle", size=11)
        for x in _lines_of(view.x_mm, step)
    ]
    shown += [
        text(_signed(y, decimals), view.left - 7, view.at((0.0, y))[1] + 4, fill=MUTED, anchor="end", size=11)
        for y in _lines_of(view.y_mm, step)
    ]
    shown.append(text("x, y in mm, frame W", view.left, bottom + 38, fill=MUTED, size=11))
    return "".join(shown)


def _signed(value: float, decimals: int) -> str:
    shown = f"{abs(value):.{decimals}f}"
    return f"−{shown}" if value < 0 and float(shown) else shown


def scale_bar(view: View) -> str:
    """A bar of a round length, below the window."""
    span = nice_step(view.x_mm[1] - view.x_mm[0], 5.0)
    right, y = view.left + view.width, view.top + view.height + 34
    left = right - span * view.scale
    bar = f"M{number(left)},{number(y - 4)}v8M{number(left)},{number(y)}H{number(right)}m0,-4v8"
    caption = f"{number(span)} mm"
    return element("path", d=bar, stroke=INK, stroke_width=LINE, fill="none") + text(
        caption, left - 8, y + 4, anchor="end", size=12
    )
