"""Plane geometry: rotations, angles modulo a turn, and point-in-polygon tests."""

import math
from collections.abc import Iterable
from typing import TypeVar

import numpy as np

from palpate.base.geometry.arrays import Bools, Floats

__all__ = ["points_in_polygon", "rotate", "rotation_matrix", "wrap_angle"]

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


def points_in_polygon(points: Floats, rings: Iterable[Floats]) -> Bools:
    """Which points (n, 2) the rings, each (m, 2), enclose by the even-odd rule.

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
