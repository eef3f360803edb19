"""What a straight approach must and may meet, over every configuration in a cell.

Used backwards as evidence (the path before a contact was free; a missed approach was free all along) and
forwards as prediction (where will the finger stop?), so that planner and recogniser cannot disagree. If no
point of the object is further than ρ from where the cell's middle configuration puts it, the finger cannot
stop before it comes within ρ of the middle outline, and cannot pass a point that lies deeper than ρ in it.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from palpate.recognizer.arrays import Bools, Floats, Ints
from palpate.recognizer.catalogue import Catalogue
from palpate.recognizer.contact import Contact, Finger
from palpate.recognizer.edges import EdgeSet
from palpate.recognizer.region import Cells
from palpate.recognizer.segments import capsule_interval
from palpate.recognizer.strips import StripForest

__all__ = ["Approach", "StopInterval", "clear_of_outline", "sweep", "unblocked"]

_SOME_EDGES = 64
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
    """For k cells and m approaches: the finger stops after a travel within [`earliest`, `latest`] (k, m) mm.

    `earliest` is infinite where nothing can be met; `latest` is infinite where the finger may miss.
    """

    earliest: Floats
    latest: Floats


def sweep(
    catalogue: Catalogue,
    cells: Cells,
    anchor_mm: Floats,
    approaches: Sequence[Approach],
    skipped: Bools | None = None,
) -> StopInterval:
    """Enclose the travel at which the object stops the finger, for k cells, all of each, and m approaches.

    Those `skipped` (k, m) are not looked at and come back as infinite.
    """
    shape = (len(cells), len(approaches))
    earliest, latest = np.full(shape, np.inf), np.full(shape, np.inf)
    for finger in dict.fromkeys(approach.finger for approach in approaches):
        edges = catalogue.outlines(finger)
        columns = [k for k, approach in enumerate(approaches) if approach.finger == finger]
        start, heading = _in_object_frame(cells, anchor_mm, [approaches[k] for k in columns])
        bound = np.array([approaches[k].position_bound_mm for k in columns])
        # A point of the path is moved into the object's frame by any configuration of the cell; seen from the
        # middle one its lever is longer by as much as the centroid may be off.
        body = (
            cells.displacement(edges.state_reach_mm[cells.state] + cells.radius)
            + edges.state_slack_mm[cells.state]
        )
        rays = _Rays(
            np.repeat(cells.state, len(columns)),
            start.reshape(-1, 2),
            heading.reshape(-1, 2),
            (body[:, None] + bound).ravel(),
        )
        row, column = np.divmod(np.arange(len(rays.state)), len(columns))
        column = np.array(columns)[column]
        if skipped is not None:
            wanted = np.flatnonzero(~skipped[row, column])
            rays, row, column = rays.select(wanted), row[wanted], column[wanted]
        if len(row):
            earliest[row, column], latest[row, column] = _stops(edges, catalogue.outline_strips(finger), rays)
    return StopInterval(earliest, latest)


def unblocked(
    catalogue: Catalogue,
    cells: Cells,
    anchor_mm: Floats,
    contacts: Sequence[Contact],
    skipped: Bools | None = None,
) -> Bools:
    """Cells (k,) that the free paths of m contacts, and of misses, do not rule out altogether.

    A cell goes only if every configuration in it would have stopped a finger before the end of its path.
    `skipped` (k, m): paths that are no evidence for a cell, or that are known to leave it.
    """
    paths = [
        Approach(
            contact.finger,
            contact.start_mm,
            contact.direction_rad,
            contact.travel_mm,
            contact.free_path_bound_mm,
        )
        for contact in contacts
    ]
    travel = np.array([path.travel_mm for path in paths])
    result: Bools = np.all(sweep(catalogue, cells, anchor_mm, paths, skipped).latest >= travel, axis=1)
    return result


def clear_of_outline(
    catalogue: Catalogue, cells: Cells, anchor_mm: Floats, paired: Ints, contacts: Sequence[Contact]
) -> Bools:
    """Cells in which paths of contacts on their edges, `paired` (k, m), are outside of the outline: (k, m).

    A path is, if it comes from within its edge's open cone whatever the orientation, and does not end beyond
    an end of the edge at which the outline may rise again. Then it is never deeper in the outline than its
    end may be, and `unblocked` would keep the cell.
    """
    clear = np.zeros(paired.shape, dtype=bool)
    for finger in dict.fromkeys(contact.finger for contact in contacts):
        edges = catalogue.edges(finger)
        columns = [
            column
            for column, contact in enumerate(contacts)
            if contact.finger == finger and contact.free_path_bound_mm >= contact.position_bound_mm
        ]
        if columns and len(edges.state) and edges is catalogue.outlines(finger):
            some = [contacts[column] for column in columns]
            clear[:, columns] = _clear(edges, cells, anchor_mm, paired[:, columns], some)
    return clear


def _clear(edges: EdgeSet, cells: Cells, anchor_mm: Floats, edge: Ints, contacts: Sequence[Contact]) -> Bools:
    middle, half_width = cells.middle[:, None], cells.half_width[:, None]
    against = np.array([contact.direction_rad + np.pi for contact in contacts])
    off = against - edges.normal_rad[edge] - middle
    off -= 2 * np.pi * np.rint(off / (2 * np.pi))
    left, right = edges.open_cone[0][edge], edges.open_cone[1][edge]
    within = (edge >= 0) & (off + half_width <= left) & (half_width - off <= right)
    # Seen from the edge's middle: how far along it the contact lies, give or take the cell's extent.
    x, y = (np.array([contact.end_mm for contact in contacts]) - anchor_mm).T
    cos, sin = np.cos(middle), np.sin(middle)
    rel = cells.centre[:, None] + edges.centre[edge]
    along = edges.direction[edge]
    aside = (cos * x + sin * y - rel[..., 0]) * along[..., 0] + (cos * y - sin * x - rel[..., 1]) * along[
        ..., 1
    ]
    room = edges.half_length[edge] - half_width * np.hypot(x, y) - cells.radius[:, None]
    ends = ((aside <= room) | (left >= np.pi / 2)) & ((-aside <= room) | (right >= np.pi / 2))
    result: Bools = within & ends
    return result


@dataclass(frozen=True, eq=False)
class _Rays:
    """r rays in the frames of their objects: `state` (r,), `start`, unit `heading` (r, 2), `rho` (r,) mm."""

    state: Ints
    start: Floats
    heading: Floats
    rho: Floats

    def select(self, part: slice | Ints) -> "_Rays":
        return _Rays(self.state[part], self.start[part], self.heading[part], self.rho[part])


def _in_object_frame(
    cells: Cells, anchor_mm: Floats, approaches: Sequence[Approach]
) -> tuple[Floats, Floats]:
    """Start and unit heading (k, m, 2) of m paths in the frame of each cell's middle configuration."""
    cos, sin = np.cos(cells.middle)[:, None], np.sin(cells.middle)[:, None]
    x, y = (np.array([approach.start_mm for approach in approaches]) - anchor_mm).T
    start = np.stack([cos * x + sin * y, cos * y - sin * x], axis=2) - cells.centre[:, None]
    ahead = np.array([approach.direction_rad for approach in approaches])
    u, v = np.cos(ahead), np.sin(ahead)
    return start, np.stack([cos * u + sin * v, cos * v - sin * u], axis=2)


