"""Uncovered pieces: what of a grown section's boundary is visible.

Pieces are cut where they meet one another; of what is between two cuts all or nothing is nearer than the
radius to another side of the section, and its middle tells which.
"""

import numpy as np
import shapely

from palpate.base.geometry import Bools, Floats, Ints
from palpate.recognizer.boundary_pieces import Pieces, Sides

__all__ = ["uncovered"]

_COVERED_MM = 1e-7  # a place must be covered by more than this to be left out
_NOTHING_MM = 1e-9  # shorter parts of faces are none
_NOTHING_RAD = 1e-10  # and of arcs: well below what normals are rounded by


def uncovered(pieces: Pieces, sides: Sides, radius_mm: float) -> Pieces:
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
    """Where pieces meet one another: the piece (k,) and how far along it (k,)."""
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
