"""Lost cones: conical faces that a tessellation left out are put back.

OpenCASCADE cuts no triangles of some chamfers and tips of drilled holes, which leaves holes in a surface that
is closed. The cone itself is known. Each hole whose edge lies on a cone is covered by triangles with their
corners on that cone: a fan to its apex, a band between two circles, or the hole unrolled into the plane.

A triangle whose corners are on a cone of radius r, within a sector of angle δ about its axis, is within
r · (1 − cos(δ/2)) of it: at each height, r is linear in the corners as the triangle is, and so is the
projection on the sector's middle, which is at least r · cos(δ/2).
"""

import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import shapely

from palpate.base.geometry import Floats, Ints
from palpate.cad.mesh_mending import Mesh, open_loops

_ON_CONE_MM = 1e-3
"""How far corners of a hole may be off a cone that closes it; rounding of single precision included."""


_SAME_RAD = 1e-5
"""Angles that differ by less are the same."""

_ENTITY = re.compile(
    rb"#(\d+)\s*=\s*(CONICAL_SURFACE|AXIS2_PLACEMENT_3D|CARTESIAN_POINT|DIRECTION)\s*"
    rb"\(\s*'(?:[^']|'')*'\s*,\s*([^;]*)\)\s*;"
)


@dataclass(frozen=True, eq=False)
class Cone:
    """A double cone: `apex_mm` (3,), unit vector `axis` (3,), and the angle (rad) from it to the surface."""

    apex_mm: Floats
    axis: Floats
    half_angle_rad: float

    def move(self, matrix: Floats) -> "Cone":
        """The cone after a rigid motion (4, 4), in mm."""
        rotation, offset = matrix[:3, :3], matrix[:3, 3]
        return Cone(rotation @ self.apex_mm + offset, rotation @ self.axis, self.half_angle_rad)

    def is_like(self, other: "Cone") -> bool:
        """Whether another one is the same surface."""
        return bool(
            np.abs(self.apex_mm - other.apex_mm).max() <= _ON_CONE_MM
            and np.linalg.norm(np.cross(self.axis, other.axis)) <= _SAME_RAD
            and abs(self.half_angle_rad - other.half_angle_rad) <= _SAME_RAD
        )


@dataclass(frozen=True, eq=False)
class _Edge:
    """The edge of a hole on a cone: vertices (k,), in the order in which triangles of the hole run.

    `turn_rad` (k,): about the axis, without jumps; `along_mm` (k,): from the apex along the axis. `windings`:
    how often the edge goes round the axis.
    """

    vertices: Ints
    turn_rad: Floats
    along_mm: Floats
    windings: int


def cones_in(step: bytes, unit_mm: float) -> list[Cone]:
    """Conical surfaces of a STEP file (ISO 10303-42), each in the frame of its shape.

    An angle that could be one in radians or in degrees gives two: only what a hole fits is ever used.
    """
    entity = {number: (kind, value) for number, kind, value in _ENTITY.findall(step)}
    found = []
    for kind, value in entity.values():
        if kind != b"CONICAL_SURFACE":
            continue
        try:
            place, radius, angle = value.split(b",")
            origin, axis, *_ = (item.strip() for item in entity[place.strip()[1:]][1].split(b","))
            found += _cones(
                unit_mm * _vector(entity[origin[1:]][1]),
                np.array([0.0, 0.0, 1.0]) if axis == b"$" else _vector(entity[axis[1:]][1]),
                unit_mm * float(radius),
                float(angle),
            )
        except (KeyError, ValueError):
            continue  # not written as the standard has it
    return found


def _vector(text: bytes) -> Floats:
    return np.array([float(part) for part in text.strip(b"() \r\n\t").split(b",")]).reshape(3)


def _cones(origin_mm: Floats, axis: Floats, radius_mm: float, angle: float) -> list[Cone]:
    """Cones with a radius at their origin that grows along the axis, of an angle in either unit."""
    unit = axis / np.linalg.norm(axis)
    halves = [half for half in (angle, math.radians(angle)) if _SAME_RAD < half < math.pi / 2 - _SAME_RAD]
    return [Cone(origin_mm - unit * radius_mm / math.tan(half), unit, half) for half in halves]


