"""Minkowski sums: a section grown by the finger's radius turns the finger into a point.

Memo footnote 3; Lozano-Pérez 1981. The Minkowski sum of a section with a disc is bounded by the section's
edges moved outwards and by arcs about its convex vertices. Arcs are faceted from inside; how far an arc
bulges out over its facet is kept with every edge and is part of the error bound. The sum is built as a union
of exact pieces rather than by a polygon buffer, because buffers simplify their input by an amount that they
do not state. Facets cross elsewhere than their arcs do, so the union only says which pieces meet where; the
corners are then put where the arcs themselves meet, and each visible arc is faceted anew between its corners.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
import shapely

from palpate.geometry import Floats, Ints, Section
from palpate.geometry.plane import wrap_angle
from palpate.recognizer.outline_arcs import facet_turn, with_exact_arcs
from palpate.recognizer.tables import Table

__all__ = ["GrownSection", "OrientedRing", "grow", "oriented_rings"]

_MERGE_MM = 1e-7  # union vertices nearer than this are one
_ON_ARC_MM = 1e-9
_STRAIGHT_MM = 1e-8  # a union vertex nearer than this to its neighbours' line is none
_UNION_FINER = 16.0  # facets of the union are this much closer to their arcs than the final ones


@dataclass(frozen=True, eq=False)
class GrownSection(Table):
    """Edges of a grown section in the object's frame; n edges, the solid on the left of each.

    `start` and `end` (n, 2) mm, `direction` (n, 2) unit, `length` (n,) mm, `bulge` and `dent` (n,) mm: how
    far the true boundary may stand out over the edge, or back behind it, `span` (n,) rad: half of the turn of
    the true normal along the edge. `feature` (n,): edge k of the section is k, an arc about vertex k is
    −1 − k; edges are counted through the section's polygons in the order given, outer ring first.
    """

    start: Floats
    end: Floats
    direction: Floats
    length: Floats
    bulge: Floats
    dent: Floats
    span: Floats
    feature: Ints

    def moved(self, by_mm: Floats) -> "GrownSection":
        """The same, moved by (2,) mm."""
        return replace(self, start=self.start + by_mm, end=self.end + by_mm)


def grow(section: Section, radius_mm: float, facet_error_mm: float) -> GrownSection:
    """Grow a section by a disc of `radius_mm`, with no arc further than `facet_error_mm` from its facet."""
    sources = _sources(section)
    pieces: list[shapely.Geometry] = [shapely.Polygon(p.outer, p.holes) for p in section.polygons]
    if radius_mm > 0:
        turn = facet_turn(radius_mm, facet_error_mm / _UNION_FINER)
        for ring in sources.rings:
            pieces += _skirt(ring, radius_mm, turn)
    outlines = []
    for outline in _boundary_rings(shapely.union_all(pieces)):
        features = sources.features_of(outline, radius_mm)
        if radius_mm > 0:
            turn = facet_turn(radius_mm, facet_error_mm)
            outlines.append(with_exact_arcs(outline, features, sources.vertex_at, radius_mm, turn))
        else:
            outlines.append((outline, features))
    start = np.vstack([points for points, _ in outlines])
    end = np.vstack([np.roll(points, -1, axis=0) for points, _ in outlines])
    feature = np.concatenate([features for _, features in outlines])
    return _edges(start, end, feature, sources.vertex_at, radius_mm)


@dataclass(frozen=True, eq=False)
class OrientedRing:
    """A ring with the solid on its left; `edge` and `vertex` are the numbers that the section gave them."""

    points: Floats
    edge: Ints
    vertex: Ints


@dataclass(frozen=True, eq=False)
class _Sources:
    """The section's own edges and vertices; `vertex_at` (n, 2) holds vertex k of the section at row k."""

    rings: tuple[OrientedRing, ...]
    vertex_at: Floats

    def features_of(self, outline: Floats, radius_mm: float) -> Ints:
        """Feature from which each edge of a grown outline (n, 2) stems: the one nearest to its midpoint."""
        legs = np.stack([outline, np.roll(outline, -1, axis=0)], axis=1)
        source = np.vstack([ring.points for ring in self.rings])
        leg = np.vstack([np.roll(ring.points, -1, axis=0) for ring in self.rings]) - source
        edge = np.concatenate([ring.edge for ring in self.rings])
        vertex = np.concatenate([ring.vertex for ring in self.rings])
        next_vertex = np.concatenate([np.roll(ring.vertex, -1) for ring in self.rings])
        middle = legs.mean(axis=1)
        which = _nearest_edge(source, leg, middle)
        square = np.sum(leg * leg, axis=1)[which]
        at = np.sum((middle - source[which]) * leg[which], axis=1) / square
        # A midpoint that projects onto the open edge came from that edge; otherwise from one of its ends,
        # unless that end is a vertex without a bend: the edge is a facet only if neither of its own ends is
        # further off.
        margin = _MERGE_MM / np.sqrt(square)
        at_end = (at <= margin) | (at >= 1 - margin)
        nearest_vertex = np.where(at > 0.5, next_vertex[which], vertex[which])
        centre = source[which] + (at > 0.5)[:, None] * leg[which]
        furthest = np.linalg.norm(legs - centre[:, None], axis=2).max(axis=1)
        on_arc = at_end & (furthest <= radius_mm + _ON_ARC_MM) & (radius_mm > 0)
        return np.where(on_arc, -1 - nearest_vertex, edge[which]).astype(np.int64)


