"""Symmetries of a solid: its rotational order, orbits of its states, and products of known motions.

A solid has rotational symmetry of the order n if turns by 1/n about an axis bring it onto itself. Cylinders,
gears and bolts lie in as many congruent ways as their order; those ways are an orbit, of which one state is
compared with others. Further symmetries become known as states are compared. Their products need no search
and no proof of their own: two motions in a row are apart by no more than both together, because neither
changes distances, so from a few that are proven on the surface follow hundreds. Each is first made as exact
as the solid is, by bringing the vertices onto each other in the mean (Kabsch, A solution for the best
rotation to relate two sets of vectors, Acta Crystallographica A32, 1976).
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.spatial import cKDTree

from palpate.base.geometry import Floats, Ints
from palpate.cad.parts import RotationalSymmetry, Solid, StableState
from palpate.cad.stable_states import centre_of_mass
from palpate.cad.surface_congruence import SurfaceDistance, congruence_bound_mm, solid_congruence_bound_mm

_SAME_RADIUS_SHARE = 1e-5
"""Share of the size: vertices as far out as any, and at one height, are so nearly so."""
_VERTEX_SHARE = 1e-6
"""Share of the size: what the symmetry of a file's numbers is good for."""
_ROUNDING_SHARE = 1e-8
"""Share of the size that is rounding of our own."""
_LITTLE_SHARE = 0.1
"""Share of the distance that is allowed, below which a looser bound is as good."""
_PARALLEL_RAD = 1e-4
"""Directions that differ by less are one."""
_MOST_FACES, _MOST_ORDER = 20_000, 64
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
            apart = _symmetry_bound_mm(surface, centre, direction, order, within_mm)
            if apart is not None:
                best = RotationalSymmetry(direction, order, apart)
                break
    return solid if best is None else replace(solid, symmetry=best)


