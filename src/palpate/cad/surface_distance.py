"""Distance of points from a triangle surface, and the nearest triangle: for hundreds of thousands of points.

Triangles are found by their boxes as they are seen along the axis that the surface is most square to: seen
so, few of them lie above each other. Radii grow: a point that is nearly on the surface meets one or two
triangles, and how far to look at most is known from the nearest vertex.
"""

from functools import cached_property
from typing import Any

import numpy as np
import shapely
from scipy.spatial import cKDTree

from palpate.base.geometry import Bools, Floats, Ints
from palpate.cad.values import Solid

__all__ = ["SurfaceDistance"]

_AT_ONCE = 50_000
"""Points that are looked up together: what they meet is kept in memory."""
_FLAT = 1e-6
"""Lower triangles, beside their longest side, are taken as their sides: their normal is rounding."""


class SurfaceDistance:
    """The triangles of a solid.

    `corners_mm` (m, 3, 3); `normal` (m, 3): unit vectors, zero where `flat` (m,); `inward` (m, 3, 3): unit
    vectors in the plane of the triangle, from the side after each corner to its inside; `size_mm`: the
    diagonal of the box round everything; `looked`: points that were asked for so far.
    """

    def __init__(self, solid: Solid) -> None:
        self.vertices_mm = solid.vertices_mm
        self.faces = solid.faces
        self.corners_mm: Floats = solid.vertices_mm[solid.faces]
        self.size_mm = float(np.linalg.norm(np.ptp(solid.vertices_mm, axis=0)))
        sides = np.roll(self.corners_mm, -1, axis=1) - self.corners_mm
        longest = np.linalg.norm(sides, axis=2).max(axis=1)
        normal = np.cross(sides[:, 0], sides[:, 1])
        twice = np.linalg.norm(normal, axis=1)
        self.flat: Bools = twice <= _FLAT * longest**2
        self.normal: Floats = np.where(
            self.flat[:, None], 0.0, normal / np.where(self.flat, 1.0, twice)[:, None]
        )
        inward = np.cross(self.normal[:, None], sides)
        length = np.linalg.norm(inward, axis=2, keepdims=True)
        self.inward: Floats = inward / np.where(length > 0, length, 1.0)
        self._low, self._high = self.corners_mm.min(axis=1), self.corners_mm.max(axis=1)
        self.looked = 0
        self._trees: dict[int, Any] = {}

    @cached_property
    def vertex_tree(self) -> cKDTree:
        """The vertices."""
        return cKDTree(self.vertices_mm)

    def nearest(
        self, points_mm: Floats, normal: Floats, near_mm: float, within_mm: float
    ) -> tuple[Floats, Ints]:
        """Distance (p,) of points (p, 3) from the surface and the triangle (p,) there; inf and −1 beyond.

        `normal` (p, 3): about that of the surface near each point, which only makes the search fast; most
        points are expected within `near_mm`.
        """
        self.looked += len(points_mm)
        axis = np.abs(normal).argmax(axis=1)
        off, triangle = np.full(len(points_mm), np.inf), np.full(len(points_mm), -1)
        left = np.arange(len(points_mm))
        reach = np.full(len(points_mm), min(near_mm, within_mm))
        for last in (False, True):
            for k in range(3):
                rows = left[axis[left] == k]
                for some in np.split(rows, range(_AT_ONCE, len(rows), _AT_ONCE)):
                    off[some], triangle[some] = self._met(points_mm[some], k, reach[some])
            left = left[off[left] > reach[left]]
            if last or not len(left) or near_mm >= within_mm:
                break
            vertex = self.vertex_tree.query(points_mm[left])[0]
            reach[left] = np.minimum(vertex * (1 + 1e-9) + 1e-12 * self.size_mm, within_mm)
        beyond = off > within_mm
        off[beyond], triangle[beyond] = np.inf, -1
        return off, triangle

    def off_mm(self, points_mm: Floats, triangle: Ints) -> Floats:
        """Distance (...,) of points (..., 3) from the triangle with the same number, never too small."""
        corners = self.corners_mm[triangle]
        normal, inward = self.normal[triangle], self.inward[triangle]
        off = np.full(points_mm.shape[:-1], np.inf)
        inside = ~self.flat[triangle]
        for k in range(3):
            start = corners[..., k, :]
            along = corners[..., (k + 1) % 3, :] - start
            away = points_mm - start
            inside = inside & ((away * inward[..., k, :]).sum(axis=-1) >= 0)
            length2 = (along**2).sum(axis=-1)
            share = (away * along).sum(axis=-1) / np.where(length2 > 0, length2, 1.0)
            foot = away - np.clip(share, 0.0, 1.0)[..., None] * along
            off = np.minimum(off, np.linalg.norm(foot, axis=-1))
        height = np.abs(((points_mm - corners[..., 0, :]) * normal).sum(axis=-1))
        result: Floats = np.where(inside, height, off)
        return result

    def _met(self, points: Floats, axis: int, reach: Floats) -> tuple[Floats, Ints]:
        """Least distance (p,) from triangles whose boxes are within reach (p,), and which that is."""
        off, triangle = np.full(len(points), np.inf), np.full(len(points), -1)
        if not len(points):
            return off, triangle
        first, second = (axis + 1) % 3, (axis + 2) % 3
        low, high = points - reach[:, None], points + reach[:, None]
        boxes = shapely.box(low[:, first], low[:, second], high[:, first], high[:, second])
        point, met = self._tree(axis).query(boxes)
        level = (self._low[met, axis] <= high[point, axis]) & (self._high[met, axis] >= low[point, axis])
        point, met = point[level], met[level]
        each = self.off_mm(points[point], met)
        order = np.lexsort((each, point))
        point, met, each = point[order], met[order], each[order]
        best = np.r_[True, point[1:] != point[:-1]][: len(point)]
        off[point[best]], triangle[point[best]] = each[best], met[best]
        return off, triangle

    def _tree(self, axis: int) -> Any:
        """Boxes of the triangles as seen along an axis."""
        if axis not in self._trees:
            x, y = (axis + 1) % 3, (axis + 2) % 3
            boxes = shapely.box(self._low[:, x], self._low[:, y], self._high[:, x], self._high[:, y])
            self._trees[axis] = shapely.STRtree(boxes)
        return self._trees[axis]
