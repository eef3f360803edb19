"""Felt outline: bounds on what tips of one radius can feel of a part, by their contacts and free ways.

Of a part's section a tip of radius r feels its *closing*: all that no disc of radius r, coming from outside,
can cover without meeting the section. Notches into which the tip cannot go belong to it.

*Outer bound.* Where a tip has passed, the section is not. What remains of the workspace is in pieces; the
section, one piece itself, is in one that all contacts can be on.

*Inner bound.* A contact is a point of the section on an arc about the tip's centre, as long as the range of
normals. A tip's centre from which the whole arc is nearer than r, and all within the position's bound of it,
is not free. No point of an arc of at most half a turn is further from such a place than both its ends are: it
would have to lie opposite, and then one of the ends is further away than r as well. The union of these
places, with what they enclose and nothing can reach from outside, shrunk by r, is part of the closing.

Geometry is rounded outward: chords of arcs are inside of what is swept or not free; shrinking goes as much
further as they may stray.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import shapely

from palpate.base.geometry import Floats
from palpate.recognizer import Contact

_CHORDS_PER_QUARTER = 32
_AROUND = 1 / math.cos(math.pi / (4 * _CHORDS_PER_QUARTER))  # by which chords stay inside of their arc
_ROUNDING_MM = 1e-6
_SLIVER_MM2 = 1e-6


@dataclass(frozen=True, eq=False)
class TouchedArcs:
    """Arcs (n,) on which the section was touched, by their ends (n, 2) in W.

    `off_mm` (n,): how far off the arc the point may be. `bulge_mm` (n,): how far the arc is from its chord;
    infinite if it is longer than half a turn.
    """

    first_mm: Floats
    last_mm: Floats
    off_mm: Floats
    bulge_mm: Floats

    @property
    def middles_mm(self) -> Floats:
        """Middles (n, 2) of the arcs' chords."""
        result: Floats = (self.first_mm + self.last_mm) / 2
        return result

    def barriers(self, radius_mm: float) -> tuple[shapely.Geometry, ...]:
        """Places that each touch proves not to be free for a tip's centre; empty if it proves none."""
        return self._near_both(np.where(np.isfinite(self.bulge_mm), radius_mm - self.off_mm, 0.0))

    def surroundings(self, distance_mm: float) -> tuple[shapely.Geometry, ...]:
        """Places that each touch proves to be within a distance of the section; empty if it proves none."""
        return self._near_both(distance_mm - self.off_mm - self.bulge_mm)

    def distances_mm(self, points_mm: Floats) -> Floats:
        """Distance of each point (k, 2) from the section (k,), at most; infinite if there are no touches."""
        ends = (points_mm[:, None] - item for item in (self.first_mm, self.last_mm))
        far = np.maximum(*(np.linalg.norm(item, axis=2) for item in ends)) + self.off_mm + self.bulge_mm
        result: Floats = far.min(axis=1, initial=np.inf)
        return result

    def _near_both(self, near_mm: Floats) -> tuple[shapely.Geometry, ...]:
        """Places no further than (n,) from both ends of each arc."""
        near = np.maximum(near_mm, 0.0)
        discs = [
            shapely.buffer(shapely.points(ends), near, quad_segs=_CHORDS_PER_QUARTER)
            for ends in (self.first_mm, self.last_mm)
        ]
        return tuple(shapely.intersection(*discs))


@dataclass(frozen=True, eq=False)
class FeltOutline:
    """Bounds on the outline that tips of `radius_mm` feel: the section's closing holds all of `inner`, and
    nothing outside of `outer`; both in W. `touched`: where the section was touched.
    """

    radius_mm: float
    inner: shapely.Geometry
    outer: shapely.Geometry
    touched: TouchedArcs
    workspace_radius_mm: float

    @property
    def is_closed(self) -> bool:
        """True if tips have passed all round, and feel one piece that is solid inside."""
        if self.inner.is_empty or not self.holds_together:
            return False
        reach = float(np.hypot(*shapely.get_coordinates(self.outer).T).max(initial=0.0))
        return isinstance(self.outer, shapely.Polygon) and reach < self.workspace_radius_mm - _ROUNDING_MM

    @property
    def holds_together(self) -> bool:
        """False if what is certainly felt sticks out of what may be: the part moved, or a bound is wrong."""
        return bool(self.inner.difference(self.outer).area <= _SLIVER_MM2)

    @property
    def band(self) -> shapely.Geometry:
        """Where the felt outline may be."""
        return self.outer.difference(self.inner)


def felt_outline(contacts: Sequence[Contact], workspace_radius_mm: float) -> FeltOutline:
    """Bounds by contacts and misses of upright tips of one radius and height."""
    radius, arcs = contacts[0].finger.tip_radius_mm, _arcs_of(contacts)
    inner = _inner_bound(arcs.barriers(radius), radius)
    return FeltOutline(radius, inner, _outer_bound(contacts, workspace_radius_mm), arcs, workspace_radius_mm)


def swept_room(contacts: Iterable[Contact]) -> shapely.Geometry:
    """Room that tips have passed through, and that the part does not fill."""
    ways = [
        shapely.LineString([item.start_mm, item.end_mm]).buffer(free, _CHORDS_PER_QUARTER)
        for item in contacts
        if (free := item.finger.tip_radius_mm - item.free_path_bound_mm) > 0
    ]
    return shapely.union_all(ways)


def _outer_bound(contacts: Sequence[Contact], workspace_radius_mm: float) -> shapely.Geometry:
    room = shapely.Point(0, 0).buffer(workspace_radius_mm * _AROUND, _CHORDS_PER_QUARTER)
    left = room.difference(swept_room(contacts))
    pieces = np.array(shapely.get_parts(left))
    touched = [item for item in contacts if item.touched]
    if not len(pieces) or not touched:
        return left
    ends = shapely.points([item.end_mm for item in touched])
    reach = np.array([item.finger.tip_radius_mm + item.position_bound_mm for item in touched])
    near = shapely.distance(pieces[:, None], ends) <= reach + _ROUNDING_MM
    held = pieces[near.all(axis=1)]
    return shapely.union_all(held)


def _arcs_of(contacts: Iterable[Contact]) -> TouchedArcs:
    first, last, off, bulge = list[Floats](), list[Floats](), list[float](), list[float]()
    for item in contacts:
        if not item.touched:
            continue
        normals, end, radius = item.outward_normals(), np.array(item.end_mm), item.finger.tip_radius_mm
        lo, hi = (0.0, 2 * math.pi) if normals is None else (normals.lo_rad, normals.hi_rad)
        first.append(end - radius * np.array([math.cos(lo), math.sin(lo)]))
        last.append(end - radius * np.array([math.cos(hi), math.sin(hi)]))
        off.append(item.position_bound_mm + _ROUNDING_MM)
        bulge.append(radius * (1 - math.cos((hi - lo) / 2)) if hi - lo <= math.pi else math.inf)
    places = np.array([*first, *last]).reshape(2, -1, 2)
    return TouchedArcs(places[0], places[1], np.array(off), np.array(bulge))


def _inner_bound(barriers: Sequence[shapely.Geometry], radius_mm: float) -> shapely.Geometry:
    # What is enclosed no tip comes to from outside.
    solid = [shapely.Polygon(piece.exterior) for piece in shapely.get_parts(shapely.union_all(barriers))]
    return shapely.union_all(solid).buffer(-radius_mm * _AROUND - _ROUNDING_MM, _CHORDS_PER_QUARTER)
