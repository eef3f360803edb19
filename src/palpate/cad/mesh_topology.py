"""Topology of triangle surfaces: adjacency of faces, connected components, and pairs of boxes that overlap.

A `TriangleSurface` knows its faces' neighbours and planes; every edge belongs to two faces. Overlapping boxes
are the broad phase of collision tests between faces: a balanced tree of boxes is walked against itself, many
pairs of nodes at a time (after Gottschalk, Lin and Manocha, OBBTree, SIGGRAPH 1996, with boxes along the
axes).
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from palpate.base.geometry import Bools, Floats, Ints

_ROUNDING_SHARE = 2.0**-20
"""Eight times the spacing of single-precision numbers, in which most files are written."""


@dataclass(frozen=True, eq=False)
class TriangleSurface:
    """`vertices` (n, 3), `faces` (m, 3) and their `corners` (m, 3, 3).

    Edge k of a face runs from its corner k to the next one. `neighbours` (m, 3): the face on the other side
    of each edge, `across` (m, 3): the vertex of that face that is not on the edge. `normals` (m, 3) of length
    1, or 0 for faces thinner than `tolerance`; `heights` (m,): the smallest altitude of each face.
    """

    vertices: Floats
    faces: Ints
    corners: Floats
    neighbours: Ints
    across: Ints
    normals: Floats
    heights: Floats
    tolerance: float

    @property
    def thin(self) -> Bools:
        """Faces without a plane: nowhere wider than the tolerance (m,)."""
        result: Bools = self.heights <= self.tolerance
        return result


def vertex_rounding(vertices: Floats) -> float:
    """Distance within which two vertices (n, 3) of a file may be meant as one, in their unit.

    A millionth of the largest coordinate or side, whichever is larger: some times the rounding of single
    precision.
    """
    return float(_ROUNDING_SHARE * max(np.abs(vertices).max(), np.ptp(vertices, axis=0).max()))


def edge_keys(faces: Ints, count: int) -> tuple[Ints, Ints]:
    """A number for each directed edge (m, 3) of faces over `count` vertices, and that of its reverse."""
    start, end = faces, np.roll(faces, -1, axis=1)
    return start * count + end, end * count + start


def triangle_surface_of(vertices: Floats, faces: Ints, tolerance: float) -> TriangleSurface:
    """Take a surface apart whose every directed edge has its reverse in exactly one other face."""
    keys, reverse = edge_keys(faces, len(vertices))
    order = np.argsort(keys, axis=None)
    twins = order[np.searchsorted(keys.ravel(), reverse, sorter=order)]
    corners = vertices[faces]
    sides = np.roll(corners, -1, axis=1) - corners
    longest = np.sqrt((sides**2).sum(axis=2).max(axis=1))
    twice = np.cross(sides[:, 0], sides[:, 1])
    size = np.sqrt((twice**2).sum(axis=1))
    heights = np.divide(size, longest, out=np.zeros(len(faces)), where=longest > 0)
    normals = np.where((heights > tolerance)[:, None], twice / np.where(size > 0, size, 1.0)[:, None], 0.0)
    return TriangleSurface(
        vertices,
        faces,
        corners,
        twins // 3,
        faces[twins // 3, (twins % 3 + 2) % 3],
        normals,
        heights,
        tolerance,
    )


def component_of(first: Ints, second: Ints, count: int) -> Ints:
    """Number (count,) of each item's component, from 0; `first` (k,) are linked with `second` (k,)."""
    links = coo_array((np.ones(len(first)), (first, second)), shape=(count, count))
    labels: Ints = connected_components(links, directed=False)[1].astype(np.int64)
    return labels


_LEAF_BOXES = 4
"""Boxes in a leaf, at least: among so few every pair is looked at."""
_PAIRS_AT_ONCE = 1 << 17
"""Pairs that are worked on together: bounds the memory, whatever the shape."""


@dataclass(frozen=True, eq=False)
class _Boxes:
    """`lo`, `hi` (n, 3) and the group of each box (n,), -1 for none."""

    lo: Floats
    hi: Floats
    group: Ints

    def meeting(self, pairs: Ints) -> Ints:
        """Select the pairs (k, 2) whose boxes overlap and whose groups differ."""
        first, second = pairs.T
        keep: Bools = (self.group[first] != self.group[second]) | (self.group[first] < 0)
        pairs = pairs[keep]
        # One axis after the other: most pairs are gone after the first.
        for lo, hi in zip(self.lo.T, self.hi.T, strict=True):
            first, second = pairs.T
            pairs = pairs[(lo[first] <= hi[second]) & (lo[second] <= hi[first])]
        return pairs


