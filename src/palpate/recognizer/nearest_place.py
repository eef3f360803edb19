"""Nearest places: where on the true boundary the centre of a tip may be, next to where it is said to be.

A piece of the boundary is a segment and a range of normals; what of the range the contact allows is again a
range, or two. The nearest centre on it is found in closed form: its normal is at an end of the range, or
straight from an end of the segment, or such that the centre's offset meets the segment.
"""

from dataclasses import dataclass

import numpy as np

from palpate.base.geometry import Bools, Floats, Ints
from palpate.recognizer.boundary_pieces import Pieces
from palpate.recognizer.free_line import ALLOWANCE_MM, clearances
from palpate.recognizer.tables import Table
from palpate.recognizer.true_boundary import TrueBoundary

__all__ = ["ALLOWANCE_RAD", "NEAR_MM", "Places", "nearest_places"]

ALLOWANCE_RAD = 1e-9
NEAR_MM = 1.0
"""So far beyond bounds places are looked for, to be moved to."""

_AT_END_RAD = 1e-6
_STEP_MM = 1e-9  # distances that differ by less are the same
_AS_NEAR, _AS_NEAR_MM2 = 1e-9, 1e-18  # and squares of distances by this share of them, and this
_AT_ONCE = 2_000  # points: each may have hundreds of pieces


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
        """None known."""
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
    state: Ints,
    point: Floats,
    lo_rad: Floats,
    width_rad: Floats,
    bound: Floats,
    beyond_mm: float = NEAR_MM,
    *,
    judged: bool = True,
    most: int | None = None,
) -> Places:
    """The place next to each point (q, 2) with a normal in [lo, lo + width] (q,); object's frame.

    A negative width allows no normal. Looked for are places up to `beyond_mm` beyond the bound (q,) mm.
    Unless places are `judged`, what may cover them is not looked at: `fits` says that some are within bounds.
    Once `most` pairs of a point and a piece with a place so near were found, points of the smallest bounds
    first, nothing is known of the others: their distance is 0.
    """
    result = Places.nowhere(len(state))
    order = np.arange(len(state)) if most is None else np.argsort(bound, kind="stable")
    near = 0
    for rows in np.array_split(order, len(state) // _AT_ONCE + 1):
        if most is not None and near > most:
            result.distance[rows] = 0.0
            continue
        owner, piece = _near_pieces(boundary, state[rows], point[rows], bound[rows], beyond_mm)
        found, pairs = _nearest(
            boundary,
            state[rows],
            point[rows],
            lo_rad[rows],
            width_rad[rows],
            bound[rows],
            beyond_mm,
            owner,
            piece,
            judged=judged,
        )
        near += pairs
        result.place(rows, found)
    return result


def _nearest(
    boundary: TrueBoundary,
    state: Ints,
    point: Floats,
    lo: Floats,
    width: Floats,
    bound: Floats,
    beyond_mm: float,
    owner: Ints,
    piece: Ints,
    *,
    judged: bool,
) -> tuple[Places, int]:
    """The same for points with the pieces that may be near: pairs of `owner` and `piece` (m,).

    Also: how many pairs are near.
    """
    pieces = boundary.pieces.select(piece)
    which, begin, turn = _common_normals(pieces, lo[owner], width[owner])
    owner, pieces = owner[which], pieces.select(which)
    offset, normal = _offsets(pieces, begin, turn, point[owner])
    away = np.hypot(*offset.T)
    gap = np.maximum(away - pieces.off, 0.0)
    near = np.flatnonzero(gap <= bound[owner] + beyond_mm)
    owner, pieces, offset, normal = owner[near], pieces.select(near), offset[near], normal[near]
    away, gap = away[near], gap[near]
    fits = gap <= bound[owner] + ALLOWANCE_MM
    loose = np.flatnonzero(fits & (pieces.off > 0) & (boundary.clearance_mm[state[owner]] > 0))
    if judged and len(loose):
        fits[loose] = _uncovered(
            boundary,
            state[owner[loose]],
            point[owner[loose]],
            offset[loose],
            normal[loose],
            pieces.off[loose],
            bound[owner[loose]],
        )
    found = Places.nowhere(len(state))
    found.fits[owner[fits]] = True
    # Where two pieces share a place, rounding must not choose.
    order = np.lexsort((np.rint(gap / _STEP_MM), owner))
    first = order[np.flatnonzero(np.diff(owner[order], prepend=-1))]
    shorter = offset[first] * (gap[first] / np.maximum(away[first], 1e-300))[:, None]
    rows = owner[first]
    found.distance[rows], found.offset[rows], found.normal[rows] = gap[first], shorter, normal[first]
    angle = np.arctan2(normal[first, 1], normal[first, 0]) - lo[rows] + _AT_END_RAD
    found.limited[rows] = (angle % (2 * np.pi) <= 2 * _AT_END_RAD) | (
        (angle - width[rows]) % (2 * np.pi) <= 2 * _AT_END_RAD
    )
    return found, len(near)


def _near_pieces(
    boundary: TrueBoundary, state: Ints, point: Floats, bound: Floats, beyond_mm: float
) -> tuple[Ints, Ints]:
    """Pairs of a point and a piece that has places within its bound, or not far beyond."""
    pieces = boundary.pieces
    owner, piece = boundary.pieces_near(state, point, bound + beyond_mm)
    x, y = (point[owner] - pieces.start[piece]).T
    u, v = pieces.along[piece].T
    along = np.clip(x * u + y * v, 0.0, pieces.length[piece])
    away = np.hypot(x - along * u, y - along * v)
    reach = bound[owner] + pieces.off[piece] + beyond_mm
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
    """From each point (k, 2) to the nearest centre of a tip on its piece, and the normal there.

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
    best = np.argmax(square <= square.min(axis=0) * (1 + _AS_NEAR) + _AS_NEAR_MM2, axis=0)
    every = np.arange(len(rel))
    return offset[best, every], normal[best, every]


def _uncovered(
    boundary: TrueBoundary,
    state: Ints,
    point: Floats,
    offset: Floats,
    normal: Floats,
    off: Floats,
    bound: Floats,
) -> Bools:
    """Whether a tip's centre within `bound` of its point, and `off` of the place, is clear of the section.

    Tried are the nearest to either, and those that are furthest out.
    """
    place = point + offset
    bound, off = (bound + ALLOWANCE_MM)[:, None], off[:, None]
    tried = [
        _towards(point, place, bound),
        _towards(place, point, off),
        _towards(point, place + off * normal, bound),
        _towards(place, point + bound * normal, off),
    ]
    found = np.zeros(len(state), dtype=bool)
    for centre in tried:
        near = (np.hypot(*(centre - point).T) <= bound[:, 0] + 1e-9) & (
            np.hypot(*(centre - place).T) <= off[:, 0] + 1e-9
        )
        rows = np.flatnonzero(near & ~found)
        free = clearances(boundary, state[rows], centre[rows])
        found[rows] = free >= boundary.clearance_mm[state[rows]] - ALLOWANCE_MM
    return found


def _towards(begin: Floats, end: Floats, most: Floats) -> Floats:
    """Points (k, 2) from `begin` towards `end`, at most so far (k, 1)."""
    leg = end - begin
    far = np.hypot(*leg.T)[:, None]
    result: Floats = begin + leg * np.minimum(1.0, most / np.maximum(far, 1e-300))
    return result
