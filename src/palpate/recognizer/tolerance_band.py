"""Tolerance bands: edges that may be paired with contacts on an object with a tolerance.

The outline grown from the nominal section says too little of them: where a notch is a little wider in truth
than in the model, a finger may touch its floor or its corners though the nominal grown outline has neither.
So every edge and every convex vertex is taken by itself.

With vertices off by δ at most, each point of a true edge is within δ of the nominal edge, and an edge of
length L tilts by up to asin(2δ/L). Where the true outline is a round of sagitta δ over the edge its normal is
off by nearly twice that, so asin(4δ/L) is allowed. A finger of radius r that touches the edge has its centre
r along the true normal from such a point; one that touches a vertex has it r from a point within δ of the
nominal vertex, along a normal between those of the two true edges. Nothing else is assumed.

An edge much shorter than δ may then point anywhere, and a fine outline says nothing of its normals. But a tip
of some radius rests on peaks, which limits the normals with which it can touch (`tip_clearance`). And a model
may state by how much normals are off at most: then that takes the place of asin(4δ/L). Runs of edges that
stray from a chord by no more than a share of δ are one edge.
"""

import math
from dataclasses import dataclass

import numpy as np
import shapely
from scipy.spatial import cKDTree

from palpate.base.geometry import Bools, Floats, Ints, Section
from palpate.base.geometry.outlines import region_of
from palpate.base.geometry.plane import wrap_angle
from palpate.recognizer.minkowski import (
    OrientedRing,
    grow,
    merge_runs,
    oriented_rings,
    simplify_outline,
)
from palpate.recognizer.offset_curves import GrownSection, facet_turn
from palpate.recognizer.tables import Table
from palpate.recognizer.tip_clearance import clearance_depths_mm, clearance_tilts_rad, worthwhile_tilt_rad
from palpate.recognizer.tip_obstacle import first_occurrences

_MAX_SIDES = 1000  # of a ring; finer ones are replaced by chords
_MAX_STRAY_TOLERANCES = 0.5  # by which chords may stray from the runs of edges that they replace


@dataclass(frozen=True)
class ToleranceBand:
    """Deviation that an outline may have: points by `off_mm`, normals by `turn_rad` if that is stated."""

    off_mm: float
    turn_rad: float | None = None

    def turns_rad(self, length_mm: Floats) -> Floats:
        """Largest deviation (n,) of the normals of edges of some lengths (n,)."""
        if self.turn_rad is not None:
            return np.full(len(length_mm), self.turn_rad)
        ratio = 4 * self.off_mm / length_mm
        return np.where(ratio < 1.0, np.arcsin(np.minimum(ratio, 1.0)), np.pi)


@dataclass(frozen=True, eq=False)
class PairingEdges(Table):
    """Edges (n) in the section's frame, for pairing only: they overlap, and do not close to outlines.

    `inward`, `outward` and `along` (n,) mm: how far the tip's centre may lie from them.
    """

    edges: GrownSection
    inward: Floats
    outward: Floats
    along: Floats


def pairing_edges(
    section: Section, radius_mm: float, band: ToleranceBand, facet_error_mm: float, *, united: bool = False
) -> PairingEdges:
    """Places of a tip's centre at every feature, except for those that the object is certain to cover.

    The centre is never nearer to the nominal section than r − δ. Of polygons of several sections (`united`)
    those walls are looked at once that are the same in several.
    """
    parts = []
    solid = region_of(section.polygons)
    rings = oriented_rings(section)
    fresh = first_occurrences([ring.points for ring in rings]) if united else (True,) * len(rings)
    for ring in (ring for ring, first in zip(rings, fresh, strict=True) if first):
        sides = _uncertain_edges(solid, ring, radius_mm, band, facet_error_mm)
        parts.append(_along_edges(solid, sides, radius_mm, band.off_mm))
        if radius_mm > 0:
            parts.append(_about_vertices(sides, radius_mm, facet_turn(radius_mm, facet_error_mm)))
    found = PairingEdges.join(parts)
    if radius_mm <= band.off_mm:
        return found
    return found.select(~_is_covered(found, section, radius_mm - band.off_mm, facet_error_mm))


