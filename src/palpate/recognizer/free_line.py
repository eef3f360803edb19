"""Free lines: whether the centre of a tip, going straight, keeps clear of a section.

Clear means: no nearer to the section than the radius, less the object's tolerance; if the tolerance is more
than the radius, no deeper in it than by the rest.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from palpate.base.geometry import Bools, Floats, Ints
from palpate.recognizer.tables import Table, expand_ranges
from palpate.recognizer.true_boundary import TrueBoundary

__all__ = ["ALLOWANCE_MM", "clearances", "lines_are_free"]

ALLOWANCE_MM = 1e-6
"""By so much a tip may be nearer, or further, than a bound says: for rounding."""

_PAIRS_AT_ONCE = 2_000_000


@dataclass(frozen=True, eq=False)
class _Seen(Table):
    """Pairs (k) of a line and a side, the side's ends as seen along the line: ahead x, to the left y, mm."""

    line: Ints
    x0: Floats
    y0: Floats
    x1: Floats
    y1: Floats

    @cached_property
    def crossing(self) -> Bools:
        """Whether the line crosses the side. Neighbours share the numbers of their corner."""
        result: Bools = (self.y0 > 0) != (self.y1 > 0)
        return result

    @cached_property
    def crossed_at(self) -> Floats:
        """Where it does, ahead of the line's beginning; anything where it does not."""
        rise = np.where(self.crossing, self.y1 - self.y0, 1.0)
        return self.x0 - self.y0 * (self.x1 - self.x0) / rise

    def distance(self, x: Floats) -> Floats:
        """From the point x (k,) of the line to the side."""
        u, v = self.x1 - self.x0, self.y1 - self.y0
        share = np.clip(((x - self.x0) * u - self.y0 * v) / np.maximum(u * u + v * v, 1e-300), 0.0, 1.0)
        result: Floats = np.hypot(self.x0 + share * u - x, self.y0 + share * v)
        return result


def clearances(boundary: TrueBoundary, state: Ints, point: Floats) -> Floats:
    """Distance of points (q, 2) from the outlines in mm, negative inside; infinite: nothing is there."""
    seen = _seen(boundary, state, point, np.tile([1.0, 0.0], (len(state), 1)))
    nearest = np.full(len(state), np.inf)
    np.minimum.at(nearest, seen.line, seen.distance(np.zeros(len(seen))))
    return np.where(_begin_inside(seen, len(state)), -nearest, nearest)


def lines_are_free(boundary: TrueBoundary, state: Ints, begin: Floats, end: Floats) -> Bools:
    """Which straight paths of the tip's centre (q,) are clear of the object; begin and end (q, 2)."""
    count = np.diff(boundary.first_side)[state]
    cuts = np.flatnonzero(np.diff(np.cumsum(count) // _PAIRS_AT_ONCE)) + 1
    free = np.ones(len(state), dtype=bool)
    for rows in np.split(np.arange(len(state)), cuts):
        leg = end[rows] - begin[rows]
        travel = np.hypot(*leg.T)
        heading = np.where(travel[:, None] > 0, leg / np.maximum(travel, 1e-300)[:, None], [1.0, 0.0])
        seen = _seen(boundary, state[rows], begin[rows], heading)
        clearance = boundary.clearance_mm[state[rows]] - ALLOWANCE_MM
        apart = clearance > 0
        if apart.any():
            free[rows[apart]] = _keeps_away(seen, travel, clearance)[apart]
        if not apart.all():
            free[rows[~apart]] = _stays_shallow(seen, travel, -clearance)[~apart]
    return free


def _seen(boundary: TrueBoundary, state: Ints, begin: Floats, heading: Floats) -> _Seen:
    """All sides of each line's state (q,), seen along the line."""
    sides = boundary.sides
    line, side = expand_ranges(boundary.first_side[state], np.diff(boundary.first_side)[state])
    (x, y), (u, v) = begin[line].T, heading[line].T
    ahead = []
    for corner in (sides.start[side], sides.end[side]):
        a, b = corner[:, 0] - x, corner[:, 1] - y
        ahead += [u * a + v * b, u * b - v * a]
    return _Seen(line, *ahead)


def _begin_inside(seen: _Seen, lines: int) -> Bools:
    """Whether lines begin inside: then an odd number of sides crosses them before they do."""
    behind = seen.select(seen.crossing & (np.minimum(seen.x0, seen.x1) < 0))
    before = behind.line[behind.crossed_at < 0]
    inside: Bools = np.bincount(before, minlength=lines) % 2 == 1
    return inside


def _keeps_away(seen: _Seen, travel: Floats, clearance: Floats) -> Bools:
    """Lines (q,) that begin outside and come nowhere nearer to a side than the clearance (q,), positive."""
    blocked = _begin_inside(seen, len(travel))
    far, wide = travel[seen.line], clearance[seen.line]
    near = (np.minimum(seen.y0, seen.y1) < wide) & (np.maximum(seen.y0, seen.y1) > -wide)
    near &= (np.minimum(seen.x0, seen.x1) < far + wide) & (np.maximum(seen.x0, seen.x1) > -wide)
    seen, far, wide = seen.select(near), far[near], wide[near]
    away = np.minimum(seen.distance(np.zeros(len(seen))), seen.distance(far))
    for x, y in ((seen.x0, seen.y0), (seen.x1, seen.y1)):
        away = np.minimum(away, np.hypot(x - np.clip(x, 0.0, far), y))
    at = seen.crossed_at
    hit = (away < wide) | (seen.crossing & (at >= 0) & (at <= far))
    blocked[seen.line[hit]] = True
    return ~blocked


def _stays_shallow(seen: _Seen, travel: Floats, depth: Floats) -> Bools:
    """Lines (q,) that are nowhere inside and further than `depth` (q,) from every side."""
    wide = depth[seen.line]
    seen = seen.select((np.minimum(seen.y0, seen.y1) <= wide) & (np.maximum(seen.y0, seen.y1) >= -wide))
    enter, leave = _within(seen, depth[seen.line])
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


def _within(seen: _Seen, wide: Floats) -> tuple[Floats, Floats]:
    """Where lines come within `wide` (k,) of their sides, and where they leave; enter > leave: nowhere."""
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
    at = seen.crossed_at
    enter = np.where(seen.crossing, np.minimum(enter, at), enter)
    leave = np.where(seen.crossing, np.maximum(leave, at), leave)
    return enter, leave
