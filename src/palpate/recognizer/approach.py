"""Approaches: straight paths of a tip, as rays in the frames of objects, and the edges that they sweep.

Where a ray runs within ρ of an edge (a capsule) follow the earliest and the latest stop of a finger and the
edges it may be on. `constraints` uses them as evidence, `prediction` to look ahead, so that recogniser and
planner cannot disagree.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np

from palpate.base.geometry import Bools, Floats, Ints
from palpate.base.geometry.plane import capsule_interval
from palpate.recognizer.contact import Finger
from palpate.recognizer.edges import EdgeSet
from palpate.recognizer.pose_region import Cells
from palpate.recognizer.strip_trees import StripForest
from palpate.recognizer.tables import Table

_EDGES_PER_STRIP_QUERY = 64
_RAYS_TIMES_EDGES = 400_000  # in one piece: bounds the temporary arrays to tens of MB


@dataclass(frozen=True, eq=False)
class Approach:
    """A straight path of a tip's centre in W: from `start_mm` along `direction_rad` for `travel_mm`."""

    finger: Finger
    start_mm: tuple[float, float]
    direction_rad: float
    travel_mm: float
    position_bound_mm: float

    def point_mm(self, travel_mm: float) -> tuple[float, float]:
        """Place of the tip's centre in W after a travel."""
        (x, y), angle = self.start_mm, self.direction_rad
        return x + travel_mm * math.cos(angle), y + travel_mm * math.sin(angle)

    def aside_mm(self, x_mm: float, y_mm: float) -> float:
        """Distance at which the path's line passes a point in W."""
        right, up = x_mm - self.start_mm[0], y_mm - self.start_mm[1]
        return abs(up * math.cos(self.direction_rad) - right * math.sin(self.direction_rad))


def approach_lines(approaches: Sequence[Approach]) -> tuple[Floats, Floats]:
    """Starts (n, 2) mm and directions (n,) rad in W."""
    start = np.array([approach.start_mm for approach in approaches]).reshape(-1, 2)
    return start, np.array([approach.direction_rad for approach in approaches])


def offset_from_lines(start: Floats, angle: Floats, point: Floats) -> Floats:
    """Signed distance (n,) mm of a point (2,) from the lines of `approach_lines`, positive on their left."""
    rel = point - start
    return np.cos(angle) * rel[:, 1] - np.sin(angle) * rel[:, 0]


@dataclass(frozen=True, eq=False)
class Rays(Table):
    """r rays in the frames of their objects: `state` (r,), `start`, unit `heading` (r, 2), `rho` (r,) mm."""

    state: Ints
    start: Floats
    heading: Floats
    rho: Floats


@dataclass(frozen=True, eq=False)
class Facing(Table):
    """Directions in which r rays can be stopped, in the frames of the objects' middle orientations.

    `against` (r,): against the travel; orientations may turn it by `half_width` (r,) either way. A finger is
    stopped only where its path, which leans by less than `lean` − π/2 (r,) over its stated direction, goes
    into the outline; anywhere, and with any normal, where it is `vague` (r,).
    """

    against: Floats
    half_width: Floats
    lean: Floats
    vague: Bools


def in_object_frame(cells: Cells, anchor_mm: Floats, approaches: Sequence[Approach]) -> tuple[Floats, Floats]:
    """Start and unit heading (k, m, 2) of m paths in the frame of each cell's middle configuration."""
    cos, sin = np.cos(cells.middle)[:, None], np.sin(cells.middle)[:, None]
    x, y = (np.array([approach.start_mm for approach in approaches]) - anchor_mm).T
    start = np.stack([cos * x + sin * y, cos * y - sin * x], axis=2) - cells.centre[:, None]
    ahead = np.array([approach.direction_rad for approach in approaches])
    u, v = np.cos(ahead), np.sin(ahead)
    return start, np.stack([cos * u + sin * v, cos * v - sin * u], axis=2)


def rays_of(edges: EdgeSet, cells: Cells, anchor_mm: Floats, approaches: Sequence[Approach]) -> Rays:
    """m approaches of one kind of finger in each of k cells: ray i·m + j is approach j in cell i.

    ρ covers the whole cell, the outline's slack and the approach's bound.
    """
    start, heading = in_object_frame(cells, anchor_mm, approaches)
    bound = np.array([approach.position_bound_mm for approach in approaches])
    # A point of the path is moved into the object's frame by any configuration of the cell; seen from the
    # middle one its lever is longer by as much as the centroid may be off.
    body = (
        cells.displacement(edges.state_reach_mm[cells.state] + cells.radius)
        + edges.state_slack_mm[cells.state]
    )
    return Rays(
        np.repeat(cells.state, len(approaches)),
        start.reshape(-1, 2),
        heading.reshape(-1, 2),
        (body[:, None] + bound).ravel(),
    )


