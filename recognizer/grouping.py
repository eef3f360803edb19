"""Which cells belong together: connected pose regions, with θ counted modulo the state's symmetry.

From cells to hypotheses. Cells of one state are linked where their boxes in (x, y, θ) meet.
"""

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from palpate.recognizer.arrays import Bools, Floats, Ints, expand_ranges

__all__ = ["Boxes", "connected"]

_FEW = 160  # boxes compared each with each
_PAIRS_AT_ONCE = 2_000_000
_FIRST_NEIGHBOURS = 32
_STRETCH_RAD = 32.0  # of keys for each state: more than three turns
_TOUCHING_RAD = 1e-9


@dataclass(frozen=True, eq=False)
class Boxes:
    """k boxes: of `state` (k,), θ within `half_width` of `middle` modulo `turn`, each (k,) rad; position from
    `lo` to `hi` (k, 2) mm in W.
    """

    state: Ints
    middle: Floats
    half_width: Floats
    turn: Floats
    lo: Floats
    hi: Floats

    def meet(self, one: Ints, two: Ints) -> Bools:
        """Whether boxes `one` and `two` (index arrays that broadcast), known to be of one state, meet."""
        apart = self.middle[one] - self.middle[two]
        turn = self.turn[one]
        apart = np.abs(apart - turn * np.rint(apart / turn))
        result: Bools = apart <= self.half_width[one] + self.half_width[two] + _TOUCHING_RAD
        for axis in (0, 1):
            result &= self.lo[one, axis] <= self.hi[two, axis]
            result &= self.lo[two, axis] <= self.hi[one, axis]
        return result


def connected(boxes: Boxes) -> Ints:
    """Component (k,) of each box, numbered from 0."""
    count = len(boxes.state)
    if count > _FEW:
        return _connected_by_order(boxes)
    one, two = np.arange(count)[:, None], np.arange(count)[None]
    return _by_spreading((boxes.state[:, None] == boxes.state) & boxes.meet(one, two))


def _by_spreading(links: Bools) -> Ints:
    """Component of each of a few rows (k, k): everyone takes the least number among those linked to it."""
    label = np.arange(len(links))
    while len(links):
        least = np.where(links, label, len(links)).min(axis=1)
        least = least[least]
        if np.array_equal(least, label):
            break
        label = least
    result: Ints = np.unique(label, return_inverse=True)[1]
    return result


def _components(one: Ints, two: Ints, count: int) -> Ints:
    links = coo_array((np.ones(len(one), dtype=np.int8), (one, two)), shape=(count, count))
    label: Ints = connected_components(links, directed=False)[1].astype(np.int64)
    return label


def _connected_by_order(boxes: Boxes) -> Ints:
    """Boxes in the order of state and θ; links among near neighbours join nearly all that belong together.

    The rest is done for boxes outside of their state's largest component only, so that wide regions do not
    cost the square of their cells.
    """
    count = len(boxes.state)
    folded = boxes.middle % boxes.turn
    base = boxes.state * _STRETCH_RAD
    copies = np.concatenate([base + folded, base + folded - boxes.turn, base + folded + boxes.turn])
    order = np.argsort(copies, kind="stable")
    keys, box = copies[order], order % count
    at = np.empty(3 * count, dtype=np.int64)
    at[order] = np.arange(3 * count)
    at = at[:count]
    reach = np.minimum(boxes.half_width + float(boxes.half_width.max()) + _TOUCHING_RAD, boxes.turn)
    before = at - np.searchsorted(keys, base + folded - reach, side="left")
    after = np.searchsorted(keys, base + folded + reach, side="right") - at - 1
    everything = np.arange(count)
    links = [_links(boxes, everything, at + 1, np.minimum(after, _FIRST_NEIGHBOURS), box)]
    label = _components(links[0][0], links[0][1], count)
    size = np.bincount(label)[label]
    largest = np.zeros(int(boxes.state.max()) + 1, dtype=np.int64)
    np.maximum.at(largest, boxes.state, size)
    outside = np.flatnonzero((size < largest[boxes.state]) & (before + after > 0))
    if len(outside) and int(after.max()) > _FIRST_NEIGHBOURS:
        links.append(
            _links(boxes, outside, at[outside] - before[outside], (before + after + 1)[outside], box)
        )
        label = _components(
            np.concatenate([one for one, _ in links]), np.concatenate([two for _, two in links]), count
        )
    return label


def _links(boxes: Boxes, some: Ints, begin: Ints, count: Ints, box: Ints) -> tuple[Ints, Ints]:
    """Pairs of a box of `some` (n,) and one at places [begin, begin + count) of the order that meet."""
    left, right = [], []
    for piece in np.array_split(np.arange(len(some)), int(count.sum()) // _PAIRS_AT_ONCE + 1):
        owner, key = expand_ranges(begin[piece], count[piece])
        one, two = some[piece][owner], box[key]
        meets = boxes.meet(one, two)
        left.append(one[meets])
        right.append(two[meets])
    return np.concatenate(left), np.concatenate(right)
