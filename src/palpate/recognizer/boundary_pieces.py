"""Pieces of a grown section's true boundary, and the sides of the section that they come from.

A piece is a segment and a range of normals: the tip's centre is at distance r, along one of the normals, from
a point of the segment. An edge has one normal, a convex vertex has no length.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from palpate.base.geometry import Bools, Floats, Ints
from palpate.base.geometry.plane import wrap_angle
from palpate.recognizer.bounding_circles import ROUNDING_MM
from palpate.recognizer.tables import Table

__all__ = ["Pieces", "Sides"]


@dataclass(frozen=True, eq=False)
class Sides(Table):
    """Edges (n) of sections in the centred object frame, the solid on their left; sorted by state.

    `ring` (n,) numbers the rings of a state. `start` and `end` (n, 2) mm; neighbours meet in the same
    numbers.
    """

    state: Ints
    ring: Ints
    start: Floats
    end: Floats

    @cached_property
    def length(self) -> Floats:
        """Of each, (n,) mm."""
        result: Floats = np.hypot(*(self.end - self.start).T)
        return result

    @cached_property
    def along(self) -> Floats:
        """Unit direction of each, (n, 2)."""
        return (self.end - self.start) / self.length[:, None]

    @cached_property
    def normal_rad(self) -> Floats:
        """Outward normal of each, (n,)."""
        result: Floats = np.arctan2(-self.along[:, 0], self.along[:, 1])
        return result

    @cached_property
    def before(self) -> Ints:
        """The side (n,) that ends where each begins: the one before, or the last of its ring."""
        begins = np.flatnonzero(np.diff(self.ring, prepend=-1))
        result = np.arange(len(self)) - 1
        result[begins] = np.append(begins[1:], len(self)) - 1
        return result


@dataclass(frozen=True, eq=False)
class Pieces(Table):
    """n pieces, sorted by state: `state` (n,); a segment from `start` along `along` (n, 2), `length` (n,) mm.

    Outward normals: from `normal_rad` counter-clockwise by `turn_rad` (n,). A true point of the feature is
    within `off` (n,) mm of the segment. What touches has the `radius` (n,) mm.
    """

    state: Ints
    start: Floats
    along: Floats
    length: Floats
    normal_rad: Floats
    turn_rad: Floats
    off: Floats
    radius: Floats

    @cached_property
    def is_face(self) -> Bools:
        """Which are edges moved out, (n,); the others are arcs about vertices."""
        return self.length > 0

    @cached_property
    def size(self) -> Floats:
        """How far each goes on (n,): mm along a face, rad about a vertex."""
        return np.where(self.is_face, self.length, self.turn_rad)

    def centres(self, at: Floats, radius_mm: float) -> Floats:
        """Centres (n, 2) of a tip so far along each, `at` (n,)."""
        normal = self.normal_rad + np.where(self.is_face, 0.0, at)
        foot = self.start + self.along * np.where(self.is_face, at, 0.0)[:, None]
        return foot + radius_mm * np.column_stack([np.cos(normal), np.sin(normal)])

    @property
    def circles(self) -> Floats:
        """Circles (n, 3) round all places of a tip's true centre on each: middle x, y, radius mm."""
        radius_mm = self.radius
        half = self.turn_rad / 2
        middle, narrow = self.normal_rad + half, half < np.pi / 2
        out = radius_mm * np.where(narrow, np.cos(half), 0.0)
        centre = self.start + self.along * (self.length / 2)[:, None]
        centre = centre + out[:, None] * np.column_stack([np.cos(middle), np.sin(middle)])
        wide = radius_mm * np.where(narrow, np.sin(half), 1.0)
        return np.column_stack([centre, self.length / 2 + wide + self.off + ROUNDING_MM])

    def along_at(self, point: Floats) -> Floats:
        """How far along each a centre (n, 2) on its line or circle is, (n,)."""
        rel = point - self.start
        # Just before the beginning counts as such, not as a turn further on.
        half = self.turn_rad / 2
        turned = wrap_angle(np.arctan2(rel[:, 1], rel[:, 0]) - self.normal_rad - half) + half
        return np.where(self.is_face, np.sum(rel * self.along, axis=1), turned)

    def stretch(self, begin: Floats, end: Floats) -> "Pieces":
        """The part from `begin` to `end` (n,) of each."""
        face = self.is_face
        return replace(
            self,
            start=self.start + self.along * np.where(face, begin, 0.0)[:, None],
            length=np.where(face, end - begin, 0.0),
            normal_rad=self.normal_rad + np.where(face, 0.0, begin),
            turn_rad=np.where(face, 0.0, end - begin),
        )
