"""Circles and arcs of outlines, and the polygons that stand for them.

All computations are with polygons. One that stands for a curve has its vertices on it, so that it strays to
one side by the sagitta of a facet; how far, and by what angle the curve's normals differ from those of its
facets, is kept.
"""

import math
from dataclasses import dataclass

import numpy as np

from palpate.base.geometry.arrays import Floats

__all__ = ["Circle", "Curve", "FlatCurve", "arcs_polygon", "circle_facets", "circle_polygon"]

_LEAST_FACETS, _MOST_FACETS = 48, 720


@dataclass(frozen=True, slots=True)
class Circle:
    """A circle in the object's frame, mm."""

    centre_mm: tuple[float, float]
    radius_mm: float


Curve = Circle | Floats
"""A circle, or points (n, 3): x, y and the bulge of what runs from there to the next point.

The bulge is the tangent of a quarter of an arc's angle, positive for one that turns to the left; 0: straight.
"""


@dataclass(frozen=True, slots=True, eq=False)
class FlatCurve:
    """The polygon `ring` (n, 2) that stands for a curve, mm.

    Points of one are within `off_mm` of the other, and normals there within `turn_rad`.
    """

    ring: Floats
    off_mm: float
    turn_rad: float


def circle_facets(radius_mm: float, stray_mm: float) -> int:
    """How many facets keep the sagitta of a circle at `stray_mm` or below: a multiple of 48, up to 720."""
    half = math.acos(max(1.0 - stray_mm / radius_mm, -1.0))
    return min(math.ceil(math.pi / half / _LEAST_FACETS) * _LEAST_FACETS, _MOST_FACETS)


def circle_polygon(circle: Circle, facets: int) -> FlatCurve:
    """A regular polygon with its vertices on the circle, counter-clockwise."""
    angle = 2 * np.pi * np.arange(facets) / facets
    ring = np.array(circle.centre_mm) + circle.radius_mm * np.column_stack([np.cos(angle), np.sin(angle)])
    half = math.pi / facets
    return FlatCurve(ring, circle.radius_mm * (1.0 - math.cos(half)), half)


def arcs_polygon(points: Floats, stray_mm: float) -> FlatCurve:
    """Points (n, 3) with bulges as a polygon; its facets' sagittas are `stray_mm` at most."""
    parts, off, turn = [], 0.0, 0.0
    for (x, y, bulge), (end_x, end_y, _) in zip(points, np.roll(points, -1, axis=0), strict=True):
        start, end = complex(x, y), complex(end_x, end_y)
        chord = abs(end - start)
        if bulge == 0.0 or chord == 0.0:
            parts.append(np.array([start]))
            continue
        angle = 4 * math.atan(bulge)
        radius = chord * (1 + bulge * bulge) / (4 * abs(bulge))
        step = 2 * math.acos(max(1.0 - stray_mm / radius, 0.0))
        count = max(1, math.ceil(abs(angle) / step))
        # Seen from the start, a point of the arc that is turned by a is at the chord's share
        # sin(a/2) / sin(angle/2), turned back from the chord by half of what is left.
        at = angle * np.arange(count) / count
        way = np.sin(at / 2) / math.sin(angle / 2) * np.exp(0.5j * (at - angle))
        parts.append(start + (end - start) * way)
        half = abs(angle) / count / 2
        off, turn = max(off, radius * (1.0 - math.cos(half))), max(turn, half)
    ring = np.concatenate(parts)
    return FlatCurve(np.column_stack([ring.real, ring.imag]), off, turn)
