"""Cells with NumPy: cut from intervals of orientations, subdivided, and tested against free paths."""

from dataclasses import replace
from itertools import combinations

import numpy as np

from palpate.base.geometry import Bools, Floats, Ints
from palpate.recognizer.approach import Rays, capsules_of, rays_of, split_rays
from palpate.recognizer.catalogue import Catalogue
from palpate.recognizer.constraints import free_paths_of
from palpate.recognizer.contact import Finger
from palpate.recognizer.interpretations import Interpretations, Query
from palpate.recognizer.model_test import all_half_planes, narrow, sinusoid_maximum
from palpate.recognizer.pose_region import MAX_TRIPLED_CONTACTS, Cells, Intervals, clip_polygons
from palpate.recognizer.tables import expand_ranges

_FURTHEST_SHARE = 1 - 1e-9  # of the furthest vertex: of those that are, but for rounding, the first is taken


def cut_cells(query: Query, nodes: Interpretations, intervals: Intervals) -> tuple[Cells, Ints]:
    """Cells of the intervals: the first contact's rectangle, clipped by all other contacts.

    Empty ones are left out; returned with the cells is which interval each belongs to.
    """
    node, lo, hi = intervals.node, intervals.lo, intervals.hi
    g, coefficients = all_half_planes(query, nodes.edges[node])
    limit = coefficients[..., 0] + sinusoid_maximum(
        coefficients[..., 1], coefficients[..., 2], lo[:, None], hi[:, None]
    )
    polygon = _rectangle(g, limit)
    # Most half-planes cut nothing, and some leave nothing: a look at the corners settles these at once.
    height = np.einsum("kvj,kmj->kvm", polygon, g[:, 4:]) - limit[:, None, 4:]
    alive = np.flatnonzero(~np.any(np.all(height > 0, axis=1), axis=1))
    cutting = np.flatnonzero(np.any(height[alive] > 0, axis=(0, 1))) + 4
    polygon, g, limit = polygon[alive], g[alive], limit[alive]
    for side in cutting:
        polygon, kept = clip_polygons(polygon, g[:, side], limit[:, side])
        if not kept.all():
            alive, g, limit = alive[kept], g[kept], limit[kept]
    node = node[alive]
    return Cells(node, nodes.state[node], lo[alive], hi[alive], polygon), alive


def _rectangle(g: Floats, limit: Floats) -> Floats:
    """Corners (k, 4, 2) of the rectangle that the first contact's four half-planes enclose."""
    inner, along = g[:, 1], g[:, 3]
    across = (-limit[:, 0], limit[:, 1])
    length = (-limit[:, 2], limit[:, 3])
    corners = [
        across[a][:, None] * inner + length[b][:, None] * along for a, b in ((0, 0), (1, 0), (1, 1), (0, 1))
    ]
    return np.stack(corners, axis=1)


def refine_intervals(
    query: Query, nodes: Interpretations, cells: Cells, parts: Ints
) -> tuple[Intervals, Ints]:
    """The intervals of cells (k,), each in `parts` (k,), narrowed to what the closed-form test leaves.

    To be cut anew, never larger together, often smaller. Contacts are taken in twos, and in threes as long as
    they are few: their triples are many, and narrow cells say nearly as much. Also returned: which cell each
    is of, (m,).
    """
    owner, part = expand_ranges(np.zeros(len(cells), np.int64), parts)
    width = (cells.hi - cells.lo)[owner] / parts[owner]
    lo = cells.lo[owner] + part * width
    hi = np.where(part == parts[owner] - 1, cells.hi[owner], lo + width)
    node, contacts = cells.node[owner], range(len(query.contacts))
    sizes = (2, 3) if len(contacts) <= MAX_TRIPLED_CONTACTS else (2,)
    for group in (group for size in sizes for group in combinations(contacts, size)):
        lo, hi = narrow(query.select(group), nodes.edges[node][:, group], lo, hi)
        left = lo <= hi
        owner, node, lo, hi = owner[left], node[left], lo[left], hi[left]
    return Intervals(node, lo, hi), owner


