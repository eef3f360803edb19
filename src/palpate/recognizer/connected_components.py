"""Connected components of cells: pose regions, with θ counted modulo the state's symmetry.

Cells of one state are linked where their boxes in (x, y, θ) meet.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from palpate.base.geometry import Bools, Floats, Ints
from palpate.recognizer.constraints import Constraints
from palpate.recognizer.pose_region import Cells
from palpate.recognizer.tables import expand_ranges, split_evenly

_MAX_COMPARED_ALL = 160  # boxes that are compared each with each
_MAX_MEAN_PER_STATE = 500  # boxes of a state, in the mean over boxes
_PAIRS_AT_ONCE = 2_000_000
_FIRST_NEIGHBOURS = 32
_KEY_STRIDE_RAD = 32.0  # of keys for each state: more than three turns
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
        """Return whether boxes `one` and `two` of one state (index arrays that broadcast) meet."""
        apart = self.middle[one] - self.middle[two]
        turn = self.turn[one]
        apart = np.abs(apart - turn * np.rint(apart / turn))
        result: Bools = apart <= self.half_width[one] + self.half_width[two] + _TOUCHING_RAD
        for axis in (0, 1):
            result &= self.lo[one, axis] <= self.hi[two, axis]
            result &= self.lo[two, axis] <= self.hi[one, axis]
        return result


Group = Callable[[Boxes, Ints, tuple[Ints, Ints, Ints]], Ints]
"""Component (k,) of each box, if box `asked[0]` (n,) is compared with places [`asked[1]`, `asked[2]`) of an
order (m,) of boxes."""


def region_boxes(constraints: Constraints, cells: Cells, position: tuple[Floats, Floats]) -> Boxes:
    """Boxes of cells whose centroids are within `position`, corners (k, 2) mm in W."""
    turn = 2 * np.pi / constraints.catalogue.symmetry_orders[cells.state]
    return Boxes(cells.state, cells.middle, cells.half_width, turn, *position)


def component_labels(boxes: Boxes, group: Group, most_pairs: int = 40_000_000) -> Ints:
    """Component (k,) of each box, numbered from 0.

    Where more than `most_pairs` would have to be compared, and not all states have few, boxes that are a
    little apart may be joined, too.
    """
    count = len(boxes.state)
    if count > _MAX_COMPARED_ALL:
        return _components_by_order(boxes, group, most_pairs)
    everything = np.arange(count)
    return group(boxes, everything, (everything, everything + 1, np.full(count, count)))


def few_in_each(state: Ints) -> bool:
    """Return whether each of the states (k,) has so few boxes that all are compared with each other."""
    count = np.bincount(state).astype(float)
    return bool(count @ count <= _MAX_MEAN_PER_STATE * len(state))


def _components(one: Ints, two: Ints, count: int) -> Ints:
    links = coo_array((np.ones(len(one), dtype=np.int8), (one, two)), shape=(count, count))
    return connected_components(links, directed=False)[1].astype(np.int64)


def _components_by_order(boxes: Boxes, group: Group, most_pairs: int) -> Ints:
    """Boxes in the order of state and θ; links among near neighbours join nearly all that belong together.

    The rest is done for boxes outside of their state's largest component only, so that wide regions do not
    cost the square of their cells.
    """
    count = len(boxes.state)
    folded = boxes.middle % boxes.turn
    base = boxes.state * _KEY_STRIDE_RAD
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
    size = np.minimum(after, _FIRST_NEIGHBOURS)
    label = group(boxes, box, (everything, at + 1, at + 1 + size))
    # A box of each state's largest component: assignment keeps the last, and these come sorted by size.
    members = np.bincount(label)[label]
    largest = np.zeros(int(boxes.state.max()) + 1, dtype=np.int64)
    by_size = np.argsort(members, kind="stable")
    largest[boxes.state[by_size]] = by_size
    outside = np.flatnonzero((label != label[largest[boxes.state]]) & (before + after > 0))
    if not len(outside) or int(after.max()) <= _FIRST_NEIGHBOURS:
        return label
    around = before + after + 1
    if int(around[outside].sum()) > most_pairs and not few_in_each(boxes.state):
        return _components_by_bins(boxes)
    begin = np.concatenate([at + 1, (at - before)[outside]])
    size = np.concatenate([size, around[outside]])
    return group(boxes, box, (np.append(everything, outside), begin, begin + size))


def _components_by_bins(boxes: Boxes) -> Ints:
    """Boxes that reach into one bin of a grid count as connected: for very many that overlap all over.

    That joins a few that are apart by less than a bin: fewer and wider hypotheses, none of them untrue. A bin
    is as large as the middling box, and no box covers more than five of them along an axis.
    """
    count = len(boxes.state)
    theta = boxes.middle % boxes.turn
    lo = np.column_stack([boxes.lo, theta - boxes.half_width])
    hi = np.column_stack([boxes.hi, theta + boxes.half_width])
    extent = hi - lo
    size = np.maximum(np.maximum(np.median(extent, axis=0), extent.max(axis=0) / 4), 1e-9)
    # Whole bins in every turn, so that the last one meets the first.
    round_about = np.maximum(np.floor(boxes.turn / size[2]), 1.0).astype(np.int64)
    scale = np.column_stack([np.full((count, 2), 1 / size[:2]), round_about / boxes.turn])
    first = np.floor((lo - _TOUCHING_RAD) * scale).astype(np.int64)
    spread = np.floor((hi + _TOUCHING_RAD) * scale).astype(np.int64) - first + 1
    owner, place = expand_ranges(np.zeros(count, np.int64), spread.prod(axis=1))
    wide, deep = spread[owner, 0], spread[owner, 1]
    x = first[owner, 0] + place % wide
    y = first[owner, 1] + place // wide % deep
    angle = (first[owner, 2] + place // (wide * deep)) % round_about[owner]
    _, bin_of = np.unique(np.column_stack([boxes.state[owner], x, y, angle]), axis=0, return_inverse=True)
    return _components(owner, count + bin_of, count + int(bin_of.max()) + 1)[:count]


def group_by_links(boxes: Boxes, order: Ints, asked: tuple[Ints, Ints, Ints]) -> Ints:
    """Components by whole arrays: a `Group`."""
    some, begin, end = asked
    links = []
    for piece in split_evenly(len(some), int((end - begin).sum()) // _PAIRS_AT_ONCE + 1):
        owner, place = expand_ranges(begin[piece], (end - begin)[piece])
        one, two = some[piece][owner], order[place]
        meets = (boxes.state[one] == boxes.state[two]) & boxes.meet(one, two)
        links.append((one[meets], two[meets]))
    return _components(
        np.concatenate([one for one, _ in links]), np.concatenate([two for _, two in links]), len(boxes.state)
    )