def _orders(azimuth: Floats, least: int) -> Iterator[int]:
    """Orders above the least by which turns bring azimuths (n,) onto each other, the highest first."""
    count = len(azimuth)
    gap = np.diff(azimuth, append=azimuth[:1] + 2 * math.pi)
    for order in range(min(count, _MOST_ORDER), least, -1):
        same = count % order == 0 and np.allclose(gap, np.roll(gap, count // order), atol=1e-3)
        if same:
            yield order


def _symmetry_bound_mm(
    surface: SurfaceDistance, centre: Floats, axis: Floats, order: int, within_mm: float
) -> float | None:
    """Distance of the surface from itself in every turn by a multiple of 1/order; None beyond bounds.

    Turned k times the surface is at most k times as far as turned once: where that is little, it will do.
    """
    frame, worst, most = axis_frame(axis), 0.0, order // 2  # a turn back is as far apart as one there
    for number in range(1, most + 1):
        rotation = frame.T @ _turn_about_z(2 * math.pi * number / order) @ frame
        apart = congruence_bound_mm(surface, rotation, centre - rotation @ centre, within_mm)
        if apart is None:
            return None
        if number == 1 and most * apart <= _LITTLE_SHARE * within_mm:
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
        if all(1 - abs(float(unit_one @ other)) > _PARALLEL_RAD**2 / 2 for other in seen):
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
    far = np.flatnonzero(radius > radius.max() - _SAME_RADIUS_SHARE * size)
    level = far[np.abs(points[far, 2] - points[far[0], 2]) < _SAME_RADIUS_SHARE * size]
    return np.sort(np.arctan2(points[level, 1], points[level, 0]))


def vertex_permutations(points: Floats, order: int) -> Ints | None:
    """Numbers (order, n) of the vertices that vertices (n, 3) come to in so many turns about the z axis.

    None if they do not come onto vertices.
    """
    if order < 3:
        return None
    off, number = cKDTree(points).query(points @ _turn_about_z(2 * math.pi / order).T)
    if np.max(off) > _VERTEX_SHARE * float(np.ptp(points, axis=0).max()):
        return None
    rows = [np.arange(len(points))]
    for _ in range(order):
        rows.append(np.asarray(number)[rows[-1]])
    whole: Ints = np.stack(rows[:-1])
    return whole if (rows[-1] == rows[0]).all() else None


def prove_symmetry(solid: Solid, axis: Floats, order: int) -> RotationalSymmetry | None:
    """The symmetry of a solid that one turn brings onto itself but for rounding, if that can be proven."""
    centre, frame = centre_of_mass(solid), axis_frame(axis)
    rotation = frame.T @ _turn_about_z(2 * math.pi / order) @ frame
    size = float(np.linalg.norm(np.ptp(solid.vertices_mm, axis=0)))
    apart = solid_congruence_bound_mm(solid, rotation, centre - rotation @ centre, _ROUNDING_SHARE * size)
    # Any multiple of the turn is at most half the order of them in a row, one way or the other.
    return None if apart is None else RotationalSymmetry(axis, order, order / 2 * apart)


def _turn_about_z(angle_rad: float) -> Floats:
    c, s = math.cos(angle_rad), math.sin(angle_rad)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


_UPRIGHT_RAD = 1e-5
"""Directions down that are so near after a turn, rad, are the same but for rounding."""
NEGLIGIBLE_SHARE = 0.1
"""Of the distance within which states are one: a symmetry that is so exact may make orbits."""


@dataclass(eq=False)
class Orbit:
    """States that turns make of the `first`, which is among them; none is further than `apart_mm` from it."""

    first: StableState
    members: list[StableState] = field(default_factory=list)
    apart_mm: float = 0.0


def orbits_of(solid: Solid, states: Sequence[StableState], within_mm: float) -> list[Orbit]:
    """States by orbits, in their order; each by itself where no symmetry is known, or is exact enough."""
    symmetry = solid.symmetry
    if symmetry is None:
        return [Orbit(state, [state]) for state in states]
    size = float(np.linalg.norm(np.ptp(solid.vertices_mm, axis=0)))
    if symmetry.apart_mm + _UPRIGHT_RAD * size > NEGLIGIBLE_SHARE * within_mm:
        return [Orbit(state, [state]) for state in states]
    frame, turn = axis_frame(symmetry.axis), 2 * math.pi / symmetry.order
    found: list[Orbit] = []
    polar, azimuth = np.zeros(0), np.zeros(0)
    for state in states:
        x, y, z = -frame @ state.rotation[2]
        its_polar, its_azimuth = math.atan2(math.hypot(x, y), z), math.atan2(y, x)
        beyond = np.abs((azimuth - its_azimuth + turn / 2) % turn - turn / 2)
        tilt = np.hypot(polar - its_polar, math.sin(its_polar) * beyond)
        same = np.flatnonzero(tilt <= _UPRIGHT_RAD)
        if len(same):
            orbit = found[int(same[0])]
            orbit.members.append(state)
            off = symmetry.apart_mm + float(tilt[same[0]]) * size
            orbit.apart_mm = max(orbit.apart_mm, off)
        else:
            found.append(Orbit(state, [state]))
            polar, azimuth = np.append(polar, its_polar), np.append(azimuth, its_azimuth)
    return found


_MOST_KNOWN = 128
"""So many are kept as they come, later on only those that two others in a row do not make."""
_EXACT_SHARE = 1e-8
"""Share of the size: a symmetry that is nearer need not be made more exact."""
_LEAST_VERTEX_PAIRS = 4


@dataclass(frozen=True, eq=False)
class SolidSymmetry:
    """A motion in the file's frame that brings the solid onto itself within `apart_mm`.

    A vertex v goes to `rotation` (3, 3) @ v + `shift_mm` (3,).
    """

    rotation: Floats
    shift_mm: Floats
    apart_mm: float

    def then(self, after: "SolidSymmetry") -> "SolidSymmetry":
        """Both in a row, this one first."""
        return SolidSymmetry(
            after.rotation @ self.rotation,
            after.rotation @ self.shift_mm + after.shift_mm,
            after.apart_mm + self.apart_mm,
        )

    def back(self) -> "SolidSymmetry":
        """The inverse."""
        turned = self.rotation.T
        return SolidSymmetry(turned, -turned @ self.shift_mm, self.apart_mm)


class KnownSymmetries:
    """Symmetries of one `surface` that are known so far, each with its inverse."""

    def __init__(self, surface: SurfaceDistance) -> None:
        self.surface = surface
        self._known = [SolidSymmetry(np.eye(3), np.zeros(3), 0.0)]

    def proven(self, rotation: Floats, shift_mm: Floats, apart_mm: float) -> None:
        """Remember a motion that the surface was found to allow."""
        found = SolidSymmetry(rotation, shift_mm, apart_mm)
        self._keep(found if apart_mm <= _EXACT_SHARE * self.surface.size_mm else self._exact(found))

    def remember(self, found: SolidSymmetry) -> None:
        """One that others made, unless many are known."""
        if len(self._known) < _MOST_KNOWN:
            self._keep(found)

    def _keep(self, found: SolidSymmetry) -> None:
        self._known += [found, found.back()]

    def taking(self, one: Floats, other: Floats, within_rad: float) -> SolidSymmetry | None:
        """The one, or two in a row, that takes a direction (3,) most nearly to another; None if beyond.

        Of such as do so equally well one that is as little apart as can be.
        """
        if len(self._known) == 1:
            return None
        turns = np.array([item.rotation for item in self._known])
        apart = np.array([item.apart_mm for item in self._known])
        # The first takes the one to where the second takes the other back to.
        first, second = turns @ one, other @ turns
        tilt = np.linalg.norm(first - second[:, None], axis=2)
        off = tilt * self.surface.size_mm + apart + apart[:, None]
        after, before = np.unravel_index(int(off.argmin()), off.shape)
        if tilt[after, before] > within_rad:
            return None
        return self._known[before].then(self._known[after])

    def _exact(self, found: SolidSymmetry) -> SolidSymmetry:
        """The motion that brings vertices best onto those that they come near to, if that is proven."""
        surface = self.surface
        points = surface.vertices_mm @ found.rotation.T + found.shift_mm
        off, vertex = surface.vertex_tree.query(points, distance_upper_bound=2 * found.apart_mm)
        near = np.isfinite(off)
        if near.sum() < _LEAST_VERTEX_PAIRS:
            return found
        here, there = surface.vertices_mm[near], surface.vertices_mm[np.asarray(vertex)[near]]
        middle, its = here.mean(axis=0), there.mean(axis=0)
        u, _, v = np.linalg.svd((here - middle).T @ (there - its))
        proper = np.diag([1.0, 1.0, np.linalg.det(u) * np.linalg.det(v)])
        rotation = v.T @ proper @ u.T
        shift = its - rotation @ middle
        apart = congruence_bound_mm(surface, rotation, shift, found.apart_mm)
        return found if apart is None else SolidSymmetry(rotation, shift, apart)
