"""Is a configuration what `verified` says? By shapely alone, on outlines and true arcs.

It shares no code with the recogniser. In the frame of the object. Rounded outward: distances and radii by
2e-6 mm, normals by 1e-6 rad. Where a path as stated is not free, or much of a contact's surroundings is
covered, discs are replaced by polygons that are up to 4e-5 mm smaller; of an object with a tolerance, by as
much for all of its contacts.
"""

import math
from collections.abc import Iterator, Sequence
from functools import cache
from itertools import pairwise

import numpy as np
import shapely

from palpate.base.geometry import Floats, State
from palpate.recognizer import Configuration, Contact

__all__ = ["objections"]

_ROUND_MM, _ROUND_RAD = 2e-6, 1e-6
_POLYGONAL_MM = 5e-5
_SEGMENTS = 256  # of a quarter circle
_STEP_RAD = 1e-3
_SAMPLES = 200  # of a bound


def objections(
    state: State, tolerance_mm: float, at: Configuration, contacts: Sequence[Contact]
) -> list[str]:
    """What speaks against an object lying so: contacts and paths that it does not satisfy."""
    found = []
    for contact in contacts:
        shape = _shape(state, contact.finger.height_mm)
        start, end = (_seen(at, point) for point in (contact.start_mm, contact.end_mm))
        if contact.touched and not _is_contact(shape, tolerance_mm, at, contact, end):
            found.append(f"contact of {contact.name}")
        radius = contact.finger.tip_radius_mm - tolerance_mm - _ROUND_MM
        if not _is_free(shape, radius, start, end, contact.free_path_bound_mm):
            found.append(f"path of {contact.name}")
    return found


@cache
def _shape(state: State, height_mm: float) -> shapely.Geometry:
    parts = [
        shapely.Polygon(polygon.outer, polygon.holes)
        for section in state.sections_at(height_mm)
        for polygon in section.polygons
    ]
    return shapely.union_all(parts)


def _seen(at: Configuration, point: tuple[float, float]) -> Floats:
    x, y = point[0] - at.x_mm, point[1] - at.y_mm
    cos, sin = math.cos(at.theta_rad), math.sin(at.theta_rad)
    return np.array([cos * x + sin * y, cos * y - sin * x])


def _is_contact(
    shape: shapely.Geometry, tolerance: float, at: Configuration, contact: Contact, point: Floats
) -> bool:
    radius, bound = contact.finger.tip_radius_mm, contact.position_bound_mm
    assert contact.normal is not None
    lo = contact.normal.lo_rad - at.theta_rad - _ROUND_RAD
    allowed = (lo, contact.normal.hi_rad - contact.normal.lo_rad + 2 * _ROUND_RAD)
    near = radius + bound + tolerance + 1e-3
    for begin, end, normal, turn in _features(shape, tolerance, radius):
        if shapely.distance(shapely.LineString([begin, end]), shapely.Point(point)) > near:
            continue
        for first, width in _common((normal, turn), allowed):
            swept, place = _swept(begin, end, first, width, radius), shapely.Point(point)
            if shapely.distance(swept, place) > bound + tolerance + _ROUND_MM:
                continue
            if tolerance > 0:
                fits = _loosely_near(shape, swept, place, radius, bound, tolerance)
            else:
                fits = _near(shape, swept, place, radius, bound)
            if fits:
                return True
    return False


@cache
def _feature_list(
    shape: shapely.Geometry, tolerance: float, *, arcs: bool
) -> list[tuple[Floats, Floats, float, float]]:
    found = []
    for part in shapely.get_parts(shape):
        oriented = shapely.geometry.polygon.orient(part)
        for ring in (oriented.exterior, *oriented.interiors):
            points = shapely.get_coordinates(ring)[:-1]
            legs = np.roll(points, -1, axis=0) - points
            sines = [min(1.0, 4 * tolerance / math.hypot(*leg)) for leg in legs]
            tilts = [math.pi if sine >= 1 else math.asin(sine) for sine in sines]
            normals = [math.atan2(-x, y) for x, y in legs]
            for k in range(len(points)):
                tilt, before = tilts[k], tilts[k - 1]
                found.append((points[k], points[k] + legs[k], normals[k] - tilt, 2 * tilt))
                bend = math.remainder(normals[k] - normals[k - 1], 2 * math.pi) + tilt + before
                if arcs and bend > 0:
                    width = min(bend, 2 * math.pi)
                    found.append((points[k], points[k], normals[k - 1] - before, width))
    return found


