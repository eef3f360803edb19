"""Rotational symmetry of a state, from all of its sections together (memo §2.1 and Fig. 4).

A turn by 2π/n that moves the boundary onto itself within a tolerance proves little: k such turns may be off
by k times as much, and an oval of many vertices passes for round. So the whole orbit of every vertex is
compared. The turn maps vertices onto vertices and keeps neighbours neighbours. Turned back by 2πk/n, the
k-th vertex of an orbit lies where the first one does, if the symmetry is exact. The points of an orbit that
are turned back so have some diameter. The turn by 2π(j − k)/n moves the k-th vertex to within that diameter
of the j-th, for every j and k, so the largest of all orbits' diameters bounds what every power of the turn is
off by: for vertices, and hence for the edges between them.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
import shapely
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from palpate.base.geometry import Complexes, Floats, Ints, Polygon, Section, State
from palpate.base.geometry.outlines import EdgeRings, oriented_rings_of, region_of

_STRAIGHT_MM = 1e-8  # a vertex nearer than this to its neighbours' line is none
_ROUNDING_MM = 1e-11
_WIDTH_DIRECTIONS = 32  # directions in which an orbit's width is taken


@dataclass(frozen=True)
class Symmetry:
    """A state looks the same after each nth of a turn, n = `order`; 1: it has no symmetry.

    After any number of these turns no point of a boundary is further than `off_mm` from where the boundary
    was, and its normal differs by at most `lean_rad`.
    """

    order: int = 1
    off_mm: float = 0.0
    lean_rad: float = 0.0


def centroid(state: State) -> Floats:
    """Centre of area of all sections together, shape (2,), mm, in the frame of the object's file."""
    shapes = [region_of(section.polygons) for section in state.sections]
    areas = np.array([shape.area for shape in shapes])
    centres = np.array([[shape.centroid.x, shape.centroid.y] for shape in shapes])
    result: Floats = areas @ centres / areas.sum()
    return result


def rotational_symmetry(state: State, about: Floats, tolerance_mm: float) -> Symmetry:
    """Largest n such that no multiple of 2π/n about `about` moves a boundary further than the tolerance."""
    boundaries = [_Boundary.of(section, about) for section in state.sections]
    # No vertex is at the centre: every orbit has n vertices.
    most = math.gcd(*[len(boundary.points) for boundary in boundaries])
    for order in range(most, 1, -1):
        if most % order:
            continue
        found = _of_order(boundaries, order, tolerance_mm)
        if found is not None:
            return found
    return Symmetry()


def symmetrise(state: State, about: Floats, order: int, tolerance_mm: float) -> State | None:
    """The state with every orbit of vertices replaced by the regular one at its mean; vertices keep numbers.

    Each vertex is moved by less than the symmetry's `off_mm`. None where vertices of the sections are not
    those of their unions: where polygons overlap, and where some lie on a straight line.
    """
    sections = []
    for section in state.sections:
        boundary = _Boundary.of(section, about)
        points = np.vstack([ring - about for ring in section.rings])
        away, number = boundary.tree.query(points)
        orbits = boundary.orbits(order, tolerance_mm)
        if orbits is None or len(points) != len(boundary.points) or float(np.max(away)) > 0:
            return None
        turns = np.exp(2j * np.pi * np.arange(order) / order)[:, None]
        mean = np.mean(boundary.points[orbits] / turns, axis=0)
        regular = np.empty_like(boundary.points)
        regular[orbits] = mean * turns
        moved = iter(np.column_stack([regular.real, regular.imag])[number] + about)
        polygons = [
            [np.array([next(moved) for _ in ring]) for ring in polygon.rings] for polygon in section.polygons
        ]
        sections.append(
            replace(section, polygons=tuple(Polygon(outer, tuple(holes)) for outer, *holes in polygons))
        )
    return replace(state, sections=tuple(sections))


def _of_order(boundaries: "list[_Boundary]", order: int, tolerance_mm: float) -> Symmetry | None:
    off_mm = lean_rad = 0.0
    for boundary in boundaries:
        orbits = boundary.orbits(order, tolerance_mm)
        if orbits is None:
            return None
        off, lean = boundary.spread(orbits)
        off_mm, lean_rad = max(off_mm, off), max(lean_rad, lean)
        if off_mm > tolerance_mm:
            return None
    return Symmetry(order, off_mm, lean_rad)


