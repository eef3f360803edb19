"""Edge sets: the edges that one kind of finger can meet, over the whole catalogue, in flat arrays.

They are sorted by normal within a state, so that the angle test is a range look-up. Made by `grown_edges`.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from palpate.base.geometry import Bools, Floats, Ints, State
from palpate.base.short_repr import ShortRepr
from palpate.recognizer.budget import BudgetSpentError
from palpate.recognizer.symmetry import Symmetry
from palpate.recognizer.tables import expand_ranges

ROUNDING_MM = 1e-6
"""Allowance for floating-point error in every comparison of lengths; coordinates are below 10⁴ mm."""

ROUNDING_RAD = 1e-9
"""The same for normals."""

NULL_EDGE = -1
"""Stands for an edge where a contact is taken as spurious: the null branch of the interpretation tree."""

_ROUGH_RAD = np.pi / 2  # mean half-turn of the normal on a state's edges
_SUPPORT_DIRECTIONS = 360
_NO_SUPPORT_MM = -1e4  # support of what is not there
_KEY_STRIDE_RAD = 16.0  # rad between the sorted normals of one state and the next: more than two turns


@dataclass(frozen=True, eq=False, repr=False)
class CatalogueState(ShortRepr):
    """One state of one object, as hypotheses name it.

    `origin_mm` is the centroid in the frame of the object's file; inside the recogniser the centroid is the
    origin, so that a symmetry turns the object about its own origin. `tolerance_mm` is by how much the
    vertices of the true outline may be off. `holds_n`, `support_mm`, `normal_bound_rad` and
    `least_tip_radius_mm` are the object's.
    """

    object_name: str
    state: State
    origin_mm: Floats
    symmetry: Symmetry
    tolerance_mm: float
    holds_n: float | None = None
    support_mm: float | None = None
    normal_bound_rad: float | None = None
    least_tip_radius_mm: float | None = None

    @property
    def symmetry_order(self) -> int:
        """Order of the symmetry: the state looks the same after each nth of a turn; 0: however it is turned.

        A round state is searched as the polygon that stands for it, of the order of its `symmetry`.
        """
        return 0 if self.state.is_round else self.symmetry.order

    @property
    def rounding_mm(self) -> float:
        """Allowance for rounding and for a symmetry that is not quite one."""
        return ROUNDING_MM + self.symmetry.off_mm

    @property
    def is_exactly_symmetric(self) -> bool:
        """True if the allowances for rounding alone cover what the symmetry is off by."""
        return self.symmetry.off_mm <= ROUNDING_MM / 4 and self.symmetry.lean_rad <= ROUNDING_RAD / 4


@dataclass(frozen=True, eq=False)
class EdgeGrid:
    """Midpoints (mm) and half lengths of edges, one row for each of S states, (S, columns).

    Edge k of a state stands in column k; where a state has no more, `half_length` is −∞.
    """

    centre_x: Floats
    centre_y: Floats
    half_length: Floats


@dataclass(frozen=True, eq=False)
class EdgeSet:
    """The grown edges that one kind of finger can meet, over the whole catalogue; n edges, S states.

    `state` (n,), `start`, `end`, `direction` and outward `normal` (n, 2), `length` (n,), all in the centred
    object frames in mm, neighbours meeting in the same numbers; `slack_in` and `slack_out` (n,): how far the
    tip's centre may lie inside or outside of the edge's line though nothing is mismeasured; `normal_rad`
    (n,) in [0, 2π), ascending within a state; `span` (n,) half-turn of the normal on the edge;
    `representative` (n,): one edge of each symmetric orbit; `first` (S + 1,): where each state begins.
    """

    state: Ints
    start: Floats
    end: Floats
    direction: Floats
    normal: Floats
    length: Floats
    slack_in: Floats
    slack_out: Floats
    slack_along: Floats
    normal_rad: Floats
    span: Floats
    feature: Ints
    representative: Bools
    first: Ints

    @property
    def count(self) -> Ints:
        """Edges in each state, shape (S,)."""
        return np.diff(self.first)

    @property
    def supports_shape(self) -> tuple[int, ...]:
        """Shape of a state's supports."""
        return (_SUPPORT_DIRECTIONS,)

    def with_supports(self, supports: Floats) -> "EdgeSet":
        """The same edges, whose `supports` (S, …) were worked out before."""
        result = replace(self)
        vars(result)["supports"] = supports  # where a cached property keeps its value
        return result

    @cached_property
    def is_rough(self) -> Bools:
        """Mask of states (S,) on whose edges normals may point nearly anywhere.

        There neighbours overlap: pairing a contact with edges says little, and multiplies interpretations.
        """
        result: Bools = self.mean_turn_rad > _ROUGH_RAD
        return result

    @cached_property
    def mean_turn_rad(self) -> Floats:
        """Mean half-turn of the normal (S,) along the edges of each state."""
        states = len(self.count)
        turned = np.bincount(self.state, self.length * self.span, states)
        result: Floats = turned / np.maximum(np.bincount(self.state, self.length, states), 1e-300)
        return result

    @cached_property
    def centre(self) -> Floats:
        """Midpoint (n, 2) of each edge."""
        return (self.start + self.end) / 2

    @cached_property
    def half_length(self) -> Floats:
        """Half of each edge's length, (n,)."""
        return self.length / 2

    def grid(self, columns: int) -> "EdgeGrid":
        """The edges of states that have at most so many, in rows."""
        if columns not in self._grids:
            self._grids[columns] = self._grid(columns)
        return self._grids[columns]

    @cached_property
    def _grids(self) -> "dict[int, EdgeGrid]":
        return {}

    def _grid(self, columns: int) -> "EdgeGrid":
        row, column = self.state, np.arange(len(self.state)) - self.first[self.state]
        row, column = row[column < columns], column[column < columns]
        x, y = np.zeros((2, len(self.count), columns))
        half = np.full((len(self.count), columns), -np.inf)
        edge = self.first[row] + column
        x[row, column], y[row, column] = self.centre[edge].T
        half[row, column] = self.half_length[edge]
        return EdgeGrid(x, y, half)

    @cached_property
    def middle(self) -> Floats:
        """Middle (n, 2) of the rectangle in which the tip's centre may lie though nothing is mismeasured."""
        outward = (self.slack_out - self.slack_in) / 2
        result: Floats = self.start + self.direction * (self.length / 2)[:, None]
        return result + self.normal * outward[:, None]

    @cached_property
    def half_across(self) -> Floats:
        """Half of that rectangle's size across the edge, (n,)."""
        return (self.slack_out + self.slack_in) / 2

    @cached_property
    def half_along(self) -> Floats:
        """Half of that rectangle's size along the edge, (n,)."""
        return self.length / 2 + self.slack_along

    @cached_property
    def sides(self) -> Floats:
        """Directions (n, 4, 2) of the half-planes of a contact on each edge: −n, n, −t, t (`half_planes`)."""
        return np.stack([-self.normal, self.normal, -self.direction, self.direction], axis=1)

    @cached_property
    def side_limits(self) -> Floats:
        """Constants (n, 4) of these half-planes, mm, for a contact without error at the anchor."""
        offset = np.sum(self.normal * self.start, axis=1)
        begin = np.sum(self.direction * self.start, axis=1)
        return np.stack(
            [
                offset + self.slack_out,
                self.slack_in - offset,
                begin + self.length + self.slack_along,
                self.slack_along - begin,
            ],
            axis=1,
        )

    @cached_property
    def slack_mm(self) -> Floats:
        """Distances from edges at which the tip's centre may lie though nothing is mismeasured, (n,)."""
        return np.hypot(np.maximum(self.slack_in, self.slack_out), self.slack_along)

    @cached_property
    def state_reach_mm(self) -> Floats:
        """Largest distance from the centroid at which each state's outline may be met, (S,)."""
        return self._most(np.hypot(*self.start.T)) + self.state_slack_mm

    def support(self, state: Ints, angle_rad: Floats) -> Floats:
        """Extent of each outline (m,) from its centroid in a direction (m,), mm: to about 0.01 mm.

        −10⁴ where nothing is high enough.
        """
        place = (angle_rad % (2 * np.pi)) * (_SUPPORT_DIRECTIONS / (2 * np.pi))
        below = place.astype(np.int64)
        share = place - below
        table = self.supports
        result: Floats = (1 - share) * table[state, below % _SUPPORT_DIRECTIONS]
        return result + share * table[state, (below + 1) % _SUPPORT_DIRECTIONS]

    @cached_property
    def supports(self) -> Floats:
        """Support of each state (S, _SUPPORTS) in evenly spaced directions."""
        angle = np.arange(_SUPPORT_DIRECTIONS) * (2 * np.pi / _SUPPORT_DIRECTIONS)
        towards = np.stack([np.cos(angle), np.sin(angle)])
        table = np.full((len(self.count), _SUPPORT_DIRECTIONS), _NO_SUPPORT_MM)
        for state in np.flatnonzero(self.count):
            block = slice(int(self.first[state]), int(self.first[state + 1]))
            table[state] = (self.start[block] @ towards).max(axis=0)
        return table

    @cached_property
    def state_slack_mm(self) -> Floats:
        """Largest slack of each state's edges, (S,)."""
        return self._most(self.slack_mm)

    def _most(self, value: Floats) -> Floats:
        result = np.zeros(len(self.first) - 1)
        np.maximum.at(result, self.state, value)
        return result

    @cached_property
    def _keys(self) -> Floats:
        once = self.state * _KEY_STRIDE_RAD + self.normal_rad
        return np.sort(np.concatenate([once, once + 2 * np.pi]))

    def by_normal(
        self, state: Ints, lo_rad: Floats, width_rad: Floats, most: int | None = None
    ) -> tuple[Ints, Ints]:
        """Edges of `state` (m,) whose normal angle lies in [lo, lo + width] (m,), widths at most 2π.

        Returns (owner, edge), flat, owner indexing the m queries. Raises BudgetSpentError where there are
        more than `most`.
        """
        lo = lo_rad % (2 * np.pi) + state * _KEY_STRIDE_RAD
        first = np.searchsorted(self._keys, lo - 1e-12, side="left")
        last = np.searchsorted(self._keys, lo + width_rad + 1e-12, side="right")
        # In each state's stretch of keys the edges come twice, a turn apart; a full turn meets each once.
        count = np.minimum(last - first, self.count[state])
        if most is not None and count.sum() > most:
            raise BudgetSpentError
        owner, key = expand_ranges(first, count)
        begin = self.first[state[owner]]
        size = self.count[state[owner]]
        within = key - 2 * begin
        return owner, begin + within - np.where(within >= size, size, 0)


def ring_order(start: Floats, end: Floats) -> tuple[Ints, list[int]]:
    """Closed outlines of n edges, which meet in the same numbers, walked ring after ring.

    Returns the edges (n,) in that order, and the size of each ring.
    """
    following = np.empty(len(start), np.int64)
    following[np.lexsort(end.T)] = np.lexsort(start.T)
    follow, left = following.tolist(), np.ones(len(start), dtype=bool)
    order: list[int] = []
    sizes = []
    for first in range(len(start)):
        ring, at = [], first
        while left[at]:
            left[at] = False
            ring.append(at)
            at = follow[at]
        if ring:
            order += ring
            sizes.append(len(ring))
    return np.array(order, dtype=np.int64), sizes
