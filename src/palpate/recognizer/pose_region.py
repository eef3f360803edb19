"""Pose regions: what is left of the configuration space of an interpretation, as a list of cells.

A cell is an interval of orientations and a convex polygon of positions that together contain every feasible
configuration in that interval: each half-plane of the `model_test` is relaxed to its largest value over the
interval, and the polygon is clipped by them. The union of an interpretation's cells contains the truth
whenever the errors are in bounds.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations

import numpy as np

from palpate.base.geometry import Bools, Floats, Ints
from palpate.recognizer.catalogue import Catalogue
from palpate.recognizer.compiled import KERNEL, clip_polygons, polygon_shapes
from palpate.recognizer.compiled_search import Pairings, cut_polygons, divide_cells, narrow_parts, pairings_of
from palpate.recognizer.contact import Contact
from palpate.recognizer.interpretation_tree import Interpretations
from palpate.recognizer.model_test import (
    all_half_planes,
    sinusoid_maximum,
    three_contact_hull,
    two_contact_hull,
)
from palpate.recognizer.tables import Table, expand_ranges

_MAX_ALL_PROBED, _INTERVALS_PER_PROBE = 256, 8
_MAX_CELLS = 64  # per interpretation and pass
_MAX_TRIPLED_CONTACTS = 4  # contacts whose triples are looked at again when cells are refined
_NARROWEST_RAD = 2e-4  # narrower cells bound nothing better: 0.01 mm at 50 mm
_FURTHEST_SHARE = 1 - 1e-9  # of the furthest vertex: of those that are, but for rounding, the first is taken


@dataclass(frozen=True, eq=False)
class Cells(Table):
    """k cells. `node` (k,): the interpretation each belongs to; θ in [`lo`, `hi`] (k,) rad.

    `polygon` (k, v, 2) mm: positions s = R(−θ)(p − anchor) of the centroid, seen in the object's frame,
    counter-clockwise, padded by repeating the first vertex. `state` (k,): index into the catalogue.
    """

    node: Ints
    state: Ints
    lo: Floats
    hi: Floats
    polygon: Floats

    @classmethod
    def joined(cls, parts: "Sequence[Cells]") -> "Cells":
        """Cells of several regions in one; polygons with fewer vertices are padded."""
        most = max(part.polygon.shape[1] for part in parts)
        return super().joined([replace(part, polygon=_pad(part.polygon, most)) for part in parts])

    @cached_property
    def middle(self) -> Floats:
        """Middle orientation, (k,)."""
        return (self.lo + self.hi) / 2

    @cached_property
    def half_width(self) -> Floats:
        """Half of the orientation interval, (k,)."""
        return (self.hi - self.lo) / 2

    @cached_property
    def centre(self) -> Floats:
        """Middle of each polygon's bounding box, (k, 2)."""
        if KERNEL is not None:
            return self._shapes[0]
        result: Floats = (self.polygon.min(axis=1) + self.polygon.max(axis=1)) / 2
        return result

    @cached_property
    def radius(self) -> Floats:
        """Largest distance from `centre` to a vertex, (k,)."""
        if KERNEL is not None:
            return self._shapes[1]
        offset = self.polygon - self.centre[:, None]
        result: Floats = np.hypot(offset[..., 0], offset[..., 1]).max(axis=1)
        return result

    @cached_property
    def volume(self) -> Floats:
        """Area times orientation interval, (k,) mm²·rad."""
        if KERNEL is not None:
            return self._shapes[2] * (self.hi - self.lo)
        x, y = self.polygon[..., 0], self.polygon[..., 1]
        after = np.arange(1, x.shape[1] + 1) % x.shape[1]
        twice = np.sum(x * y[:, after] - y * x[:, after], axis=1)
        result: Floats = np.abs(twice) / 2 * (self.hi - self.lo)
        return result

    @cached_property
    def _shapes(self) -> tuple[Floats, Floats, Floats]:
        assert KERNEL is not None
        return polygon_shapes(KERNEL, self.polygon)

    def displacement(self, reach_mm: Floats) -> Floats:
        """How far the object's points may be from where the cell's middle configuration puts them, (k,) mm.

        Holds for all points within `reach_mm` (k,) of the centroid and every configuration in the cell.
        """
        lever = reach_mm + np.hypot(*self.centre.T)
        result: Floats = self.half_width * lever + self.radius
        return result


