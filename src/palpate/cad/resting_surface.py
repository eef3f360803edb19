"""Surface of a solid resting on the support plane: heights and headings of facets, slices and silhouette.

Heights are rounded here, once: facets that are level within 1 µm are made level, and those thinner than 1 µm
are taken to have no normal of their own, because coordinates in files are no better than that. So a height
means that height within 1 µm. In a slice, vertices at the very height count as above it, which moves the
plane by nothing and spares all special cases; rings are followed from facet to facet through shared edges, so
nothing is matched by coordinates. The silhouette is what is seen from the side: for pictures that say which
side is down.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import shapely

from palpate.base.errors import InputError
from palpate.base.geometry import Bools, Floats, Ints, Polygon
from palpate.base.geometry.outlines import rings_of
from palpate.base.geometry.plane import signed_area
from palpate.cad.parts import Solid, StableState

ROUNDING_SHARE = 2e-7
"""Of the size, in the coordinates of files in single precision."""

SAME_HEIGHT_MM = 1e-3
"""Heights that differ by less are the same; facets thinner than it have no normal."""

_NEARLY_LEVEL_DRIFT = 1 / math.tan(math.radians(10.5))
"""Drift of a facet that is next to a level one on a curve."""


@dataclass(frozen=True, eq=False)
class RestingSurface:
    """A closed surface of m triangles in the frame of its state, z upwards from the support plane, mm.

    `vertices_mm` (n, 3); `faces` (m, 3), counter-clockwise seen from outside; `edges` (m, 3): the number of
    the edge from each corner to the next; `ends` (e, 2): an edge's vertices; `sides` (e, 2): the facet that
    runs from its first to its second vertex, and the other one. Of facets: `low`, `high` (m,) mm; `normal`
    (m, 2): its projection, of length one; `bare` (m,): without a normal
    in the plane, level or thin; `level` (m,); `upright` (m,): without drift sideways but for rounding;
    `drift` (m,): how far sideways per height, 0 where it is `bare`.
    `size_mm`: the greatest extent. `off_mm`: how far the real surface may be from these facets.
    """

    vertices_mm: Floats
    faces: Ints
    edges: Ints
    ends: Ints
    sides: Ints
    low: Floats
    high: Floats
    normal: Floats
    bare: Bools
    level: Bools
    upright: Bools
    drift: Floats
    size_mm: float
    off_mm: float = 0.0

    @property
    def top_mm(self) -> float:
        """Greatest height of the surface."""
        return float(self.vertices_mm[:, 2].max())

    def within(self, from_mm: float, to_mm: float) -> Ints:
        """Facets that reach into the open range of heights."""
        return np.flatnonzero((self.low < to_mm) & (self.high > from_mm))

    def around(self, from_mm: float, to_mm: float) -> tuple[float, float]:
        """Heights between which facets are that a range of the real surface is near to.

        A real point is within `off_mm` of a facet, and the real solid rests as much higher or lower. Beyond a
        level face, which is where it is, are no such facets.
        """
        if not self.off_mm:
            return from_mm, to_mm
        steps = self._steps_mm
        middle = (from_mm + to_mm) / 2  # of a thin range, one level face is not at both ends
        low = steps[steps <= min(from_mm + SAME_HEIGHT_MM, middle)].max(initial=0.0)
        high = steps[steps >= max(to_mm - SAME_HEIGHT_MM, middle)].min(initial=np.inf)
        far = 2 * self.off_mm
        return float(min(max(from_mm - far, low), from_mm)), float(max(min(to_mm + far, high), to_mm))

    @cached_property
    def _steps_mm(self) -> Floats:
        """Heights of level faces, but for facets of a curve: those have neighbours that are nearly level."""
        one, other = self.sides.T
        curved = np.zeros(len(self.level), dtype=bool)
        for facet, beside in ((one, other), (other, one)):
            curved[facet[self.drift[beside] > _NEARLY_LEVEL_DRIFT]] = True
        return np.setdiff1d(self.low[self.level], self.low[self.level & curved])

    def peaks(self) -> Floats:
        """Heights (k,), ascending, at which some part of it begins or ends: no neighbour is beyond."""
        first, second = self.ends.T
        height = self.vertices_mm[:, 2]
        above, below = (np.zeros(len(height), dtype=bool) for _ in range(2))
        above[first[height[second] > height[first]]] = True
        above[second[height[first] > height[second]]] = True
        below[first[height[second] < height[first]]] = True
        below[second[height[first] < height[second]]] = True
        return np.unique(height[~(above & below)])


def resting_surface_of(solid: Solid, state: StableState) -> RestingSurface:
    """Lay a solid as a state says.

    Raises InputError if its surface is not closed.
    """
    vertices = solid.vertices_mm @ state.rotation.T + state.offset_mm
    vertices[:, 2] = _level_heights(vertices[:, 2], solid.faces)
    edges, ends, sides = _edges_of(solid)
    corners = vertices[solid.faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    flat = np.hypot(normal[:, 0], normal[:, 1])
    longest = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2).max(axis=1)
    thickness = np.linalg.norm(normal, axis=1) / np.maximum(longest, 1e-300)
    low, high = corners[:, :, 2].min(axis=1), corners[:, :, 2].max(axis=1)
    level = low == high
    size = float(np.ptp(vertices, axis=0).max())
    slope = np.abs(normal[:, 2]) / np.maximum(flat, 1e-300)
    bare = level | (thickness < SAME_HEIGHT_MM)
    return RestingSurface(
        vertices,
        solid.faces,
        edges,
        ends,
        sides,
        low,
        high,
        normal[:, :2] / np.maximum(flat, 1e-300)[:, None],
        bare,
        level,
        slope * (high - low) <= 2 * ROUNDING_SHARE * size,
        np.where(bare, 0.0, slope),
        size,
        solid.off_mm,
    )


def _level_heights(height: Floats, faces: Ints) -> Floats:
    """Heights (n,) with the corners of almost level facets at the same ones."""
    of_faces = height[faces]
    flat = np.ptp(of_faces, axis=1) < SAME_HEIGHT_MM
    values, group = np.unique(of_faces[flat], return_inverse=True)
    common = values.copy()
    begin = -np.inf
    for index, value in enumerate(values.tolist()):
        if value - begin >= SAME_HEIGHT_MM:
            begin = value
        common[index] = begin
    result = height.copy()
    result[faces[flat].ravel()] = common[group.ravel()]
    return result


def _edges_of(solid: Solid) -> tuple[Ints, Ints, Ints]:
    count = len(solid.vertices_mm)
    begin, end = solid.faces, np.roll(solid.faces, -1, axis=1)
    key = np.minimum(begin, end) * count + np.maximum(begin, end)
    keys, number = np.unique(key, return_inverse=True)
    edges = number.reshape(key.shape)
    sides = np.full((len(keys), 2), -1)
    face = np.arange(len(solid.faces))[:, None].repeat(3, axis=1)
    forth = begin < end
    sides[edges[forth], 0] = face[forth]
    sides[edges[~forth], 1] = face[~forth]
    if 2 * len(keys) != key.size or (sides < 0).any():
        raise InputError(f"{solid.name}: its surface is not closed; repair it in the CAD program")
    return edges, np.stack([keys // count, keys % count], axis=1), sides


@dataclass(frozen=True, eq=False)
class SectionRing:
    """A closed outline with the solid on its left: edge k runs from point k to the next, along a facet.

    `points` (n, 2) mm; `facet` (n,): the number of the facet that each edge lies on.
    """

    points: Floats
    facet: Ints


def slice_surface(surface: RestingSurface, height_mm: float) -> list[SectionRing]:
    """Rings in which the plane at `height_mm` cuts the surface; consecutive points may coincide."""
    facets = np.flatnonzero((surface.low < height_mm) & (surface.high >= height_mm))
    if not len(facets):
        return []
    above = surface.vertices_mm[surface.faces[facets], 2] >= height_mm
    after = np.roll(above, -1, axis=1)
    # Seen from outside, a facet's falling edge is on the left of its rising one.
    rows = np.arange(len(facets))
    falling = surface.edges[facets][rows, (above & ~after).argmax(axis=1)]
    rising = surface.edges[facets][rows, (~above & after).argmax(axis=1)]
    order = np.argsort(falling)
    following = order[np.searchsorted(falling[order], rising)].tolist()
    start = surface.vertices_mm[surface.ends[falling, 0]]
    leg = surface.vertices_mm[surface.ends[falling, 1]] - start
    points = start[:, :2] + ((height_mm - start[:, 2]) / leg[:, 2])[:, None] * leg[:, :2]
    seen = [False] * len(facets)
    rings = []
    for first in range(len(facets)):
        if seen[first]:
            continue
        own = []
        at = first
        while not seen[at]:
            seen[at] = True
            own.append(at)
            at = following[at]
        rings.append(SectionRing(points[own], facets[own]))
    return rings


def regions_of(rings: Sequence[Floats]) -> tuple[Polygon, ...]:
    """Polygons with holes from disjoint rings (n, 2) with the solid on their left.

    Raises InputError if a ring lies inside of material, or a hole outside of it.
    """
    areas = [signed_area(ring) for ring in rings]
    outers = sorted((k for k in range(len(rings)) if areas[k] > 0), key=lambda k: areas[k])
    holes = [k for k in range(len(rings)) if areas[k] <= 0]
    shells = [shapely.Polygon(rings[k]) for k in outers]
    owned: list[list[Floats]] = [[] for _ in outers]
    for hole in holes:
        inside = shapely.Polygon(rings[hole]).representative_point()
        owner = next(
            (n for n, k in enumerate(outers) if areas[k] > -areas[hole] and shells[n].contains(inside)), None
        )
        if owner is None:
            raise InputError(f"a hole at ({inside.x:.4g}, {inside.y:.4g}) lies outside of the material")
        owned[owner].append(rings[hole])
    return tuple(Polygon(rings[k], tuple(own)) for k, own in zip(outers, owned, strict=True))


_GRID_CELLS = 256
"""Cells along the largest side: silhouettes are no finer, so that many facets are few different ones."""
_CHORD_SHARE = 0.005
"""Share of the size that the outline may be off besides."""


def silhouette(solid: Solid, state: StableState) -> tuple[Floats, ...]:
    """Open rings (n, 2) of (across, z), mm; what is in an odd number of them is part.

    Seen along +y, across is x; along −x where the part is longer in y, across is y.
    """
    resting = solid.vertices_mm @ state.rotation.T + state.offset_mm
    wide, deep = np.ptp(resting[:, :2], axis=0)
    seen = resting[:, [0, 2]] if wide >= deep else resting[:, [1, 2]]
    size = float(np.ptp(seen, axis=0).max())
    cell = size / _GRID_CELLS
    corners = np.round(seen / cell).astype(np.int64)[solid.faces]
    first, second, third = (corners[:, k] for k in range(3))
    across, along = second - first, third - first
    # Those that face away cover the same as those that are seen.
    turn = across[:, 0] * along[:, 1] - across[:, 1] * along[:, 0]
    some = np.unique(corners[turn > 0].reshape(-1, 6), axis=0).reshape(-1, 3, 2)
    # On a grid, here of cells: unions of many needles fail without one.
    whole = shapely.union_all(shapely.polygons(some), grid_size=1.0)
    # Rounded corners leave gaps of a cell between facets.
    closed = whole.buffer(1.0, join_style="mitre").buffer(-1.0, join_style="mitre")
    plain = shapely.simplify(closed, _CHORD_SHARE * _GRID_CELLS)
    return tuple(cell * ring for ring in rings_of(plain) if len(ring) > 2)
