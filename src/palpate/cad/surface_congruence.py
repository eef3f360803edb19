"""Congruence of a solid's surface with itself after a motion, or with another one, proven without sampling.

The result bounds the Hausdorff distance between the two surfaces. Why it holds: the distance from one
triangle is convex, so over a piece of a facet it is nowhere larger than at the corners of the piece; the
distance from the surface is no larger. A facet whose corners come to those of a facet is done with that. Any
other piece is held against the triangle that is nearest to its middle, and cut along that triangle's border
where it reaches beyond it, so that different triangulations of one surface are found to be one. Vertices and
middles that are too far end it at once. Rounding is allowed for with 1e-9 of the size.

`SurfaceDistance` gives the distance of points from a surface, and the nearest triangle, for hundreds of
thousands of points. Triangles are found by their boxes as they are seen along the axis that the surface is
most square to: seen so, few of them lie above each other. Radii grow: a point that is nearly on the surface
meets one or two triangles, and how far to look at most is known from the nearest vertex.
"""

from functools import cached_property
from typing import Any

import numpy as np
import shapely
from scipy.spatial import cKDTree

from palpate.base.geometry import Bools, Floats, Ints
from palpate.cad.parts import Solid

_POINTS_AT_ONCE = 50_000
"""Points that are looked up together: what they meet is kept in memory."""
_FLAT_SHARE = 1e-6
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
        self.flat: Bools = twice <= _FLAT_SHARE * longest**2
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
                for some in np.split(rows, range(_POINTS_AT_ONCE, len(rows), _POINTS_AT_ONCE)):
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


_ZERO_SHARE = 1e-6
"""Share of the size that counts as zero."""
_ROUNDING_SHARE = 1e-9
_GOOD_BOUND_RATIO, _GOOD_BOUND_SHARE = 1.5, 0.1
"""Where some point is off, a bound of so many times its distance and this share of what is wanted will do."""
_FIRST_VERTICES = 256
"""So many vertices are asked first: a motion that is none of the solid's is mostly found out by them."""
_HASTY_AFTER_ROUNDS = 24
"""After so many rounds of cutting, anything within the wanted distance will do."""
_MAX_ROUNDS = 40
_HASTY_PIECES_FACTOR, _MAX_PIECES_FACTOR = 3, 6
_SPARE_PIECES = 100_000
"""Pieces over all rounds, in multiples of facets + `_PIECES`: then anything within will do; then it ends."""


def solid_congruence_bound_mm(
    solid: Solid, rotation: Floats, shift_mm: Floats, within_mm: float
) -> float | None:
    """Distance of a surface from itself when a vertex v goes to `rotation` (3, 3) @ v + `shift_mm` (3,).

    An upper bound of the Hausdorff distance, both ways; None if it is beyond `within_mm` or if the proof
    would take too long. A proper rotation; whether outside comes to outside is not looked at.
    """
    return congruence_bound_mm(SurfaceDistance(solid), rotation, shift_mm, within_mm)


def congruence_bound_mm(
    surface: SurfaceDistance, rotation: Floats, shift_mm: Floats, within_mm: float
) -> float | None:
    """Bound as that of `solid_congruence_bound_mm`, for many motions of the same solid."""
    allowed = within_mm - _ROUNDING_SHARE * surface.size_mm
    there = _one_way_bound_mm(surface, rotation, shift_mm, allowed)
    if there is None:
        return None
    # How far the surface is from the moved one: as far as the surface moved back is from itself.
    back = _one_way_bound_mm(surface, rotation.T, -rotation.T @ shift_mm, allowed)
    return None if back is None else max(there, back) + _ROUNDING_SHARE * surface.size_mm


def surface_distance_bound_mm(one: SurfaceDistance, other: SurfaceDistance, within_mm: float) -> float | None:
    """Bound on the distance of two solids as they are, as `solid_congruence_bound_mm` has it."""
    rounding = _ROUNDING_SHARE * max(one.size_mm, other.size_mm)
    close, allowed = _ZERO_SHARE * one.size_mm, within_mm - rounding
    there = _piece_bound_mm(one, other.corners_mm, other.normal, 0.0, close, allowed, alike=False)
    if there is None:
        return None
    back = _piece_bound_mm(other, one.corners_mm, one.normal, 0.0, close, allowed, alike=False)
    return None if back is None else max(there, back) + rounding


def _one_way_bound_mm(
    surface: SurfaceDistance, rotation: Floats, shift: Floats, within: float
) -> float | None:
    """Bound on the distance of the moved surface's points from the surface; None beyond or unproven."""
    if within <= 0:
        return None
    close = min(_ZERO_SHARE * surface.size_mm, within)
    points = surface.vertices_mm @ rotation.T + shift
    found = surface.vertex_tree.query(points, distance_upper_bound=within)
    on_vertex, vertex = np.asarray(found[0]), np.asarray(found[1])
    normal = surface.normal @ rotation.T
    least = _vertex_distance_mm(surface, points, on_vertex, normal, close, within)
    if least > within:
        return None
    known = np.where(on_vertex <= close, vertex, -1)[surface.faces]
    of_facet = on_vertex[surface.faces].max(axis=1)
    done: Bools = np.asarray((known >= 0).all(axis=1))
    done[done] = np.isin(_key(known[done]), _key(surface.faces))
    most = float(of_facet[done].max(initial=0.0))
    rest = _piece_bound_mm(surface, points[surface.faces[~done]], normal[~done], least, close, within)
    return None if rest is None else max(most, rest)


