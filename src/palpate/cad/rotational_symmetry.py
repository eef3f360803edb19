"""Rotational symmetry of a solid: of the order n, if turns by 1/n about an axis bring it onto itself.

Cylinders, gears and bolts lie in as many congruent ways as their order: knowing that beforehand spares
comparing them one by one.
"""

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from palpate.base.geometry import Floats, Ints
from palpate.cad.congruence import surface_apart_between_mm, surface_apart_mm
from palpate.cad.hull import centre_of_mass
from palpate.cad.surface_distance import SurfaceDistance
from palpate.cad.values import RotationalSymmetry, Solid

__all__ = [
    "axis_directions",
    "axis_frame",
    "far_azimuths",
    "proven_symmetry",
    "turned_onto_itself",
    "with_symmetry",
]

_SAME = 1e-5
"""Share of the size: vertices as far out as any, and at one height, are so nearly so."""
_EXACT = 1e-6
"""Share of the size: what the symmetry of a file's numbers is good for."""
_ROUNDING = 1e-8
"""Share of the size that is rounding of our own."""
_LITTLE = 0.1
"""Share of the distance that is allowed, below which a looser bound is as good."""
_PARALLEL = 1e-4
"""Directions that differ by less are one."""
_MOST_FACES, _MOST_PROVEN = 20_000, 64
"""Solids of more facets, and symmetries of which more turns would have to be proven, are not looked at."""


def with_symmetry(solid: Solid, within_mm: float) -> Solid:
    """The solid with the rotational symmetry of the highest order that can be proven within a distance."""
    if len(solid.faces) > _MOST_FACES:
        return solid
    surface, centre = SurfaceDistance(solid), centre_of_mass(solid)
    best: RotationalSymmetry | None = None
    for direction in axis_directions(solid):
        azimuth = far_azimuths((solid.vertices_mm - centre) @ axis_frame(direction).T)
        for order in _orders(azimuth, 1 if best is None else best.order):
            apart = _apart_mm(surface, centre, direction, order, within_mm)
            if apart is not None:
                best = RotationalSymmetry(direction, order, apart)
                break
    return solid if best is None else replace(solid, symmetry=best)


def _orders(azimuth: Floats, least: int) -> Iterator[int]:
    """Orders above the least by which turns bring azimuths (n,) onto each other, the highest first."""
    count = len(azimuth)
    gap = np.diff(azimuth, append=azimuth[:1] + 2 * math.pi)
    for order in range(min(count, _MOST_PROVEN), least, -1):
        same = count % order == 0 and np.allclose(gap, np.roll(gap, count // order), atol=1e-3)
        if same:
            yield order


def _apart_mm(
    surface: SurfaceDistance, centre: Floats, axis: Floats, order: int, within_mm: float
) -> float | None:
    """How far the surface is from itself in every turn by a multiple of 1/order; None if that is too far.

    Turned k times the surface is at most k times as far as turned once: where that is little, it will do.
    """
    frame, worst, most = axis_frame(axis), 0.0, order // 2  # a turn back is as far apart as one there
    for number in range(1, most + 1):
        rotation = frame.T @ _turn(2 * math.pi * number / order) @ frame
        apart = surface_apart_between_mm(surface, rotation, centre - rotation @ centre, within_mm)
        if apart is None:
            return None
        if number == 1 and most * apart <= _LITTLE * within_mm:
            return most * apart
        worst = max(worst, apart)
    return worst


def axis_directions(solid: Solid) -> Iterator[Floats]:
    """Directions (3,) that an axis may have: the file's, those of the largest faces, those of inertia."""
    corners = solid.vertices_mm[solid.faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(normal, axis=1)
    unit = normal / np.maximum(area, 1e-300)[:, None]
    keys, group = np.unique(np.round(unit, 4), axis=0, return_inverse=True)
    largest = np.argsort(-np.bincount(group.ravel(), area, len(keys)))[:2]
    flat = [np.average(unit[group.ravel() == k], axis=0, weights=area[group.ravel() == k]) for k in largest]
    middle = corners.mean(axis=1) - np.average(corners.mean(axis=1), axis=0, weights=area)
    inertia = np.linalg.eigh((middle * area[:, None]).T @ middle)[1].T
    seen: list[Floats] = []
    for direction in (*np.eye(3), *flat, *inertia):
        unit_one = direction / np.linalg.norm(direction)
        if all(1 - abs(float(unit_one @ other)) > _PARALLEL**2 / 2 for other in seen):
            seen.append(unit_one)
            yield unit_one


def axis_frame(direction: Floats) -> Floats:
    """A rotation (3, 3) whose last row is a direction."""
    aside = np.eye(3)[int(np.abs(direction).argmin())]
    x = np.cross(aside, direction)
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(direction, x), direction])


def far_azimuths(points: Floats) -> Floats:
    """Azimuths (n,) of the vertices furthest from the z axis, of those at one height; ascending, rad."""
    size = float(np.ptp(points, axis=0).max())
    radius = np.hypot(points[:, 0], points[:, 1])
    far = np.flatnonzero(radius > radius.max() - _SAME * size)
    level = far[np.abs(points[far, 2] - points[far[0], 2]) < _SAME * size]
    return np.sort(np.arctan2(points[level, 1], points[level, 0]))


def turned_onto_itself(points: Floats, order: int) -> Ints | None:
    """Numbers (order, n) of the vertices that vertices (n, 3) come to in so many turns about the z axis.

    None if they do not come onto vertices.
    """
    if order < 3:
        return None
    off, number = cKDTree(points).query(points @ _turn(2 * math.pi / order).T)
    if np.max(off) > _EXACT * float(np.ptp(points, axis=0).max()):
        return None
    rows = [np.arange(len(points))]
    for _ in range(order):
        rows.append(np.asarray(number)[rows[-1]])
    whole: Ints = np.stack(rows[:-1])
    return whole if (rows[-1] == rows[0]).all() else None


def proven_symmetry(solid: Solid, axis: Floats, order: int) -> RotationalSymmetry | None:
    """The symmetry of a solid that one turn brings onto itself but for rounding, if that can be proven."""
    centre, frame = centre_of_mass(solid), axis_frame(axis)
    rotation = frame.T @ _turn(2 * math.pi / order) @ frame
    size = float(np.linalg.norm(np.ptp(solid.vertices_mm, axis=0)))
    apart = surface_apart_mm(solid, rotation, centre - rotation @ centre, _ROUNDING * size)
    # Any multiple of the turn is at most half the order of them in a row, one way or the other.
    return None if apart is None else RotationalSymmetry(axis, order, order / 2 * apart)


def _turn(angle_rad: float) -> Floats:
    c, s = math.cos(angle_rad), math.sin(angle_rad)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