def split_rays(edges: EdgeSet, strips: StripForest, rays: Rays) -> list[Rays]:
    """Cut rays so that no piece has many more than _RAYS_TIMES_EDGES edges to look at."""
    large = strips.root[rays.state] >= 0
    # Of outlines in strip trees only a few edges are ever looked at; how many is a guess.
    size = np.where(large, _EDGES_PER_STRIP_QUERY, edges.count[rays.state])
    total = np.cumsum(size)
    cuts = np.searchsorted(
        total, np.arange(_RAYS_TIMES_EDGES, int(total[-1]) if len(total) else 0, _RAYS_TIMES_EDGES)
    )
    bounds = np.unique([0, *cuts, len(size)])
    if len(bounds) < 3:
        return [rays]
    return [rays.select(slice(int(a), int(b))) for a, b in pairwise(bounds)]


def near_edges(edges: EdgeSet, strips: StripForest, rays: Rays) -> tuple[Ints, Ints]:
    """Pairs of a ray and an edge that its line passes within ρ, by ray. Most edges lie clear on one side."""

    def near(ray: Ints, begin: Floats, end: Floats, stray: Floats | float) -> Bools:
        first, last = offset_from_rays(rays, ray, begin), offset_from_rays(rays, ray, end)
        margin = rays.rho[ray] + stray + 1e-9
        return (np.minimum(first, last) <= margin) & (np.maximum(first, last) >= -margin)

    large = strips.root[rays.state] >= 0
    # One look at an edge's circle is half of the work of two at its ends, and settles most.
    rows = np.flatnonzero(~large)
    grid = edges.grid(_columns(int(edges.count[rays.state[rows]].max(initial=0))))
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


def _columns(count: int) -> int:
    """Number from `count` on, a power of two or one and a half of one, so that few grids are made."""
    whole = 1 << max(count - 1, 1).bit_length()
    return whole * 3 // 4 if count <= whole * 3 // 4 else whole


def offset_from_rays(rays: Rays, ray: Ints, point: Floats) -> Floats:
    """Signed distance (n,) of points (n, 2) from the lines of the rays `ray` (n,)."""
    x = point[:, 0] - rays.start[ray, 0]
    y = point[:, 1] - rays.start[ray, 1]
    away: Floats = rays.heading[ray, 0] * y - rays.heading[ray, 1] * x
    return away


@dataclass(frozen=True, eq=False)
class EdgeCapsules:
    """Edges, up to n, that each of r rays passes within ρ, padded: all (r, n).

    The ray is in the edge's capsule for a travel in [`enter`, `leave`] mm; `crossing`: its line crosses the
    edge. Where there is no edge, `edge` is −1, `enter` ∞ and `leave` −∞.
    """

    edge: Ints
    enter: Floats
    leave: Floats
    crossing: Bools

    @cached_property
    def touchable(self) -> Bools:
        """Edges whose capsule the ray is in at some travel ≥ 0, (r, n)."""
        return (self.leave >= 0) & (self.enter <= self.leave)

    @cached_property
    def earliest(self) -> Floats:
        """No stop comes before this travel (r,) mm; infinite if nothing can be met."""
        enter = np.where(self.touchable, np.maximum(self.enter, 0.0), np.inf)
        result: Floats = enter.min(axis=1, initial=np.inf)
        return result

    @cached_property
    def latest(self) -> Floats:
        """First travel ≥ 0 (r,) at which a ray is inside the outline and in no capsule; infinite if never."""
        order = np.argsort(self.enter, axis=1)
        enter = np.take_along_axis(self.enter, order, axis=1)
        covered = np.maximum.accumulate(np.take_along_axis(self.leave, order, axis=1), axis=1)
        # Every crossing lies in its own edge's capsule, so after the first i capsules the ray is inside iff
        # an odd number of them held one.
        inside = np.logical_xor.accumulate(np.take_along_axis(self.crossing, order, axis=1), axis=1)
        following = np.column_stack([enter[:, 1:], np.full(len(enter), np.inf)])
        gap = inside & (following > covered) & (following > 0)
        depth: Floats = np.where(gap, np.maximum(covered, 0.0), np.inf).min(axis=1, initial=np.inf)
        return depth


def capsules_of(edges: EdgeSet, strips: StripForest, rays: Rays) -> EdgeCapsules:
    """The capsules that rays run through."""
    ray, edge = near_edges(edges, strips, rays)
    begin, end = offset_from_rays(rays, ray, edges.start[edge]), offset_from_rays(rays, ray, edges.end[edge])
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
    found = EdgeCapsules(
        np.full(shape, -1), np.full(shape, np.inf), np.full(shape, -np.inf), np.zeros(shape, dtype=bool)
    )
    for to, value in (
        (found.edge, edge),
        (found.enter, enter),
        (found.leave, leave),
        (found.crossing, crossing),
    ):
        to[ray, slot] = value
    return found