def _nearest_edge(source: Floats, leg: Floats, point: Floats) -> Ints:
    """Index of the edge from `source` (m, 2) along `leg` that is nearest to each point (n, 2)."""
    tree = shapely.STRtree(shapely.linestrings(np.stack([source, source + leg], axis=1)))
    nearest: Ints = tree.nearest(shapely.points(point)).astype(np.int64)
    return nearest


def oriented_rings(section: Section) -> tuple[OrientedRing, ...]:
    """The section's rings with the solid on their left, numbered as in `GrownSection.feature`."""
    return _sources(section).rings


def _sources(section: Section) -> _Sources:
    rings, vertices = [], []
    first = 0
    for polygon in section.polygons:
        for points, ccw in ((polygon.outer, True), *((hole, False) for hole in polygon.holes)):
            rings.append(_ring(points, first, ccw=ccw))
            vertices.append(points)
            first += len(points)
    return _Sources(tuple(rings), np.vstack(vertices))


def _ring(points: Floats, first: int, *, ccw: bool) -> OrientedRing:
    number = np.arange(len(points))
    following = np.roll(points, -1, axis=0)
    distinct = np.linalg.norm(following - points, axis=1) > _MERGE_MM
    points, edge, vertex = points[distinct], number[distinct], number[distinct]
    following = np.roll(points, -1, axis=0)
    area = float(np.sum(points[:, 0] * following[:, 1] - points[:, 1] * following[:, 0]))
    if (area > 0) != ccw:
        points, edge, vertex = points[::-1], np.roll(edge[::-1], -1), vertex[::-1]
    return OrientedRing(points, first + edge, first + vertex)


def _skirt(source: OrientedRing, radius_mm: float, turn_rad: float) -> list[shapely.Polygon]:
    """What growing adds along a ring: a rectangle on each edge and a fan at each convex vertex."""
    ring = source.points
    following = np.roll(ring, -1, axis=0)
    along = following - ring
    angle = np.arctan2(along[:, 1], along[:, 0]) - np.pi / 2
    outward = radius_mm * np.column_stack([np.cos(angle), np.sin(angle)])
    pieces = [
        shapely.Polygon([ring[k], ring[k] + outward[k], following[k] + outward[k], following[k]])
        for k in range(len(ring))
    ]
    for k in range(len(ring)):
        turn = wrap_angle(angle[k] - angle[k - 1])
        if turn <= 1e-12:
            continue
        count = math.ceil(turn / turn_rad)
        inner = angle[k - 1] + turn * np.arange(1, count) / count
        rim = ring[k] + radius_mm * np.column_stack([np.cos(inner), np.sin(inner)])
        pieces.append(
            shapely.Polygon(np.vstack([ring[k], ring[k] + outward[k - 1], rim, ring[k] + outward[k]]))
        )
    return pieces


def _boundary_rings(solid: shapely.Geometry) -> list[Floats]:
    """All boundary rings (n, 2), solid on the left, collinear neighbours merged."""
    rings = []
    for part in shapely.get_parts(solid):
        if part.geom_type != "Polygon":
            continue
        oriented = shapely.geometry.polygon.orient(part)
        for ring in (oriented.exterior, *oriented.interiors):
            points = _without_collinear(np.asarray(ring.coords)[:-1])
            if len(points) >= 3:
                rings.append(points)
    return rings


def _without_collinear(points: Floats) -> Floats:
    """The ring without repeated points and without points that lie on their neighbours' line."""
    gap = np.linalg.norm(points - np.roll(points, 1, axis=0), axis=1)
    points = points[gap > _MERGE_MM]
    while len(points) > 3:
        before = points - np.roll(points, 1, axis=0)
        after = np.roll(points, -1, axis=0) - points
        cross = before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0]
        dot = np.sum(before * after, axis=1)
        span = np.linalg.norm(before, axis=1) + np.linalg.norm(after, axis=1)
        straight = (np.abs(cross) <= _STRAIGHT_MM * span) & (dot > 0)
        # Of neighbours only every other one at a time: each may be straight and the two together a bend.
        dropped = np.zeros(len(points), dtype=bool)
        for k in np.flatnonzero(straight):
            dropped[k] = not (dropped[k - 1] or dropped[(k + 1) % len(points)])
        if not dropped.any():
            break
        points = points[~dropped]
    return points


def _edges(start: Floats, end: Floats, feature: Ints, vertex_at: Floats, radius_mm: float) -> GrownSection:
    """Edges with the bulge and the turn of the arcs that they stand for."""
    along = end - start
    length = np.linalg.norm(along, axis=1)
    direction = along / length[:, None]
    on_arc = feature < 0
    offset = start - vertex_at[np.where(on_arc, -1 - feature, 0)]
    # How far the facet's line passes from the vertex; a facet that was cut short bulges as if it were whole.
    away = np.clip(offset[:, 0] * direction[:, 1] - offset[:, 1] * direction[:, 0], 0.0, radius_mm)
    half = np.arccos(np.clip(away / max(radius_mm, 1e-12), 0.0, 1.0))
    return GrownSection(
        start=start,
        end=end,
        direction=direction,
        length=length,
        bulge=np.where(on_arc, radius_mm - away, 0.0),
        dent=np.zeros(len(length)),
        span=np.where(on_arc, half, 0.0),
        feature=feature,
    )