def close_cones(mesh: Mesh, cones: Sequence[Cone]) -> tuple[Mesh, float]:
    """The surface with all holes covered that lie on a cone, and how far (mm) that is off the cones."""
    vertices, faces = mesh
    loops = open_loops(faces) if cones else []
    off = 0.0
    for cone, near in _candidates(vertices, loops, cones):
        edges = [edge for loop in near if (edge := _edge_on(vertices, loop, cone)) is not None]
        for group in _groups(edges):
            points, more = _cover(group, cone, len(vertices))
            if more is not None:
                vertices, faces = np.vstack([vertices, points]), np.vstack([faces, more])
                off = max(off, _ON_CONE_MM + _deviation_mm(vertices[more], cone))
    return (vertices, faces), off


def _candidates(
    vertices: Floats, loops: Sequence[Ints], cones: Sequence[Cone]
) -> Iterator[tuple[Cone, list[Ints]]]:
    """Cones with the holes that they may close; a hole is of the first cone on which two corners lie."""
    if not loops:
        return
    corners = vertices[[[loop[0], loop[len(loop) // 3]] for loop in loops]]
    left = np.ones(len(loops), dtype=bool)
    for cone in cones:
        near = left & (_off_mm(cone, corners) <= _ON_CONE_MM).all(axis=1)
        left &= ~near
        if near.any():
            yield cone, [loop for loop, on in zip(loops, near.tolist(), strict=True) if on]


def _off_mm(cone: Cone, points: Floats) -> Floats:
    """How far points (…, 3) are off a cone."""
    away = points - cone.apex_mm
    along = away @ cone.axis
    radius = np.sqrt(np.maximum((away**2).sum(axis=-1) - along**2, 0.0))
    off = np.abs(radius * math.cos(cone.half_angle_rad) - np.abs(along) * math.sin(cone.half_angle_rad))
    return np.asarray(off)


def _frame(cone: Cone) -> Floats:
    """Rotation (3, 3) that brings the axis to z."""
    aside = np.eye(3)[int(np.abs(cone.axis).argmin())]
    x = np.cross(aside, cone.axis)
    x /= np.linalg.norm(x)
    return np.array([x, np.cross(cone.axis, x), cone.axis])


def _edge_on(vertices: Floats, loop: Ints, cone: Cone) -> _Edge | None:
    """The edge of a hole, if all of it lies on a cone, on one side of its apex."""
    x, y, along = _frame(cone) @ (vertices[loop] - cone.apex_mm).T
    radius = np.hypot(x, y)
    if (
        _off_mm(cone, vertices[loop]).max() > _ON_CONE_MM
        or radius.min() <= _ON_CONE_MM
        or along.min() * along.max() <= 0
    ):
        return None
    turn = np.unwrap(np.append(np.arctan2(y, x), math.atan2(y[0], x[0])))
    return _Edge(loop, turn[:-1], along, round((turn[-1] - turn[0]) / math.tau))


def _groups(edges: Sequence[_Edge]) -> list[tuple[_Edge, ...]]:
    """Edges of one hole each: two that go round the axis, in opposite directions, next to one another."""
    around = sorted(
        (edge for edge in edges if abs(edge.windings) == 1), key=lambda edge: edge.along_mm.mean()
    )
    found: list[tuple[_Edge, ...]] = [(edge,) for edge in edges if edge.windings == 0]
    while around:
        first = around.pop(0)
        if around and around[0].windings == -first.windings and around[0].along_mm[0] * first.along_mm[0] > 0:
            found.append((first, around.pop(0)))
        else:
            found.append((first,))
    return found


def _cover(edges: tuple[_Edge, ...], cone: Cone, count: int) -> tuple[Floats, Ints | None]:
    """New vertices (k, 3), numbered from `count` on, and triangles of a hole; None: of another kind."""
    none = np.zeros((0, 3))
    if len(edges) == 2:
        return none, _band(*edges)
    (edge,) = edges
    if edge.windings == 0:
        return none, _unroll(edge, cone)
    if not _is_monotone(edge):
        return none, None
    ahead = np.roll(edge.vertices, -1)
    return cone.apex_mm[None], np.column_stack([edge.vertices, ahead, np.full(len(ahead), count)])


def _is_monotone(edge: _Edge) -> bool:
    steps = np.diff(np.append(edge.turn_rad, edge.turn_rad[0] + edge.windings * math.tau))
    return bool((steps * edge.windings > 0).all())


def _band(one: _Edge, other: _Edge) -> Ints | None:
    """Triangles between two circles, in the order of the angles of their corners."""
    if not (_is_monotone(one) and _is_monotone(other)):
        return None
    forward, back = (one, other) if one.windings > 0 else (other, one)
    first, second = _from_zero(forward.vertices, forward.turn_rad), _from_zero(back.vertices, back.turn_rad)
    (a, a_turn), (b, b_turn) = first, second
    triangles, i, j = [], 0, 0
    while i < len(a) - 1 or j < len(b) - 1:
        if j == len(b) - 1 or (i < len(a) - 1 and a_turn[i + 1] <= b_turn[j + 1]):
            triangles.append((a[i], a[i + 1], b[j]))
            i += 1
        else:
            triangles.append((a[i], b[j + 1], b[j]))
            j += 1
    return np.array(triangles, dtype=np.int64)


def _from_zero(vertices: Ints, turn_rad: Floats) -> tuple[list[int], list[float]]:
    """Vertices by their angle, the first one again at the end, a turn later."""
    angle = np.mod(turn_rad, math.tau)
    order = np.argsort(angle, kind="stable")
    ring, turned = vertices[order].tolist(), angle[order].tolist()
    return [*ring, ring[0]], [*turned, turned[0] + math.tau]


def _unroll(edge: _Edge, cone: Cone) -> Ints | None:
    """Triangles of a hole that does not go round the axis: a cone unrolls into the plane."""
    slant = np.abs(edge.along_mm) / math.cos(cone.half_angle_rad)
    angle = edge.turn_rad * math.sin(cone.half_angle_rad)
    if np.ptp(angle) >= math.pi:
        return None
    flat = np.column_stack([slant * np.cos(angle), slant * np.sin(angle)])
    polygon = shapely.Polygon(flat)
    if not polygon.is_valid:
        return None
    number = {tuple(point): int(vertex) for point, vertex in zip(flat.tolist(), edge.vertices, strict=True)}
    parts = shapely.get_parts(shapely.constrained_delaunay_triangles(polygon))
    corners = shapely.get_coordinates(parts).reshape(-1, 4, 2)[:, :3]
    triangles = np.array([[number[tuple(point)] for point in three] for three in corners.tolist()])
    (ax, ay), (bx, by) = ((corners[:, k] - corners[:, 0]).T for k in (1, 2))
    turned = (ax * by < ay * bx) == polygon.exterior.is_ccw
    triangles[turned] = triangles[turned][:, ::-1]
    return triangles


def _deviation_mm(corners: Floats, cone: Cone) -> float:
    """How far triangles (m, 3, 3) with corners on the cone are off it, at most."""
    x, y, _ = np.moveaxis((corners - cone.apex_mm) @ _frame(cone).T, 2, 0)
    radius, turn = np.hypot(x, y), np.arctan2(y, x)
    away = np.where(radius > _ON_CONE_MM, 1.0, 0.0)  # an apex is in every sector
    apart = np.abs(np.remainder(turn - np.roll(turn, 1, axis=1) + math.pi, math.tau) - math.pi)
    sector = (apart * away * np.roll(away, 1, axis=1)).max(axis=1)
    return float((radius.max(axis=1) * (1 - np.cos(sector / 2))).max())
