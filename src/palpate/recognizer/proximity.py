"""Proximity queries on the true boundary: the nearest position of a tip's centre, and free straight paths.

A piece of the boundary is a segment and a range of normals; what of the range the contact allows is again a
range, or two. The nearest centre on it is found in closed form: its normal is at an end of the range, or
straight from an end of the segment, or such that the centre's offset meets the segment.

A path is free where it is no nearer to the section than the radius, less the object's tolerance; if the
tolerance is more than the radius, no deeper in it than by the rest.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from palpate.base.geometry import Bools, Floats, Ints
from palpate.recognizer.boundary_pieces import Pieces
from palpate.recognizer.tables import Table, expand_ranges
from palpate.recognizer.true_boundary import TrueBoundary

ALLOWANCE_MM = 1e-6
"""By so much a tip may be nearer, or further, than a bound says: for rounding."""

_PAIRS_AT_ONCE = 2_000_000


@dataclass(frozen=True, eq=False)
class _SideViews(Table):
    """Pairs (k) of a line and a side, the side's ends as seen along the line: ahead x, to the left y, mm."""

    line: Ints
    x0: Floats
    y0: Floats
    x1: Floats
    y1: Floats

    @cached_property
    def crossing(self) -> Bools:
        """True where the line crosses the side. Neighbours share the numbers of their corner."""
        result: Bools = (self.y0 > 0) != (self.y1 > 0)
        return result

    @cached_property
    def crossing_mm(self) -> Floats:
        """Way along the line from its beginning to the crossing; arbitrary where there is none."""
        rise = np.where(self.crossing, self.y1 - self.y0, 1.0)
        return self.x0 - self.y0 * (self.x1 - self.x0) / rise

    def distance(self, x: Floats) -> Floats:
        """Distance from the point x (k,) of the line to the side."""
        u, v = self.x1 - self.x0, self.y1 - self.y0
        share = np.clip(((x - self.x0) * u - self.y0 * v) / np.maximum(u * u + v * v, 1e-300), 0.0, 1.0)
        result: Floats = np.hypot(self.x0 + share * u - x, self.y0 + share * v)
        return result


def _clearances(boundary: TrueBoundary, state: Ints, point: Floats) -> Floats:
    """Distance of points (q, 2) from the outlines in mm, negative inside; infinite: nothing is there."""
    seen = _side_views(boundary, state, point, np.tile([1.0, 0.0], (len(state), 1)))
    nearest = np.full(len(state), np.inf)
    np.minimum.at(nearest, seen.line, seen.distance(np.zeros(len(seen))))
    return np.where(_begin_inside(seen, len(state)), -nearest, nearest)


