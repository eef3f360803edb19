"""Minkowski sums: a section grown by the finger's radius turns the finger into a point.

Memo footnote 3; Lozano-Pérez 1981. The Minkowski sum of a section with a disc is bounded by the section's
edges moved outwards and by arcs about its convex vertices. What of them is visible is computed in closed form
(`offset_curves`), not by a polygon buffer, because buffers simplify their input by an amount that they do not
state. Arcs are faceted from inside; how far an arc bulges out over its facet is kept with every edge and is
part of the error bound. Runs of edges of very fine outlines are replaced by one edge each; how far they stray
from it is kept likewise.
"""

from dataclasses import dataclass, replace

import numpy as np
import shapely
from scipy.spatial import cKDTree

from palpate.base.geometry import Floats, Ints, Section
from palpate.base.geometry.outlines import oriented_rings_of, region_of
from palpate.base.geometry.plane import cross, signed_area, wrap_angle
from palpate.recognizer.offset_curves import BoundaryEdges, GrownSection, faceted_rings, visible_parts
from palpate.recognizer.tables import expand_ranges

_MERGE_MM = 1e-7  # vertices nearer than this are one
_STRAIGHT_MM = 1e-8  # a vertex nearer than this to its neighbours' line is none


def grow(section: Section, radius_mm: float, facet_error_mm: float) -> GrownSection:
    """Grow a section by a disc of `radius_mm`, with no arc further than `facet_error_mm` from its facet."""
    edges = _boundary_edges(section)
    if radius_mm <= 0:
        nothing = np.zeros(len(edges))
        return GrownSection(
            edges.start, edges.end, edges.direction, edges.length, nothing, nothing, edges.lean, edges.edge
        )
    return faceted_rings(edges, visible_parts(edges, radius_mm), radius_mm, facet_error_mm)


@dataclass(frozen=True, eq=False)
class OrientedRing:
    """A ring with the solid on its left; `edge` and `vertex` are the numbers that the section gave them."""

    points: Floats
    edge: Ints
    vertex: Ints


def oriented_rings(section: Section) -> tuple[OrientedRing, ...]:
    """The section's rings with the solid on their left, numbered as in `GrownSection.feature`."""
    rings = []
    first = 0
    for polygon in section.polygons:
        for points, ccw in ((polygon.outer, True), *((hole, False) for hole in polygon.holes)):
            rings.append(_ring(points, first, ccw=ccw))
            first += len(points)
    return tuple(rings)


def _ring(points: Floats, first: int, *, ccw: bool) -> OrientedRing:
    number = np.arange(len(points))
    following = np.roll(points, -1, axis=0)
    distinct = np.linalg.norm(following - points, axis=1) > _MERGE_MM
    points, edge, vertex = points[distinct], number[distinct], number[distinct]
    if (signed_area(points) > 0) != ccw:
        points, edge, vertex = points[::-1], np.roll(edge[::-1], -1), vertex[::-1]
    return OrientedRing(points, first + edge, first + vertex)


def _boundary_edges(section: Section) -> BoundaryEdges:
    """The edges of the section's boundary; those on one line are one."""
    rings = oriented_rings(section)
    if len(section.polygons) > 1:
        rings = _union_rings(section, rings)
    parts, first = [], 0
    for ring in rings:
        if len(ring.points) < 3:
            continue  # smaller than rounding
        edges = _straighten(ring)
        parts.append(replace(edges, previous=first + (np.arange(len(edges)) - 1) % len(edges)))
        first += len(edges)
    return BoundaryEdges.join(parts)


def _union_rings(section: Section, rings: tuple[OrientedRing, ...]) -> tuple[OrientedRing, ...]:
    """Rings of the union of a section's polygons, which may touch or overlap."""
    solid = region_of(section.polygons)
    source = np.vstack([ring.points for ring in rings])
    leg = np.vstack([np.roll(ring.points, -1, axis=0) for ring in rings]) - source
    sides = shapely.STRtree(shapely.linestrings(np.stack([source, source + leg], axis=1)))
    corners = cKDTree(source)
    edge = np.concatenate([ring.edge for ring in rings])
    vertex = np.concatenate([ring.vertex for ring in rings])
    found = []
    for ring in oriented_rings_of(solid):
        points = ring[np.linalg.norm(ring - np.roll(ring, 1, axis=0), axis=1) > _MERGE_MM]
        if len(points) >= 3:
            middle = shapely.points((points + np.roll(points, -1, axis=0)) / 2)
            found.append(OrientedRing(points, edge[sides.nearest(middle)], vertex[corners.query(points)[1]]))
    return tuple(found)


def _straighten(ring: OrientedRing) -> BoundaryEdges:
    """Edges of a ring without the vertices that lie on their neighbours' line."""
    kept = _bends(ring.points)
    count = np.diff(np.append(kept, kept[0] + len(ring.points)))
    start = ring.points[kept]
    end = np.roll(start, -1, axis=0)
    along = end - start
    length = np.hypot(*along.T)
    run = np.repeat(np.arange(len(kept)), count)
    row = (kept[0] + np.arange(len(run))) % len(ring.points)
    leg = (np.roll(ring.points, -1, axis=0) - ring.points)[row]
    angle = np.arctan2(along[:, 1], along[:, 0])
    lean = np.zeros(len(kept))
    np.maximum.at(lean, run, np.abs(wrap_angle(np.arctan2(leg[:, 1], leg[:, 0]) - angle[run])))
    # Of several edges on one line the one in the middle gives the number.
    middle = np.sum((start + along / 2)[run] * along[run], axis=1)
    passed = np.sum(ring.points[row] * along[run], axis=1) <= middle
    last = np.maximum.reduceat(np.where(passed, np.arange(len(run)), 0), np.cumsum(count) - count)
    return BoundaryEdges(
        start=start,
        end=end,
        direction=along / length[:, None],
        length=length,
        lean=np.where(count > 1, lean, 0.0),
        previous=np.zeros(len(kept), np.int64),
        edge=ring.edge[row[last]],
        vertex=ring.vertex[kept],
    )