def _stops(edges: EdgeSet, strips: StripForest, rays: _Rays) -> tuple[Floats, Floats]:
    """Earliest and latest stop (r,) of rays on the edges of their states."""
    large = strips.root[rays.state] >= 0
    # Of outlines in strip trees only a few edges are ever looked at; how many is a guess.
    size = np.where(large, _SOME_EDGES, edges.count[rays.state])
    parts = [_stops_of(edges, strips, rays.select(piece)) for piece in _pieces(size)]
    if len(parts) == 1:
        return parts[0]
    return np.concatenate([part[0] for part in parts]), np.concatenate([part[1] for part in parts])


def _pieces(size: Ints) -> list[slice]:
    """Cut rows so that no piece has many more than _RAYS_TIMES_EDGES edges to look at."""
    total = np.cumsum(size)
    cuts = np.searchsorted(
        total, np.arange(_RAYS_TIMES_EDGES, int(total[-1]) if len(total) else 0, _RAYS_TIMES_EDGES)
    )
    bounds = np.unique([0, *cuts, len(size)])
    if len(bounds) < 2:
        return [slice(0, 0)]
    return [slice(int(a), int(b)) for a, b in pairwise(bounds)]


def _stops_of(edges: EdgeSet, strips: StripForest, rays: _Rays) -> tuple[Floats, Floats]:
    ray, edge = _near_edges(edges, strips, rays)
    begin, end = _side(rays, ray, edges.start[edge]), _side(rays, ray, edges.end[edge])
    enter, leave = capsule_interval(
        rays.start[ray],
        rays.heading[ray],
        edges.start[edge],
        edges.direction[edge],
        edges.length[edge],
        rays.rho[ray],
    )
    # Neighbours share their corner's numbers, so a ray through a corner crosses both of them or neither.
    crossing = (begin > 0) != (end > 0)
    count = np.bincount(ray, minlength=len(rays.state))
    slot = np.arange(len(ray)) - np.repeat(np.cumsum(count) - count, count)
    shape = (len(count), int(count.max(initial=0)))
    table = (np.full(shape, np.inf), np.full(shape, -np.inf), np.zeros(shape, dtype=bool))
    for to, value in zip(table, (enter, leave, crossing), strict=True):
        to[ray, slot] = value
    enter, leave, crossing = table
    touchable = (leave >= 0) & (enter <= leave)
    earliest = np.where(touchable, np.maximum(enter, 0.0), np.inf).min(axis=1, initial=np.inf)
    return earliest, _first_certain_depth(crossing, enter, leave)


