"""Pose regions: what is left of the configuration space of an interpretation, as a list of cells.

From interpretations to certified bounds, weights and witnesses, and to the planner. A cell is an interval of
orientations and a convex polygon of positions that together contain every feasible configuration in that
interval: each half-plane of `arcs` is relaxed to its largest value over the interval, and the polygon is
clipped by them. The union of an interpretation's cells contains the truth whenever the errors are in bounds.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from palpate.recognizer.arcs import TRIPLE_TRIPLES, all_half_planes, arc_hull, largest, triple_arcs
from palpate.recognizer.arrays import Bools, Floats, Ints, expand_ranges
from palpate.recognizer.catalogue import Catalogue
from palpate.recognizer.chord import chord_hull
from palpate.recognizer.contact import Contact
from palpate.recognizer.tree import Interpretations

__all__ = ["Cells", "build_cells", "exact_position", "joined_cells", "refined"]

_MAX_CELLS = 64  # per interpretation and pass
_TRIPLED = 4  # contacts whose triples are looked at again when cells are refined
_FINEST_RAD = 2e-4  # narrower cells bound nothing better: 0.01 mm at 50 mm


@dataclass(frozen=True, eq=False)
class Cells:
    """k cells. `node` (k,): the interpretation each belongs to; θ in [`lo`, `hi`] (k,) rad.

    `polygon` (k, v, 2) mm: positions s = R(−θ)(p − anchor) of the centroid, seen in the object's frame,
    counter-clockwise, padded by repeating the first vertex. `state` (k,): index into the catalogue.
    """

    node: Ints
    state: Ints
    lo: Floats
    hi: Floats
    polygon: Floats

    def __len__(self) -> int:
        return len(self.node)

    def select(self, index: Ints | Bools | slice) -> "Cells":
        """Those at `index` (integers, a mask or a slice)."""
        return Cells(self.node[index], self.state[index], self.lo[index], self.hi[index], self.polygon[index])

    @property
    def middle(self) -> Floats:
        """Middle orientation, (k,)."""
        result: Floats = (self.lo + self.hi) / 2
        return result

    @property
    def half_width(self) -> Floats:
        """Half of the orientation interval, (k,)."""
        result: Floats = (self.hi - self.lo) / 2
        return result

    @property
    def centre(self) -> Floats:
        """Middle of each polygon's bounding box, (k, 2)."""
        result: Floats = (self.polygon.min(axis=1) + self.polygon.max(axis=1)) / 2
        return result

    @property
    def radius(self) -> Floats:
        """Largest distance from `centre` to a vertex, (k,)."""
        offset = self.polygon - self.centre[:, None]
        result: Floats = np.hypot(offset[..., 0], offset[..., 1]).max(axis=1)
        return result

    @property
    def volume(self) -> Floats:
        """Area times orientation interval, (k,) mm²·rad."""
        following = np.roll(self.polygon, -1, axis=1)
        twice = np.sum(
            self.polygon[..., 0] * following[..., 1] - self.polygon[..., 1] * following[..., 0], axis=1
        )
        result: Floats = np.abs(twice) / 2 * (self.hi - self.lo)
        return result

    def displacement(self, reach_mm: Floats) -> Floats:
        """How far the object's points may be from where the cell's middle configuration puts them, (k,) mm.

        Holds for all points within `reach_mm` (k,) of the centroid and every configuration in the cell.
        """
        lever = reach_mm + np.hypot(*self.centre.T)
        result: Floats = self.half_width * lever + self.radius
        return result


def joined_cells(parts: Sequence[Cells]) -> Cells:
    """Cells of several regions in one; polygons with fewer vertices are padded."""
    most = max(part.polygon.shape[1] for part in parts)
    polygons = [np.pad(part.polygon, ((0, 0), (0, most - part.polygon.shape[1]), (0, 0))) for part in parts]
    for part, polygon in zip(parts, polygons, strict=True):
        polygon[:, part.polygon.shape[1] :] = polygon[:, :1]
    return Cells(
        np.concatenate([part.node for part in parts]),
        np.concatenate([part.state for part in parts]),
        np.concatenate([part.lo for part in parts]),
        np.concatenate([part.hi for part in parts]),
        np.concatenate(polygons),
    )


def build_cells(
    catalogue: Catalogue,
    nodes: Interpretations,
    contacts: list[Contact],
    anchor_mm: Floats,
    *,
    step_rad: float,
    least: int,
) -> Cells:
    """Cells of every interpretation over its orientation interval, empty ones left out.

    Each interval is cut into steps of at most `step_rad`, at least `least` and at most 64 of them; but one
    that is narrow already is not cut for the sake of `least`.
    """
    width = nodes.hi - nodes.lo
    fewest = np.clip(np.ceil(width / _FINEST_RAD), 1, least)
    count = np.clip(np.ceil(width / step_rad), fewest, _MAX_CELLS).astype(np.int64)
    node, part = expand_ranges(np.zeros_like(count), count)
    width = (nodes.hi - nodes.lo)[node] / count[node]
    lo = nodes.lo[node] + part * width
    return _cut(catalogue, nodes, contacts, anchor_mm, node, lo, lo + width)