def overlapping_pairs(lo: Floats, hi: Floats, group: Ints) -> Iterator[Ints]:
    """All pairs of boxes that overlap or touch, each once, in arrays of shape (k, 2).

    `lo`, `hi` (n, 3): corners of the boxes. Pairs of boxes of the same `group` (n,) are left out, except of
    group -1, which is none.
    """
    if not len(lo):
        return
    boxes = _Boxes(lo, hi, group)
    order, starts, nodes = _tree(boxes)
    first_leaf = len(starts) - 1
    stack = [np.zeros((1, 2), dtype=np.int64)]
    while stack:
        pairs = stack.pop()
        if len(pairs) > _PAIRS_AT_ONCE:
            stack += [pairs[_PAIRS_AT_ONCE:], pairs[:_PAIRS_AT_ONCE]]
            continue
        pairs = nodes.meeting(pairs)
        if not len(pairs):
            continue
        # An array holds pairs of nodes of one level only.
        if pairs[0, 0] < first_leaf:
            stack.append(_children(pairs))
            continue
        for start in range(0, len(pairs), _PAIRS_AT_ONCE // _LEAF_BOXES**2):
            leaves = pairs[start : start + _PAIRS_AT_ONCE // _LEAF_BOXES**2] - first_leaf
            found = boxes.meeting(_members(order, starts, leaves))
            if len(found):
                yield found


def _tree(boxes: _Boxes) -> tuple[Ints, Ints, _Boxes]:
    """Order of the boxes, where each leaf starts in it, and boxes of all nodes: k above 2k + 1, 2k + 2.

    Every node is cut at the median, along the longest side of the box of its centres.
    """
    count = len(boxes.lo)
    levels = max(0, int(np.log2(count / _LEAF_BOXES)) if count > _LEAF_BOXES else 0)
    order = np.arange(count)
    centre = (boxes.lo + boxes.hi) / 2
    for level in range(levels):
        starts = _node_starts(count, level)
        points = centre[order]
        spread = np.maximum.reduceat(points, starts) - np.minimum.reduceat(points, starts)
        node = np.repeat(np.arange(len(starts)), np.diff(np.append(starts, count)))
        along = points[np.arange(count), spread.argmax(axis=1)[node]]
        order = order[np.lexsort((along, node))]
    lo, hi, group = [], [], []
    for level in range(levels + 1):
        starts = _node_starts(count, level)
        lo.append(np.minimum.reduceat(boxes.lo[order], starts))
        hi.append(np.maximum.reduceat(boxes.hi[order], starts))
        least = np.minimum.reduceat(boxes.group[order], starts)
        most = np.maximum.reduceat(boxes.group[order], starts)
        group.append(np.where(least == most, least, -1))
    return order, _node_starts(count, levels), _Boxes(np.vstack(lo), np.vstack(hi), np.concatenate(group))


def _node_starts(count: int, level: int) -> Ints:
    """Places in the order at which the 2 ** level nodes of a level start."""
    result: Ints = (np.arange(1 << level) * count) >> level
    return result


def _children(pairs: Ints) -> Ints:
    """Pairs of children of pairs of nodes; a node with itself has three."""
    left, right = 2 * pairs + 1, 2 * pairs + 2
    other = pairs[:, 0] != pairs[:, 1]
    crossed = np.column_stack([right[:, 0], left[:, 1]])[other]
    return np.vstack([left, right, np.column_stack([left[:, 0], right[:, 1]]), crossed])


def _members(order: Ints, starts: Ints, leaves: Ints) -> Ints:
    """Pairs of boxes of pairs of leaves."""
    ends = np.append(starts[1:], len(order))
    width = int((ends - starts).max())
    places = starts[leaves][:, :, None] + np.arange(width)
    there = places < ends[leaves][:, :, None]
    one, two = np.divmod(np.arange(width**2), width)
    both = there[:, 0, one] & there[:, 1, two]
    both &= (leaves[:, :1] != leaves[:, 1:]) | (one < two)
    row, column = np.nonzero(both)
    result: Ints = order[np.column_stack([places[row, 0, one[column]], places[row, 1, two[column]]])]
    return result
