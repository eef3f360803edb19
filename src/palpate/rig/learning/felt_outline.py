"""Felt outline: bounds on what tips of one radius can feel of a part, by their contacts and free ways.

Of a part's section a tip of radius r feels its *closing*: all that no disc of radius r, coming from outside,
can cover without meeting the section. Notches into which the tip cannot go belong to it.

*Outer bound.* Where a tip has passed, the section is not. What remains of the workspace is in pieces; the
section, one piece itself, is in one that all contacts can be on.

*Inner bound.* A contact is a point of the section on an arc about the tip's centre, as long as the range of
normals. A tip's centre from which the whole arc is nearer than r, and all within the position's bound of it,
is not free. The union of these places, with what they enclose and nothing can reach from outside, shrunk by
r, is part of the closing.

Geometry is rounded outward: chords of arcs are inside of what is swept or blocked, and shrinking goes as much
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
class FeltOutline:
    """Bounds on the outline that tips of `radius_mm` feel: the section's closing holds all of `inner`, and
    nothing outside of `outer`; both in W. `touched_mm` (n, 2): about where it was touched.
    """

    radius_mm: float
    inner: shapely.Geometry
    outer: shapely.Geometry
    touched_mm: Floats
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
    radius = contacts[0].finger.tip_radius_mm
    arcs = [_contact_arc(item) for item in contacts if item.touched]
    touched = np.array([(arc.first_mm + arc.last_mm) / 2 for arc in arcs]).reshape(-1, 2)
    outer = _outer_bound(contacts, workspace_radius_mm)
    return FeltOutline(radius, _inner_bound(arcs, radius), outer, touched, workspace_radius_mm)


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


@dataclass(frozen=True, eq=False)
class _ContactArc:
    """Arc on which the section was touched: its ends (2,), and how far off their chord the point may be."""

    first_mm: Floats
    last_mm: Floats
    off_mm: float


def _contact_arc(contact: Contact) -> _ContactArc:
    normals = contact.outward_normals()
    lo, hi = (0.0, 2 * math.pi) if normals is None else (normals.lo_rad, normals.hi_rad)
    radius, end = contact.finger.tip_radius_mm, np.array(contact.end_mm)
    first, last = (end - radius * np.array([math.cos(angle), math.sin(angle)]) for angle in (lo, hi))
    bulge = radius * (1 - math.cos(min((hi - lo) / 2, math.pi)))
    return _ContactArc(first, last, contact.position_bound_mm + bulge + _ROUNDING_MM)


def _inner_bound(arcs: Sequence[_ContactArc], radius_mm: float) -> shapely.Geometry:
    near = [arc for arc in arcs if arc.off_mm < radius_mm]
    far = np.array([radius_mm - arc.off_mm for arc in near])
    discs = [
        shapely.buffer(shapely.points(np.array(ends).reshape(-1, 2)), far, quad_segs=_CHORDS_PER_QUARTER)
        for ends in ([arc.first_mm for arc in near], [arc.last_mm for arc in near])
    ]
    blocked = shapely.union_all(shapely.intersection(*discs))
    # What is enclosed no tip comes to from outside.
    solid = [shapely.Polygon(piece.exterior) for piece in shapely.get_parts(blocked)]
    return shapely.union_all(solid).buffer(-radius_mm * _AROUND - _ROUNDING_MM, _CHORDS_PER_QUARTER)