def refined(
    catalogue: Catalogue,
    nodes: Interpretations,
    cells: Cells,
    contacts: list[Contact],
    anchor_mm: Floats,
    parts: int,
) -> Cells:
    """The same region in cells of 1/`parts` of the width, cut anew: never larger, often smaller or empty.

    Each is first narrowed to the orientations that the closed-form test leaves for the contacts, taken in
    threes as long as they are few: their triples are many, and narrow cells say nearly as much.
    """
    owner, part = expand_ranges(np.zeros(len(cells), np.int64), np.full(len(cells), parts))
    width = (cells.hi - cells.lo)[owner] / parts
    lo = cells.lo[owner] + part * width
    hi = np.where(part == parts - 1, cells.hi[owner], lo + width)
    node = cells.node[owner]
    for pair in combinations(range(len(contacts)), 2):
        lo, hi = _by_chord(catalogue, nodes.edges[node][:, pair], [contacts[k] for k in pair], lo, hi)
        node, lo, hi = _left(node, lo, hi)
    if len(contacts) <= _TRIPLED:
        for group in combinations(range(len(contacts)), 3):
            some = [contacts[k] for k in group]
            g, coefficients = all_half_planes(catalogue, nodes.edges[node][:, group], some, anchor_mm)
            lo, hi = arc_hull(lo, hi, triple_arcs(g, coefficients, TRIPLE_TRIPLES))
            node, lo, hi = _left(node, lo, hi)
    return _cut(catalogue, nodes, contacts, anchor_mm, node, lo, hi)


def _by_chord(
    catalogue: Catalogue, edges: Ints, pair: list[Contact], lo: Floats, hi: Floats
) -> tuple[Floats, Floats]:
    """`chord_hull` of two contacts on `edges` (k, 2); where either is null, all of [lo, hi] is left."""
    one, two = pair
    first, second = catalogue.edges(one.finger), catalogue.edges(two.finger)
    null = (edges < 0).any(axis=1)
    if not null.any():
        return chord_hull(first, edges[:, 0], one, second, edges[:, 1], two, lo, hi)
    lo, hi = lo.copy(), hi.copy()
    if not null.all():
        edges = edges[~null]
        lo[~null], hi[~null] = chord_hull(
            first, edges[:, 0], one, second, edges[:, 1], two, lo[~null], hi[~null]
        )
    return lo, hi


def _left(node: Ints, lo: Floats, hi: Floats) -> tuple[Ints, Floats, Floats]:
    left = lo <= hi
    return node[left], lo[left], hi[left]


def exact_position(
    catalogue: Catalogue, nodes: Interpretations, contacts: list[Contact], anchor_mm: Floats, theta: Floats
) -> tuple[Floats, Bools]:
    """A position s (n, 2) that satisfies every contact of its interpretation at orientation θ (n,) exactly.

    The mean of the vertices of the feasible polygon. Also whether there is one (n,).
    """
    cells = _cut(catalogue, nodes, contacts, anchor_mm, np.arange(len(nodes)), theta, theta)
    position = np.zeros((len(nodes), 2))
    found = np.zeros(len(nodes), dtype=bool)
    position[cells.node] = cells.polygon.mean(axis=1)
    found[cells.node] = True
    return position, found


def _cut(
    catalogue: Catalogue,
    nodes: Interpretations,
    contacts: list[Contact],
    anchor_mm: Floats,
    node: Ints,
    lo: Floats,
    hi: Floats,
) -> Cells:
    """The cells [lo, hi] of the given nodes: the first contact's rectangle, clipped by all other contacts."""
    g, coefficients = all_half_planes(catalogue, nodes.edges[node], contacts, anchor_mm)
    limit = largest(coefficients, lo[:, None], hi[:, None])
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
    return Cells(node, nodes.state[node], lo[alive], hi[alive], polygon)


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
    """Clip convex polygons (k, v, 2) by g·s ≤ limit, one half-plane each; returns those left, and a mask."""
    height = np.einsum("kvj,kj->kv", polygon, g) - limit[:, None]
    inside = height <= 0
    if bool(np.all(inside)):
        return polygon, np.ones(len(polygon), dtype=bool)
    following = np.roll(height, -1, axis=1)
    crossing = inside != (following <= 0)
    fraction = np.where(crossing, height / np.where(crossing, height - following, 1.0), 0.0)
    cut = polygon + fraction[..., None] * (np.roll(polygon, -1, axis=1) - polygon)
    count, vertices = height.shape
    emit = np.stack([inside, crossing], axis=2).reshape(count, 2 * vertices)
    point = np.stack([polygon, cut], axis=2).reshape(count, 2 * vertices, 2)
    slot = np.cumsum(emit, axis=1) - 1
    kept = slot[:, -1] >= 0
    emit, point, slot = emit[kept], point[kept], slot[kept]
    rows, columns = np.nonzero(emit)
    leading = point[np.arange(len(point)), np.argmax(emit, axis=1)]
    clipped = np.repeat(leading[:, None], int(slot.max(initial=0)) + 1, axis=1)
    clipped[rows, slot[rows, columns]] = point[rows, columns]
    return clipped, kept
