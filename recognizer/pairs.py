"""Pairs of edges, by the turn between their normals and by their range of distances (memo §2.2.1).

Between the catalogue and the tree's second level. The turn from one edge's normal to the other's does not
depend on the object's orientation, so the pairs that two measured normals allow are one stretch of a sorted
list; in it only the distances are compared. Single precision, rounded outward, keeps large catalogues small.
"""

import numpy as np
from numpy.typing import NDArray

from palpate.recognizer.arrays import Bools, Floats, Ints, expand_ranges
from palpate.recognizer.edges import EdgeSet
from palpate.recognizer.segments import distance_range
from palpate.recognizer.strips import strip_forest

__all__ = ["PairTable"]

_AT_ONCE = 1 << 16
_TURN_ROUNDING_RAD = 2e-6  # of a turn kept in single precision


class PairTable:
    """All pairs of an edge of `first` and an edge of `second` of the same state.

    `flat` (S,): states of at most `flat_edges`, whose pairs are listed; others are paired by strips.
    Distances include what the edges' slack adds to them.
    """

    def __init__(self, first: EdgeSet, second: EdgeSet, flat_edges: int) -> None:
        self._first, self._second = first, second
        self.flat: Bools = np.maximum(first.count, second.count) <= flat_edges
        self._columns: Ints = np.where(self.flat, second.count, 0)
        sizes = np.where(self.flat, first.count, 0) * self._columns
        self._begin: Ints = np.cumsum(np.append(0, sizes))[:-1]
        edge_a, edge_b = self._all_pairs(sizes)
        self._shortest, self._longest = self._distances(edge_a, edge_b)
        listed = np.flatnonzero(first.representative[edge_a])
        turn = (second.normal_rad[edge_b[listed]] - first.normal_rad[edge_a[listed]]) % (2 * np.pi)
        order = np.argsort(turn)
        listed = listed[order]
        self._turn = turn[order].astype(np.float32)
        self._edge_a, self._edge_b = edge_a[listed], edge_b[listed]
        self._near, self._far = self._shortest[listed], self._longest[listed]
        self._strips = (strip_forest(first, ~self.flat), strip_forest(second, ~self.flat))
        self._span_rad = float(np.max(first.span, initial=0.0) + np.max(second.span, initial=0.0))

    def between(
        self, turn_lo_rad: float, turn_hi_rad: float, distance_mm: float, bound_mm: float
    ) -> tuple[Ints, Ints]:
        """Pairs whose normals may differ by a turn in [lo, hi] and whose points by the distance ± bound.

        Only one edge of each symmetric orbit stands first. Returns (edge_a, edge_b), each (n,).
        """
        margin = self._span_rad + _TURN_ROUNDING_RAD
        width = turn_hi_rad - turn_lo_rad + 2 * margin
        begin = (turn_lo_rad - margin) % (2 * np.pi)
        stretches = [(begin, begin + width)] if width < 2 * np.pi else [(0.0, 2 * np.pi + 1.0)]
        if stretches[0][1] > 2 * np.pi and width < 2 * np.pi:
            stretches = [(begin, 2 * np.pi + 1.0), (0.0, begin + width - 2 * np.pi)]
        parts = []
        for lo, hi in stretches:
            at, end = np.searchsorted(self._turn, (lo, hi), side="left")
            near, far = self._near[at:end], self._far[at:end]
            fits = (near <= np.float32(distance_mm + bound_mm)) & (far >= np.float32(distance_mm - bound_mm))
            parts.append(at + np.flatnonzero(fits))
        found = np.concatenate(parts)
        edge_a, edge_b = self._edge_a[found].astype(np.int64), self._edge_b[found].astype(np.int64)
        if self.flat.all():
            return edge_a, edge_b
        one, two = self._strips[0].pairs(self._strips[1], turn_lo_rad, turn_hi_rad, distance_mm, bound_mm)
        kept = self._first.representative[one]
        return np.concatenate([edge_a, one[kept]]), np.concatenate([edge_b, two[kept]])

    def ranges(self, state: Ints, edge_a: Ints, edge_b: Ints) -> tuple[Floats, Floats]:
        """Shortest and longest distance (mm) for pairs (n,) of edges of `state` (n,), with their slack."""
        columns = self._columns[state]
        rows, within = edge_a - self._first.first[state], edge_b - self._second.first[state]
        index = np.where(columns > 0, self._begin[state] + rows * columns + within, 0)
        large = np.flatnonzero(columns == 0)
        if not len(large):
            return self._shortest[index].astype(np.float64), self._longest[index].astype(np.float64)
        shortest, longest = np.empty(len(state)), np.empty(len(state))
        small = np.flatnonzero(columns > 0)
        shortest[small], longest[small] = self._shortest[index[small]], self._longest[index[small]]
        shortest[large], longest[large] = _slack_range(
            self._first, edge_a[large], self._second, edge_b[large]
        )
        return shortest, longest

    def _all_pairs(self, sizes: Ints) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
        state, within = expand_ranges(np.zeros_like(sizes), sizes)
        width = np.maximum(self._columns[state], 1)
        edge_a = (self._first.first[state] + within // width).astype(np.int32)
        return edge_a, (self._second.first[state] + within % width).astype(np.int32)

    def _distances(
        self, edge_a: NDArray[np.int32], edge_b: NDArray[np.int32]
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        shortest, longest = np.empty(len(edge_a), np.float32), np.empty(len(edge_a), np.float32)
        for begin in range(0, len(edge_a), _AT_ONCE):
            part = slice(begin, begin + _AT_ONCE)
            near, far = _slack_range(self._first, edge_a[part], self._second, edge_b[part])
            shortest[part] = np.nextafter(near.astype(np.float32), np.float32(-np.inf))
            longest[part] = np.nextafter(far.astype(np.float32), np.float32(np.inf))
        return shortest, longest


def _slack_range(
    first: EdgeSet, edge_a: NDArray[np.integer], second: EdgeSet, edge_b: NDArray[np.integer]
) -> tuple[Floats, Floats]:
    shortest, longest = distance_range(
        first.start[edge_a], first.end[edge_a], second.start[edge_b], second.end[edge_b]
    )
    slack = first.slack_mm[edge_a] + second.slack_mm[edge_b]
    return shortest - slack, longest + slack
