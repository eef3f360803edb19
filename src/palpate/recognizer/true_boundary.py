"""True boundary of grown sections: possible positions of the centre of a tip that touches an object.

For `verification`, which asks whether a configuration is one; nothing here is used by the search, which has
facets instead of arcs. Of an object that is exact, what lies nearer than the radius to another part of the
section is left out. An object with a tolerance has a wider piece at every feature (`tolerance_band` says
why); none of it is left out, because what covers it may be off as well.

Which pieces may have a place near a point is told by boxes: each piece has a rectangle along its middle
normal, and neighbouring pieces of a state share upright boxes, eight and eight, up to a few for each state.
Unlike a tree of geometries they are built in no time, of little memory.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import shapely

from palpate.base.geometry import Bools, Floats, Ints, Section
from palpate.base.geometry.outlines import oriented_rings_of
from palpate.base.geometry.plane import wrap_angle
from palpate.recognizer.boundary_pieces import Pieces, Sides, uncovered_pieces
from palpate.recognizer.contact import Finger
from palpate.recognizer.edges import CatalogueState
from palpate.recognizer.tables import Table, expand_ranges
from palpate.recognizer.tip_clearance import clearance_tilts_rad
from palpate.recognizer.tip_obstacle import TipObstacle, tip_obstacle

_BOXES_PER_PARENT = 8
_ROUNDING_MM = 1e-6


@dataclass(frozen=True, eq=False)
class _Rectangles(Table):
    """Rectangles (n), each with a piece in it: `centre` (n, 2), directions `out` (n, 2) of the middle normal,
    half sizes `half_out` along it and `half_aside` across (n,); how far the piece may be `off` (n,) it.
    """

    centre: Floats
    out: Floats
    half_out: Floats
    half_aside: Floats
    off: Floats

    def near(self, rows: Ints, point: Floats, reach: Floats) -> Bools:
        """Mask of points (m, 2) that are within `reach` (m,) of the rectangles `rows` (m,)."""
        x, y = (point - self.centre[rows]).T
        u, v = self.out[rows].T
        out = np.maximum(np.abs(x * u + y * v) - self.half_out[rows], 0.0)
        aside = np.maximum(np.abs(y * u - x * v) - self.half_aside[rows], 0.0)
        result: Bools = out * out + aside * aside <= (reach + self.off[rows]) ** 2
        return result


@dataclass(frozen=True, eq=False)
class _Boxes:
    """Upright boxes (n), `low` to `high` (n, 2), each of what begins at `first` (n + 1,) one level below."""

    low: Floats
    high: Floats
    first: Ints

    def near(self, rows: Ints, point: Floats, reach: Floats) -> Bools:
        """Mask of points (m, 2) that are within `reach` (m,) of the boxes `rows` (m,)."""
        x, y = np.maximum(np.maximum(self.low[rows] - point, point - self.high[rows]), 0.0).T
        result: Bools = x * x + y * y <= reach * reach
        return result


@dataclass(frozen=True, eq=False)
class PieceBoxes:
    """Boxes of pieces of S states; `levels` from above, of which the first's begin at `first` (S + 1,)."""

    rectangles: _Rectangles
    levels: tuple[_Boxes, ...]
    first: Ints

    def near(self, state: Ints, point: Floats, reach: Floats) -> tuple[Ints, Ints]:
        """Pairs (point, piece) of points (q, 2) of states (q,) and pieces that may be within `reach` (q,) mm.

        All that are, and some more; by point, then by piece.
        """
        reach = reach + _ROUNDING_MM
        owner, row = expand_ranges(self.first[state], np.diff(self.first)[state])
        for boxes in self.levels:
            kept = boxes.near(row, point[owner], reach[owner])
            owner, row = owner[kept], row[kept]
            nth, row = expand_ranges(boxes.first[row], np.diff(boxes.first)[row])
            owner = owner[nth]
        kept = self.rectangles.near(row, point[owner], reach[owner])
        return owner[kept], row[kept]


