"""What a straight approach must and may meet, over every configuration in a cell.

Used backwards as evidence (the path before a contact was free; a missed approach was free all along) and
forwards as prediction (where will the finger stop?), so that planner and recogniser cannot disagree. If no
point of the object is further than ρ from where the cell's middle configuration puts it, the finger cannot
stop before it comes within ρ of the middle outline, and cannot pass a point that lies deeper than ρ in it.
"""

from dataclasses import dataclass

import numpy as np

from palpate.recognizer.arrays import Bools, Floats
from palpate.recognizer.catalogue import Catalogue, EdgeSet
from palpate.recognizer.contact import Contact, Finger
from palpate.recognizer.region import Cells
from palpate.recognizer.segments import capsule_interval

__all__ = ["Approach", "StopInterval", "sweep", "unblocked"]

_RAYS_TIMES_EDGES = 400_000  # in one piece: bounds the temporary arrays to tens of MB


@dataclass(frozen=True, eq=False)
class Approach:
    """A straight path of a tip's centre in W: from `start_mm` along `direction_rad` for `travel_mm`."""

    finger: Finger
    start_mm: tuple[float, float]
    direction_rad: float
    travel_mm: float
    position_bound_mm: float


@dataclass(frozen=True, eq=False)
class StopInterval:
    """For k cells: the finger stops after a travel within [`earliest`, `latest`] (k,) mm.

    `earliest` is infinite where nothing can be met; `latest` is infinite where the finger may miss.
    """

    earliest: Floats
    latest: Floats


def sweep(catalogue: Catalogue, cells: Cells, anchor_mm: Floats, approach: Approach) -> StopInterval:
    """Enclose the travel at which the object stops the finger, for each cell and all of it."""
    edges = catalogue.edges(approach.finger)
    earliest, latest = np.full(len(cells), np.inf), np.full(len(cells), np.inf)
    start, heading = _in_object_frame(cells, anchor_mm, approach)
    for state in np.unique(cells.state):
        rows = np.flatnonzero(cells.state == state)
        block = slice(int(edges.first[state]), int(edges.first[state + 1]))
        size = block.stop - block.start
        if size == 0:
            continue
        slack = float(edges.slack_out[block].max())
        reach = float(np.hypot(*edges.start[block].T).max()) + slack
        here = cells.select(rows)
        # A point of the path is moved into the object's frame by any configuration of the cell; seen from the
        # middle one its lever is longer by as much as the centroid may be off.
        rho = here.displacement(reach + here.radius) + approach.position_bound_mm + slack
        chunk = max(1, _RAYS_TIMES_EDGES // size)
        for begin in range(0, len(rows), chunk):
            part = slice(begin, begin + chunk)
            at = rows[part]
            earliest[at], latest[at] = _stops(edges, block, start[at], heading[at], rho[part])
    return StopInterval(earliest, latest)


def unblocked(catalogue: Catalogue, cells: Cells, anchor_mm: Floats, contact: Contact) -> Bools:
    """Cells (k,) that the free path of a contact, or of a miss, does not rule out altogether.

    A cell goes only if every configuration in it would have stopped the finger before the end of the path.
    """
    path = Approach(
        contact.finger,
        contact.start_mm,
        contact.direction_rad,
        contact.travel_mm,
        contact.free_path_bound_mm,
    )
    result: Bools = sweep(catalogue, cells, anchor_mm, path).latest >= contact.travel_mm
    return result


def _in_object_frame(cells: Cells, anchor_mm: Floats, approach: Approach) -> tuple[Floats, Floats]:
    """Start (k, 2) and unit heading (k, 2) of the path in the frame of each cell's middle configuration."""
    cos, sin = np.cos(cells.middle), np.sin(cells.middle)
    x, y = np.asarray(approach.start_mm) - anchor_mm
    turned = np.column_stack([cos * x + sin * y, cos * y - sin * x])
    relative = approach.direction_rad - cells.middle
    return turned - cells.centre, np.column_stack([np.cos(relative), np.sin(relative)])


def _stops(
    edges: EdgeSet, block: slice, start: Floats, heading: Floats, rho: Floats
) -> tuple[Floats, Floats]:
    """Earliest and latest stop (m,) of m rays on the edges of one state, given each ray's ρ."""
    begin, end = _side(start, heading, edges.start[block]), _side(start, heading, edges.end[block])
    # Most edges lie clear of the ray's line on one side; the capsules of the others are looked at closely.
    margin = rho[:, None] + 1e-9
    ray, edge = np.nonzero((np.minimum(begin, end) <= margin) & (np.maximum(begin, end) >= -margin))
    enter, leave = np.full(begin.shape, np.inf), np.full(begin.shape, -np.inf)
    enter[ray, edge], leave[ray, edge] = capsule_interval(
        start[ray],
        heading[ray],
        edges.start[block][edge],
        edges.direction[block][edge],
        edges.length[block][edge],
        rho[ray],
    )
    # Neighbours share their corner's numbers, so a ray through a corner crosses both of them or neither.
    crossing = (begin > 0) != (end > 0)
    touchable = (leave >= 0) & (enter <= leave)
    earliest = np.where(touchable, np.maximum(enter, 0.0), np.inf).min(axis=1)
    return earliest, _first_certain_depth(crossing, enter, leave)


def _first_certain_depth(crossing: Bools, enter: Floats, leave: Floats) -> Floats:
    """First travel ≥ 0 at which a ray is inside the outline and in no edge's capsule; infinite if never.

    All (m, n): whether the ray's line crosses each edge, and where it is in the edge's capsule.
    """
    order = np.argsort(enter, axis=1)
    enter = np.take_along_axis(enter, order, axis=1)
    covered = np.maximum.accumulate(np.take_along_axis(leave, order, axis=1), axis=1)
    # Every crossing lies in its own edge's capsule, so after the first i capsules the ray is inside iff an
    # odd number of them held one.
    inside = np.cumsum(np.take_along_axis(crossing, order, axis=1), axis=1) % 2 == 1
    following = np.column_stack([enter[:, 1:], np.full(len(enter), np.inf)])
    gap = inside & (following > covered) & (following > 0)
    depth: Floats = np.where(gap, np.maximum(covered, 0.0), np.inf).min(axis=1)
    return depth


def _side(start: Floats, heading: Floats, point: Floats) -> Floats:
    """Signed distance (m, n) of points (n, 2) from the lines of m rays."""
    x = point[None, :, 0] - start[:, None, 0]
    y = point[None, :, 1] - start[:, None, 1]
    return heading[:, None, 0] * y - heading[:, None, 1] * x
