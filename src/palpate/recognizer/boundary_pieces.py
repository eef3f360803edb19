"""Pieces of a grown section's true boundary, with the sides of the section that generate them.

A piece is a segment and a range of normals: the tip's centre is at distance r, along one of the normals, from
a point of the segment. An edge has one normal, a convex vertex has no length. To leave out what is covered,
pieces are cut where they meet one another; of what is between two cuts all or nothing is nearer than the
radius to another side of the section, and its middle tells which. Circles round pieces, and round blocks of
them that follow each other, let the compiled kernel pass over what is far away.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import shapely

from palpate.base.geometry import Bools, Floats, Ints
from palpate.base.geometry.plane import wrap_angle
from palpate.recognizer.tables import Table, expand_ranges

_BLOCK_ROWS = 16
"""Features in a block; the last one of a state may have fewer."""

_CIRCLE_ROUNDING_MM = 1e-7
"""Circles are larger by so much."""


def segment_circles(start: Floats, end: Floats) -> Floats:
    """Circles (n, 3) round segments (n, 2): middle x, y, radius mm."""
    return np.column_stack([(start + end) / 2, np.hypot(*(end - start).T) / 2 + _CIRCLE_ROUNDING_MM])


def block_circles(circles: Floats, first: Ints) -> tuple[Ints, Floats]:
    """Circles (b, 3) round blocks of circles (n, 3), and where the blocks of each state begin (S + 1,).

    `first` (S + 1,): where the circles of each state begin. A circle's middle is that of its box.
    """
    count = -(-np.diff(first) // _BLOCK_ROWS)
    begins = np.cumsum(np.append(0, count))
    state, nth = expand_ranges(np.zeros_like(count), count)
    rows = first[state] + _BLOCK_ROWS * nth
    if not len(rows):
        return begins, np.empty((0, 3))
    place, radius = circles[:, :2], circles[:, 2:]
    lo = np.minimum.reduceat(place - radius, rows)
    middle = (lo + np.maximum.reduceat(place + radius, rows)) / 2
    own = np.repeat(np.arange(len(rows)), np.diff(np.append(rows, len(circles))))
    reach = np.maximum.reduceat(np.hypot(*(place - middle[own]).T) + circles[:, 2], rows)
    return begins, np.column_stack([middle, reach + _CIRCLE_ROUNDING_MM])


@dataclass(frozen=True, eq=False)
class Sides(Table):
    """Edges (n) of sections in the centred object frame, the solid on their left; sorted by state.

    `ring` (n,) numbers the rings of a state. `start` and `end` (n, 2) mm; neighbours meet in the same
    numbers.
    """

    state: Ints
    ring: Ints
    start: Floats
    end: Floats

    @cached_property
    def length(self) -> Floats:
        """Lengths of the sides, (n,) mm."""
        result: Floats = np.hypot(*(self.end - self.start).T)
        return result

    @cached_property
    def along(self) -> Floats:
        """Unit direction of each, (n, 2)."""
        return (self.end - self.start) / self.length[:, None]

    @cached_property
    def normal_rad(self) -> Floats:
        """Outward normal of each, (n,)."""
        result: Floats = np.arctan2(-self.along[:, 0], self.along[:, 1])
        return result

    @cached_property
    def before(self) -> Ints:
        """The side (n,) that ends where each begins: the one before, or the last of its ring."""
        begins = np.flatnonzero(np.diff(self.ring, prepend=-1))
        result = np.arange(len(self)) - 1
        result[begins] = np.append(begins[1:], len(self)) - 1
        return result


@dataclass(frozen=True, eq=False)
class Pieces(Table):
    """n pieces, sorted by state: `state` (n,); a segment from `start` along `along` (n, 2), `length` (n,) mm.

    Outward normals: from `normal_rad` counter-clockwise by `turn_rad` (n,). A true point of the feature is
    within `off` (n,) mm of the segment. What touches has the `radius` (n,) mm.
    """

    state: Ints
    start: Floats
    along: Floats
    length: Floats
    normal_rad: Floats
    turn_rad: Floats
    off: Floats
    radius: Floats

    @cached_property
    def is_face(self) -> Bools:
        """Mask of pieces that are edges moved out, (n,); the others are arcs about vertices."""
        return self.length > 0

    @cached_property
    def size(self) -> Floats:
        """Extent of each piece (n,): mm along a face, rad about a vertex."""
        return np.where(self.is_face, self.length, self.turn_rad)

    def centres(self, at: Floats, radius_mm: float) -> Floats:
        """Centres (n, 2) of a tip so far along each, `at` (n,)."""
        normal = self.normal_rad + np.where(self.is_face, 0.0, at)
        foot = self.start + self.along * np.where(self.is_face, at, 0.0)[:, None]
        return foot + radius_mm * np.column_stack([np.cos(normal), np.sin(normal)])

    @property
    def circles(self) -> Floats:
        """Circles (n, 3) round all places of a tip's true centre on each: middle x, y, radius mm."""
        radius_mm = self.radius
        half = self.turn_rad / 2
        middle, narrow = self.normal_rad + half, half < np.pi / 2
        out = radius_mm * np.where(narrow, np.cos(half), 0.0)
        centre = self.start + self.along * (self.length / 2)[:, None]
        centre = centre + out[:, None] * np.column_stack([np.cos(middle), np.sin(middle)])
        wide = radius_mm * np.where(narrow, np.sin(half), 1.0)
        return np.column_stack([centre, self.length / 2 + wide + self.off + _CIRCLE_ROUNDING_MM])

    def along_at(self, point: Floats) -> Floats:
        """Distance along each piece, (n,), of a centre (n, 2) on its line or circle."""
        rel = point - self.start
        # Just before the beginning counts as such, not as a turn further on.
        half = self.turn_rad / 2
        turned = wrap_angle(np.arctan2(rel[:, 1], rel[:, 0]) - self.normal_rad - half) + half
        return np.where(self.is_face, np.sum(rel * self.along, axis=1), turned)

    def stretch(self, begin: Floats, end: Floats) -> "Pieces":
        """The part from `begin` to `end` (n,) of each."""
        face = self.is_face
        return replace(
            self,
            start=self.start + self.along * np.where(face, begin, 0.0)[:, None],
            length=np.where(face, end - begin, 0.0),
            normal_rad=self.normal_rad + np.where(face, 0.0, begin),
            turn_rad=np.where(face, 0.0, end - begin),
        )