def boxes_of(pieces: Pieces, first: Ints) -> PieceBoxes:
    """Boxes of where a tip's centre is on pieces; those of each state begin at `first` (S + 1,)."""
    rectangles = _rectangles(pieces)
    across = np.abs(rectangles.out) * rectangles.half_out[:, None]
    half = across + np.abs(rectangles.out[:, ::-1]) * rectangles.half_aside[:, None] + pieces.off[:, None]
    low, high = rectangles.centre - half, rectangles.centre + half
    levels: list[_Boxes] = []
    while int(np.diff(first).max(initial=0)) > _BOXES_PER_PARENT or not levels:
        size = np.diff(first)
        count = -(-size // _BOXES_PER_PARENT)
        owner, nth = expand_ranges(np.zeros_like(count), count)
        begin = np.append(first[owner] + nth * _BOXES_PER_PARENT, first[-1])
        if len(owner):
            low, high = np.minimum.reduceat(low, begin[:-1]), np.maximum.reduceat(high, begin[:-1])
        levels.append(_Boxes(low, high, begin))
        first = np.concatenate([[0], np.cumsum(count)])
    return PieceBoxes(rectangles, tuple(reversed(levels)), first)


def _rectangles(pieces: Pieces) -> _Rectangles:
    radius_mm = pieces.radius
    half = np.minimum(pieces.turn_rad / 2, np.pi)
    angle = pieces.normal_rad + pieces.turn_rad / 2
    out = np.column_stack([np.cos(angle), np.sin(angle)])
    aside = np.column_stack([-out[:, 1], out[:, 0]])
    leg = pieces.along * pieces.length[:, None]
    leg_out, leg_aside = np.sum(leg * out, axis=1), np.sum(leg * aside, axis=1)
    depth = radius_mm * (1.0 - np.cos(half))  # from the middle of the arc of normals back to its ends
    width = radius_mm * np.where(half < np.pi / 2, np.sin(half), 1.0)
    middle_out = radius_mm - depth / 2 + leg_out / 2
    return _Rectangles(
        pieces.start + out * middle_out[:, None] + aside * (leg_aside / 2)[:, None],
        out,
        (depth + np.abs(leg_out)) / 2,
        width + np.abs(leg_aside) / 2,
        pieces.off,
    )


_NOTHING_MM = 1e-9  # shorter sides are none


@dataclass(frozen=True, eq=False)
class TrueBoundary:
    """Boundaries of S states for one kind of finger: `pieces` and `sides`.

    Those of each state begin at `first_piece` and `first_side` (S + 1,). `clearance_mm` (S,): how near the
    tip's centre may come to what `sides` enclose; negative: how deep into it. That is a section and what
    touches is a disc of `radius_mm` (S,); or the least circle of a ball, and sections that are grown by what
    others have more.
    """

    radius_mm: Floats
    pieces: Pieces
    sides: Sides
    first_piece: Ints
    first_side: Ints
    clearance_mm: Floats

    def pieces_near(self, state: Ints, point: Floats, reach: Floats) -> tuple[Ints, Ints]:
        """Pairs of a point (q, 2) of an object and a piece: all that have a place within `reach` (q,) mm.

        And some more.
        """
        return self._boxes.near(state, point, reach)

    @cached_property
    def _boxes(self) -> PieceBoxes:
        return boxes_of(self.pieces, self.first_piece)


def true_boundary(states: Sequence[CatalogueState], finger: Finger) -> TrueBoundary:
    """The pieces that `finger` can be on, and the sides that can be in its way."""
    pieces, sides, radius, clearance = [], [], [], []
    for number, item in enumerate(states):
        met = tip_obstacle(item, finger)
        if met is None:
            radius.append(finger.tip_radius_mm)
            clearance.append(finger.tip_radius_mm - item.tolerance_mm)
            continue
        radius.append(met.radius_mm)
        clearance.append(met.radius_mm - met.tolerance_mm)
        outlines = _outlines(met.section, item.origin_mm)
        outer = _sides(number, [shapely.union_all(outlines)] if len(outlines) > 1 else outlines)
        sides.append(outer)
        if met.tolerance_mm > 0:
            pieces += _all_uncertain_pieces(number, item, met)
        else:
            pieces.append(_visible_pieces(outer, met.radius_mm))
    whole, every = Pieces.join([_NO_PIECES, *pieces]), Sides.join([_NO_SIDES, *sides])
    numbers = np.arange(len(states) + 1)
    return TrueBoundary(
        np.array(radius, np.float64),
        whole,
        every,
        np.searchsorted(whole.state, numbers),
        np.searchsorted(every.state, numbers),
        np.array(clearance, np.float64),
    )


_NONE, _NOWHERE, _NO_STATE = np.empty(0), np.empty((0, 2)), np.empty(0, np.int64)
_NO_SIDES = Sides(_NO_STATE, _NO_STATE, _NOWHERE, _NOWHERE)
_NO_PIECES = Pieces(_NO_STATE, _NOWHERE, _NOWHERE, _NONE, _NONE, _NONE, _NONE, _NONE)


def _outlines(section: Section, origin_mm: Floats) -> list[shapely.Polygon]:
    """A section's polygons, the state's centroid at the origin."""
    return [
        shapely.Polygon(polygon.outer - origin_mm, [hole - origin_mm for hole in polygon.holes])
        for polygon in section.polygons
    ]


def _sides(state: int, shapes: Sequence[shapely.Geometry]) -> Sides:
    """Sides of all rings, ring after ring."""
    parts = [_NO_SIDES]
    for number, ring in enumerate(ring for shape in shapes for ring in oriented_rings_of(shape)):
        points = ring[np.hypot(*(np.roll(ring, -1, axis=0) - ring).T) > _NOTHING_MM]
        whole = np.full(len(points), 1)
        parts.append(Sides(state * whole, number * whole, points, np.roll(points, -1, axis=0)))
    return Sides.join(parts)


def _all_uncertain_pieces(state: int, item: CatalogueState, met: TipObstacle) -> list[Pieces]:
    """Uncertain pieces of each outline by itself, met by the disc of its layer."""
    pieces = []
    for section, radius_mm in met.layers:
        outlines = _outlines(section, item.origin_mm)
        solid = shapely.union_all(outlines)
        own = [_sides(state, [outline]) for outline in outlines]
        pieces += [_uncertain_pieces(part, solid, radius_mm, met) for part in own]
    return pieces


def _uncertain_pieces(sides: Sides, solid: shapely.Geometry, radius_mm: float, met: TipObstacle) -> Pieces:
    """Pieces of an outline of which every point may be off by the tolerance, and normals tilted."""
    tolerance_mm = met.tolerance_mm
    normal, ratio = sides.normal_rad, 4 * tolerance_mm / sides.length
    tilt = np.where(ratio < 1.0, np.arcsin(np.minimum(ratio, 1.0)), np.pi)
    if met.normal_bound_rad is not None:
        tilt = np.full(len(normal), met.normal_bound_rad)
    by_tip = clearance_tilts_rad(solid, sides.start, sides.end, radius_mm, tolerance_mm)
    whole = by_tip <= tilt
    tilt = np.minimum(tilt, by_tip)
    off, radius = np.full(len(normal), tolerance_mm), np.full(len(normal), radius_mm)
    faces = Pieces(sides.state, sides.start, sides.along, sides.length, normal - tilt, 2 * tilt, off, radius)
    if not radius_mm > 0 or not len(normal):
        return faces
    before = sides.before
    turn = wrap_angle(normal - normal[before]) + tilt + tilt[before]
    arcs = Pieces(
        sides.state,
        sides.start,
        sides.along,
        np.zeros(len(normal)),
        (normal - tilt)[before],
        np.minimum(turn, 2 * np.pi),
        off,
        radius,
    )
    # What touches the end of a side has a piece of that side if its normals are any, or those the tip leaves.
    held = whole | (tilt >= np.pi)
    return Pieces.join([faces, arcs.select((turn > 0) & ~(held | held[before]))])


def _visible_pieces(sides: Sides, radius_mm: float) -> Pieces:
    """Pieces of an outline that is exact, without what is nearer than the radius to another side."""
    normal, nothing, radius = sides.normal_rad, np.zeros(len(sides)), np.full(len(sides), radius_mm)
    faces = Pieces(sides.state, sides.start, sides.along, sides.length, normal, nothing, nothing, radius)
    if not radius_mm > 0 or not len(sides):
        return faces
    before = sides.before
    bend = wrap_angle(normal - normal[before])
    arcs = Pieces(sides.state, sides.start, sides.along, nothing, normal[before], bend, nothing, radius)
    whole = Pieces.join([faces, arcs.select(bend > 0)])
    return uncovered_pieces(whole, sides, radius_mm)