def _near_edges(edges: EdgeSet, strips: StripForest, rays: _Rays) -> tuple[Ints, Ints]:
    """Pairs of a ray and an edge that its line passes within ρ, by ray. Most edges lie clear on one side."""

    def near(ray: Ints, begin: Floats, end: Floats, stray: Floats | float) -> Bools:
        first, last = _side(rays, ray, begin), _side(rays, ray, end)
        margin = rays.rho[ray] + stray + 1e-9
        result: Bools = (np.minimum(first, last) <= margin) & (np.maximum(first, last) >= -margin)
        return result

    large = strips.root[rays.state] >= 0
    # One look at an edge's circle is half of the work of two at its ends, and settles most.
    rows = np.flatnonzero(~large)
    grid = edges.grid(1 << int(edges.count[rays.state[rows]].max(initial=0)).bit_length())
    state, (u, v) = rays.state[rows], rays.heading[rows].T
    offset = rays.start[rows, 1] * u - rays.start[rows, 0] * v
    away = grid.centre_y[state] * u[:, None]
    away -= grid.centre_x[state] * v[:, None]
    away -= offset[:, None]
    close = np.abs(away) <= grid.half_length[state] + (rays.rho[rows] + 1e-9)[:, None]
    ray, column = np.divmod(np.flatnonzero(close), close.shape[1])
    ray, edge = rows[ray], edges.first[state[ray]] + column
    if not large.any():
        return ray, edge
    rows = np.flatnonzero(large)
    query, found = strips.descend(
        rays.state[rows],
        lambda query, strip: near(rows[query], strips.start[strip], strips.end[strip], strips.stray[strip]),
    )
    ray, edge = np.concatenate([ray, rows[query]]), np.concatenate([edge, found])
    order = np.argsort(ray, kind="stable")
    return ray[order], edge[order]


def _first_certain_depth(crossing: Bools, enter: Floats, leave: Floats) -> Floats:
    """First travel ≥ 0 at which a ray is inside the outline and in no edge's capsule; infinite if never.

    All (m, n): whether the ray's line crosses each edge, and where it is in the edge's capsule.
    """
    order = np.argsort(enter, axis=1)
    enter = np.take_along_axis(enter, order, axis=1)
    covered = np.maximum.accumulate(np.take_along_axis(leave, order, axis=1), axis=1)
    # Every crossing lies in its own edge's capsule, so after the first i capsules the ray is inside iff an
    # odd number of them held one.
    inside = np.logical_xor.accumulate(np.take_along_axis(crossing, order, axis=1), axis=1)
    following = np.column_stack([enter[:, 1:], np.full(len(enter), np.inf)])
    gap = inside & (following > covered) & (following > 0)
    depth: Floats = np.where(gap, np.maximum(covered, 0.0), np.inf).min(axis=1, initial=np.inf)
    return depth


def _side(rays: _Rays, ray: Ints, point: Floats) -> Floats:
    """Signed distance (n,) of points (n, 2) from the lines of the rays `ray` (n,)."""
    x = point[:, 0] - rays.start[ray, 0]
    y = point[:, 1] - rays.start[ray, 1]
    side: Floats = rays.heading[ray, 0] * y - rays.heading[ray, 1] * x
    return side
