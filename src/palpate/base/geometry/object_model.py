"""Object model: an object known in advance, as stable states and their cross sections.

A state is one stable way in which an object rests on the support plane: a stack of cross sections parallel
to that plane (memo §1.2 and §3.1). Recognition treats states as separate objects. Models are read from files
by `palpate.config`, or made directly from arrays.

All computations use polygons. A polygon that represents a circle or arcs has its vertices on the curve, so
that it deviates to one side by the sagitta of a facet; this deviation is stored, with the angle by which the
curve's normals differ from those of its facets.
"""

import math
from dataclasses import dataclass

import numpy as np

from palpate.base.geometry.plane import Floats
from palpate.base.short_repr import ShortRepr

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


Faceted = tuple[Floats, float, float]
"""Polygon (n, 2) mm that stands for a curve, by how much points of either are off, and normals there, rad."""


def circle_facets(radius_mm: float, stray_mm: float) -> int:
    """Number of facets that keep a circle's sagitta at `stray_mm` or below: a multiple of 48, up to 720."""
    half = math.acos(max(1.0 - stray_mm / radius_mm, -1.0))
    return min(math.ceil(math.pi / half / _LEAST_FACETS) * _LEAST_FACETS, _MOST_FACETS)


def circle_polygon(circle: Circle, facets: int) -> Faceted:
    """A regular polygon with its vertices on the circle, counter-clockwise."""
    angle = 2 * np.pi * np.arange(facets) / facets
    ring = np.array(circle.centre_mm) + circle.radius_mm * np.column_stack([np.cos(angle), np.sin(angle)])
    half = math.pi / facets
    return ring, circle.radius_mm * (1.0 - math.cos(half)), half


def arcs_polygon(points: Floats, stray_mm: float) -> Faceted:
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
    return np.column_stack([ring.real, ring.imag]), off, turn


@dataclass(frozen=True, slots=True, eq=False)
class Polygon:
    """Simple polygon with holes: rings of shape (n, 2), mm, object frame, open, in either direction.

    Edge k of a ring runs from vertex k to vertex k + 1, the last one back to vertex 0. `curves`: the circle
    or the arcs that each ring stands for, None for one that is itself; empty: all are.
    """

    outer: Floats
    holes: tuple[Floats, ...] = ()
    curves: tuple[Curve | None, ...] = ()

    @property
    def rings(self) -> tuple[Floats, ...]:
        """The outer ring and those of the holes."""
        return (self.outer, *self.holes)

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Polygon):
            return NotImplemented
        rings, others = self.rings, other.rings
        return len(rings) == len(others) and all(map(np.array_equal, rings, others))

    def __hash__(self) -> int:
        return hash(tuple(map(len, self.rings)))

    def __repr__(self) -> str:
        return f"<Polygon of {len(self.outer)} vertices, {len(self.holes)} holes>"


@dataclass(frozen=True, slots=True, repr=False)
class Section(ShortRepr):
    """Cross section at heights `z_mm` = (from, to), mm above the support plane, both included."""

    z_mm: tuple[float, float]
    polygons: tuple[Polygon, ...]

    @property
    def rings(self) -> tuple[Floats, ...]:
        """Rings of all polygons, each outer one before its holes: the order in which edges are counted."""
        return tuple(ring for polygon in self.polygons for ring in polygon.rings)


@dataclass(frozen=True, slots=True, repr=False)
class State(ShortRepr):
    """Stable state: a way to rest on the support plane; `probability` and `tipping_angle_rad` where known.

    `heights_mm`: ranges of height (from, to), ascending, at which the sections are known, None: everywhere.
    Within them a height without a section is free. `height_mm`: height of the part; None: its sections'.
    `normal_bound_rad`: as that of the object, before which it goes. Polygons that stand for curves are within
    `curves_off_mm` of them, and their normals within `curves_turn_rad`: that is not in any other bound.
    `side_mm`: rings (n, 2) of (across, z) of its silhouette from the side, for pictures; none: not known.
    """

    name: str
    sections: tuple[Section, ...]
    probability: float | None = None
    tipping_angle_rad: float | None = None
    height_mm: float | None = None
    heights_mm: tuple[tuple[float, float], ...] | None = None
    normal_bound_rad: float | None = None
    curves_off_mm: float = 0.0
    curves_turn_rad: float = 0.0
    side_mm: tuple[Floats, ...] = ()

    @property
    def is_round(self) -> bool:
        """True if it looks the same however it is turned: all outlines are circles about one centre."""
        curves = [
            curve
            for section in self.sections
            for polygon in section.polygons
            for curve in polygon.curves or (None,)
        ]
        first = curves[0]
        return isinstance(first, Circle) and all(
            isinstance(curve, Circle) and curve.centre_mm == first.centre_mm for curve in curves
        )

    @property
    def top_mm(self) -> float:
        """Height above which there is nothing."""
        return max(part.z_mm[1] for part in self.sections) if self.height_mm is None else self.height_mm

    def known_at(self, height_mm: float) -> bool:
        """True if the section at a height is known; above the part it is: there is none."""
        return self.known_within((height_mm, height_mm))

    def known_within(self, span_mm: tuple[float, float]) -> bool:
        """True if the sections are known at all heights of a span (from, to)."""
        at, end = span_mm
        if self.heights_mm is None or at > self.top_mm:
            return True
        for low, high in self.heights_mm:
            if low <= at <= high:
                at = high  # and what is known may go on from there
                if at >= min(end, self.top_mm):
                    return True
        return False

    def sections_at(self, height_mm: float) -> tuple[Section, ...]:
        """Sections at a height: two where one ends and the next begins, none where nothing is that high."""
        return self.sections_within((height_mm, height_mm))

    def sections_within(self, span_mm: tuple[float, float]) -> tuple[Section, ...]:
        """Sections somewhere in a span of heights (from, to), both included: what stands beside a tip."""
        low, high = span_mm
        return tuple(part for part in self.sections if part.z_mm[0] <= high and low <= part.z_mm[1])


LEARNED_HEIGHT_MM = 0.01
"""By so much more than a tip's own height a section that it has learned is said to be known."""


@dataclass(frozen=True, slots=True)
class ObjectModel:
    """Known object; its true outline is within `tolerance_mm` of the modelled one.

    `holds_n`: horizontal force at its middle below which it does not slide. `support_mm`: lower bound on the
    mean distance of its support from the support's geometric median. `normal_bound_rad`: every normal
    that the true outline has at a point, at a vertex all between its edges', is within this of one that the
    modelled outline has within `tolerance_mm` of the point. None: not declared. `least_tip_radius_mm`: the
    model is of what tips of this radius or more feel that are as high as its sections; None: of the part.
    """

    name: str
    states: tuple[State, ...]
    tolerance_mm: float = 0.0
    holds_n: float | None = None
    support_mm: float | None = None
    normal_bound_rad: float | None = None
    least_tip_radius_mm: float | None = None

    def __repr__(self) -> str:
        names = ", ".join(state.name for state in self.states[:4])
        more = f" and {len(self.states) - 4} more" if len(self.states) > 4 else ""
        return f"<ObjectModel {self.name}: {names}{more}; tolerance {self.tolerance_mm:g} mm>"
