"""Swept volumes of fingers, and their distances from obstacles and from one another; whole arrays, mm.

Everything that a finger sweeps is kept as straight capsules with half widths: what does not change shape on
the way as it is, what does (the links of an arm) at samples whose half widths are larger by as much as any
point of them moves up to the middle between two samples.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from palpate.base.geometry import Bools, Floats, Ints
from palpate.base.geometry.plane import distance_range, points_in_polygon
from palpate.drivers.kinematics import FingerBody

_PAIRS_PER_BATCH = (
    200_000  # pairs of capsules in one piece of work: bounds the temporary arrays to tens of MB
)
_BISECTIONS = 12

_Point = Sequence[float]


@dataclass(frozen=True, eq=False)
class BodyCapsules:
    """Capsules: segments `start` to `end` (s, 2) with half widths (s,); `owner` (s,): the body of each."""

    start: Floats
    end: Floats
    half_width: Floats
    owner: Ints

    def of(self, rows: Ints | Bools) -> "BodyCapsules":
        """Part of the capsules."""
        return BodyCapsules(self.start[rows], self.end[rows], self.half_width[rows], self.owner[rows])


@dataclass(frozen=True, eq=False)
class Swept:
    """Room that n approaches sweep, as a function of how far each goes.

    `capsules` that count from a travel of `since` (s,) on. `grows` (s,): this capsule's end moves on along
    `heading` (n, 2) of its approach; all other capsules stay as they are.
    """

    capsules: BodyCapsules
    since: Floats
    grows: Bools
    heading: Floats

    def of(self, rows: Bools) -> "Swept":
        """Part of the capsules, of all approaches."""
        return Swept(self.capsules.of(rows), self.since[rows], self.grows[rows], self.heading)

    def only(self, which: Ints) -> "Swept":
        """Room of some approaches (indices, ascending), which count from 0 then."""
        some = self.of(np.isin(self.capsules.owner, which))
        owner = np.searchsorted(which, some.capsules.owner)
        capsules = replace(some.capsules, owner=owner)
        return replace(some, capsules=capsules, heading=self.heading[which])

    def at(self, which: Ints, travel_mm: Floats) -> BodyCapsules:
        """Capsules swept by approaches `which` (k,) after travels (k,); `owner` is the place in `which`."""
        first, end = (np.searchsorted(self.capsules.owner, which, side=side) for side in ("left", "right"))
        place = np.repeat(np.arange(len(which)), end - first)
        rows = np.arange(len(place)) - np.repeat(np.cumsum(end - first) - end, end - first)
        counted = self.since[rows] < travel_mm[place]
        rows, place = rows[counted], place[counted]
        kept = self.capsules.of(rows)
        way = np.where(self.grows[rows], np.maximum(travel_mm[place], 0.0), 0.0)
        moved = kept.end + way[:, None] * self.heading[kept.owner]
        return BodyCapsules(kept.start, moved, kept.half_width, place)


def capsules_of(bodies: Sequence[FingerBody], *, between: bool = False) -> BodyCapsules:
    """Capsules of m bodies. With `between`, also what is between each and the next one of the same finger.

    Ends of a capsule move on arcs or straight; up to the middle between two samples they are within half the
    way from one of them to the other plus the arc's height, which is less than half of it again.
    """
    starts, ends = np.stack([b.start for b in bodies]), np.stack([b.end for b in bodies])
    widths = np.stack([b.half_width for b in bodies])
    if between and len(bodies) > 1:
        way = np.maximum(_steps(starts), _steps(ends))  # (m - 1, k)
        nearest = np.zeros_like(widths)
        nearest[:-1] = way
        nearest[1:] = np.maximum(nearest[1:], way)
        widths = widths + 0.75 * nearest
    count = starts.shape[1]
    owner = np.repeat(np.arange(len(bodies)), count)
    return BodyCapsules(starts.reshape(-1, 2), ends.reshape(-1, 2), widths.ravel(), owner)


def is_apart(one: FingerBody, other: FingerBody, clearance_mm: float) -> bool:
    """True if all capsules of one body are at least `clearance_mm` from all of the other.

    The same as by `gap_mm`, for the few capsules of two fingers, in a loop that drives servos: there arrays
    cost more than they save.
    """
    return all(
        _apart_mm(a, b, c, d) - width - wide >= clearance_mm
        for a, b, width in zip(one.start.tolist(), one.end.tolist(), one.half_width.tolist(), strict=True)
        for c, d, wide in zip(
            other.start.tolist(), other.end.tolist(), other.half_width.tolist(), strict=True
        )
    )


def _apart_mm(a: _Point, b: _Point, c: _Point, d: _Point) -> float:
    """Shortest distance between segments ab and cd."""
    if _side(a, b, c) * _side(a, b, d) < 0 and _side(c, d, a) * _side(c, d, b) < 0:
        return 0.0
    return min(_off_mm(a, c, d), _off_mm(b, c, d), _off_mm(c, a, b), _off_mm(d, a, b))


def _off_mm(point: _Point, start: _Point, end: _Point) -> float:
    """Distance of a point from a segment."""
    x, y = end[0] - start[0], end[1] - start[1]
    u, v = point[0] - start[0], point[1] - start[1]
    square = x * x + y * y
    share = 0.0 if square == 0.0 else min(max((u * x + v * y) / square, 0.0), 1.0)
    return math.hypot(u - share * x, v - share * y)


def _side(a: _Point, b: _Point, c: _Point) -> float:
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])


def gaps_mm(one: BodyCapsules, other: BodyCapsules) -> Floats:
    """Free space (s, t) between all capsules of one and all of the other; negative where they overlap."""
    result = np.empty((len(one.owner), len(other.owner)))
    rows = max(1, _PAIRS_PER_BATCH // max(len(other.owner), 1))
    for first in range(0, len(one.owner), rows):
        part = one.of(np.arange(first, min(first + rows, len(one.owner))))
        i, j = np.divmod(np.arange(len(part.owner) * len(other.owner)), max(len(other.owner), 1))
        apart, _ = distance_range(part.start[i], part.end[i], other.start[j], other.end[j])
        free = apart - part.half_width[i] - other.half_width[j]
        result[first : first + len(part.owner)] = free.reshape(len(part.owner), -1)
    return result


def gap_mm(one: BodyCapsules, other: BodyCapsules) -> Floats:
    """Free space (s,) between every capsule of one and whatever of the other is nearest; inf for none."""
    nearest: Floats = gaps_mm(one, other).min(axis=1, initial=np.inf)
    return nearest


def polygon_gap_mm(capsules: BodyCapsules, corners: Floats) -> Floats:
    """Free space (s,) between capsules and a polygon with corners (c, 2); negative for what is inside."""
    ends = np.roll(corners, -1, axis=0)
    edges = BodyCapsules(corners, ends, np.zeros(len(corners)), np.zeros(len(corners), np.int64))
    return np.where(
        points_in_polygon(capsules.start, [corners]), -capsules.half_width, gap_mm(capsules, edges)
    )


def longest_way_mm(swept: Swept, travel_mm: Floats, free: Callable[[BodyCapsules], Bools]) -> Floats:
    """Longest way (n,) of each approach, up to `travel_mm` (n,), on which all its capsules are free.

    `free` tells for every capsule by itself. −1 where not even the waiting finger is free. What is swept only
    grows, so the ways are halved until they are exact to a fraction of a millimetre, rounded down.
    """
    longest = travel_mm.copy()
    still = swept.capsules.of(~swept.grows)
    blocked = np.flatnonzero(~free(still))
    np.minimum.at(longest, still.owner[blocked], swept.since[~swept.grows][blocked])

    only = swept.of(swept.grows)

    def clear(rows: Ints, travel: Floats) -> Bools:
        result = np.ones(len(rows), dtype=bool)
        moving = only.at(rows, travel)
        np.logical_and.at(result, moving.owner, free(moving))
        return result

    hi = np.maximum(longest, 0.0)
    short = np.flatnonzero(~clear(np.arange(len(hi)), hi))
    if len(short):
        longest[short] = np.minimum(longest[short], _bisect_travel(short, hi[short], clear))
    return np.where(longest < 0, -1.0, longest)


def _bisect_travel(rows: Ints, hi: Floats, clear: Callable[[Ints, Floats], Bools]) -> Floats:
    """The longest clear travel (m,) of each of `rows` (m,), less than `hi` (m,); −1 if not even 0 is."""
    lo = np.zeros_like(hi)
    nowhere = ~clear(rows, lo)
    for _ in range(_BISECTIONS):
        middle = (lo + hi) / 2
        good = clear(rows, middle)
        lo, hi = np.where(good, middle, lo), np.where(good, hi, middle)
    return np.where(nowhere, -1.0, lo)


def _steps(points: Floats) -> Floats:
    """Lengths (m - 1, k) of steps between points (m, k, 2)."""
    length: Floats = np.hypot(*np.moveaxis(np.diff(points, axis=0), 2, 0))
    return length