def corner_mask(polygon: Floats) -> Bools:
    """Vertices of polygons (k, v, 2) that are no padding, (k, v): all that are not the first once more."""
    result: Bools = np.any(polygon != polygon[:, :1], axis=2)
    result[:, :1] = True
    return result


def _pad(polygon: Floats, vertices: int) -> Floats:
    """Polygons (k, v, 2) with the first vertex repeated up to a number of vertices."""
    missing = vertices - polygon.shape[1]
    if not missing:
        return polygon
    return np.concatenate([polygon, np.repeat(polygon[:, :1], missing, axis=1)], axis=1)


@dataclass(frozen=True, eq=False)
class ProbedCells:
    """k cells, t of which were looked at in their middle.

    `section` (t, v, 2) mm: the polygon of positions s that satisfy every contact at exactly the middle
    orientation of the cells `tried` (t,).
    """

    cells: Cells
    tried: Ints
    section: Floats


@dataclass(frozen=True, eq=False)
class Intervals(Table):
    """Orientation intervals [`lo`, `hi`] (k,) rad of interpretations `node` (k,): cells not yet cut."""

    node: Ints
    lo: Floats
    hi: Floats


def divide_orientations(nodes: Interpretations, *, step_rad: float, least: int) -> Intervals:
    """Every interpretation's orientations in steps of at most `step_rad`, at least `least` and at most 64.

    One that is narrow already is not cut for the sake of `least`.
    """
    width = nodes.hi - nodes.lo
    fewest = np.clip(np.ceil(width / _NARROWEST_RAD), 1, least)
    count = np.clip(np.ceil(width / step_rad), fewest, _MAX_CELLS).astype(np.int64)
    node, part = expand_ranges(np.zeros_like(count), count)
    width = width[node] / count[node]
    lo = nodes.lo[node] + part * width
    return Intervals(node, lo, lo + width)


def build_cells(
    catalogue: Catalogue,
    nodes: Interpretations,
    contacts: list[Contact],
    anchor_mm: Floats,
    intervals: Intervals,
) -> Cells:
    """Cells of the intervals, empty ones left out."""
    return cut_cells(catalogue, nodes, contacts, anchor_mm, intervals)[0]


def refine_intervals(
    catalogue: Catalogue,
    nodes: Interpretations,
    cells: Cells,
    contacts: list[Contact],
    anchor_mm: Floats,
    parts: int | Ints,
) -> tuple[Intervals, Ints]:
    """The intervals of cells (k,), each in `parts`: to be cut anew, never larger together, often smaller.

    Also returned: which cell each is of, (m,). An interval is first narrowed to the orientations that the
    closed-form test leaves for the contacts, taken in threes as long as they are few: their triples are many,
    and narrow cells say nearly as much.
    """
    count = np.broadcast_to(parts, len(cells))
    if KERNEL is not None:
        pairings = _pairings(catalogue, nodes, contacts, anchor_mm)
        rows = (cells.node, cells.lo, cells.hi)
        triples = len(contacts) <= _MAX_TRIPLED_CONTACTS
        owner, lo, hi = narrow_parts(KERNEL, pairings, rows, count, triples=triples)
        return Intervals(cells.node[owner], lo, hi), owner
    owner, part = expand_ranges(np.zeros(len(cells), np.int64), count)
    width = (cells.hi - cells.lo)[owner] / count[owner]
    lo = cells.lo[owner] + part * width
    hi = np.where(part == count[owner] - 1, cells.hi[owner], lo + width)
    node = cells.node[owner]
    for pair in combinations(range(len(contacts)), 2):
        lo, hi = two_contact_hull(catalogue, nodes.edges[node][:, pair], [contacts[k] for k in pair], lo, hi)
        owner, node, lo, hi = _keep_nonempty(owner, node, lo, hi)
    if len(contacts) <= _MAX_TRIPLED_CONTACTS:
        for group in combinations(range(len(contacts)), 3):
            some = [contacts[k] for k in group]
            lo, hi = three_contact_hull(catalogue, nodes.edges[node][:, group], some, anchor_mm, lo, hi)
            owner, node, lo, hi = _keep_nonempty(owner, node, lo, hi)
    return Intervals(node, lo, hi), owner