@dataclass(frozen=True, eq=False)
class _Boundary:
    """A section's vertices (N,) about the centre of its possible symmetry, as complex numbers, mm.

    Edge k runs to vertex `following`[k] (N,), the solid on its left. `stray_mm`: how far the boundary may be
    from that of the section; `stray_rad`: the same for its normal.
    """

    points: Complexes
    following: Ints
    tree: cKDTree
    stray_mm: float
    stray_rad: float

    @classmethod
    def of(cls, section: Section, about: Floats) -> "_Boundary":
        whole = region_of(section.polygons)
        region = whole.simplify(_STRAIGHT_MM)
        edges = EdgeRings.of([ring - about for ring in oriented_rings_of(region)])
        points = edges.start
        stray_mm, stray_rad = _stray(whole, region)
        return cls(points[:, 0] + 1j * points[:, 1], edges.following, cKDTree(points), stray_mm, stray_rad)

    def orbits(self, order: int, tolerance_mm: float) -> Ints | None:
        """The vertices, (order, N / order): turned by 2π/order, each row comes to lie on the next.

        None if vertices or edges do not come to lie on others within the tolerance, or not one on each.
        """
        image = self.points * np.exp(2j * np.pi / order)
        # The furthest vertex settles nearly every order.
        if self._nearest(image[[np.argmax(np.abs(image))]], tolerance_mm) is None:
            return None
        onto = self._nearest(image, tolerance_mm)
        count = len(self.points)
        if onto is None or np.any(np.bincount(onto, minlength=count) != 1):
            return None
        if np.any(onto[self.following] != self.following[onto]):
            return None
        links = coo_array((np.ones(count, dtype=np.int8), (np.arange(count), onto)), shape=(count, count))
        label = connected_components(links, directed=False)[1]
        if np.any(np.bincount(label) != order):
            return None
        rows = np.empty((order, count // order), dtype=np.int64)
        rows[0] = np.unique(label, return_index=True)[1]
        for step in range(1, order):
            rows[step] = onto[rows[step - 1]]
        return rows

    def _nearest(self, image: Complexes, tolerance_mm: float) -> Ints | None:
        """The vertex nearest to each point of an image; None if one is further off than the tolerance."""
        away, found = self.tree.query(
            np.column_stack([image.real, image.imag]), distance_upper_bound=2 * tolerance_mm
        )
        return np.asarray(found, dtype=np.int64) if np.all(away <= tolerance_mm) else None

    def spread(self, orbits: Ints) -> tuple[float, float]:
        """Spread of orbits' vertices (mm) and of edges' normals (rad), when turned back."""
        order = len(orbits)
        back = np.exp(-2j * np.pi * np.arange(order) / order)[:, None]
        turned = self.points[orbits] * back
        leg = (self.points[self.following] - self.points)[orbits] * back
        towards = np.exp(-1j * np.pi * np.arange(_WIDTH_DIRECTIONS) / _WIDTH_DIRECTIONS)
        widest = max(float(np.ptp((turned * direction).real, axis=0).max()) for direction in towards)
        # The direction of the diameter is within half a step of one of those.
        off = widest / math.cos(math.pi / (2 * _WIDTH_DIRECTIONS))
        lean = float(np.ptp(np.angle(leg / leg[0]), axis=0).max())
        return off + 2 * self.stray_mm, min(lean + 2 * self.stray_rad, math.pi)


def _stray(whole: shapely.Geometry, region: shapely.Geometry) -> tuple[float, float]:
    """Distance of a region's boundary from the one that it simplifies (mm), and of its normals (rad)."""
    points = shapely.get_coordinates(whole)
    boundary = region.boundary
    shapely.prepare(boundary)
    if bool(np.all(shapely.dwithin(boundary, shapely.points(points), _ROUNDING_MM))):
        return 0.0, 0.0
    length = np.hypot(*np.diff(points, axis=0).T)
    shortest = float(np.min(length[length > 0]))
    return _STRAIGHT_MM, math.asin(min(2 * _STRAIGHT_MM / shortest, 1.0))