def _vertex_distance_mm(
    surface: SurfaceDistance, points: Floats, on_vertex: Floats, normal: Floats, close: float, within: float
) -> float:
    """Largest distance of the vertices (n, 3), of which some are on vertices; inf if beyond."""
    of_facet = np.zeros(len(points), dtype=np.int64)
    of_facet[surface.faces] = np.arange(len(surface.faces))[:, None]
    left = np.flatnonzero(on_vertex > close)
    few = np.zeros(len(left), dtype=bool)
    few[:: -(-len(left) // _FIRST_VERTICES) or 1] = True
    least = float(on_vertex[on_vertex <= close].max(initial=0.0))
    for some in (left[few], left[~few]):
        off, _ = surface.nearest(points[some], normal[of_facet[some]], close, within)
        least = max(least, float(off.max(initial=0.0)))
        if least > within:
            break
    return least


def _key(faces: Ints) -> Ints:
    """A number for each set of three vertices."""
    first, second, third = np.sort(faces, axis=1).T
    base = np.int64(2_000_000)
    result: Ints = (first * base + second) * base + third
    return result


def _piece_bound_mm(
    surface: SurfaceDistance,
    pieces: Floats,
    normal: Floats,
    least: float,
    close: float,
    within: float,
    *,
    alike: bool = True,
) -> float | None:
    """Bound over triangles (k, 3, 3); `least`: a distance that some point is known to have.

    Unless the surfaces are expected to be `alike`, anything within the wanted distance will do.
    """
    near = close if alike else within
    most, looked = 0.0, 0
    some = len(surface.faces) + _SPARE_PIECES
    for number in range(_MAX_ROUNDS):
        if not len(pieces):
            return most
        looked += len(pieces)
        if looked > _MAX_PIECES_FACTOR * some:
            return None
        at_middle, triangle = surface.nearest(pieces.mean(axis=1), normal, near, within)
        least = max(least, float(at_middle.max()))
        if least > within:
            return None
        off = surface.off_mm(pieces, np.repeat(triangle[:, None], 3, axis=1))
        bound = off.max(axis=1)
        hasty = not alike or number >= _HASTY_AFTER_ROUNDS or looked > _HASTY_PIECES_FACTOR * some
        enough = close if least <= close else _GOOD_BOUND_RATIO * least + _GOOD_BOUND_SHARE * within
        good = bound <= (within if hasty else min(within, enough))
        most = max(most, float(bound[good].max(initial=0.0)))
        pieces, kept = _cut(surface, pieces[~good], triangle[~good], close / 4)
        normal = normal[~good][kept]
    return None


def _cut(surface: SurfaceDistance, pieces: Floats, triangle: Ints, close: float) -> tuple[Floats, Ints]:
    """Pieces cut along the side of their triangle that they reach furthest beyond, or halved if none.

    And which piece each is of.
    """
    inward = surface.inward[triangle]
    start = surface.corners_mm[triangle]
    # (piece, side, corner): how far inside of the side.
    inside = np.einsum("psx,pcsx->psc", inward, pieces[:, :, None] - start[:, None])
    side = inside.min(axis=2).argmin(axis=1)
    rows = np.arange(len(pieces))
    inside = inside[rows, side]
    across = (inside.min(axis=1) < -close) & (inside.max(axis=1) > close)
    parted, of_parted = _split_at_zero(pieces[across], inside[across])
    halves = _halve(pieces[~across])
    kept = np.concatenate([rows[across][of_parted], np.repeat(rows[~across], 2)])
    return np.concatenate([parted, halves]), kept


def _split_at_zero(pieces: Floats, inside: Floats) -> tuple[Floats, Ints]:
    """Triangles (k, 3, 3) cut where the linear function with values (k, 3) at their corners is zero."""
    rows = np.arange(len(pieces))
    beyond = inside < 0
    # The corner that is alone on its side comes first.
    alone = np.where(beyond.sum(axis=1) == 1, beyond.argmax(axis=1), (~beyond).argmax(axis=1))
    a, b, c = (pieces[rows, (alone + k) % 3] for k in range(3))
    f, g, h = (inside[rows, (alone + k) % 3] for k in range(3))
    p = a + (f / (f - g))[:, None] * (b - a)
    q = a + (f / (f - h))[:, None] * (c - a)
    parts = np.stack([np.stack(part, axis=1) for part in ((a, p, q), (p, b, c), (p, c, q))], axis=1)
    of = np.repeat(rows, 3)
    parts = parts.reshape(-1, 3, 3)
    real = _has_extent(parts)
    return parts[real], of[real]


def _has_extent(parts: Floats) -> Bools:
    """Mark parts (k, 3, 3) that are triangles; those without area lie on the side of another part."""
    area = np.linalg.norm(np.cross(parts[:, 1] - parts[:, 0], parts[:, 2] - parts[:, 0]), axis=1)
    result: Bools = np.asarray(area > 0)
    return result


def _halve(pieces: Floats) -> Floats:
    """Both halves of triangles, cut at their longest side."""
    rows = np.arange(len(pieces))
    side = np.linalg.norm(np.roll(pieces, -1, axis=1) - pieces, axis=2).argmax(axis=1)
    a, b, c = (pieces[rows, (side + k) % 3] for k in range(3))
    middle = (a + b) / 2
    halves = np.stack([np.stack(half, axis=1) for half in ((a, middle, c), (middle, b, c))], axis=1)
    return halves.reshape(-1, 3, 3)