@dataclass(frozen=True, eq=False)
class _UncertainEdges:
    """The edges (n) of a ring: edge k runs from `start` along `leg` (n, 2); `number` (n,) is its start's.

    A point of the true edge is within `off` (n,) mm of it, and the true normal within `tilt` (n,) rad.
    `held` (n,): contacts with its start are with the edge as well, or with the one before.
    """

    start: Floats
    leg: Floats
    number: Ints
    off: Floats
    tilt: Floats
    held: Bools


def _uncertain_edges(
    solid: shapely.Geometry, ring: OrientedRing, radius_mm: float, band: ToleranceBand, facet_error_mm: float
) -> _UncertainEdges:
    """A ring's edges; of a fine ring, chords of its runs of edges."""
    start, end = ring.points, np.roll(ring.points, -1, axis=0)
    length = np.hypot(*(end - start).T)
    nothing = np.zeros(len(length))
    worth = max(facet_turn(radius_mm, facet_error_mm) / 2, worthwhile_tilt_rad(radius_mm, band.off_mm))
    tilt, held = _tilts(solid, start, end, radius_mm, band, worth)
    traced = GrownSection(
        start=start,
        end=end,
        direction=(end - start) / length[:, None],
        length=length,
        bulge=nothing,
        dent=nothing,
        span=tilt,
        feature=ring.vertex,
    )
    merged = merge_runs(traced, _MAX_STRAY_TOLERANCES * band.off_mm)
    traced = simplify_outline(merged, _MAX_SIDES, facet_error_mm / 4)
    return _UncertainEdges(
        traced.start,
        traced.end - traced.start,
        traced.feature,
        band.off_mm + np.maximum(traced.dent, traced.bulge),
        traced.span,
        held[cKDTree(start).query(traced.start)[1]],
    )


def _tilts(
    solid: shapely.Geometry,
    start: Floats,
    end: Floats,
    radius_mm: float,
    band: ToleranceBand,
    worth_rad: float,
) -> tuple[Floats, Bools]:
    """Largest deviation of normals on a ring's edges, (n,), and a mask of starts that need no facets.

    An edge is made to hold contacts with its ends, too, where that turns its normal by `worth_rad` at most.
    """
    leg = end - start
    by_tip = clearance_tilts_rad(solid, start, end, radius_mm, band.off_mm)
    tilt = np.minimum(band.turns_rad(np.hypot(*leg.T)), by_tip)
    angle = np.arctan2(leg[:, 1], leg[:, 0])
    bend = wrap_angle(angle - np.roll(angle, 1))
    at_start, at_end = bend + np.roll(tilt, 1), np.roll(bend + tilt, -1)
    held_by_tip = by_tip <= np.maximum(tilt, worth_rad)
    holds_start, holds_end = held_by_tip | (at_start <= worth_rad), held_by_tip | (at_end <= worth_rad)
    for holds, reach in ((holds_start, at_start), (holds_end, at_end)):
        tilt = np.where(holds, np.maximum(tilt, np.minimum(reach, by_tip)), tilt)
    return tilt, holds_start | np.roll(holds_end, 1)


def _along_edges(
    solid: shapely.Geometry, sides: _UncertainEdges, radius_mm: float, off_mm: float
) -> PairingEdges:
    length = np.hypot(*sides.leg.T)
    direction = sides.leg / np.maximum(length, 1e-300)[:, None]
    normal = np.column_stack([direction[:, 1], -direction[:, 0]])
    nothing = np.zeros(len(length))
    edges = GrownSection(
        start=sides.start + radius_mm * normal,
        end=sides.start + sides.leg + radius_mm * normal,
        direction=direction,
        length=length,
        bulge=nothing,
        dent=nothing,
        span=sides.tilt,
        feature=sides.number,
    )
    sunk = radius_mm * (1 - np.cos(sides.tilt))
    aside = radius_mm * np.sin(np.minimum(sides.tilt, np.pi / 2))
    inward, along = sides.off + sunk, sides.off + aside
    if radius_mm > off_mm:
        inward = clearance_depths_mm(solid, edges.start, edges.end, along, inward, radius_mm - off_mm)
    return PairingEdges(edges, inward, sides.off, along)


