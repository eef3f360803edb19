"""Placement of labels where they cover nothing: the last step of drawing a picture.

Everything drawn is known as sample points with weights. A label tries positions on growing circles about its
anchor and takes the one that covers the least weight, nearest first; labels placed earlier cannot be covered.
"""

from dataclasses import dataclass

import numpy as np

from palpate.base.geometry import Floats
from palpate.base.geometry.plane import points_in_polygon

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
