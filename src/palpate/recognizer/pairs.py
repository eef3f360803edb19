"""Table of pairs of edges, by the turn between their normals and by their range of distances (memo §2.2.1).

The turn from one edge's normal to the other's does not
depend on the object's orientation, so the pairs that two measured normals allow are one stretch of a sorted
list; in it only the distances are compared. Single precision, rounded outward, keeps large catalogues small.
"""

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from palpate.base.geometry import Bools, Floats, Ints, Singles
from palpate.base.geometry.plane import cross, distance_range
from palpate.recognizer.budget import BudgetSpentError
from palpate.recognizer.contact import NormalRange
from palpate.recognizer.edges import EdgeSet
from palpate.recognizer.strip_trees import strip_forest
from palpate.recognizer.tables import expand_ranges

_PAIRS_AT_ONCE = 1 << 16
_TURN_ROUNDING_RAD = 4e-6  # of angles kept in single precision
_BEYOND_RAD = 8.0  # more than a turn

_Edges = NDArray[np.integer]
_PairFunction = Callable[[EdgeSet, _Edges, EdgeSet, _Edges], tuple[Floats | Singles, Floats | Singles]]


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
        self._shortest, self._longest = self._in_parts(_outward_range, edge_a, edge_b)
        listed = np.flatnonzero(first.representative[edge_a])
        turn = (second.normal_rad[edge_b[listed]] - first.normal_rad[edge_a[listed]]) % (2 * np.pi)
        order = np.argsort(turn)
        listed = listed[order]
        self._turn = turn[order].astype(np.float32)
        self._edge_a, self._edge_b = edge_a[listed], edge_b[listed]
        self._near, self._far = self._shortest[listed], self._longest[listed]
        self._bearing, self._sector = self._in_parts(_sector, self._edge_a, self._edge_b)
        self._strips = (strip_forest(first, ~self.flat), strip_forest(second, ~self.flat))
        self._span_rad = (
            float(np.max(first.span, initial=0.0)),
            float(np.max(second.span, initial=0.0)),
        )

    def between(
        self,
        one: NormalRange,
        two: NormalRange,
        chord_mm: tuple[float, float],
        bound_mm: float,
        most: int | None = None,
    ) -> tuple[Ints, Ints]:
        """Pairs that two contacts may lie on whose outward normals, in W, are in the ranges `one` and `two`.

        `chord_mm`: from the first contact to the second, in W, off by `bound_mm` at most. Only one edge of
        each symmetric orbit stands first. Returns (edge_a, edge_b), each (n,). Raises BudgetSpentError where
        normals alone allow more than `most`.
        """
        turn_lo, turn_hi = two.lo_rad - one.hi_rad, two.hi_rad - one.lo_rad
        distance = math.hypot(*chord_mm)
        parts = []
        stretches = [
            np.searchsorted(self._turn, ends, side="left").tolist()
            for ends in self._stretches(turn_lo, turn_hi)
        ]
        if most is not None and sum(end - at for at, end in stretches) > most:
            raise BudgetSpentError
        for at, end in stretches:
            near, far = self._near[at:end], self._far[at:end]
            fits = (near <= np.float32(distance + bound_mm)) & (far >= np.float32(distance - bound_mm))
            parts.append(at + np.flatnonzero(fits))
        found = np.concatenate(parts)
        found = found[self._seen_along(found, one, chord_mm, bound_mm)]
        edge_a, edge_b = self._edge_a[found].astype(np.int64), self._edge_b[found].astype(np.int64)
        if self.flat.all():
            return edge_a, edge_b
        large_a, large_b = self._strips[0].pairs(self._strips[1], turn_lo, turn_hi, distance, bound_mm, most)
        kept = self._first.representative[large_a]
        return np.concatenate([edge_a, large_a[kept]]), np.concatenate([edge_b, large_b[kept]])

    def _stretches(self, turn_lo: float, turn_hi: float) -> list[tuple[float, float]]:
        """Where in the sorted turns, in [0, 2π), those in [lo, hi] modulo 2π are, with a margin."""
        margin = sum(self._span_rad) + _TURN_ROUNDING_RAD
        width = turn_hi - turn_lo + 2 * margin
        if width >= 2 * np.pi:
            return [(0.0, _BEYOND_RAD)]
        begin = (turn_lo - margin) % (2 * np.pi)
        if begin + width < 2 * np.pi:
            return [(begin, begin + width)]
        return [(begin, _BEYOND_RAD), (0.0, begin + width - 2 * np.pi)]

    def _seen_along(
        self, pair: Ints, one: NormalRange, chord_mm: tuple[float, float], bound_mm: float
    ) -> Bools:
        """Whether the second edge of each listed pair (n,) is seen from the first where the chord points.

        The bearing is the chord's direction, from the first edge's normal on.
        """
        distance = math.hypot(*chord_mm)
        half = (one.hi_rad - one.lo_rad) / 2 + self._span_rad[0] + _TURN_ROUNDING_RAD
        # The model test encloses errors in rectangles; what it keeps this look must not lose.
        error = math.sqrt(2) * bound_mm
        if half >= np.pi or error >= distance:
            return np.ones(len(pair), dtype=bool)
        half += math.asin(error / distance)
        off = self._bearing[pair] - np.float32(
            math.atan2(chord_mm[1], chord_mm[0]) - one.hi_rad / 2 - one.lo_rad / 2
        )
        off -= np.float32(2 * np.pi) * np.rint(off * np.float32(0.5 / np.pi))
        result: Bools = np.abs(off) <= self._sector[pair] + np.float32(half)
        return result

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

    def _in_parts(self, of: _PairFunction, edge_a: _Edges, edge_b: _Edges) -> tuple[Singles, Singles]:
        """Two values of each pair (n,), in single precision; computed part by part."""
        values = np.empty((2, len(edge_a)), np.float32)
        for begin in range(0, len(edge_a), _PAIRS_AT_ONCE):
            part = slice(begin, begin + _PAIRS_AT_ONCE)
            values[:, part] = of(self._first, edge_a[part], self._second, edge_b[part])
        return values[0], values[1]