def _keep_nonempty(owner: Ints, node: Ints, lo: Floats, hi: Floats) -> tuple[Ints, Ints, Floats, Floats]:
    left = lo <= hi
    return owner[left], node[left], lo[left], hi[left]


def divide_longest(cells: Cells, lever_mm: float, parts: int) -> tuple[Cells, Ints]:
    """Each cell in `parts` along whichever is longest: its orientations, times the lever, or its polygon.

    Also returned: which cell each is of, (m,).
    """
    if KERNEL is not None:
        found = divide_cells(KERNEL, cells.lo, cells.hi, cells.polygon, lever_mm, parts)
        owner = found.row
        fine = Cells(cells.node[owner], cells.state[owner], found.lo, found.hi, found.polygon)
        return fine, owner
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
        polygon, kept = _clip(polygon, sign * along[owner[row]], cut[row])
        row = row[kept]
    return replace(fine.select(row), polygon=polygon), owner[row]


def probe_cells(
    catalogue: Catalogue,
    nodes: Interpretations,
    contacts: list[Contact],
    anchor_mm: Floats,
    intervals: Intervals,
) -> ProbedCells:
    """Cut the intervals, and at exactly their middle orientations as well.

    Where there are many, only the middle one of each few of an interpretation is looked at in its middle.
    """
    count = len(intervals.node)
    middle = (intervals.lo + intervals.hi) / 2
    tried = intervals_to_probe(intervals)
    found, alive = cut_cells(
        catalogue,
        nodes,
        contacts,
        anchor_mm,
        Intervals.joined([intervals, Intervals(intervals.node[tried], middle[tried], middle[tried])]),
    )
    whole = alive < count
    place = np.full(count, -1)
    place[alive[whole]] = np.arange(int(whole.sum()))
    # A cell that is not empty in its middle is not empty.
    return ProbedCells(found.select(whole), place[tried[alive[~whole] - count]], found.polygon[~whole])


def intervals_to_probe(intervals: Intervals) -> Ints:
    """Which intervals are looked at in their middle: all, or where there are many some of each node."""
    if len(intervals) <= _MAX_ALL_PROBED:
        return np.arange(len(intervals))
    return _middle_rows(intervals.node)


def _middle_rows(node: Ints) -> Ints:
    """The middle row of each stretch of at most _FEW rows with one and the same node (k,)."""
    row = np.arange(len(node))
    begins = np.ones(len(node), dtype=bool)
    begins[1:] = node[1:] != node[:-1]
    begins |= (row - np.maximum.accumulate(np.where(begins, row, 0))) % _INTERVALS_PER_PROBE == 0
    first = np.flatnonzero(begins)
    middles: Ints = (first + np.append(first[1:], len(node))) // 2
    return middles