def _about_vertices(sides: _UncertainEdges, radius_mm: float, turn_rad: float) -> PairingEdges:
    """Facets of the arcs about vertices that may be convex.

    An edge that may point anywhere holds whatever touches its ends as well.
    """
    angle = np.arctan2(sides.leg[:, 1], sides.leg[:, 0]) - np.pi / 2
    before, tilt_before = np.roll(angle, 1), np.roll(sides.tilt, 1)
    off = np.maximum(sides.off, np.roll(sides.off, 1))
    bend = wrap_angle(angle - before)
    width = np.minimum(bend + sides.tilt + tilt_before, 2 * np.pi)
    held = sides.held | (np.maximum(sides.tilt, tilt_before) >= np.pi)
    at = np.flatnonzero((width > 0) & ~held)
    count = np.ceil(width[at] / turn_rad).astype(np.int64)
    owner = np.repeat(at, count)
    step = np.repeat(width[at] / np.maximum(count, 1), count)
    place = np.arange(len(owner)) - np.repeat(np.cumsum(count) - count, count)
    begin = before[owner] - tilt_before[owner] + place * step
    start, end = (
        sides.start[owner] + radius_mm * np.column_stack([np.cos(a), np.sin(a)])
        for a in (begin, begin + step)
    )
    middle = begin + step / 2
    bulge = radius_mm * (1 - np.cos(step / 2))
    edges = GrownSection(
        start=start,
        end=end,
        direction=np.column_stack([-np.sin(middle), np.cos(middle)]),
        length=np.hypot(*(end - start).T),
        bulge=bulge,
        dent=np.zeros(len(owner)),
        span=step / 2,
        feature=-1 - sides.number[owner],
    )
    return PairingEdges(edges, off[owner], off[owner] + bulge, off[owner])


def _is_covered(found: PairingEdges, section: Section, radius_mm: float, facet_error_mm: float) -> Bools:
    """Mask of edges that lie, with all their slack, in what is nearer to the section than `radius_mm`."""
    grown = grow(section, radius_mm, facet_error_mm)
    solid = shapely.polygonize(list(shapely.linestrings(np.stack([grown.start, grown.end], axis=1))))
    inside = shapely.union_all([part for part in solid.geoms if _is_solid(part, grown)])
    edges = found.edges
    normal = np.column_stack([edges.direction[:, 1], -edges.direction[:, 0]])
    corners = [
        point + side * edges.direction * found.along[:, None] + across * normal
        for point, side, across in (
            (edges.start, -1.0, -found.inward[:, None]),
            (edges.end, 1.0, -found.inward[:, None]),
            (edges.end, 1.0, found.outward[:, None]),
            (edges.start, -1.0, found.outward[:, None]),
        )
    ]
    shapely.prepare(inside)
    covered: Bools = shapely.contains_properly(inside, shapely.polygons(np.stack(corners, axis=1)))
    return covered


def _is_solid(part: shapely.Polygon, grown: GrownSection) -> bool:
    """Return whether a face of the grown outlines is on their left: faces of holes are on their right."""
    point = part.representative_point()
    return math.isfinite(point.x) and _winding(np.array([point.x, point.y]), grown) > 0


def _winding(point: Floats, grown: GrownSection) -> int:
    begin, end = grown.start - point, grown.end - point
    turn = np.arctan2(begin[:, 0] * end[:, 1] - begin[:, 1] * end[:, 0], np.sum(begin * end, axis=1))
    return round(float(turn.sum()) / (2 * math.pi))
