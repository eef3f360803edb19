"""Plane geometry as whole-array operations, and the array types that annotations name throughout palpate.

Rotations, angles modulo a turn and point-in-polygon tests; distances and intersections of straight segments.
Rays and capsules determine where along a straight path the centre of a disc must, and where it may, be
stopped by an outline that is known only to within a distance.
"""

import math
from collections.abc import Iterable
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]
Singles = NDArray[np.float32]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]
Counts = NDArray[np.uint16]


_Angle = TypeVar("_Angle", float, Floats)


def wrap_angle(angle: _Angle) -> _Angle:
    """The same angle or angles (rad, any shape) in [−π, π)."""
    return (angle + math.pi) % (2 * math.pi) - math.pi


def rotation_matrix(angle_rad: float) -> Floats:
    """Matrix (2, 2) that rotates column vectors counter-clockwise."""
    cos, sin = math.cos(angle_rad), math.sin(angle_rad)
    return np.array([[cos, -sin], [sin, cos]])


def rotate(vectors: Floats, angle_rad: Floats) -> Floats:
    """Vectors (…, 2) rotated counter-clockwise by angles (…)."""
    cos, sin = np.cos(angle_rad), np.sin(angle_rad)
    x, y = vectors[..., 0], vectors[..., 1]
    return np.stack([cos * x - sin * y, sin * x + cos * y], axis=-1)


def signed_area(ring: Floats) -> float:
    """Area that a ring (n, 2) encloses, positive where it runs counter-clockwise."""
    x, y = (ring - ring[0]).T
    return float(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1))) / 2


def orient_ring(ring: Floats, sign: float) -> Floats:
    """The ring (n, 2) counter-clockwise for a positive sign, clockwise for a negative one."""
    return ring if sign * signed_area(ring) > 0 else ring[::-1]


def points_in_polygon(points: Floats, rings: Iterable[Floats]) -> Bools:
    """Mark points (n, 2) that the rings, each (m, 2), enclose by the even-odd rule.

    A ray to +x from an enclosed point crosses an odd number of edges.
    """
    x, y = points[:, None, 0], points[:, None, 1]
    inside: Bools = np.zeros(len(points), dtype=np.bool_)
    for ring in rings:
        a, b = ring, np.roll(ring, -1, axis=0)
        spans = (a[:, 1] > y) != (b[:, 1] > y)
        rise = np.where(a[:, 1] == b[:, 1], 1.0, b[:, 1] - a[:, 1])
        crossing = a[:, 0] + (y - a[:, 1]) * (b[:, 0] - a[:, 0]) / rise
        inside ^= np.sum(spans & (x < crossing), axis=1) % 2 == 1
    return inside


def cross(a: Floats, b: Floats) -> Floats:
    """z component of a × b for arrays of shape (…, 2)."""
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


def turn_between(one: Floats, other: Floats) -> Floats:
    """Signed angles (…), in [−π, π], from vectors to vectors (…, 2); 0 where one has no length."""
    turn: Floats = np.arctan2(cross(one, other), np.sum(one * other, axis=-1))
    return turn


def segment_distance(points: Floats, starts: Floats, ends: Floats) -> Floats:
    """Distance (n,) of each point (n, 2) from the segment with the same number."""
    leg = ends - starts
    square = np.maximum((leg**2).sum(axis=1), 1e-300)
    share = np.clip(((points - starts) * leg).sum(axis=1) / square, 0.0, 1.0)
    distance: Floats = np.hypot(*(points - starts - share[:, None] * leg).T)
    return distance


def point_segment_distance(point: Floats, start: Floats, direction: Floats, length: Floats) -> Floats:
    """Distance from points (…, 2) to segments: start (…, 2), unit direction (…, 2), length (…)."""
    rel = point - start
    along = np.clip(np.sum(rel * direction, axis=-1), 0.0, length)
    distance: Floats = np.hypot(
        rel[..., 0] - along * direction[..., 0], rel[..., 1] - along * direction[..., 1]
    )
    return distance


def distance_range(a: Floats, b: Floats, c: Floats, d: Floats) -> tuple[Floats, Floats]:
    """Shortest and longest distance between segments ab and cd, each end of shape (n, 2) (memo Fig. 5)."""
    ends = [np.hypot(*(p - q).T) for p, q in ((a, c), (a, d), (b, c), (b, d))]
    longest = np.maximum.reduce(ends)
    u, v = b - a, d - c
    length_u, length_v = np.hypot(*u.T), np.hypot(*v.T)
    # A segment without length has any direction.
    unit_u = u / np.maximum(length_u, 1e-300)[:, None]
    unit_v = v / np.maximum(length_v, 1e-300)[:, None]
    shortest = np.minimum.reduce(
        [
            point_segment_distance(a, c, unit_v, length_v),
            point_segment_distance(b, c, unit_v, length_v),
            point_segment_distance(c, a, unit_u, length_u),
            point_segment_distance(d, a, unit_u, length_u),
        ]
    )
    side_1 = cross(u, c - a) * cross(u, d - a)
    side_2 = cross(v, a - c) * cross(v, b - c)
    crossing = (side_1 < 0) & (side_2 < 0)
    return np.where(crossing, 0.0, shortest), longest


def capsule_interval(
    origin: Floats, heading: Floats, start: Floats, direction: Floats, length: Floats, radius: Floats
) -> tuple[Floats, Floats]:
    """Interval of τ in which lines origin + τ·heading are within `radius` of segments; vectors (…, 2).

    A capsule is convex, so it is one interval [enter, leave] of τ; enter > leave where the line misses.
    """
    rel = origin - start
    along, across = np.sum(rel * direction, axis=-1), cross(direction, rel)
    head_along, head_across = np.sum(heading * direction, axis=-1), cross(direction, heading)
    enter_1, leave_1 = _slab(along, head_along, np.zeros_like(radius), length)
    enter_2, leave_2 = _slab(across, head_across, -radius, radius)
    enter, leave = np.maximum(enter_1, enter_2), np.minimum(leave_1, leave_2)
    missed = enter > leave
    enter, leave = np.where(missed, np.inf, enter), np.where(missed, -np.inf, leave)
    for at in (along, along - length):
        enter_3, leave_3 = _disc(at, across, head_along, head_across, radius)
        enter, leave = np.minimum(enter, enter_3), np.maximum(leave, leave_3)
    return enter, leave


def _slab(at: Floats, speed: Floats, lo: Floats, hi: Floats) -> tuple[Floats, Floats]:
    """τ for which lo ≤ at + τ·speed ≤ hi."""
    still = np.abs(speed) < 1e-15
    safe = np.where(still, 1.0, speed)
    one, two = (lo - at) / safe, (hi - at) / safe
    inside = (at >= lo) & (at <= hi)
    enter = np.where(still, np.where(inside, -np.inf, np.inf), np.minimum(one, two))
    leave = np.where(still, np.where(inside, np.inf, -np.inf), np.maximum(one, two))
    return enter, leave


def _disc(
    along: Floats, across: Floats, head_along: Floats, head_across: Floats, radius: Floats
) -> tuple[Floats, Floats]:
    """τ for which (along, across) + τ·(unit heading) is within `radius` of the origin."""
    middle = -(along * head_along + across * head_across)
    miss = along * head_across - across * head_along
    square = radius * radius - miss * miss
    half = np.sqrt(np.maximum(square, 0.0))
    return np.where(square >= 0, middle - half, np.inf), np.where(square >= 0, middle + half, -np.inf)