def _bends(points: Floats) -> Ints:
    """Rows of a ring's vertices that do not lie on their neighbours' line."""
    rows = np.arange(len(points))
    while len(rows) > 3:
        at = points[rows]
        before, after = at - np.roll(at, 1, axis=0), np.roll(at, -1, axis=0) - at
        cross = before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0]
        span = np.hypot(*before.T) + np.hypot(*after.T)
        straight = (np.abs(cross) <= _STRAIGHT_MM * span) & (np.sum(before * after, axis=1) > 0)
        # Of neighbours only every other one at a time: each may be straight and the two together a bend.
        dropped = np.zeros(len(rows), dtype=bool)
        for k in np.flatnonzero(straight):
            dropped[k] = not (dropped[k - 1] or dropped[(k + 1) % len(rows)])
        if not dropped.any():
            break
        rows = rows[~dropped]
    return rows


_FIRST_STRAY_MM = 1e-3
_ROUGH_SURFACE_MM = 0.1


def simplify_outline(grown: GrownSection, most: int, fine_mm: float = 0.0) -> GrownSection:
    """The same outline in no more than `most` edges, if it has more and that can be done.

    Each ring keeps four edges at least. The stray allowed is doubled until the edges are few enough, up to
    the size of the outline. As long as it is no more than `fine_mm`, only a tenth of them are few enough.
    Where it has to be coarser than a rough surface is, a quarter as many edges are enough: more would only
    pair every contact with noise.
    """
    stray = _FIRST_STRAY_MM
    size = float(np.ptp(grown.start, axis=0).max(initial=0.0))
    result = grown
    while len(result.length) > _sufficient_edges(most, stray, fine_mm) and stray < size:
        result = merge_runs(grown, stray)
        stray *= 2
    return result


def _sufficient_edges(most: int, stray_mm: float, fine_mm: float) -> int:
    if stray_mm <= fine_mm:
        return most // 10
    return most if stray_mm < _ROUGH_SURFACE_MM else most // 4


def merge_runs(grown: GrownSection, stray_mm: float) -> GrownSection:
    """Chords of runs of edges that stray from them by no more than `stray_mm`."""
    follows = np.all(grown.start == np.roll(grown.end, 1, axis=0), axis=1)
    begins = np.flatnonzero(~follows)
    begins = begins if len(begins) else np.zeros(1, np.int64)
    ends = np.append(begins[1:], len(grown.length))
    kept = [a + _corners(grown.start[a:b], stray_mm) for a, b in zip(begins, ends, strict=True)]
    first = np.concatenate(kept)
    count = np.diff(np.append(first, len(grown.length)))
    return _chords(grown, first, count)


def _corners(ring: Floats, stray_mm: float) -> Ints:
    """Indices of the ring's vertices that are kept (Douglas and Peucker), the first among them."""
    if len(ring) <= 4:
        return np.arange(len(ring))
    closed = np.vstack([ring, ring[:1]])
    half = len(ring) // 2
    kept = [_kept_vertices(closed[a : b + 1], stray_mm) + a for a, b in ((0, half), (half, len(ring)))]
    result = np.unique(np.concatenate(kept))
    result = result[result < len(ring)]
    if len(result) < 3:
        return np.arange(0, len(ring), -(-len(ring) // 4))
    return result


def _kept_vertices(line: Floats, stray_mm: float) -> Ints:
    """Indices of the vertices of a line that simplifying it keeps."""
    simple = shapely.get_coordinates(shapely.LineString(line).simplify(stray_mm, preserve_topology=False))
    found, at = [], 0
    for point in simple:
        at += int(np.argmax(np.all(line[at:] == point, axis=1)))
        found.append(at)
        at += 1
    return np.array(found, dtype=np.int64)


def _chords(grown: GrownSection, first: Ints, count: Ints) -> GrownSection:
    """One edge for each run of `count` (m,) edges from `first` (m,) on."""
    last = first + count - 1
    start, end = grown.start[first], grown.end[last]
    along = end - start
    length = np.hypot(*along.T)
    safe = np.where(length > 0, length, 1.0)
    direction = np.where(length[:, None] > 0, along / safe[:, None], grown.direction[first])
    run, edge = expand_ranges(first, count)
    rel = grown.start[edge] - start[run]
    along, inward = np.sum(rel * direction[run], axis=1), cross(direction[run], rel)
    turned = wrap_angle(_angle(grown.direction[edge]) - _angle(direction)[run])
    # An arc over a facet that is turned stands out along the chord, too.
    beyond = np.maximum(-along, along - length[run]) + grown.bulge[edge] * np.abs(np.sin(turned))
    out, back, bulge, dent, span = (np.zeros(len(first)) for _ in range(5))
    np.maximum.at(out, run, -inward)
    np.maximum.at(back, run, np.maximum(inward, beyond))
    np.maximum.at(bulge, run, grown.bulge[edge])
    np.maximum.at(dent, run, grown.dent[edge])
    np.maximum.at(span, run, np.abs(turned) + grown.span[edge])
    middle = first + count // 2
    return GrownSection(
        start=start,
        end=end,
        direction=direction,
        length=length,
        bulge=bulge + out,
        dent=dent + back,
        span=np.minimum(span, np.pi),
        feature=grown.feature[middle],
    )


def _angle(direction: Floats) -> Floats:
    return np.arctan2(direction[:, 1], direction[:, 0])
