"""Obstacle of a tip: the polygons of a state along its length, and those that a ball can meet.

An upright rigid cylinder touches a part where it touches any of the cross sections between its ends, so the
obstacle for its axis is the union of these sections, grown by a disc. Polygons that others are certain to
cover, whatever the tolerance makes of them, cannot be touched and are left out: a wall that leans is cut into
many sections, of which a few stand out.

*Ball.* A ball of radius R, its equator at height h, meets a section at height z as a disc of radius √(R² − (z
− h)²). In a section that is the same from z to z' the largest such disc touches first: that at the height
nearest to h. So the obstacle for the ball's axis is the union of all sections, each grown by its own radius.
Where one of them covers all others for certain, as upright walls do at the equator, the ball is a disc of its
radius.

With outlines that are off by up to δ, walls may lean within a section: then the ball may touch at another
height than the nearest to h, with a radius r(z) smaller than r. But the section at that nearest height is
within 2δ of the point that is touched, and nowhere nearer to the axis than r: r − 2δ ≤ r(z) ≤ r. So what is
touched is within 3δ of where a disc of radius r would touch. Normals are those of the section that is
touched.

What the obstacle covers for certain is one section for a single disc again: all polygons are brought to the
least radius ρ among theirs, by growing each by what it has more. Arcs are faceted from inside then.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import shapely

from palpate.base.errors import InputError
from palpate.base.geometry import Circle, Floats, Polygon, Section
from palpate.base.geometry.outlines import polygons_of
from palpate.base.tips import TipShape, implementation_for
from palpate.recognizer.contact import Finger
from palpate.recognizer.edges import CatalogueState
from palpate.recognizer.minkowski import OrientedRing, oriented_rings

_LEAN_TOLERANCES = 3.0  # by which a wall that leans in its section may be off from where the disc touches
_FACET_RAD = math.pi / 24  # of an arc that stands for a difference of radii
_ROUNDING_MM = 1e-6


@dataclass(frozen=True, eq=False)
class BallObstacle:
    """Obstacle of a ball: `layers`, polygons and the radius of the disc that each of them is met by.

    They are within `tolerance_mm` of what touches. What stops the ball is within it, too, of the `even`
    polygons grown by the least radius; these are the layer's where there is one only.
    """

    layers: tuple[tuple[tuple[Polygon, ...], float], ...]
    even: tuple[Polygon, ...]
    tolerance_mm: float
    normal_bound_rad: float | None

    @property
    def radius_mm(self) -> float:
        """The least radius."""
        return min(radius for _, radius in self.layers)


@dataclass(frozen=True, eq=False)
class _Part:
    """A polygon of a section, and the ball's radius beside it."""

    polygon: Polygon
    radius_mm: float
    z_mm: tuple[float, float]

    @property
    def shape(self) -> shapely.Polygon:
        return shapely.Polygon(self.polygon.outer, self.polygon.holes)

    @property
    def about_mm2(self) -> float:
        """Area of the polygon grown by the radius, if it were convex."""
        return float(self.shape.area + self.shape.length * self.radius_mm + math.pi * self.radius_mm**2)


def ball_obstacle(item: CatalogueState, finger: Finger) -> BallObstacle | None:
    """Obstacle that a state is to a ball; None where nothing of it is met.

    Raises InputError where it may touch more than 60° from its equator: it would press down or up there more
    than aside, and small errors of height would be large ones of place.
    """
    parts = [
        _Part(polygon, radius, section.z_mm)
        for section in item.state.sections_within(finger.span_mm)
        if (radius := finger.radius_beside_mm(section.z_mm)) > 0
        for polygon in section.polygons
    ]
    parts = _uncovered_parts(parts, item.tolerance_mm)
    if not parts:
        return None
    steepest = min(parts, key=lambda part: part.radius_mm)
    least = steepest.radius_mm
    if least - 2 * item.tolerance_mm < finger.tip.least_share * finger.tip_radius_mm:
        raise InputError(_steep_text(item, finger, steepest))
    layers = _layers(parts)
    tolerance, bound = _LEAN_TOLERANCES * item.tolerance_mm, item.normal_bound_rad
    if len(layers) == 1:
        return BallObstacle(layers, layers[0][0], tolerance, bound)
    even = tuple(
        polygon
        for polygons, radius in layers
        for given in polygons
        for polygon in _grow_polygon(given, radius - least, is_round=item.state.is_round)
    )
    tolerance += _sagitta_mm(item, layers, least) + _ROUNDING_MM
    return BallObstacle(layers, even, tolerance, bound if item.tolerance_mm > 0 else 0.0)


def _layers(parts: Sequence[_Part]) -> tuple[tuple[tuple[Polygon, ...], float], ...]:
    """Polygons by radius, the least radius of those that hardly differ first."""
    radii: list[float] = []
    for radius in sorted({part.radius_mm for part in parts}):
        if not radii or radius > radii[-1] + _ROUNDING_MM:
            radii.append(radius)
    own = np.searchsorted(np.array(radii) - _ROUNDING_MM / 2, [part.radius_mm for part in parts], "right") - 1
    return tuple(
        (tuple(part.polygon for part, k in zip(parts, own.tolist(), strict=True) if k == number), radius)
        for number, radius in enumerate(radii)
    )