def _features(
    shape: shapely.Geometry, tolerance: float, radius: float
) -> Iterator[tuple[Floats, Floats, float, float]]:
    """Edges, and vertices if the finger has a radius: ends, and first normal and turn of the normals."""
    yield from _feature_list(shape, tolerance, arcs=radius > 0)


def _common(one: tuple[float, float], two: tuple[float, float]) -> Iterator[tuple[float, float]]:
    """Where two ranges of directions (begin, width) meet."""
    for (begin, width), (other, room) in ((one, two), (two, one)):
        into = (begin - other) % (2 * math.pi)
        if into <= room:
            yield begin, min(width, room - into)


def _swept(begin: Floats, end: Floats, first: float, width: float, radius: float) -> shapely.Geometry:
    """Where the tip's centre is on a feature with these normals."""
    angles = first + np.linspace(0.0, width, 2 + int(width / _STEP_RAD))
    rim = radius * np.column_stack([np.cos(angles), np.sin(angles)])
    if width <= 0 or radius == 0:
        return shapely.LineString([begin + rim[0], end + rim[0]])
    if np.array_equal(begin, end):
        return shapely.LineString(begin + rim)
    quads = [shapely.Polygon([begin + a, end + a, end + b, begin + b]).convex_hull for a, b in pairwise(rim)]
    return shapely.union_all(quads)


def _near(
    shape: shapely.Geometry, swept: shapely.Geometry, at: shapely.Point, radius: float, bound: float
) -> bool:
    """Whether the tip may be on this feature within the bound: there, the object is just a radius away."""
    nearest = shapely.shortest_line(swept, at).coords[0]
    reach = at.buffer(bound + _ROUND_MM + _POLYGONAL_MM, quad_segs=_SEGMENTS)
    around = swept.intersection(reach)
    fine = shapely.get_coordinates(shapely.segmentize(around, max(bound, 1e-3) / _SAMPLES))
    places = shapely.points(np.vstack([[nearest], fine]))
    clear = shapely.distance(places, shape) >= radius - _ROUND_MM
    if np.any(clear & (shapely.distance(places, at) <= bound + _ROUND_MM)):
        return True
    # The part that is not covered may be shorter than what lies between two samples.
    open_part = around.difference(_grown(shape, radius - _ROUND_MM, reach))
    return not open_part.is_empty and shapely.distance(open_part, at) <= bound + _ROUND_MM


def _loosely_near(
    shape: shapely.Geometry,
    swept: shapely.Geometry,
    at: shapely.Point,
    radius: float,
    bound: float,
    tolerance: float,
) -> bool:
    """The same of a feature that is off by up to the tolerance: the object is a radius less that away."""
    if radius <= tolerance:
        return True
    reach = at.buffer(bound + _POLYGONAL_MM, quad_segs=_SEGMENTS)
    around = swept.buffer(tolerance + _POLYGONAL_MM, quad_segs=_SEGMENTS).intersection(reach)
    return not around.difference(_grown(shape, radius - tolerance - _ROUND_MM, reach)).is_empty


def _grown(shape: shapely.Geometry, radius: float, about: shapely.Geometry) -> shapely.Geometry:
    """The shape grown, or shrunk, as far as that matters in a region."""
    if radius <= 0:
        return shape.buffer(radius, join_style="mitre")
    x0, y0, x1, y1 = about.bounds
    margin = radius + 1.0
    part = shape.intersection(shapely.box(x0 - margin, y0 - margin, x1 + margin, y1 + margin))
    return part.buffer(radius, quad_segs=_SEGMENTS)


def _is_free(shape: shapely.Geometry, radius: float, start: Floats, end: Floats, bound: float) -> bool:
    """Whether some path, off by no more than the bound, does not come nearer to the shape than the radius."""
    path = shapely.LineString([start, end])
    if radius > 0 and shapely.distance(path, shape) >= radius:
        return True
    tube = path.buffer(bound + _POLYGONAL_MM, quad_segs=_SEGMENTS)
    ends = [shapely.Point(at).buffer(bound + _POLYGONAL_MM, quad_segs=_SEGMENTS) for at in (start, end)]
    free = tube.difference(_grown(shape, radius, tube))
    return any(all(part.intersects(disc) for disc in ends) for part in shapely.get_parts(free))
