"""Solids of revolution: faceted approximations are rebuilt so that they are uniform around the axis.

CAD kernels triangulate a surface of revolution irregularly, so that a cone has as many different lying
states as facets. Here the profile, the curve that is turned about the axis, is read from the vertices and
turned in equal steps: lying states are then exactly congruent, and become one. How far the new surface is
from the old one, both ways, is proven like the congruence of two states, piece by piece.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import reduce
from typing import Any

import numpy as np
import shapely

from palpate.base.geometry import Floats, Ints
from palpate.base.geometry.outlines import oriented_rings_of
from palpate.cad.parts import RotationalSymmetry, Solid, StableState
from palpate.cad.resting_surface import resting_surface_of, slice_surface
from palpate.cad.solid_symmetries import (
    axis_directions,
    axis_frame,
    far_azimuths,
    prove_symmetry,
    vertex_permutations,
)
from palpate.cad.stable_states import centre_of_mass, volume_mm3
from palpate.cad.surface_congruence import SurfaceDistance, surface_distance_bound_mm

_FEWEST_SIDES = 24
_FEWEST_STEPS, _MOST_STEPS = 48, 320
"""Steps of the turn about the axis, and of a ball's profile; multiples of four."""
_STEP_SHARE, _BALL_SHARE, _PROFILE_SHARE = 0.3, 0.3, 0.12
"""Of the distance allowed: for the steps of the turn, and for points of the profile that are left out."""
_SAME_POINT_SHARE = 1e-5
"""Share of the size: vertices so near to each other in the profile are one, and so near to the axis on it."""
_MOST_VERTICES, _MOST_PROFILE_POINTS = 8000, 400
"""Different ones, and those that a profile keeps; more of them belong to a rough surface."""
_STEP_ROUNDING_SHARE = 1e-12
"""Share of the size: what equal steps differ by in numbers."""
_PROFILE_AZIMUTH_RAD = 0.7236
"""Of the half-plane in which the profile is read, rad; no corner is there, unless by chance."""


def solid_of_revolution(solid: Solid, within_mm: float, ball_within_mm: float = 0.0) -> Solid | None:
    """A solid of revolution in place of one that is nowhere further from it than a distance, or None.

    A ball may be further off, as it has no state else: each of its facets is one. Its `off_mm` counts that
    distance, too. What is alike all round as it is, but for rounding, keeps its facets; None for prisms,
    which have few sides.
    """
    ball = _ball(solid, within_mm, max(ball_within_mm, within_mm))
    if ball is not None:
        return ball
    for direction in axis_directions(solid):
        centre = fit_axis_point(solid, direction)
        frame = axis_frame(direction)
        points = (solid.vertices_mm - centre) @ frame.T
        profile = _profile(solid, points, within_mm)
        if profile is None:
            continue
        turned = vertex_permutations(points, len(far_azimuths(points)))
        if turned is not None:
            return _regularise(solid, points, turned, frame, centre) if len(turned) >= _FEWEST_SIDES else None
        number = steps_of_turn(max(float(ring[:, 0].max()) for ring in profile), within_mm * _STEP_SHARE)
        made = revolve(solid, profile, frame, centre, number)
        apart = surface_distance_bound_mm(SurfaceDistance(solid), SurfaceDistance(made), within_mm)
        if apart is not None:
            return replace(made, off_mm=solid.off_mm + apart)
    return None