def _sagitta_mm(
    item: CatalogueState, layers: Sequence[tuple[tuple[Polygon, ...], float]], least_mm: float
) -> float:
    """Largest depth of even polygons inside of what they stand for."""
    most = layers[-1][1] - least_mm
    if not item.state.is_round:
        return most * (1 - math.cos(_FACET_RAD / 2))
    # Rings that stand for circles are off by a share of their radii.
    curves = (curve for polygons, _ in layers for polygon in polygons for curve in polygon.curves)
    smallest = min(curve.radius_mm for curve in curves if isinstance(curve, Circle))
    return item.state.curves_off_mm * most / smallest


def _steep_text(item: CatalogueState, finger: Finger, part: _Part) -> str:
    low, high = part.z_mm
    return (
        f'object "{item.object_name}", state "{item.state.name}": '
        f"a ball of radius {finger.tip_radius_mm:g} mm at {finger.height_mm:g} mm may touch what stands from "
        f"{low:g} to {high:g} mm more than 60° from its equator; set the finger to another height, give it a "
        "smaller ball, or leave the state out"
    )


def _uncovered_parts(parts: Sequence[_Part], tolerance_mm: float) -> list[_Part]:
    """Parts that no other one, each grown by its radius, covers for certain."""
    kept: list[_Part] = []
    for part in sorted(parts, key=lambda item: -item.about_mm2):
        if not any(_is_part_covered(part, other, tolerance_mm) for other in kept):
            kept.append(part)
    return kept


def _is_part_covered(part: _Part, by: _Part, tolerance_mm: float) -> bool:
    """Return whether a part, grown by radius and tolerance, lies in another, grown by less than its radius.

    So it does if the part lies in the other one grown by the difference of radii less twice the tolerance.
    """
    if part.polygon == by.polygon and part.radius_mm <= by.radius_mm:
        return True  # what is true of the one is true of the other
    more = by.radius_mm - part.radius_mm - 2 * tolerance_mm
    inner, outer = part.shape, by.shape
    if more < 0:
        return bool(outer.covers(inner) and inner.distance(outer.boundary) > -more + _ROUNDING_MM)
    if outer.covers(inner):
        return True
    ends, around = np.array(inner.bounds), np.array(outer.bounds)
    if (ends[:2] < around[:2] - more).any() or (ends[2:] > around[2:] + more).any() or more < _ROUNDING_MM:
        return False
    return bool(shapely.union_all(_grown_shapes(by.polygon, more - _ROUNDING_MM)).covers(inner))


def _grow_circles(polygon: Polygon, more_mm: float) -> Polygon:
    """A ring between circles grown by so much; a hole that closes is none."""
    rings, curves = [], []
    for number, (ring, curve) in enumerate(zip(polygon.rings, polygon.curves, strict=True)):
        assert isinstance(curve, Circle), "the state is round"
        radius = curve.radius_mm + (more_mm if number == 0 else -more_mm)
        if radius > _ROUNDING_MM:
            centre = np.array(curve.centre_mm)
            rings.append(centre + (ring - centre) * (radius / curve.radius_mm))
            curves.append(replace(curve, radius_mm=radius))
    return Polygon(rings[0], tuple(rings[1:]), tuple(curves))


def _grow_polygon(polygon: Polygon, by_mm: float, *, is_round: bool) -> list[Polygon]:
    """A polygon grown by a disc; arcs are faceted from inside."""
    if by_mm <= _ROUNDING_MM:
        return [polygon]
    if is_round:
        return [_grow_circles(polygon, by_mm)]
    return list(polygons_of(shapely.union_all(_grown_shapes(polygon, by_mm))))


def _grown_shapes(polygon: Polygon, by_mm: float) -> list[shapely.Polygon]:
    """Parts of a polygon grown by a disc: itself, strips along edges and wedges about convex vertices.

    Not a buffer, which simplifies its input by an amount that it does not state.
    """
    shapes = [shapely.Polygon(polygon.outer, polygon.holes)]
    for ring in oriented_rings(Section((0.0, 0.0), (polygon,))):
        shapes += _strips_and_wedges(ring, by_mm)
    return shapes


def _strips_and_wedges(ring: OrientedRing, by_mm: float) -> list[shapely.Polygon]:
    start, end = ring.points, np.roll(ring.points, -1, axis=0)
    angle = np.arctan2(-(end - start)[:, 0], (end - start)[:, 1])
    out = by_mm * np.column_stack([np.cos(angle), np.sin(angle)])
    shapes = list(shapely.polygons(np.stack([start, start + out, end + out, end], axis=1)))
    for at, begin, turn in zip(start, np.roll(angle, 1), _turns(angle), strict=True):
        if turn > 0:
            steps = max(math.ceil(turn / _FACET_RAD), 1)
            around = begin + turn * np.arange(steps + 1) / steps
            arc = at + by_mm * np.column_stack([np.cos(around), np.sin(around)])
            shapes.append(shapely.Polygon(np.vstack([at, arc])))
    return shapes


def _turns(angle: Floats) -> Floats:
    """Left turns of the outline at the start of each edge, within ± π."""
    result: Floats = (angle - np.roll(angle, 1) + math.pi) % (2 * math.pi) - math.pi
    return result


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