def _sector(first: EdgeSet, edge_a: _Edges, second: EdgeSet, edge_b: _Edges) -> tuple[Floats, Floats]:
    """Middle and half-width (n,) rad of the directions from points of edge a to points of edge b.

    Counted from the normal of edge a. All differences lie within `reach` of the middles' difference, so they
    are seen in a sector about it: the parallelogram's corners, and the edges' slack beyond them.
    """
    normal, along = first.normal[edge_a], first.direction[edge_a]
    gap = second.centre[edge_b] - first.centre[edge_a]
    across = [
        sign_a * first.half_length[edge_a][:, None] * along
        + sign_b * second.half_length[edge_b][:, None] * second.direction[edge_b]
        for sign_a, sign_b in ((1.0, 1.0), (1.0, -1.0))
    ]
    slack = math.sqrt(2) * (first.slack_mm[edge_a] + second.slack_mm[edge_b])
    nearest = np.full(len(edge_a), np.inf)
    widest = np.zeros(len(edge_a))
    for corner in (gap + sign * part for part in across for sign in (1.0, -1.0)):
        widest = np.maximum(widest, np.abs(np.arctan2(cross(gap, corner), np.sum(gap * corner, axis=1))))
        nearest = np.minimum(nearest, np.hypot(corner[:, 0], corner[:, 1]))
    # Corners less than a right angle off, all of them: the parallelogram does not surround the origin. The
    # nearest of its points is then no nearer than the nearest corner times the cosine of the widest angle.
    apart = nearest * np.cos(np.minimum(widest, np.pi / 2))
    seen = (widest < np.pi / 2) & (apart > slack)
    beyond = np.arcsin(np.clip(slack / np.where(seen, apart, np.inf), 0.0, 1.0))
    bearing = np.arctan2(cross(normal, gap), np.sum(normal * gap, axis=1))
    return bearing, np.where(seen, widest + beyond, np.pi) + _TURN_ROUNDING_RAD


def _slack_range(first: EdgeSet, edge_a: _Edges, second: EdgeSet, edge_b: _Edges) -> tuple[Floats, Floats]:
    shortest, longest = distance_range(
        first.start[edge_a], first.end[edge_a], second.start[edge_b], second.end[edge_b]
    )
    slack = first.slack_mm[edge_a] + second.slack_mm[edge_b]
    return shortest - slack, longest + slack


def _outward_range(
    first: EdgeSet, edge_a: _Edges, second: EdgeSet, edge_b: _Edges
) -> tuple[Singles, Singles]:
    """`_slack_range` in single precision, rounded outward."""
    near, far = _slack_range(first, edge_a, second, edge_b)
    return (
        np.nextafter(near.astype(np.float32), np.float32(-np.inf)),
        np.nextafter(far.astype(np.float32), np.float32(np.inf)),
    )