def _ball(solid: Solid, within: float, shell: float) -> Solid | None:
    """A ball, in the middle of a shell that all of the surface is in, of twice `shell` thickness at most.

    `within`: for its facets.

    Two surfaces round one centre are apart by no more than their distances from it differ.
    """
    points = solid.vertices_mm
    # |p|² = 2 c·p + k for all points of a sphere.
    rows = np.column_stack([2 * points, np.ones(len(points))])
    centre: Floats = np.linalg.lstsq(rows, (points**2).sum(axis=1), rcond=None)[0][:3]
    least, most = _distances(solid, centre)
    is_round = len(points) >= _FEWEST_STEPS and most - least <= 2 * shell
    if not is_round or volume_mm3(solid) < 2 * np.pi / 3 * least**3:  # half a ball: the centre is inside
        return None
    number = steps_of_turn(most, within * _BALL_SHARE)
    polar = np.linspace(0.0, np.pi, number // 2 + 1)
    profile = (least + most) / 2 * np.column_stack([np.sin(polar), -np.cos(polar)])
    profile[[0, -1], 0] = 0.0
    made = revolve(solid, [profile], np.eye(3), centre, number)
    inner, outer = _distances(made, centre)
    return replace(made, off_mm=solid.off_mm + max(most - inner, outer - least))


def _distances(solid: Solid, centre: Floats) -> tuple[float, float]:
    """Least and greatest distance of a surface from a point."""
    surface = SurfaceDistance(solid)
    count = len(solid.faces)
    off = surface.off_mm(np.broadcast_to(centre, (count, 3)), np.arange(count))
    return float(off.min()), float(np.linalg.norm(solid.vertices_mm - centre, axis=1).max())


def fit_axis_point(solid: Solid, direction: Floats) -> Floats:
    """A point (3,) of the axis: the common centre of circles at the heights that have many vertices."""
    start = centre_of_mass(solid)
    frame = axis_frame(direction)
    points = (solid.vertices_mm - start) @ frame.T
    size = float(np.ptp(points, axis=0).max())
    radius = np.hypot(points[:, 0], points[:, 1])
    # Vertices of one circle have a height and, nearly, a distance from the axis in common.
    _, ring = np.unique(np.round(points[:, 2:] / (_SAME_POINT_SHARE * size)), axis=0, return_inverse=True)
    ring = ring.ravel()
    outer = np.zeros(int(ring.max()) + 1)
    np.maximum.at(outer, ring, radius)
    some = radius > 0.98 * outer[ring]
    count = np.bincount(ring[some], minlength=len(outer))
    some &= count[ring] >= 8
    if not some.any():
        return start
    _, ring = np.unique(ring[some], return_inverse=True)
    xy = points[some, :2]
    # |p|² = 2 c·p + k, one k for each circle: less the means of the circles.
    size_of = np.bincount(ring)
    less = [np.bincount(ring, column) / size_of for column in (*xy.T, (xy**2).sum(axis=1))]
    rows = 2 * (xy - np.column_stack(less[:2])[ring])
    there = np.linalg.lstsq(rows, (xy**2).sum(axis=1) - less[2][ring], rcond=None)[0]
    centre: Floats = start + there @ frame[:2]
    return centre


def _profile(solid: Solid, points: Floats, within: float) -> list[Floats] | None:
    """Lines (k, 2) of (distance from the axis, height), the solid on their left, closed or from axis to axis.

    `points` (n, 3): the vertices in the axis' frame. They lie on the profile, and are put in order by a cut
    through the solid in a half-plane, which passes them at most `within` away. None if it does not.
    """
    near = _SAME_POINT_SHARE * float(np.ptp(points, axis=0).max())
    cut = cut_half_plane(solid, points)
    flat = np.column_stack([np.hypot(points[:, 0], points[:, 1]), points[:, 2]])
    flat[flat[:, 0] < near, 0] = 0.0
    flat = flat[np.sort(np.unique(np.round(flat / near), axis=0, return_index=True)[1])]
    if not cut or len(flat) > _MOST_VERTICES:
        return None
    lines = np.array([shapely.LineString(line) for line in cut], dtype=object)
    off = shapely.distance(shapely.points(flat)[:, None], lines[None])
    if float(off.min(axis=1).max()) > within:
        return None
    own = [flat[off.argmin(axis=1) == number] for number in range(len(lines))]
    if any(len(ring) < 2 for ring in own):
        return None
    ordered = [_order_points(*item, near) for item in zip(own, lines, cut, strict=True)]
    simple = shapely.simplify(np.array(ordered, dtype=object), _PROFILE_SHARE * within)
    rings = [shapely.get_coordinates(line) for line in simple]
    few = all(3 <= len(ring) <= _MOST_PROFILE_POINTS for ring in rings)
    return rings if few and shapely.MultiLineString(rings).is_simple else None


def _order_points(own: Floats, line: Any, cut: Floats, near: float) -> Any:
    """The line through points (k, 2) in their order along another, which is closed as that is."""
    ring = own[np.argsort(shapely.line_locate_point(line, shapely.points(own)), kind="stable")]
    is_closed = bool((cut[0] == cut[-1]).all())
    return shapely.LineString(np.vstack([ring, ring[:1]]) if is_closed else _to_axis(ring, cut, near))


def _to_axis(ring: Floats, cut: Floats, near: float) -> Floats:
    """An open line (k, 2) with both ends on the axis, as those of the cut are: a disc has no vertex there."""
    ends = []
    for height, last in ((cut[0, 1], ring[0]), (cut[-1, 1], ring[-1])):
        level = abs(height - last[1]) < near
        ends.append([[0.0, last[1] if level else height]] if last[0] > 0.0 else np.zeros((0, 2)))
    return np.vstack([ends[0], ring, ends[1]])


def cut_half_plane(solid: Solid, points: Floats, azimuth_rad: float = _PROFILE_AZIMUTH_RAD) -> list[Floats]:
    """The solid cut by a half-plane from its axis: lines (k, 2), those that end on the axis open.

    `points` (n, 3): the vertices in the axis' frame.
    """
    size = float(np.ptp(points, axis=0).max())
    c, s = math.cos(azimuth_rad), math.sin(azimuth_rad)
    seen = np.array([[c, s, 0.0], [0.0, 0.0, 1.0], [s, -c, 0.0]])
    turned = replace(solid, vertices_mm=points)
    surface = resting_surface_of(turned, StableState("cut", seen, np.zeros(3), 0.0, 0.0, np.zeros((0, 2))))
    rings = [ring.points for ring in slice_surface(surface, 0.0) if len(ring.points) > 2]
    # Overlays of rings that touch themselves fail.
    regions = [shapely.make_valid(shapely.Polygon(ring)) for ring in rings]
    # Rings do not cross: what is in an odd number of them is solid.
    area = reduce(shapely.symmetric_difference, regions, shapely.Polygon())
    half = shapely.box(0.0, float(points[:, 2].min()) - size, 2 * size, float(points[:, 2].max()) + size)
    cut = oriented_rings_of(shapely.intersection(area, half))
    return [line for ring in cut for line in _off_axis(ring, _SAME_POINT_SHARE * size)]


def _off_axis(ring: Floats, near: float) -> list[Floats]:
    """A ring (k, 2) without its sides on the axis: one closed line, or open ones."""
    axis = ring[:, 0] <= near
    on = axis & np.roll(axis, -1)
    if not on.any():
        return [np.vstack([ring, ring[:1]])]
    first = int(np.flatnonzero(on)[-1]) + 1
    turned, cut = np.roll(ring, -first, axis=0), np.roll(on, -first)
    parts = np.split(turned, np.flatnonzero(cut) + 1)
    return [part for part in parts if len(part) > 1]


def steps_of_turn(radius_mm: float, within: float) -> int:
    """Steps of a turn whose chords are as far inside of a circle as corners are outside: no further."""
    half = math.acos(max(1 - 2 * within / max(radius_mm, 2 * within), 0.0))
    return 4 * math.ceil(min(max(math.pi / max(half, 1e-3), _FEWEST_STEPS), _MOST_STEPS) / 4)


def _regularise(solid: Solid, points: Floats, turned: Ints, frame: Floats, centre: Floats) -> Solid:
    """The solid with vertices exactly where turns bring them; `turned` (k, n): their numbers after k turns.

    A facet moves by no more than the vertex that moves most.
    """
    azimuth = 2 * np.pi * np.arange(len(turned)) / len(turned)
    c, s = np.cos(azimuth)[:, None], np.sin(azimuth)[:, None]
    x, y, z = np.moveaxis(points[turned], 2, 0)
    # Each vertex is the mean of those that it comes to, turned back.
    exact = np.stack([(c * x + s * y).mean(axis=0), (c * y - s * x).mean(axis=0), z.mean(axis=0)], axis=1)
    made = replace(solid, vertices_mm=exact @ frame + centre, axis=frame[2])
    moved = float(np.linalg.norm(exact - points, axis=1).max())
    symmetry = prove_symmetry(made, frame[2], len(turned))
    return replace(made, off_mm=solid.off_mm + moved, symmetry=symmetry)


def revolve(solid: Solid, profile: Sequence[Floats], frame: Floats, centre: Floats, number: int) -> Solid:
    """The profile turned about the axis in so many steps."""
    scale = 2 / (1 + math.cos(math.pi / number))
    azimuth = 2 * np.pi * np.arange(number) / number
    vertices: list[Floats] = []
    faces: list[Ints] = []
    for ring in profile:
        is_closed = bool((ring[0] == ring[-1]).all())
        line = ring[:-1] if is_closed else ring
        index, points = _ring_vertices(line, azimuth, scale, sum(map(len, vertices)))
        following = np.roll(index, -1, axis=0) if is_closed else index[1:]
        faces += _strips(index if is_closed else index[:-1], following)
        vertices.append(points)
    made = np.vstack(vertices) @ frame + centre
    size = float(np.linalg.norm(np.ptp(made, axis=0)))
    symmetry = RotationalSymmetry(frame[2], number, _STEP_ROUNDING_SHARE * size)
    return replace(solid, vertices_mm=made, faces=np.vstack(faces), axis=frame[2], symmetry=symmetry)


def _ring_vertices(line: Floats, azimuth: Floats, scale: float, first: int) -> tuple[Ints, Floats]:
    """Vertex numbers (k, n) of each point's circle, n times the same on the axis; the vertices (v, 3)."""
    index, points, count = [], [], first
    for radius, height in line.tolist():
        if radius == 0.0:
            index.append(np.full(len(azimuth), count))
            points.append(np.array([[0.0, 0.0, height]]))
        else:
            index.append(count + np.arange(len(azimuth)))
            circle = scale * radius * np.column_stack([np.cos(azimuth), np.sin(azimuth)])
            points.append(np.column_stack([circle, np.full(len(azimuth), height)]))
        count += len(points[-1])
    return np.array(index), np.vstack(points)


def _strips(here: Ints, there: Ints) -> list[Ints]:
    """Triangles between circles of vertex numbers (k, n) and the next ones; none without area."""
    result = []
    for one, other in zip(here, there, strict=True):
        after, other_after = np.roll(one, -1), np.roll(other, -1)
        if one[0] != after[0]:
            result.append(np.column_stack([one, after, other]))
        if other[0] != other_after[0]:
            result.append(np.column_stack([after, other_after, other]))
    return result