def lines_are_free(boundary: TrueBoundary, state: Ints, begin: Floats, end: Floats) -> Bools:
    """Mask of straight paths of the tip's centre (q,) that are clear of the object; begin and end (q, 2)."""
    count = np.diff(boundary.first_side)[state]
    cuts = np.flatnonzero(np.diff(np.cumsum(count) // _PAIRS_AT_ONCE)) + 1
    free = np.ones(len(state), dtype=bool)
    for rows in np.split(np.arange(len(state)), cuts):
        leg = end[rows] - begin[rows]
        travel = np.hypot(*leg.T)
        heading = np.where(travel[:, None] > 0, leg / np.maximum(travel, 1e-300)[:, None], [1.0, 0.0])
        seen = _side_views(boundary, state[rows], begin[rows], heading)
        clearance = boundary.clearance_mm[state[rows]] - ALLOWANCE_MM
        apart = clearance > 0
        if apart.any():
            free[rows[apart]] = _keeps_away(seen, travel, clearance)[apart]
        if not apart.all():
            free[rows[~apart]] = _stays_shallow(seen, travel, -clearance)[~apart]
    return free


def _side_views(boundary: TrueBoundary, state: Ints, begin: Floats, heading: Floats) -> _SideViews:
    """All sides of each line's state (q,), seen along the line."""
    sides = boundary.sides
    line, side = expand_ranges(boundary.first_side[state], np.diff(boundary.first_side)[state])
    (x, y), (u, v) = begin[line].T, heading[line].T
    ahead = []
    for corner in (sides.start[side], sides.end[side]):
        a, b = corner[:, 0] - x, corner[:, 1] - y
        ahead += [u * a + v * b, u * b - v * a]
    return _SideViews(line, *ahead)


def _begin_inside(seen: _SideViews, lines: int) -> Bools:
    """Mask of lines that begin inside: then an odd number of sides crosses them before they do."""
    behind = seen.select(seen.crossing & (np.minimum(seen.x0, seen.x1) < 0))
    before = behind.line[behind.crossing_mm < 0]
    inside: Bools = np.bincount(before, minlength=lines) % 2 == 1
    return inside


def _keeps_away(seen: _SideViews, travel: Floats, clearance: Floats) -> Bools:
    """Lines (q,) that begin outside and come nowhere nearer to a side than the clearance (q,), positive."""
    blocked = _begin_inside(seen, len(travel))
    far, wide = travel[seen.line], clearance[seen.line]
    near = (np.minimum(seen.y0, seen.y1) < wide) & (np.maximum(seen.y0, seen.y1) > -wide)
    near &= (np.minimum(seen.x0, seen.x1) < far + wide) & (np.maximum(seen.x0, seen.x1) > -wide)
    seen, far, wide = seen.select(near), far[near], wide[near]
    away = np.minimum(seen.distance(np.zeros(len(seen))), seen.distance(far))
    for x, y in ((seen.x0, seen.y0), (seen.x1, seen.y1)):
        away = np.minimum(away, np.hypot(x - np.clip(x, 0.0, far), y))
    at = seen.crossing_mm
    hit = (away < wide) | (seen.crossing & (at >= 0) & (at <= far))
    blocked[seen.line[hit]] = True
    return ~blocked


def _stays_shallow(seen: _SideViews, travel: Floats, depth: Floats) -> Bools:
    """Lines (q,) that are nowhere inside and further than `depth` (q,) from every side."""
    wide = depth[seen.line]
    seen = seen.select((np.minimum(seen.y0, seen.y1) <= wide) & (np.maximum(seen.y0, seen.y1) >= -wide))
    enter, leave = _near_stretches(seen, depth[seen.line])
    reached = enter <= leave
    seen, enter, leave = seen.select(reached), enter[reached], leave[reached]
    # One row for each line, its sides in the order in which the line comes near them.
    order = np.lexsort((enter, seen.line))
    line = seen.line[order]
    count = np.bincount(line, minlength=len(travel))
    slot = np.arange(len(line)) - np.repeat(np.cumsum(count) - count, count)
    shape = (len(travel), int(count.max(initial=0)) + 1)
    entered, left, crossed = np.full(shape, np.inf), np.full(shape, -np.inf), np.zeros(shape, dtype=bool)
    entered[line, slot], left[line, slot] = enter[order], leave[order]
    crossed[line, slot] = seen.crossing[order]
    left, inside = np.maximum.accumulate(left, axis=1), np.logical_xor.accumulate(crossed, axis=1)
    # A side is crossed while it is near: between two that are, the line is inside if it has crossed an odd
    # number of those before.
    following = np.column_stack([entered[:, 1:], np.full(len(entered), np.inf)])
    deep = inside & (np.maximum(left, 0.0) < np.minimum(following, travel[:, None]))
    result: Bools = ~np.any(deep, axis=1)
    return result


def _near_stretches(seen: _SideViews, wide: Floats) -> tuple[Floats, Floats]:
    """Stretches of lines within `wide` (k,) of their sides: enter and leave; enter > leave: none."""
    enter, leave = np.full(len(seen), np.inf), np.full(len(seen), -np.inf)
    for x, y in ((seen.x0, seen.y0), (seen.x1, seen.y1)):
        square = wide * wide - y * y
        half = np.sqrt(np.maximum(square, 0.0))
        enter = np.where(square >= 0, np.minimum(enter, x - half), enter)
        leave = np.where(square >= 0, np.maximum(leave, x + half), leave)
    # The side moved aside by `wide`, to the left and to the right.
    u, v = seen.x1 - seen.x0, seen.y1 - seen.y0
    length = np.maximum(np.hypot(u, v), 1e-300)
    for hand in (-1.0, 1.0):
        x, y = seen.x0 - hand * wide * v / length, seen.y0 + hand * wide * u / length
        meets = (y > 0) != (y + v > 0)
        at = x - y * u / np.where(meets, v, 1.0)
        enter = np.where(meets, np.minimum(enter, at), enter)
        leave = np.where(meets, np.maximum(leave, at), leave)
    at = seen.crossing_mm
    enter = np.where(seen.crossing, np.minimum(enter, at), enter)
    leave = np.where(seen.crossing, np.maximum(leave, at), leave)
    return enter, leave


ALLOWANCE_RAD = 1e-9
NEAR_MM = 1.0
"""So far beyond bounds places are looked for, to be moved to."""

_AT_END_RAD = 1e-6
_EQUAL_MM = 1e-9  # distances that differ by less are the same
_EQUAL_SHARE, _EQUAL_MM2 = 1e-9, 1e-18  # and squares of distances by this share of them, and this
_POINTS_AT_ONCE = 2_000  # points: each may have hundreds of pieces


@dataclass(frozen=True, eq=False)
class TipCentres(Table):
    """q stated centres of tips, `point` (q, 2) in frames of objects in `state` (q,), within `bound` (q,) mm.

    Surface normals are in [`lo_rad`, `lo_rad` + `width_rad`] (q,); a negative width allows none.
    """

    state: Ints
    point: Floats
    lo_rad: Floats
    width_rad: Floats
    bound: Floats


@dataclass(frozen=True, eq=False)
class Places(Table):
    """q places: `distance` (q,) mm from the stated centre, `offset` (q, 2) from there, `normal` (q, 2).

    `fits` (q,): some place, this or another one, is within the bound. `limited` (q,): the normal is at an end
    of the contact's range. Infinite `distance`: none is near by.
    """

    distance: Floats
    offset: Floats
    normal: Floats
    fits: Bools
    limited: Bools

    @classmethod
    def nowhere(cls, count: int) -> "Places":
        """Places of so many centres, none of them known."""
        nothing = np.zeros((count, 2))
        no = np.zeros(count, dtype=bool)
        return cls(np.full(count, np.inf), nothing, nothing.copy(), no, no.copy())

    def place(self, rows: Ints | Bools, others: "Places") -> None:
        """Write others to rows of this."""
        self.distance[rows], self.offset[rows] = others.distance, others.offset
        self.normal[rows], self.fits[rows] = others.normal, others.fits
        self.limited[rows] = others.limited


def nearest_places(
    boundary: TrueBoundary,
    centres: TipCentres,
    beyond_mm: float = NEAR_MM,
    *,
    judged: bool = True,
    most: int | None = None,
) -> Places:
    """The place next to each centre with a normal that is allowed there; object's frame.

    Looked for are places up to `beyond_mm` beyond the bound. Unless places are `judged`, what may cover them
    is not looked at: `fits` says that some are within bounds. Once `most` pairs of a centre and a piece with
    a place so near were found, centres of the smallest bounds first, nothing is known of the others: their
    distance is 0.
    """
    result = Places.nowhere(len(centres))
    order = np.arange(len(centres)) if most is None else np.argsort(centres.bound, kind="stable")
    near = 0
    for rows in np.array_split(order, len(centres) // _POINTS_AT_ONCE + 1):
        if most is not None and near > most:
            result.distance[rows] = 0.0
            continue
        found, pairs = _nearest_places(boundary, centres.select(rows), beyond_mm, judged=judged)
        near += pairs
        result.place(rows, found)
    return result


def _nearest_places(
    boundary: TrueBoundary, centres: TipCentres, beyond_mm: float, *, judged: bool
) -> tuple[Places, int]:
    """The same for centres that are few enough; and how many pairs of a centre and a piece are near."""
    owner, piece = _near_pieces(boundary, centres, beyond_mm)
    pieces = boundary.pieces.select(piece)
    lo, width = centres.lo_rad, centres.width_rad
    which, begin, turn = _common_normals(pieces, lo[owner], width[owner])
    owner, pieces = owner[which], pieces.select(which)
    offset, normal = _offsets(pieces, begin, turn, centres.point[owner])
    away = np.hypot(*offset.T)
    gap = np.maximum(away - pieces.off, 0.0)
    near = np.flatnonzero(gap <= centres.bound[owner] + beyond_mm)
    owner, pieces, offset, normal = owner[near], pieces.select(near), offset[near], normal[near]
    away, gap = away[near], gap[near]
    fits = gap <= centres.bound[owner] + ALLOWANCE_MM
    loose = np.flatnonzero(fits & (pieces.off > 0) & (boundary.clearance_mm[centres.state[owner]] > 0))
    if judged and len(loose):
        some, off = centres.select(owner[loose]), pieces.off[loose]
        fits[loose] = _is_uncovered(boundary, some, offset[loose], normal[loose], off)
    found = Places.nowhere(len(centres))
    found.fits[owner[fits]] = True
    # Where two pieces share a place, rounding must not choose.
    order = np.lexsort((np.rint(gap / _EQUAL_MM), owner))
    first = order[np.flatnonzero(np.diff(owner[order], prepend=-1))]
    shorter = offset[first] * (gap[first] / np.maximum(away[first], 1e-300))[:, None]
    rows = owner[first]
    found.distance[rows], found.offset[rows], found.normal[rows] = gap[first], shorter, normal[first]
    angle = np.arctan2(normal[first, 1], normal[first, 0]) - lo[rows] + _AT_END_RAD
    found.limited[rows] = (angle % (2 * np.pi) <= 2 * _AT_END_RAD) | (
        (angle - width[rows]) % (2 * np.pi) <= 2 * _AT_END_RAD
    )
    return found, len(near)


def _near_pieces(boundary: TrueBoundary, centres: TipCentres, beyond_mm: float) -> tuple[Ints, Ints]:
    """Pairs of a centre and a piece that has places within its bound, or not far beyond."""
    pieces = boundary.pieces
    owner, piece = boundary.pieces_near(centres.state, centres.point, centres.bound + beyond_mm)
    x, y = (centres.point[owner] - pieces.start[piece]).T
    u, v = pieces.along[piece].T
    along = np.clip(x * u + y * v, 0.0, pieces.length[piece])
    away = np.hypot(x - along * u, y - along * v)
    reach = centres.bound[owner] + pieces.off[piece] + beyond_mm
    radius = pieces.radius[piece]
    near = (away <= radius + reach) & ((away >= radius - reach) | (pieces.off[piece] > 0))
    return owner[near], piece[near]


def _common_normals(pieces: Pieces, lo: Floats, width: Floats) -> tuple[Ints, Floats, Floats]:
    """Normals that both pieces (k,) and contacts allow: which piece, where they begin, how far they turn.

    Two ranges of directions may meet twice: where one begins within the other, and where the other does.
    """
    lo = lo - ALLOWANCE_RAD
    width = np.where(width >= 0, width + 2 * ALLOWANCE_RAD, -1.0)
    after_lo = (pieces.normal_rad - lo) % (2 * np.pi)
    after_piece = (lo - pieces.normal_rad) % (2 * np.pi)
    one = np.flatnonzero(after_lo <= width)
    two = np.flatnonzero((after_piece <= pieces.turn_rad) & (width >= 0))
    return (
        np.concatenate([one, two]),
        np.concatenate([pieces.normal_rad[one], lo[two]]),
        np.concatenate(
            [
                np.minimum(pieces.turn_rad[one], width[one] - after_lo[one]),
                np.minimum(width[two], pieces.turn_rad[two] - after_piece[two]),
            ]
        ),
    )


def _offsets(pieces: Pieces, begin: Floats, turn: Floats, point: Floats) -> tuple[Floats, Floats]:
    """Vectors from each point (k, 2) to the nearest centre of a tip on its piece, and the normal there.

    Normals are from `begin` on by `turn` (k,) rad; of those that are as good it is the first one tried.
    """
    rel, along, radius = point - pieces.start, pieces.along, pieces.radius
    across = rel[:, 0] * along[:, 1] - rel[:, 1] * along[:, 0]
    face = np.arctan2(-along[:, 0], along[:, 1])
    lean = np.arccos(np.clip(across / np.maximum(radius, 1e-300), -1.0, 1.0))
    far = rel - along * pieces.length[:, None]
    tried = np.stack(
        [
            begin,
            begin + turn,
            face - lean,
            face + lean,
            np.arctan2(rel[:, 1], rel[:, 0]),
            np.arctan2(far[:, 1], far[:, 0]),
        ]
    )
    tried[2:] = np.where((tried[2:] - begin) % (2 * np.pi) <= turn, tried[2:], begin)
    normal = np.stack([np.cos(tried), np.sin(tried)], axis=2)
    left = rel - radius[:, None] * normal
    foot = np.clip(np.sum(left * along, axis=2), 0.0, pieces.length)
    offset = along * foot[..., None] - left
    # Where two normals lead to the same place, rounding must not choose.
    square = np.sum(offset * offset, axis=2)
    best = np.argmax(square <= square.min(axis=0) * (1 + _EQUAL_SHARE) + _EQUAL_MM2, axis=0)
    every = np.arange(len(rel))
    return offset[best, every], normal[best, every]


def _is_uncovered(
    boundary: TrueBoundary, centres: TipCentres, offset: Floats, normal: Floats, off: Floats
) -> Bools:
    """Mask (k,): true if a tip within `bound` of its stated centre, and `off` of the place, may be clear.

    Tried are the nearest to either, and those that are furthest out.
    """
    point, place = centres.point, centres.point + offset
    bound, off = (centres.bound + ALLOWANCE_MM)[:, None], off[:, None]
    tried = [
        _towards(point, place, bound),
        _towards(place, point, off),
        _towards(point, place + off * normal, bound),
        _towards(place, point + bound * normal, off),
    ]
    found = np.zeros(len(centres), dtype=bool)
    for centre in tried:
        near = (np.hypot(*(centre - point).T) <= bound[:, 0] + 1e-9) & (
            np.hypot(*(centre - place).T) <= off[:, 0] + 1e-9
        )
        rows = np.flatnonzero(near & ~found)
        state = centres.state[rows]
        found[rows] = (
            _clearances(boundary, state, centre[rows]) >= boundary.clearance_mm[state] - ALLOWANCE_MM
        )
    return found


def _towards(begin: Floats, end: Floats, most: Floats) -> Floats:
    """Points (k, 2) from `begin` towards `end`, at most so far (k, 1)."""
    leg = end - begin
    far = np.hypot(*leg.T)[:, None]
    result: Floats = begin + leg * np.minimum(1.0, most / np.maximum(far, 1e-300))
    return result
