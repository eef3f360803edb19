"""Bounding boxes of pieces of true boundaries: which pieces may have a place near a point.

Each piece has a rectangle along its middle normal, and neighbouring pieces of a state share upright boxes,
eight and eight, up to a few for each state. Unlike a tree of geometries they are built in no time, of little
memory.
"""

from dataclasses import dataclass

import numpy as np

from palpate.base.geometry import Bools, Floats, Ints
from palpate.recognizer.boundary_pieces import Pieces
from palpate.recognizer.tables import Table, expand_ranges

__all__ = ["PieceBoxes", "boxes_of"]

_TOGETHER = 8
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
        """Whether points (m, 2) are within `reach` (m,) of the rectangles `rows` (m,)."""
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
        """Whether points (m, 2) are within `reach` (m,) of the boxes `rows` (m,)."""
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
    while int(np.diff(first).max(initial=0)) > _TOGETHER or not levels:
        size = np.diff(first)
        count = -(-size // _TOGETHER)
        owner, nth = expand_ranges(np.zeros_like(count), count)
        begin = np.append(first[owner] + nth * _TOGETHER, first[-1])
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
