"""What an emulated ball meets of an object: each section by a circle of its own, worked out with shapely.

Nothing of the recogniser's is used. All sections are grown by what their circles have more than the least of
those that stand out, so that one disc meets them all where the ball would.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import shapely

from palpate.base.geometry import Floats
from palpate.drivers.emulators.tip import PartSection

__all__ = ["outline_beside_ball"]

_QUARTER_CHORDS = 48
_NOTHING_MM = 1e-9
_COVERED_MM = 1e-7
_ON_EDGE_MM = 2e-3  # more than an arc is off its chords
_PATCH_MM = 1.0  # the skin is touched so far above and below


@dataclass(frozen=True, eq=False)
class _Beside:
    """A section beside a ball: the circle that meets it, and at which height; what of it the skin touches."""

    shape: shapely.Geometry
    circle_mm: float
    z_mm: tuple[float, float]


def outline_beside_ball(
    sections: Sequence[tuple[tuple[float, float], shapely.Geometry]],
    height_mm: float,
    radius_mm: float,
    top_mm: float,
) -> PartSection | None:
    """Edges for a disc, its radius with them, that stops where a ball at a height does; None for nothing.

    `sections`: from which height to which, and in W.
    """
    beside = _standing_out([found for item in sections if (found := _beside(*item, height_mm, radius_mm))])
    if not beside:
        return None
    least = min(item.circle_mm for item in beside)
    grown = [_dilated(item.shape, item.circle_mm - least) for item in beside]
    rings = [
        np.asarray(ring.coords)[:-1]
        for part in shapely.get_parts(shapely.union_all(grown))
        if part.geom_type == "Polygon"
        for ring in (part.exterior, *part.interiors)
    ]
    rings = [ring[np.hypot(*(ring - np.roll(ring, 1, axis=0)).T) > _NOTHING_MM] for ring in rings]
    start = np.vstack(rings)
    end = np.vstack([np.roll(ring, -1, axis=0) for ring in rings])
    owner = _owners(grown, (start + end) / 2)
    upright = np.array([item.circle_mm / radius_mm for item in beside])[owner]
    return PartSection(
        start, end, top_mm, np.array([item.z_mm for item in beside])[owner], least, np.minimum(upright, 1.0)
    )


def _beside(
    z_mm: tuple[float, float], shape: shapely.Geometry, height_mm: float, radius_mm: float
) -> _Beside | None:
    """A section as the ball meets it, at the height nearest to its equator; None above it and below."""
    at = min(max(height_mm, z_mm[0]), z_mm[1])
    if abs(at - height_mm) >= radius_mm:
        return None
    circle = math.sqrt(radius_mm**2 - (at - height_mm) ** 2)
    return _Beside(shape, circle, (max(at - _PATCH_MM, z_mm[0]), min(at + _PATCH_MM, z_mm[1])))


def _standing_out(beside: list[_Beside]) -> list[_Beside]:
    """Without those that the ball never comes to: others, grown by their circles, cover all of them."""
    kept = sorted(beside, key=lambda item: item.circle_mm)
    whole = {id(item): _dilated(item.shape, item.circle_mm) for item in kept}
    for item in list(kept):
        others = [whole[id(other)] for other in kept if other is not item]
        if others and shapely.union_all(others).buffer(_COVERED_MM).covers(whole[id(item)]):
            kept.remove(item)
    return kept


def _dilated(shape: shapely.Geometry, by_mm: float) -> shapely.Geometry:
    """A shape and all within a distance: of triangles, as a buffer may smooth what is not convex."""
    if by_mm <= _NOTHING_MM:
        return shape
    triangles = shapely.get_parts(shapely.constrained_delaunay_triangles(shape))
    return shapely.union_all(shapely.buffer(triangles, by_mm, quad_segs=_QUARTER_CHORDS))


def _owners(grown: Sequence[shapely.Geometry], middle: Floats) -> np.ndarray[tuple[int], np.dtype[np.int64]]:
    """Which of the shapes each place (n, 2) is on the outline of: the nearest, of equal ones the last."""
    points = shapely.points(middle)
    away = np.array([shapely.distance(shapely.boundary(shape), points) for shape in grown])
    away = np.where(away < _ON_EDGE_MM, 0.0, away)
    found: np.ndarray[tuple[int], np.dtype[np.int64]] = len(grown) - 1 - np.argmin(away[::-1], axis=0)
    return found