_COVERED_MM = 1e-7  # a place must be covered by more than this to be left out
_NOTHING_MM = 1e-9  # shorter parts of faces are none
_NOTHING_RAD = 1e-10  # and of arcs: well below what normals are rounded by


def uncovered_pieces(pieces: Pieces, sides: Sides, radius_mm: float) -> Pieces:
    """The parts of pieces, cut where they meet one another, that no side is nearer to than the radius."""
    piece, at = _meeting_places(pieces, radius_mm)
    number = np.arange(len(pieces))
    piece = np.concatenate([number, number, piece])
    at = np.concatenate([np.zeros(len(pieces)), pieces.size, at])
    order = np.lexsort((at, piece))
    piece, at = piece[order], at[order]
    least = np.where(pieces.is_face, _NOTHING_MM, _NOTHING_RAD)
    part = np.flatnonzero((piece[1:] == piece[:-1]) & (np.diff(at) > least[piece[:-1]]))
    of, begin, end = piece[part], at[part], at[part + 1]
    lines = shapely.linestrings(np.stack([sides.start, sides.end], axis=1))
    middle = shapely.points(pieces.select(of).centres((begin + end) / 2, radius_mm))
    _, away = shapely.STRtree(lines).query_nearest(middle, all_matches=False, return_distance=True)
    clear = away >= radius_mm - _COVERED_MM
    # Neighbouring parts of one piece are one.
    joins = np.zeros(len(of), dtype=bool)
    joins[1:] = clear[1:] & clear[:-1] & (of[1:] == of[:-1])
    first = np.flatnonzero(clear & ~joins)
    last = np.flatnonzero(clear & ~np.append(joins[1:], False))
    return pieces.select(of[first]).stretch(begin[first], end[last])


