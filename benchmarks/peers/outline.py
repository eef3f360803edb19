"""Outline: how far touches are from an object in given poses. Shared by the peers that need it.

With shapely and numpy, vectorised over poses (m, 3): x, y in mm and θ in rad.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import shapely
from question import Answer, Model, Touch, angle_between

__all__ = ["QUAD_SEGMENTS", "Outline", "Ring", "bulge_mm", "distinct"]

QUAD_SEGMENTS = 8
"""Chords in a quarter turn of an arc round a vertex of a grown outline."""

ALIKE_MM, ALIKE_RAD = 5.0, np.radians(5.0)
ROUNDING = 1e-6


@dataclass(frozen=True)
class Ring:
    """Edges of a ring: begins and ends (n, 2), directions of outward normals (n,)."""

    begin: np.ndarray
    end: np.ndarray

    @classmethod
    def of(cls, points: np.ndarray) -> "Ring":
        return cls(points, np.roll(points, -1, axis=0))

    @cached_property
    def length(self) -> np.ndarray:
        return np.hypot(*(self.end - self.begin).T)

    @cached_property
    def normal(self) -> np.ndarray:
        x, y = (self.end - self.begin).T
        return np.arctan2(-x, y)

    def nearest(self, points: np.ndarray) -> np.ndarray:
        """The point (m, n, 2) of every edge that is nearest to every point (m, 2)."""
        along = self.end - self.begin
        part = np.einsum("mnk,nk->mn", points[:, None] - self.begin, along) / self.length**2
        return self.begin + np.clip(part, 0.0, 1.0)[..., None] * along


def bulge_mm(radius_mm: float) -> float:
    """How far an arc of a grown outline is beyond its chord."""
    return radius_mm * (1 - float(np.cos(np.pi / 4 / QUAD_SEGMENTS)))


@dataclass(frozen=True)
class Outline:
    """An object's outline."""

    name: str
    points: np.ndarray

    @classmethod
    def of(cls, model: Model) -> "Outline":
        return cls(model.name, model.points)

    @cached_property
    def polygon(self) -> shapely.Polygon:
        polygon = shapely.Polygon(self.points)
        shapely.prepare(polygon)
        return polygon

    @cached_property
    def ring(self) -> Ring:
        return Ring.of(self.points)

    def grown(self, radius_mm: float) -> Ring:
        """The outline on which a tip's centre is: arcs as chords."""
        if radius_mm == 0:
            return self.ring
        grown = self.polygon.buffer(radius_mm, quad_segs=QUAD_SEGMENTS)
        points = shapely.get_coordinates(shapely.geometry.polygon.orient(grown).exterior)[:-1]
        ring = Ring.of(points)
        keep = ring.length > ROUNDING
        return Ring(ring.begin[keep], ring.end[keep])

    def seen(self, poses: np.ndarray, point: np.ndarray) -> np.ndarray:
        """A point (2,) of the table in the object's frame (m, 2)."""
        cos, sin = np.cos(poses[:, 2]), np.sin(poses[:, 2])
        x, y = (point - poses[:, :2]).T
        return np.column_stack([cos * x + sin * y, cos * y - sin * x])

    def gaps(self, touch: Touch, poses: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """How far the tip is from touching (m,), negative inside, and the normal on the table there (m,)."""
        point = self.seen(poses, touch.centre)
        away = point[:, None] - self.ring.nearest(point)
        distance = np.hypot(away[..., 0], away[..., 1])
        edge = np.argmin(distance, axis=1)
        row = np.arange(len(poses))
        x, y = away[row, edge].T
        sign = np.where(shapely.contains_xy(self.polygon, point), -1.0, 1.0)
        normal = np.where(
            distance[row, edge] > ROUNDING, np.arctan2(sign * y, sign * x), self.ring.normal[edge]
        )
        return sign * distance[row, edge] - touch.radius_mm, normal + poses[:, 2]

    def residuals(self, touches: Sequence[Touch], poses: np.ndarray) -> np.ndarray:
        """Errors (m, 2 k): gap by its bound, then normal by half of its range, of every touch."""
        found = []
        for touch in touches:
            gap, normal = self.gaps(touch, poses)
            found += [gap / touch.bound_mm, angle_between(normal - touch.middle_rad) / touch.half_rad]
        return np.column_stack(found)

    def satisfied(self, touches: Sequence[Touch], poses: np.ndarray) -> np.ndarray:
        """Which poses satisfy all touches and their ways there: (m,)."""
        held = np.ones(len(poses), dtype=bool)
        for touch in touches:
            at = np.flatnonzero(held)
            held[at] &= self._touched(touch, poses[at])
            at = np.flatnonzero(held)
            held[at] &= self._free(touch, poses[at])
        return held

    def _touched(self, touch: Touch, poses: np.ndarray) -> np.ndarray:
        """Whether some edge is as near as it must be, with a normal that is allowed, and none is nearer.

        Round a vertex the true tip's normal may differ by asin(bound / radius) from the stated one's.
        """
        point = self.seen(poses, touch.centre)
        away = point[:, None] - self.ring.nearest(point)
        distance = np.hypot(away[..., 0], away[..., 1])
        deep = distance.min(axis=1) < touch.radius_mm - touch.bound_mm - ROUNDING
        inside = shapely.contains_xy(self.polygon, point) & (distance.min(axis=1) > touch.bound_mm)
        if touch.radius_mm > 0:
            normal = np.arctan2(away[..., 1], away[..., 0])
            slack = np.arcsin(min(1.0, touch.bound_mm / touch.radius_mm))
        else:
            normal, slack = np.broadcast_to(self.ring.normal, distance.shape), 0.0
        turn = angle_between(normal + poses[:, 2:] - touch.middle_rad)
        near = distance <= touch.radius_mm + touch.bound_mm + ROUNDING
        allowed = near & (np.abs(turn) <= touch.half_rad + slack + ROUNDING)
        return ~deep & ~inside & allowed.any(axis=1)

    def _free(self, touch: Touch, poses: np.ndarray) -> np.ndarray:
        """Whether the tip could come along its way."""
        ends = [self.seen(poses, np.array(point)) for point in (touch.start_mm, touch.centre_mm)]
        ways = shapely.linestrings(np.stack(ends, axis=1))
        reach = touch.radius_mm - touch.bound_mm - ROUNDING
        if reach > 0:
            return shapely.distance(self.polygon, ways) >= reach
        return shapely.length(shapely.intersection(self.polygon, ways)) <= 4 * touch.bound_mm

    def on_manifold(self, touch: Touch, ring: Ring, rng: np.random.Generator, count: int) -> np.ndarray:
        """Poses (count, 3) that satisfy one touch: anywhere on the grown outline, within all its bounds."""
        edge = rng.choice(len(ring.length), count, p=ring.length / ring.length.sum())
        part = rng.random(count)[:, None]
        point = ring.begin[edge] * (1 - part) + ring.end[edge] * part
        theta = touch.middle_rad + rng.uniform(-1, 1, count) * touch.half_rad - ring.normal[edge]
        away, bearing = touch.bound_mm * np.sqrt(rng.random(count)), rng.uniform(0, 2 * np.pi, count)
        cos, sin = np.cos(theta), np.sin(theta)
        x = touch.centre_mm[0] + away * np.cos(bearing) - cos * point[:, 0] + sin * point[:, 1]
        y = touch.centre_mm[1] + away * np.sin(bearing) - sin * point[:, 0] - cos * point[:, 1]
        return np.column_stack([x, y, theta])


def distinct(name: str, poses: np.ndarray) -> list[Answer]:
    """One answer for all poses (m, 3) that are alike: within 5 mm and 5° of the first."""
    found: list[Answer] = []
    while len(poses):
        first = poses[0]
        x, y, theta = (float(value) for value in first)
        found.append(Answer(name, (x, y, angle_between(theta))))
        near = np.hypot(*(poses[:, :2] - first[:2]).T) <= ALIKE_MM
        near &= np.abs(angle_between(poses[:, 2] - first[2])) <= ALIKE_RAD
        poses = poses[~near]
    return found
