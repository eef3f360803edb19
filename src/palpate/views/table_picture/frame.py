"""The window on W that the picture shows: grid, ticks, scale bar, shared marks, and places of labels.

Everything drawn is known as sample points with weights. A label tries positions on growing circles about its
anchor and takes the one that covers the least weight, nearest first; labels placed earlier cannot be covered.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from palpate.base.geometry import Floats
from palpate.base.geometry.plane import points_in_polygon
from palpate.views import svg
from palpate.views.table_picture.values import ApproachArrow, FingerBase, Picture, TouchMark

_SAMPLE_SPACING = 3.0  # spacing of sample points in SVG units: less than the smallest label's height
_RADII = (0.0, 10.0, 20.0, 32.0, 46.0, 62.0, 80.0, 100.0, 125.0)
_DIRECTIONS = 24
_COST_PER_SAMPLE = 14.0  # cost of covering one sample point of weight 1, in SVG units of distance
_COVERED_COST = 1e6


@dataclass(frozen=True)
class Box:
    """An upright rectangle by its middle and size, in SVG units."""

    x: float
    y: float
    width: float
    height: float

    @property
    def left(self) -> float:
        """Left side."""
        return self.x - self.width / 2

    @property
    def top(self) -> float:
        """Upper side."""
        return self.y - self.height / 2

    def overlaps(self, other: "Box", margin: float = 0.0) -> bool:
        """True if the two are nearer than `margin`."""
        apart_x = abs(self.x - other.x) - (self.width + other.width) / 2
        apart_y = abs(self.y - other.y) - (self.height + other.height) / 2
        return apart_x < margin and apart_y < margin


class LabelPlacer:
    """Free places within a frame. Coordinates are SVG units, y downwards."""

    def __init__(self, frame: Box) -> None:
        self._frame = frame
        self._points: list[Floats] = []
        self._weights: list[Floats] = []
        self._taken: list[Box] = []

    def add_line(self, points: Floats, weight: float = 1.0) -> None:
        """Mark a polyline (n, 2) as drawn."""
        along = np.diff(points, axis=0)
        count = np.ceil(np.hypot(*along.T) / _SAMPLE_SPACING).astype(np.int64) + 1
        leg = np.repeat(np.arange(len(along)), count)
        fraction = (np.arange(len(leg)) - np.repeat(np.cumsum(count) - count, count)) / count[leg]
        self._add(np.vstack([points[leg] + fraction[:, None] * along[leg], points[-1:]]), weight)

    def add_ring(self, points: Floats, weight: float = 1.0) -> None:
        """Mark a closed ring (n, 2) as drawn."""
        self.add_line(np.vstack([points, points[:1]]), weight)

    def add_disc(self, centre: Floats, radius: float, weight: float = 1.0) -> None:
        """Mark a disc as drawn, its inside too."""
        steps = np.arange(-radius, radius + _SAMPLE_SPACING, _SAMPLE_SPACING)
        x, y = (grid.ravel() for grid in np.meshgrid(steps, steps))
        inside = np.hypot(x, y) <= radius
        self._add(centre + np.column_stack([x[inside], y[inside]]), weight)

    def add_inside(self, rings: list[Floats], weight: float) -> None:
        """Mark what rings (n, 2) enclose, by the even-odd rule."""
        low = np.min([ring.min(axis=0) for ring in rings], axis=0)
        high = np.max([ring.max(axis=0) for ring in rings], axis=0)
        grid = np.meshgrid(*(np.arange(low[k], high[k], 2 * _SAMPLE_SPACING) for k in range(2)))
        points = np.column_stack([part.ravel() for part in grid])
        self._add(points[points_in_polygon(points, rings)], weight)

    def place(self, anchor: Floats, width: float, height: float, *, clear: float, towards: float) -> Box:
        """Claim a place for a label, at least `clear` from its anchor, best in direction `towards` (rad)."""
        drawn = np.vstack(self._points) if self._points else np.empty((0, 2))
        weights = np.concatenate(self._weights) if self._weights else np.empty(0)
        reach = clear + _RADII[-1] + width + height
        near = np.all(np.abs(drawn - anchor) <= reach, axis=1)
        drawn, weights = drawn[near], weights[near]
        best, least = Box(float(anchor[0]), float(anchor[1]), width, height), np.inf
        turn = 2 * np.pi / _DIRECTIONS
        offsets = sorted((turn * k for k in range(_DIRECTIONS)), key=lambda a: (min(a, 2 * np.pi - a), a))
        for radius in _RADII:
            for offset in offsets:
                box = self._beside(anchor, width, height, clear + radius, towards + offset)
                under = np.abs(drawn - (box.x, box.y)) <= ((width + 4) / 2, (height + 4) / 2)
                covered = float(weights[under[:, 0] & under[:, 1]].sum())
                cost = _COST_PER_SAMPLE * covered + radius + 6 * min(offset, 2 * np.pi - offset)
                cost += _COVERED_COST * (not self._is_open(box))
                if cost < least:
                    best, least = box, cost
            if least <= radius:
                break
        self._taken.append(best)
        return best

    def _add(self, points: Floats, weight: float) -> None:
        self._points.append(points)
        self._weights.append(np.full(len(points), weight))

    def _beside(self, anchor: Floats, width: float, height: float, gap: float, angle: float) -> Box:
        """The box whose side or corner facing the anchor is `gap` away from it, in direction `angle`."""
        across, down = np.cos(angle), -np.sin(angle)
        x = anchor[0] + across * (gap + width / 2)
        y = anchor[1] + down * (gap + height / 2)
        return Box(float(x), float(y), width, height)

    def _is_open(self, box: Box) -> bool:
        frame = self._frame
        inside = (
            abs(box.x - frame.x) <= (frame.width - box.width) / 2 - 3
            and abs(box.y - frame.y) <= (frame.height - box.height) / 2 - 3
        )
        return inside and not any(box.overlaps(other, 3.0) for other in self._taken)


_WIDTH = 780.0
_ASPECTS = (0.95, 1.35)  # width over height
_MISS_AIR_SHARE = 0.2  # of the longer side, for the sake of misses
_MARGIN_SHARE = 0.09  # of the longer side, around what must be seen


@dataclass(frozen=True)
class View:
    """Window of W in the picture: upright, drawn at (`left`, `top`) with `scale` units per mm."""

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
        """Map points of W (…, 2) mm to SVG units, y downwards."""
        offset = np.asarray(points_mm, dtype=float) - (self.x_mm[0], self.y_mm[1])
        result: Floats = offset * (self.scale, -self.scale) + (self.left, self.top)
        return result

    def at(self, point_mm: tuple[float, float]) -> Floats:
        """One point of W in SVG units."""
        return self.to_page(np.array(point_mm))

    def holds(self, point_mm: tuple[float, float]) -> bool:
        """True if a point of W is within the window."""
        return self.x_mm[0] <= point_mm[0] <= self.x_mm[1] and self.y_mm[0] <= point_mm[1] <= self.y_mm[1]


def view_of(picture: Picture, left: float, top: float) -> View:
    """The window that shows all outlines and contacts with some air, and as much of the table as fits."""
    parts = [*picture.found, *picture.truth]
    parts += [ring for other in picture.others[: svg.MAX_OTHERS] for ring in other.rings]
    parts += [_tip_corners(touch) for touch in picture.touches if touch.touched]
    parts += _nearest_part(parts, [_tip_corners(touch) for touch in picture.touches if not touch.touched])
    parts += [_stops(item) for item in picture.approaches]
    if not any(len(part) for part in parts):
        reach = picture.workspace_radius_mm or 50.0
        parts = [np.array([[-reach, -reach], [reach, reach]])]
    points = np.vstack(parts)
    low, high = points.min(axis=0), points.max(axis=0)
    middle, size = (low + high) / 2, np.maximum(high - low, 1.0)
    size = size + 2 * _MARGIN_SHARE * size.max()
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


def _tip_corners(touch: TouchMark) -> Floats:
    centre = np.array([touch.end_mm])
    return np.vstack([centre - touch.tip_radius_mm, centre + touch.tip_radius_mm])


def _stops(item: ApproachArrow) -> Floats:
    """Return where the tip may be stopped (n, 2), with its radius around; n may be 0."""
    ends = [
        end for stop in item.predictions[: svg.MAX_OTHERS] if stop.stop_mm is not None for end in stop.stop_mm
    ]
    centres = np.array([item.at(end) for end in ends]).reshape(-1, 2)
    return np.vstack([centres - item.tip_radius_mm, centres + item.tip_radius_mm])


def _nearest_part(seen: list[Floats], missed: list[Floats]) -> list[Floats]:
    """Missed tips that are worth showing: misses end far away, and must not make the object small."""
    if not seen:
        return missed
    points = np.vstack(seen)
    low, high = points.min(axis=0), points.max(axis=0)
    air = _MISS_AIR_SHARE * float((high - low).max())
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
        rules.append(f"M{svg.number(at)},{svg.number(view.top)}V{svg.number(view.top + view.height)}")
    for y in _lines_of(view.y_mm, step):
        at = view.at((0.0, y))[1]
        rules.append(f"M{svg.number(view.left)},{svg.number(at)}H{svg.number(view.left + view.width)}")
    return svg.element(
        "path", d="".join(rules) or "M0,0", stroke=svg.FAINT, stroke_width=svg.THIN, fill="none"
    )


def ticks(view: View) -> str:
    """Coordinates in W below and left of the window."""
    step = _tick_step(view)
    decimals = max(0, -math.floor(math.log10(step) + 1e-9))
    bottom = view.top + view.height
    shown = [
        svg.text(
            _signed(x, decimals), view.at((x, 0.0))[0], bottom + 16, fill=svg.MUTED, anchor="middle", size=11
        )
        for x in _lines_of(view.x_mm, step)
    ]
    shown += [
        svg.text(
            _signed(y, decimals),
            view.left - 7,
            view.at((0.0, y))[1] + 4,
            fill=svg.MUTED,
            anchor="end",
            size=11,
        )
        for y in _lines_of(view.y_mm, step)
    ]
    shown.append(svg.text("x, y in mm, frame W", view.left, bottom + 38, fill=svg.MUTED, size=11))
    return "".join(shown)


def _signed(value: float, decimals: int) -> str:
    shown = f"{abs(value):.{decimals}f}"
    return f"−{shown}" if value < 0 and float(shown) else shown


def scale_bar(view: View) -> str:
    """A bar of a round length, below the window."""
    span = nice_step(view.x_mm[1] - view.x_mm[0], 5.0)
    right, y = view.left + view.width, view.top + view.height + 34
    left = right - span * view.scale
    ends = f"M{svg.number(left)},{svg.number(y - 4)}v8M{svg.number(left)},{svg.number(y)}"
    bar = f"{ends}H{svg.number(right)}m0,-4v8"
    line = svg.element("path", d=bar, stroke=svg.INK, stroke_width=svg.LINE, fill="none")
    return line + svg.text(f"{svg.number(span)} mm", left - 8, y + 4, anchor="end", size=12)


def normal_wedge(centre: Floats, radius: float, lo_rad: float, hi_rad: float) -> str:
    """Range of a normal: sector of a disc, counter-clockwise on the page from lo to hi; SVG units."""
    count = max(2, math.ceil((hi_rad - lo_rad) / 0.12) + 1)
    angle = np.linspace(lo_rad, hi_rad, count)
    rim = centre + radius * np.column_stack([np.cos(angle), -np.sin(angle)])
    wedge = svg.path_data([np.vstack([centre, rim])])
    return svg.element(
        "path",
        d=wedge,
        fill=svg.TIP,
        fill_opacity=0.3,
        stroke=svg.TIP,
        stroke_width=svg.THIN,
        stroke_opacity=0.7,
    )


def last_visible_point(start: Floats, end: Floats, view: View) -> Floats | None:
    """The last point of a path that lies well within the window, if any does."""
    frame = view.frame
    path = end + np.linspace(0.0, 1.0, 200)[:, None] * (start - end)
    room = np.array([frame.width, frame.height]) / 2 - 6
    seen = np.all(np.abs(path - (frame.x, frame.y)) <= room, axis=1)
    if not seen.any():
        return None
    last: Floats = path[int(np.argmax(seen))]
    return last


def leader(anchor: Floats, box: Box, clear: float, colour: str) -> str:
    """A thin line from a label to what it names, where they are not next to each other."""
    near = np.clip(anchor, (box.left, box.top), (box.left + box.width, box.top + box.height))
    away = near - anchor
    distance = float(np.hypot(*away))
    if distance < clear + 14:
        return ""
    begin = anchor + away * ((clear - 3) / distance)
    return svg.segment(begin, near, stroke=colour, stroke_width=0.8, stroke_opacity=0.6)


def heading(content: str, column: svg.Column, y: float) -> str:
    """A heading of a part of the panel, ruled below."""
    rule = svg.segment((column.left, y + 7), (column.right, y + 7), stroke=svg.RULE, stroke_width=svg.THIN)
    return svg.text(content, column.left, y, size=12, fill=svg.MUTED, weight="bold") + rule


def arrow_head(tip: Floats, along: Floats, size: float = 11.0) -> str:
    """A head that ends at `tip` (2,) and points along a unit vector (2,), SVG units."""
    back, across = tip - size * along, 0.36 * size * np.array([-along[1], along[0]])
    return svg.closed_path([np.array([tip, back + across, back - across])], fill=svg.INK)


def end_cross(at: Floats, colour: str = svg.INK) -> str:
    """Mark where an approach ends that nothing stopped."""
    x, y = at.tolist()
    return svg.element(
        "path",
        d=f"M{svg.number(x - 4)},{svg.number(y - 4)}l8,8m0,-8l-8,8",
        stroke=colour,
        stroke_width=svg.LINE,
        fill="none",
    )


def badge(index: int, colour: str, x: float, y: float) -> str:
    """The letter of the index-th other hypothesis, in a disc of its outline's colour."""
    disc = svg.circle((x, y), 8.0, fill=svg.PAPER, stroke=colour, stroke_width=svg.THIN)
    letter = svg.text(chr(ord("a") + index), x, y + 3.8, size=11, fill=colour, anchor="middle", weight="bold")
    return disc + letter


