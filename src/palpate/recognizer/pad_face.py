"""Face of a flat pad: the points that represent it as evidence, and the strip that it sweeps.

A pad moves across its face, so that each point of the face goes straight, as a finger without extent would.
Its ways are evidence of some such points; where a pad stops is where the first point of its face does
(docs/recogniser.md, "A pad").
"""

import math
from collections.abc import Iterator

import numpy as np

from palpate.base.geometry import Floats, Ints
from palpate.recognizer.approach import Approach, Rays
from palpate.recognizer.edges import EdgeSet
from palpate.recognizer.tables import expand_ranges

_MAX_POINT_SPACING_MM = 2.5  # points of a face at most
_RAYS_TIMES_EDGES = 400_000  # in one piece: bounds the temporary arrays to tens of MB


def face_offsets_mm(half_width_mm: float) -> Floats:
    """Offsets of a face's points (n,), mm to the left of its middle: both ends, middle, and between."""
    return np.linspace(
        -half_width_mm, half_width_mm, 2 * math.ceil(half_width_mm / _MAX_POINT_SPACING_MM) + 1
    )


def point_to_left(point_mm: tuple[float, float], direction_rad: float, left_mm: float) -> tuple[float, float]:
    """The place so far to the left of a point, seen along a direction."""
    x, y = point_mm
    return x - left_mm * math.sin(direction_rad), y + left_mm * math.cos(direction_rad)


def face_points(approach: Approach) -> list[Approach]:
    """The approaches of the points of a pad's face."""
    point = approach.finger.face_point
    return [
        Approach(
            point,
            point_to_left(approach.start_mm, approach.direction_rad, left),
            approach.direction_rad,
            approach.travel_mm,
            approach.position_bound_mm,
        )
        for left in face_offsets_mm(approach.finger.face_half_mm).tolist()
    ]


def strip_extents(edges: EdgeSet, rays: Rays, half_width_mm: Floats | float) -> tuple[Floats, Floats]:
    """Least and greatest travel (r,) at which outlines are within `half_width_mm` (r,) beside rays.

    What is behind a start by more than ρ is left out. Where nothing is, they are infinite: ∞ and −∞.
    """
    half = np.broadcast_to(half_width_mm, len(rays))
    least, most = np.full(len(rays), np.inf), np.full(len(rays), -np.inf)
    for piece in _pieces(edges.count[rays.state]):
        some = rays.select(piece)
        least[piece], most[piece] = _extents(edges, some, half[piece])
    return least, most


def _pieces(count: Ints) -> Iterator[slice]:
    """Cuts of rays that have so many edges each."""
    number = np.cumsum(count) // _RAYS_TIMES_EDGES
    ends = [*(np.flatnonzero(np.diff(number)) + 1).tolist(), len(number)]
    begin = 0
    for end in ends:
        if end > begin:
            yield slice(begin, end)
        begin = end


def _extents(edges: EdgeSet, rays: Rays, half: Floats) -> tuple[Floats, Floats]:
    count = edges.count[rays.state]
    ray, edge = expand_ranges(edges.first[rays.state], count)
    heading = rays.heading[ray]
    begin, end = edges.start[edge] - rays.start[ray], edges.end[edge] - rays.start[ray]
    along, far_along = np.sum(begin * heading, axis=1), np.sum(end * heading, axis=1)
    left = heading[:, 0] * begin[:, 1] - heading[:, 1] * begin[:, 0]
    far_left = heading[:, 0] * end[:, 1] - heading[:, 1] * end[:, 0]
    # The share of each edge that is in the strip: between where it comes in and where it goes out.
    with np.errstate(divide="ignore", invalid="ignore"):
        shares = (np.stack([-half[ray], half[ray]]) - left) / (far_left - left)
    parallel = far_left == left
    comes = np.where(parallel, 0.0, np.clip(shares.min(axis=0), 0.0, 1.0))
    goes = np.where(parallel, 1.0, np.clip(shares.max(axis=0), 0.0, 1.0))
    inside = np.where(
        parallel, np.abs(left) <= half[ray], (shares.min(axis=0) <= 1) & (shares.max(axis=0) >= 0)
    )
    one = along + comes * (far_along - along)
    other = along + goes * (far_along - along)
    low, high = np.minimum(one, other), np.maximum(one, other)
    inside &= high >= -rays.rho[ray]
    least, most = np.full(len(rays), np.inf), np.full(len(rays), -np.inf)
    filled = np.flatnonzero(count)
    if len(filled):
        first = (np.cumsum(count) - count)[filled]
        least[filled] = np.minimum.reduceat(np.where(inside, np.maximum(low, -rays.rho[ray]), np.inf), first)
        most[filled] = np.maximum.reduceat(np.where(inside, high, -np.inf), first)
    return least, most
