"""Obstacle of a tip: which of a state's polygons stand beside it, along all of its length.

An upright rigid cylinder touches a part where it touches any of the cross sections between its ends, so the
obstacle for its axis is the union of these sections, grown by a disc. Polygons that others are certain to
cover, whatever the tolerance makes of them, cannot be touched and are left out: a wall that leans is cut into
many sections, of which a few stand out. For balls see `ball_obstacle`.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import shapely

from palpate.base.geometry import Circle, Floats, Polygon, Section
from palpate.base.tips import TipShape, implementation_for
from palpate.recognizer.ball_obstacle import ball_obstacle
from palpate.recognizer.contact import Finger
from palpate.recognizer.edges import CatalogueState

_CLEAR_DEPTH_MM = 1e-6  # far above the rounding of distances


@dataclass(frozen=True, eq=False)
class TipObstacle:
    """Obstacle of a finger: a state's polygons that may overlap, where it meets whichever stands out.

    `layers`: sections, and the radius (mm) of the disc that each is to be grown by; what is touched is within
    `tolerance_mm` of them, and normals are within `normal_bound_rad` where that is declared. `section` grown
    by `radius_mm` is within it, too, of all of them together: the only layer, but for some balls. `united`:
    the polygons are of several heights.
    """

    layers: tuple[tuple[Section, float], ...]
    section: Section
    radius_mm: float
    tolerance_mm: float
    normal_bound_rad: float | None
    united: bool


def tip_obstacle(item: CatalogueState, finger: Finger, covered_mm: float | None = None) -> TipObstacle | None:
    """Obstacle that a state is to a finger; None if nothing is met.

    Left out is what others are certain to cover if outlines are within `covered_mm`; None: the tolerance.
    Raises InputError as `ball_obstacle` does.
    """
    obstacle = implementation_for(finger.shape, _OBSTACLES, "what it meets of a part's sections")
    return obstacle(item, finger, covered_mm)


def _obstacle_of_column(item: CatalogueState, finger: Finger, covered_mm: float | None) -> TipObstacle | None:
    met = item.state.sections_within(finger.span_mm)
    if not met:
        return None
    polygons = tuple(polygon for section in met for polygon in section.polygons)
    if finger.half_length_mm > 0 and len(met) > 1:
        polygons = uncovered_polygons(polygons, item.tolerance_mm if covered_mm is None else covered_mm)
    section, radius = Section(finger.span_mm, polygons), finger.tip_radius_mm
    along = finger.half_length_mm > 0
    return TipObstacle(((section, radius),), section, radius, item.tolerance_mm, item.normal_bound_rad, along)


def _obstacle_of_ball(item: CatalogueState, finger: Finger, _covered_mm: float | None) -> TipObstacle | None:
    ball = ball_obstacle(item, finger)
    if ball is None:
        return None
    return TipObstacle(
        tuple((Section(finger.span_mm, polygons), radius) for polygons, radius in ball.layers),
        Section(finger.span_mm, ball.even),
        ball.radius_mm,
        ball.tolerance_mm,
        ball.normal_bound_rad,
        len(ball.even) > 1,
    )


def _obstacle_of_face(
    _item: CatalogueState, _finger: Finger, _covered_mm: float | None
) -> TipObstacle | None:
    raise ValueError("sections are met by points of a pad's face (Finger.face_point), not by the pad")


_OBSTACLES = {
    TipShape.CYLINDER: _obstacle_of_column,
    TipShape.BALL: _obstacle_of_ball,
    TipShape.PAD: _obstacle_of_face,
}


def is_exact(item: CatalogueState, finger: Finger) -> bool:
    """Return whether outlines that a finger meets of a state have no tolerance."""
    if item.tolerance_mm > 0 or finger.tip.is_upright:
        return not item.tolerance_mm > 0
    if len(item.state.sections_within(finger.span_mm)) < 2:
        return True
    met = tip_obstacle(item, finger)
    return met is None or not met.tolerance_mm > 0


def uncovered_polygons(polygons: tuple[Polygon, ...], tolerance_mm: float) -> tuple[Polygon, ...]:
    """Polygons that no other one covers for certain: deeper than both may be off, or as exact as it.

    Largest first is looked at, so that of equal ones one stays.
    """
    shapes = [shapely.Polygon(polygon.outer, polygon.holes) for polygon in polygons]
    deep = 2 * tolerance_mm + _CLEAR_DEPTH_MM if tolerance_mm > 0 else 0.0
    kept: list[int] = []
    for number in np.argsort([-shape.area for shape in shapes], kind="stable").tolist():
        if not any(
            polygons[number] == polygons[other] or _is_covered(shapes[number], shapes[other], deep)
            for other in kept
        ):
            kept.append(number)
    return tuple(polygons[number] for number in sorted(kept))


def _is_covered(shape: shapely.Polygon, by: shapely.Polygon, deep_mm: float) -> bool:
    """Return whether all of a shape lies so deep inside of another one."""
    if not by.covers(shape):
        return False
    return deep_mm == 0 or bool(shape.distance(by.boundary) > deep_mm)


def first_occurrences(rings: Sequence[Floats]) -> tuple[bool, ...]:
    """Mask of rings (n, 2) that are the first of their kind: walls that go up through several sections."""
    seen: set[bytes] = set()
    found = []
    for ring in rings:
        key = np.ascontiguousarray(ring).tobytes()
        found.append(key not in seen)
        seen.add(key)
    return tuple(found)


def uncovered_circles(polygons: tuple[Polygon, ...], tolerance_mm: float) -> tuple[bool, ...]:
    """Mask of rings, circles about one centre, that no other polygon surely covers; of equal ones the first.

    Unlike `standing_out` one by one: of rings round a common bore the outer circles differ.
    """
    reach, deep = [_reach_mm(polygon) for polygon in polygons], 2 * tolerance_mm + _CLEAR_DEPTH_MM
    fresh = first_occurrences([ring for polygon in polygons for ring in polygon.rings])
    bare = (
        not any(
            (low < 0 or low + deep < curve.radius_mm) and curve.radius_mm < high - deep
            for k, (low, high) in enumerate(reach)
            if k != number
        )
        for number, polygon in enumerate(polygons)
        for curve in polygon.curves
        if isinstance(curve, Circle)
    )
    return tuple(first and uncovered for first, uncovered in zip(fresh, bare, strict=True))


def union_circles(polygons: tuple[Polygon, ...]) -> tuple[bool, ...]:
    """Mask of rings, circles about one centre, that bound the union of their polygons."""
    reach = [_reach_mm(polygon) for polygon in polygons]
    bounds = []
    for number, (inner, outer) in enumerate(reach):
        others = [item for k, item in enumerate(reach) if k != number]
        before = reach[:number]  # of equal circles the first one counts
        bounds.append(
            not any(low <= outer < high for low, high in others)
            and not any(low <= outer == high for low, high in before)
        )
        if len(polygons[number].rings) > 1:
            bounds.append(
                not any(low < inner <= high for low, high in others)
                and not any(low == inner <= high for low, high in before)
            )
    return tuple(bounds)


def _reach_mm(polygon: Polygon) -> tuple[float, float]:
    """Distances from the centre between which it is solid; from −1 on if it has no hole."""
    radii = [curve.radius_mm for curve in polygon.curves if isinstance(curve, Circle)]
    return (min(radii[1:]) if len(radii) > 1 else -1.0), radii[0]