def is_base_visible(base: FingerBase, view: View) -> bool:
    """True if a finger's base lies within the window with its mark whole."""
    away = np.abs(view.at(base.at_mm) - (view.frame.x, view.frame.y))
    return bool(np.all(away <= np.array([view.width, view.height]) / 2 - 8))


def draw_base(base: FingerBase, view: View, placer: LabelPlacer) -> str:
    """A finger's base, or an arrowhead on the frame where it lies beyond."""
    at, frame = view.at(base.at_mm), view.frame
    middle = np.array([frame.x, frame.y])
    away = at - middle
    half = np.array([frame.width, frame.height]) / 2
    beyond = float(np.max(np.abs(away) / half))
    if is_base_visible(base, view):
        mark = svg.rectangle((at[0] - 5, at[1] - 5), (10.0, 10.0), fill=svg.INK)
    else:
        at = middle + away / beyond
        along = away / np.hypot(*away)
        across = np.array([-along[1], along[0]])
        mark = svg.closed_path(
            [np.array([at, at - 16 * along + 6 * across, at - 12 * along, at - 16 * along - 6 * across])],
            fill=svg.INK,
        )
    placer.add_disc(at, 12.0, 4.0)
    content = svg.shorten(base.name, svg.LABEL_SIZE, 90)
    inward = math.atan2(away[1], -away[0])
    box = placer.place(at, svg.text_width(content, svg.LABEL_SIZE) + 4, 15.0, clear=13.0, towards=inward)
    return mark + svg.text(content, box.x, box.y + 4, size=svg.LABEL_SIZE, fill=svg.INK, anchor="middle")
