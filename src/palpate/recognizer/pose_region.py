"""Pose regions: the remaining configuration space of an interpretation, as a list of cells.

A cell is an interval of orientations and a convex polygon of positions that together contain every feasible
configuration in that interval: each half-plane of the `model_test` is relaxed to its largest value over the
interval, and the polygon is clipped by them. The union of an interpretation's cells contains the truth
whenever the errors are in bounds. Connected cells, with a configuration that was looked for in them, are the
regions of hypotheses.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from palpate.base.geometry import Bools, Floats, Ints
from palpate.recognizer.interpretations import Interpretations
from palpate.recognizer.tables import Table, expand_ranges

PARTS_PER_CELL = 4
"""Parts into which a cell is cut."""

LEVER_MM = 40.0
"""What a turn counts for against a shift, where sides of cells or configurations are compared."""

MAX_TRIPLED_CONTACTS = 4
"""Contacts whose triples are looked at again when cells are refined."""

_CIRCLES_AT_ONCE = 4096  # as many as a processor's cache holds
_MAX_ALL_PROBED, _INTERVALS_PER_PROBE = 256, 8
_MAX_CELLS = 64  # per interpretation and pass
_NARROWEST_RAD = 2e-4  # narrower cells bound nothing better: 0.01 mm at 50 mm


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
    def join(cls, parts: "Sequence[Cells]") -> "Cells":
        """Cells of several regions in one; polygons with fewer vertices are padded."""
        most = max(part.polygon.shape[1] for part in parts)
        return super().join([replace(part, polygon=pad_polygons(part.polygon, most)) for part in parts])

    @cached_property
    def middle(self) -> Floats:
        """Middle orientation, (k,)."""
        return (self.lo + self.hi) / 2

    @cached_property
    def half_width(self) -> Floats:
        """Half of the orientation interval, (k,)."""
        return (self.hi - self.lo) / 2

    @property
    def centre(self) -> Floats:
        """Middle of each polygon's bounding box, (k, 2)."""
        return self._circles[0]

    @property
    def radius(self) -> Floats:
        """Largest distance from `centre` to a vertex, (k,)."""
        return self._circles[1]

    @cached_property
    def _circles(self) -> tuple[Floats, Floats]:
        """Centres and radii, vertex by vertex and some cells at once: many times as fast as cell by cell."""
        centre, radius = np.empty((len(self), 2)), np.empty(len(self))
        for begin in range(0, len(self), _CIRCLES_AT_ONCE):
            some = slice(begin, begin + _CIRCLES_AT_ONCE)
            offset = self.polygon[some].T.copy()
            middle = (offset.min(axis=1) + offset.max(axis=1)) / 2
            offset -= middle[:, None]
            offset *= offset
            centre[some] = middle.T
            radius[some] = np.sqrt((offset[0] + offset[1]).max(axis=0))
        return centre, radius

    @cached_property
    def volume(self) -> Floats:
        """Area times orientation interval, (k,) mm²·rad."""
        x, y = self.polygon[..., 0], self.polygon[..., 1]
        after = np.arange(1, x.shape[1] + 1) % x.shape[1]
        twice = np.sum(x * y[:, after] - y * x[:, after], axis=1)
        result: Floats = np.abs(twice) / 2 * (self.hi - self.lo)
        return result

    def displacement(self, reach_mm: Floats) -> Floats:
        """Largest distance of the object's points from where the middle configuration puts them, (k,) mm.

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


def pad_polygons(polygon: Floats, vertices: int) -> Floats:
    """Polygons (k, v, 2) with the first vertex repeated up to a number of vertices."""
    missing = vertices - polygon.shape[1]
    if not missing:
        return polygon
    return np.concatenate([polygon, np.repeat(polygon[:, :1], missing, axis=1)], axis=1)


def clip_polygons(polygon: Floats, g: Floats, limit: Floats) -> tuple[Floats, Bools]:
    """Clip convex polygons (k, v, 2) by g·s ≤ limit, one half-plane each; returns those left, and a mask.

    The polygons given are overwritten.
    """
    height = np.einsum("kvj,kj->kv", polygon, g) - limit[:, None]
    cut = np.flatnonzero(np.any(height > 0, axis=1))
    kept = np.ones(len(polygon), dtype=bool)
    if not len(cut):
        return polygon, kept
    clipped, left = _clip_crossed(polygon[cut], height[cut])
    vertices = max(clipped.shape[1], polygon.shape[1])
    polygon, clipped = pad_polygons(polygon, vertices), pad_polygons(clipped, vertices)
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


def intervals_to_probe(intervals: Intervals) -> Ints:
    """Rows of intervals that are probed in their middle: all, or some of each node if they are many."""
    if len(intervals) <= _MAX_ALL_PROBED:
        return np.arange(len(intervals))
    return _middle_rows(intervals.node)


def _middle_rows(node: Ints) -> Ints:
    """Middle row of each stretch of at most `_INTERVALS_PER_PROBE` rows with one and the same node (k,)."""
    row = np.arange(len(node))
    begins = np.ones(len(node), dtype=bool)
    begins[1:] = node[1:] != node[:-1]
    begins |= (row - np.maximum.accumulate(np.where(begins, row, 0))) % _INTERVALS_PER_PROBE == 0
    first = np.flatnonzero(begins)
    middles: Ints = (first + np.append(first[1:], len(node))) // 2
    return middles


@dataclass(frozen=True, eq=False)
class WitnessedCells(Table):
    """k cells; where `holds` (k,), position `spot` s (k, 2) and the middle orientation are a candidate."""

    cells: Cells
    spot: Floats
    holds: Bools


@dataclass(frozen=True, eq=False)
class Regions:
    """h regions: `cells` (k) ordered by region, each on one branch of the symmetry; region i has those from
    `first`[i] to `first`[i + 1]. `unturned` (k): the same on the branches of their interpretations. `theta`
    (h,) rad and `position` s (h, 2) mm of a configuration in it, which satisfies everything exactly where
    `verified` (h,), except for what its interpretation, `node` (h,), takes as spurious.
    """

    cells: Cells
    unturned: Cells
    first: Ints
    theta: Floats
    position: Floats
    verified: Bools
    node: Ints

    def __len__(self) -> int:
        return len(self.theta)

    def coarse_cells(self, most: int) -> tuple[Cells, Ints]:
        """Cells that cover the regions, about `most` in all, and `first` (h + 1,) of them.

        As they are where they are no more; else neighbours in orientation are one, with a box about their
        positions.
        """
        size, cells = np.diff(self.first), self.cells
        if len(cells) <= most:
            return cells, self.first
        wanted = np.minimum(size, max(most // len(size), 1))
        region = np.repeat(np.arange(len(size)), size)
        rank = np.arange(len(cells)) - self.first[region]
        part = rank * wanted[region] // size[region]
        begin = np.flatnonzero(np.append(True, (np.diff(part) != 0) | (np.diff(region) != 0)))
        cells = cells.select(np.lexsort((cells.middle, region)))
        low = np.minimum.reduceat(cells.polygon.min(axis=1), begin)
        high = np.maximum.reduceat(cells.polygon.max(axis=1), begin)
        corners = [
            (low[:, 0], low[:, 1]),
            (high[:, 0], low[:, 1]),
            (high[:, 0], high[:, 1]),
            (low[:, 0], high[:, 1]),
        ]
        covering = Cells(
            cells.node[begin],
            cells.state[begin],
            np.minimum.reduceat(cells.lo, begin),
            np.maximum.reduceat(cells.hi, begin),
            np.stack([np.column_stack(corner) for corner in corners], axis=1),
        )
        return covering, np.searchsorted(region[begin], np.arange(len(size) + 1))

    def select(self, rows: Ints) -> "Regions":
        """Regions at `rows` (n,), in that order."""
        count = np.diff(self.first)[rows]
        _, cell = expand_ranges(self.first[rows], count)
        return replace(
            self,
            theta=self.theta[rows],
            position=self.position[rows],
            verified=self.verified[rows],
            node=self.node[rows],
            cells=self.cells.select(cell),
            unturned=self.unturned.select(cell),
            first=np.cumsum(np.append(0, count)),
        )

    @classmethod
    def join(cls, parts: "Sequence[Regions]") -> "Regions":
        """The regions of all parts, one part after the other."""
        if len(parts) == 1:
            return parts[0]
        before = np.cumsum([0, *(part.first[-1] for part in parts)])
        begins = [part.first[:-1] + cells for part, cells in zip(parts, before[:-1], strict=True)]
        return cls(
            Cells.join([part.cells for part in parts]),
            Cells.join([part.unturned for part in parts]),
            np.concatenate([*begins, before[-1:]]),
            np.concatenate([part.theta for part in parts]),
            np.concatenate([part.position for part in parts]),
            np.concatenate([part.verified for part in parts]),
            np.concatenate([part.node for part in parts]),
        )

    def with_cells(self, kept: Bools) -> "Regions":
        """The same with only some of the cells (k,); regions that have none left are gone."""
        size = np.add.reduceat(kept, self.first[:-1], dtype=np.int64) if len(self) else np.empty(0, np.int64)
        rows = np.flatnonzero(kept)
        some = replace(
            self,
            cells=self.cells.select(rows),
            unturned=self.unturned.select(rows),
            first=np.cumsum(np.append(0, size)),
        )
        return some.select(np.flatnonzero(size))