def _meeting_places(pieces: Pieces, radius_mm: float) -> tuple[Ints, Floats]:
    """Places at which pieces meet one another: the piece (k,) and how far along it (k,)."""
    one, two = _near_pairs(pieces, radius_mm)
    face = pieces.is_face
    kinds = (
        (face[one] & face[two], _faces_meet),
        (face[one] & ~face[two], _face_meets_arc),
        (~face[one] & ~face[two], _arcs_meet),
    )
    piece, at = [], []
    for chosen, meet in kinds:
        a, b = one[chosen], two[chosen]
        first, second = pieces.select(a), pieces.select(b)
        for point in meet(first, second, radius_mm):
            on_first, on_second = (some.along_at(point) for some in (first, second))
            both = _is_on(first, on_first) & _is_on(second, on_second)
            piece += [a[both], b[both]]
            at += [on_first[both], on_second[both]]
    return np.concatenate(piece), np.concatenate(at)


def _is_on(pieces: Pieces, at: Floats) -> Bools:
    result: Bools = (at >= -_NOTHING_MM) & (at <= pieces.size + _NOTHING_MM)
    return result


def _near_pairs(pieces: Pieces, radius_mm: float) -> tuple[Ints, Ints]:
    """Pairs of pieces whose boxes meet; faces come before arcs, and each pair comes once."""
    some = np.stack([pieces.centres(pieces.size * share, radius_mm) for share in np.linspace(0, 1, 5)])
    margin = 1e-6 + radius_mm * (1 - np.cos(pieces.turn_rad / 8))
    low, high = some.min(axis=0) - margin[:, None], some.max(axis=0) + margin[:, None]
    boxes = shapely.box(low[:, 0], low[:, 1], high[:, 0], high[:, 1])
    one, two = shapely.STRtree(boxes).query(boxes)
    once = one < two
    return one[once].astype(np.int64), two[once].astype(np.int64)


def _offset_start(face: Pieces, radius_mm: float) -> Floats:
    return face.centres(np.zeros(len(face)), radius_mm)


def _faces_meet(one: Pieces, two: Pieces, radius_mm: float) -> list[Floats]:
    a, u, v = _offset_start(one, radius_mm), one.along, two.along
    gap = _offset_start(two, radius_mm) - a
    turn = u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]
    safe = np.where(np.abs(turn) > 1e-14, turn, np.nan)
    along = (gap[:, 0] * v[:, 1] - gap[:, 1] * v[:, 0]) / safe
    return [a + along[:, None] * u]


def _face_meets_arc(face: Pieces, arc: Pieces, radius_mm: float) -> list[Floats]:
    a, u = _offset_start(face, radius_mm), face.along
    foot = a + np.sum((arc.start - a) * u, axis=1)[:, None] * u
    square = radius_mm**2 - np.sum((foot - arc.start) ** 2, axis=1)
    half = np.sqrt(np.where(square >= 0, square, np.nan))[:, None]
    return [foot - half * u, foot + half * u]


def _arcs_meet(one: Pieces, two: Pieces, radius_mm: float) -> list[Floats]:
    gap = two.start - one.start
    half = np.hypot(*gap.T) / 2
    apart = (half > 0) & (half <= radius_mm)
    safe = np.where(apart, half, np.nan)
    across = np.sqrt(np.maximum(radius_mm**2 - safe**2, 0.0)) / (2 * safe)
    middle, aside = (one.start + two.start) / 2, np.column_stack([-gap[:, 1], gap[:, 0]])
    return [middle - across[:, None] * aside, middle + across[:, None] * aside]