def divide_cells(cells: Cells, lever_mm: float, parts: int) -> tuple[Cells, Ints]:
    """Each cell in `parts` along whichever is longest: its orientations, times the lever, or its polygon.

    Also returned: which cell each is of, (m,).
    """
    leg = cells.polygon - cells.centre[:, None]
    away = np.hypot(leg[..., 0], leg[..., 1])
    size = away.max(axis=1)
    end = leg[np.arange(len(cells)), np.argmax(away >= _FURTHEST_SHARE * size[:, None], axis=1)]
    turned = size <= cells.half_width * lever_mm
    owner, part = expand_ranges(np.zeros(len(cells), np.int64), np.full(len(cells), parts))
    fine = cells.select(owner)
    width = (fine.hi - fine.lo) / parts
    lo = np.where(turned[owner], fine.lo + part * width, fine.lo)
    hi = np.where(turned[owner] & (part < parts - 1), lo + width, fine.hi)
    fine = replace(fine, lo=lo, hi=hi)
    along = end / np.maximum(size, 1e-300)[:, None]
    height = np.einsum("kvj,kj->kv", cells.polygon, along)
    least, step = height.min(axis=1), np.ptp(height, axis=1) / parts
    polygon, row = fine.polygon, np.arange(len(fine))
    for sign, edge, outermost in ((1.0, part + 1, parts), (-1.0, part, 0)):
        # The outermost parts have no limit, and what is divided by orientation has none at all.
        cut = sign * (least[owner] + edge * step[owner])
        cut = np.where(turned[owner] | (edge == outermost), np.inf, cut)
        polygon, kept = clip_polygons(polygon, sign * along[owner[row]], cut[row])
        row = row[kept]
    return replace(fine.select(row), polygon=polygon), owner[row]


def free_cells(evidence: Query, cells: Cells, skipped: Bools | None) -> Bools:
    """Cells (k,) that the free paths of m contacts, and of misses, do not rule out altogether.

    A cell goes only if every configuration in it would have stopped a finger before the end of its path.
    `skipped` (k, m): paths that are no evidence for a cell, or that are known to leave it.
    """
    catalogue, paths = evidence.catalogue, free_paths_of(evidence.contacts)
    free: Bools = np.ones((len(cells), len(paths)), dtype=bool)
    for finger in dict.fromkeys(path.finger for path in paths):
        columns = np.array([k for k, path in enumerate(paths) if path.finger == finger])
        some = [paths[k] for k in columns]
        rays = rays_of(catalogue.outlines(finger), cells, evidence.anchor_mm, some)
        row, column = np.divmod(np.arange(len(rays)), len(columns))
        wanted = np.arange(len(rays)) if skipped is None else np.flatnonzero(~skipped[row, columns[column]])
        travel = np.array([path.travel_mm for path in some])[column[wanted]]
        latest = _latest_stops(catalogue, finger, rays.select(wanted))
        free[row[wanted], columns[column[wanted]]] = latest >= travel
    return np.asarray(free.all(axis=1))


def _latest_stops(catalogue: Catalogue, finger: Finger, rays: Rays) -> Floats:
    """Travel (r,) that rays cannot pass; infinite where the finger may miss."""
    edges, strips = catalogue.outlines(finger), catalogue.outline_strips(finger)
    return np.concatenate(
        [capsules_of(edges, strips, some).latest for some in split_rays(edges, strips, rays)]
    )


def position_boxes(cells: Cells, origin_mm: Floats, anchor_mm: Floats) -> tuple[Floats, Floats]:
    """Smallest boxes (k, 2) in W that contain every position of `origin_mm` (k, 2), rounded outward.

    The origin is a point of the object, seen from its centroid, that stands for its position.
    """
    rel = cells.polygon - origin_mm[:, None]
    x, y = rel[..., 0], rel[..., 1]
    lo, hi = cells.lo[:, None], cells.hi[:, None]
    # x of R(θ) s is x cos θ − y sin θ, and y is y cos θ + x sin θ.
    across, upward = np.stack([x, y, -x, -y]), np.stack([-y, x, y, -x])
    furthest = sinusoid_maximum(across, upward, lo, hi).max(axis=2, initial=-np.inf).T
    return anchor_mm - furthest[:, 2:] - 1e-9, anchor_mm + furthest[:, :2] + 1e-9
