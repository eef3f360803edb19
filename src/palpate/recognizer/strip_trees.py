"""Strip trees of outlines with very many edges (memo §3.3; Ballard 1981).

A strip stands for a run of neighbouring edges: a segment from the run's start to its end, how far the run
strays from it, and the range of its normals. Distance and angle are tested on strips first, and only the
halves of strips that pass are looked at further, down to single edges. What the flat search would keep is in
what the strips leave.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from palpate.base.geometry import Bools, Floats, Ints
from palpate.base.geometry.plane import wrap_angle
from palpate.recognizer.budget import BudgetSpentError
from palpate.recognizer.edges import EdgeSet, ring_order
from palpate.recognizer.tables import Table

_ROUNDING_MM = 1e-6
_ROUNDING_RAD = 1e-9


@dataclass(frozen=True, eq=False)
class StripForest(Table):
    """Strip trees of some states of an edge set; N strips in all.

    `start` and `end` (N, 2) mm in the object's frame: the strip's segment; `stray` (N,) mm: how far the run,
    slack included, leaves it; `normal` and `half_turn` (N,) rad: middle and half of the range of normals
    (spans included); `left` and `right` (N,): the strip's halves, −1 for a single edge; `edge` (N,): that
    edge, −1 for others; `root` (S,): −1 for states without a tree.
    """

    start: Floats
    end: Floats
    stray: Floats
    normal: Floats
    half_turn: Floats
    left: Ints
    right: Ints
    edge: Ints
    root: Ints

    def descend(
        self, state: Ints, keep: Callable[[Ints, Ints], Bools], most: int | None = None
    ) -> tuple[Ints, Ints]:
        """Edges that m queries, each about one `state` (m,), leave: (query, edge), flat.

        `keep(query, strip)` says which strips may hold an edge that the query is after; it must be true for
        every strip above such an edge. Raises BudgetSpentError where there are more than `most`.
        """
        query = np.flatnonzero(self.root[state] >= 0)
        strip = self.root[state[query]]
        found: list[tuple[Ints, Ints]] = []
        while len(query):
            kept = keep(query, strip)
            query, strip = query[kept], strip[kept]
            leaves = self.edge[strip] >= 0
            found.append((query[leaves], self.edge[strip[leaves]]))
            _check_room(found, len(query), most)
            strip, query = self._halves(strip[~leaves], query[~leaves])
        none = np.empty(0, np.int64)
        return (
            np.concatenate([none, *(a for a, _ in found)]),
            np.concatenate([none, *(b for _, b in found)]),
        )

    def _halves(self, strip: Ints, with_it: Ints) -> tuple[Ints, Ints]:
        """Both halves of each strip; a single edge stays as it is."""
        single = self.edge[strip] >= 0
        split = ~single
        parts = np.concatenate([strip[single], self.left[strip[split]], self.right[strip[split]]])
        return parts, np.concatenate([with_it[single], with_it[split], with_it[split]])


def _check_room(found: list[tuple[Ints, Ints]], going: int, most: int | None) -> None:
    """Stop once what was `found`, with what is still `going` down, is too much."""
    if most is not None and sum(len(one) for one, _ in found[:-1]) + going > most:
        raise BudgetSpentError


def strip_forest(edges: EdgeSet, chosen: Bools) -> StripForest:
    """Trees over the outlines of the `chosen` (S,) states."""
    root = np.full(len(chosen), -1, dtype=np.int64)
    parts: list[StripForest] = []
    size = 0
    for state in np.flatnonzero(chosen & (edges.count > 0)):
        block = slice(int(edges.first[state]), int(edges.first[state + 1]))
        ring, _ = ring_order(edges.start[block], edges.end[block])
        tree = _tree(edges, block.start + ring, size)
        root[state] = size
        size += len(tree.edge)
        parts.append(tree)
    if not parts:
        nothing, none = np.empty(0), np.empty(0, np.int64)
        return StripForest(
            np.empty((0, 2)), np.empty((0, 2)), nothing, nothing, nothing, none, none, none, root
        )
    return replace(StripForest.join(parts), root=root)


def _tree(edges: EdgeSet, ring: Ints, offset: int) -> StripForest:
    """The tree over edges `ring` (n,) in order, its root first; children are numbered from `offset` on."""
    turn = wrap_angle(np.diff(edges.normal_rad[ring]))
    normal = edges.normal_rad[ring[0]] + np.concatenate([[0.0], np.cumsum(turn)])
    begin, end = [0], [len(ring)]
    left, right = [-1], [-1]
    at = 0
    while at < len(begin):
        if end[at] - begin[at] > 1:
            middle = (begin[at] + end[at]) // 2
            left[at], right[at] = offset + len(begin), offset + len(begin) + 1
            begin += [begin[at], middle]
            end += [middle, end[at]]
            left += [-1, -1]
            right += [-1, -1]
        at += 1
    first, last = np.array(begin), np.array(end) - 1
    start, stop = edges.start[ring[first]], edges.end[ring[last]]
    single = first == last
    lo, hi = _extremes(normal - edges.span[ring], normal + edges.span[ring], first, last)
    return StripForest(
        start=start,
        end=stop,
        stray=_stray(edges, ring, first, last),
        normal=(lo + hi) / 2,
        half_turn=np.minimum((hi - lo) / 2, np.pi),
        left=np.array(left),
        right=np.array(right),
        edge=np.where(single, ring[first], -1),
        root=np.empty(0, np.int64),
    )


def _extremes(low: Floats, high: Floats, first: Ints, last: Ints) -> tuple[Floats, Floats]:
    lo = np.array([low[a : b + 1].min() for a, b in zip(first, last, strict=True)])
    hi = np.array([high[a : b + 1].max() for a, b in zip(first, last, strict=True)])
    return lo, hi


def _stray(edges: EdgeSet, ring: Ints, first: Ints, last: Ints) -> Floats:
    """Distance to which each run's edges, with their slack, leave the segment from its start to its end."""
    points, ends, slack = edges.start[ring], edges.end[ring], edges.slack_mm[ring]
    result = np.empty(len(first))
    for k, (a, b) in enumerate(zip(first, last, strict=True)):
        along = ends[b] - points[a]
        square = float(along @ along)
        rel = np.vstack([points[a : b + 1], ends[a : b + 1]]) - points[a]
        part = np.clip(rel @ along / square, 0.0, 1.0) if square > 0 else np.zeros(len(rel))
        away = np.hypot(*(rel - part[:, None] * along).T)
        result[k] = float(away.max()) + float(slack[a : b + 1].max())
    return result