def cut_cells(
    catalogue: Catalogue,
    nodes: Interpretations,
    contacts: list[Contact],
    anchor_mm: Floats,
    intervals: Intervals,
) -> tuple[Cells, Ints]:
    """Cells of the intervals: the first contact's rectangle, clipped by all other contacts.

    Empty ones are left out; returned with the cells is which interval each belongs to.
    """
    node, lo, hi = intervals.node, intervals.lo, intervals.hi
    if KERNEL is not None:
        pairings = _pairings(catalogue, nodes, contacts, anchor_mm)
        alive, polygon = cut_polygons(KERNEL, pairings, node, lo, hi)
        node = node[alive]
        return Cells(node, nodes.state[node], lo[alive], hi[alive], polygon), alive
    g, coefficients = all_half_planes(catalogue, nodes.edges[node], contacts, anchor_mm)
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
        polygon, kept = _clip(polygon, g[:, side], limit[:, side])
        if not kept.all():
            alive, g, limit = alive[kept], g[kept], limit[kept]
    node = node[alive]
    return Cells(node, nodes.state[node], lo[alive], hi[alive], polygon), alive


def _pairings(
    catalogue: Catalogue, nodes: Interpretations, contacts: list[Contact], anchor_mm: Floats
) -> Pairings:
    sets = [catalogue.edges(contact.finger) for contact in contacts]
    return pairings_of(sets, contacts, anchor_mm, nodes.edges)


def _rectangle(g: Floats, limit: Floats) -> Floats:
    """Corners (k, 4, 2) of the rectangle that the first contact's four half-planes enclose."""
    inner, along = g[:, 1], g[:, 3]
    across = (-limit[:, 0], limit[:, 1])
    length = (-limit[:, 2], limit[:, 3])
    corners = [
        across[a][:, None] * inner + length[b][:, None] * along for a, b in ((0, 0), (1, 0), (1, 1), (0, 1))
    ]
    return np.stack(corners, axis=1)


def _clip(polygon: Floats, g: Floats, limit: Floats) -> tuple[Floats, Bools]:
    """Clip convex polygons (k, v, 2) by g·s ≤ limit, one half-plane each; returns those left, and a mask.

    The polygons given are overwritten.
    """
    if KERNEL is not None:
        clipped, rows = clip_polygons(KERNEL, polygon, g, limit)
        kept = np.zeros(len(polygon), dtype=bool)
        kept[rows] = True
        return clipped, kept
    height = np.einsum("kvj,kj->kv", polygon, g) - limit[:, None]
    cut = np.flatnonzero(np.any(height > 0, axis=1))
    kept = np.ones(len(polygon), dtype=bool)
    if not len(cut):
        return polygon, kept
    clipped, left = _clip_crossed(polygon[cut], height[cut])
    vertices = max(clipped.shape[1], polygon.shape[1])
    polygon, clipped = _pad(polygon, vertices), _pad(clipped, vertices)
    rows = cut[left]
    polygon[rows] = clipped
    if len(rows) == len(cut):
        return polygon, kept
    kept[cut[~left]] = False
    return polygon[kept], kept


def _clip_crossed(polygon: Floats, height: Floats) -> tuple[Floats, Bools]:
    """Parts of convex polygons (k, v, 2) where the height (k, v), linear in between, is not positive.

    Returns those that have one and a mask of which these are.
    """
    count, vertices = height.shape
    after = np.arange(1, vertices + 1) % vertices
    inside, following = height <= 0, height[:, after]
    crossing = inside != (following <= 0)
    fraction = np.where(crossing, height / np.where(crossing, height - following, 1.0), 0.0)
    emit = np.empty((count, vertices, 2), dtype=bool)
    emit[..., 0], emit[..., 1] = inside, crossing
    point = np.empty((count, vertices, 2, 2))
    point[:, :, 0] = polygon
    point[:, :, 1] = polygon + fraction[..., None] * (polygon[:, after] - polygon)
    emitted, points = emit.reshape(count, -1), point.reshape(count, -1, 2)
    left: Bools = np.any(emitted, axis=1)
    if not left.all():
        emitted, points = emitted[left], points[left]
    slot = np.cumsum(emitted, axis=1) - 1
    rows, columns = np.nonzero(emitted)
    leading = points[np.arange(len(points)), np.argmax(emitted, axis=1)]
    clipped = np.repeat(leading[:, None], int(slot.max(initial=0)) + 1, axis=1)
    clipped[rows, slot[rows, columns]] = points[rows, columns]
    return clipped, left
