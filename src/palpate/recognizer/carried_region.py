"""Carried region: where a part may be after a motion, by where it may have been before.

Carried contacts (`recognition`) are as far off as the part was moved there, each as if by itself. But a
motion moves the part as a whole. So the earlier cells, grown by the motion, hold as well
(docs/motion-bounds.md), and clip cells that are cut anew.
"""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from palpate.base.geometry import Bools, Floats, Ints
from palpate.base.geometry.plane import rotate, wrap_angle
from palpate.recognizer.catalogue import Catalogue
from palpate.recognizer.model_test import sinusoid_maximum
from palpate.recognizer.pose_region import Cells, WitnessedCells, clip_polygons
from palpate.recognizer.tables import expand_ranges

_MOST_CELLS = 16384  # more are of hypotheses that are many still, or wide: they would clip little
_MOST_PARTS = 512  # of the region, which every cell is compared with: neighbours in orientation are one
_DIRECTIONS = 16
_WIDEST_RAD = np.pi / 2  # half of an interval; wider ones may meet another from both sides
_ROUNDING_MM, _ROUNDING_RAD = 1e-9, 1e-12

_ANGLES = np.arange(_DIRECTIONS) * (2 * np.pi / _DIRECTIONS)
_AWAY = np.column_stack([np.cos(_ANGLES), np.sin(_ANGLES)])


@dataclass(frozen=True, eq=False)
class CarriedRegion:
    """Union of cells, grown by a motion, in k parts.

    `state` (k,); orientations within `half_width` (k,) rad of `middle` (k,); how far from the anchor the
    centroid may be in each of n directions in W, `limit_mm` (k, n).
    """

    state: Ints
    middle: Floats
    half_width: Floats
    limit_mm: Floats

    @classmethod
    def of(cls, cells: Cells, shift_mm: Floats, turn_rad: Floats) -> Self | None:
        """Region after a motion by up to `shift_mm` (k,), with a turn by up to `turn_rad` (k,), of a part in
        one of the cells (k,); None where it would say little.
        """
        finite = np.isfinite(shift_mm) & np.isfinite(turn_rad)
        if not 0 < len(cells) <= _MOST_CELLS or not finite.all():
            return None
        x, y = cells.polygon[..., None, 0], cells.polygon[..., None, 1]
        cos, sin = _AWAY.T
        lo, hi = cells.lo[:, None, None], cells.hi[:, None, None]
        reach = sinusoid_maximum(x * cos + y * sin, x * sin - y * cos, lo, hi).max(axis=1)
        grown = reach + (shift_mm + _ROUNDING_MM)[:, None]
        wide = turn_rad + _ROUNDING_RAD
        return cls._join_neighbours(cells.state, cells.lo - wide, cells.hi + wide, grown)

    def on_all_branches(self, catalogue: Catalogue) -> Self:
        """The same on every branch of each state's symmetry: a new search may find the part on any."""
        orders = np.array([catalogue.states[state].symmetry_order for state in self.state.tolist()])
        row, nth = expand_ranges(np.zeros_like(orders), np.maximum(orders, 1))
        turn = nth * (2 * np.pi / np.maximum(orders, 1)[row])
        half_width = np.where(orders == 0, np.inf, self.half_width)
        return type(self)(self.state[row], self.middle[row] + turn, half_width[row], self.limit_mm[row])

    @classmethod
    def _join_neighbours(cls, state: Ints, lo: Floats, hi: Floats, limit_mm: Floats) -> Self:
        """Region of parts of a state (k,) with orientations in [lo, hi] (k,), some of which are joined."""
        order = np.lexsort((lo + hi, state))
        state, lo, hi, limit_mm = state[order], lo[order], hi[order], limit_mm[order]
        row = np.arange(len(state))
        at_state = np.maximum.accumulate(np.where(np.diff(state, prepend=-1) != 0, row, 0))
        first = np.flatnonzero((row - at_state) % -(-len(state) // _MOST_PARTS) == 0)
        lo, hi = np.minimum.reduceat(lo, first), np.maximum.reduceat(hi, first)
        return cls(state[first], (lo + hi) / 2, (hi - lo) / 2, np.maximum.reduceat(limit_mm, first, axis=0))

    def clip(self, cells: Cells) -> tuple[Cells, Ints]:
        """What the region leaves of cells (k,), those that it leaves nothing of left out; their rows."""
        narrow, limit = self._narrow(cells)
        rows = np.flatnonzero(narrow.lo <= narrow.hi)
        narrow, limit = narrow.select(rows), limit[rows]
        polygon, (away, limit) = narrow.polygon.copy(), _half_planes(narrow, limit)
        for direction in range(_DIRECTIONS):
            polygon, kept = clip_polygons(polygon, away[:, direction], limit[:, direction])
            if not kept.all():
                rows, away, limit, narrow = rows[kept], away[kept], limit[kept], narrow.select(kept)
        return replace(narrow, polygon=polygon), rows

    def clip_witnessed(self, found: WitnessedCells) -> WitnessedCells:
        """The same of cells with candidates: those outside of what is left are none.

        Orientations stay as they are: candidates are at their middle.
        """
        cells, rows = self.clip(found.cells)
        away, limit = _half_planes(cells, self._narrow(cells)[1])
        spot, at = found.spot[rows], found.cells.middle[rows]
        inside = (np.einsum("kj,knj->kn", spot, away) <= limit).all(axis=1)
        inside &= (cells.lo <= at) & (at <= cells.hi)
        whole = replace(cells, lo=found.cells.lo[rows], hi=found.cells.hi[rows])
        return WitnessedCells(whole, spot, found.holds[rows] & inside)

    def _narrow(self, cells: Cells) -> tuple[Cells, Floats]:
        """Cells (k,) with what is in the region of their orientations, lo > hi: none; limits (k, n)."""
        lo, hi = np.full(len(cells), np.inf), np.full(len(cells), -np.inf)
        limit = np.full((len(cells), _DIRECTIONS), -np.inf)
        for state in np.unique(cells.state):
            own, rows = np.flatnonzero(self.state == state), np.flatnonzero(cells.state == state)
            apart = wrap_angle(self.middle[own] - cells.middle[rows][:, None])
            wide = np.maximum(cells.half_width[rows][:, None], self.half_width[own]) > _WIDEST_RAD
            half = np.where(wide, np.inf, self.half_width[own])
            near: Bools = np.abs(apart) <= cells.half_width[rows][:, None] + half
            lo[rows] = np.where(near, apart - half, np.inf).min(axis=1, initial=np.inf)
            hi[rows] = np.where(near, apart + half, -np.inf).max(axis=1, initial=-np.inf)
            for direction in range(_DIRECTIONS):
                reach = np.where(near, self.limit_mm[own, direction], -np.inf)
                limit[rows, direction] = reach.max(axis=1, initial=-np.inf)
        lo, hi = np.maximum(cells.lo, cells.middle + lo), np.minimum(cells.hi, cells.middle + hi)
        return replace(cells, lo=lo, hi=hi), limit


def _half_planes(cells: Cells, limit_mm: Floats) -> tuple[Floats, Floats]:
    """Directions (k, n, 2) in the object's frame and how far positions s may reach in each, (k, n).

    Those of a cell's middle orientation: at others they are turned.
    """
    furthest = np.hypot(cells.polygon[..., 0], cells.polygon[..., 1]).max(axis=1, initial=0.0)
    return rotate(_AWAY, -cells.middle[:, None]), limit_mm + (cells.half_width * furthest)[:, None]
