"""From cells to settled regions: connected, on one branch of the symmetry, with a witness if there is one.

Between cells and hypotheses. Everything is done for all regions at once. Cells are a little larger than
what they enclose. Where no configuration in a region is found to hold, its cells are cut finer: one comes to
light, or nothing is left, or the doubt stays and the region remains unverified.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from palpate.recognizer.arcs import largest
from palpate.recognizer.arrays import Bools, Floats, Ints, expand_ranges
from palpate.recognizer.catalogue import Catalogue
from palpate.recognizer.contact import Contact
from palpate.recognizer.grouping import Boxes, connected
from palpate.recognizer.null_branch import ignored
from palpate.recognizer.region import Cells, exact_position, joined_cells, refined
from palpate.recognizer.sweep import unblocked
from palpate.recognizer.tree import Interpretations

__all__ = ["Question", "Regions", "position_boxes", "settled"]

_REFINEMENTS, _PARTS, _MOST_REFINED = 3, 4, 2048
_WITNESS_TRIES = 12


@dataclass(frozen=True, eq=False)
class Question:
    """What every region has to satisfy: pairings of `touched`, and all contacts and misses as evidence.

    A contact that an interpretation takes as spurious is no evidence for its cells.
    """

    catalogue: Catalogue
    nodes: Interpretations
    touched: list[Contact]
    evidence: list[Contact]
    anchor_mm: Floats

    @cached_property
    def nulls(self) -> Ints:
        """Number of null contacts of each interpretation, (n,)."""
        count: Ints = np.count_nonzero(self.nodes.edges < 0, axis=1)
        return count

    def unblocked(self, cells: Cells) -> Bools:
        """Cells (k,) that the free paths do not rule out."""
        skipped = ignored(self.nodes, cells.node, self.evidence)
        return unblocked(self.catalogue, cells, self.anchor_mm, self.evidence, skipped)


@dataclass(frozen=True, eq=False)
class Regions:
    """h regions: `cells` (k) ordered by region, each on one branch of the symmetry; region i has those from
    `first`[i] to `first`[i + 1]. `theta` (h,) rad and `position` s (h, 2) mm of a configuration in it, which
    satisfies everything exactly where `verified` (h,), except for what its interpretation, `node` (h,), takes
    as spurious.
    """

    cells: Cells
    first: Ints
    theta: Floats
    position: Floats
    verified: Bools
    node: Ints

    def __len__(self) -> int:
        return len(self.theta)

    def select(self, rows: Ints) -> "Regions":
        """Those at `rows` (n,), in that order."""
        count = np.diff(self.first)[rows]
        _, cell = expand_ranges(self.first[rows], count)
        return Regions(
            self.cells.select(cell),
            np.cumsum(np.append(0, count)),
            self.theta[rows],
            self.position[rows],
            self.verified[rows],
            self.node[rows],
        )


def settled(question: Question, cells: Cells, refinements: int = _REFINEMENTS) -> Regions:
    """The connected regions of `cells`, without those that prove to be empty."""
    label = connected(_boxes(question, cells))
    order = np.argsort(label, kind="stable")
    cells, label = cells.select(order), label[order]
    first = np.searchsorted(label, np.arange(int(label.max(initial=-1)) + 2))
    branch = _branch(question.catalogue, cells, first, label)
    refinable = (np.diff(first) * _PARTS <= _MOST_REFINED) & (refinements > 0)
    regions = _witnessed(question, cells, first, label, branch, refinable)
    doubtful = ~regions.verified & refinable
    if not doubtful.any():
        return regions
    again = cells.select(doubtful[label])
    finer = refined(question.catalogue, question.nodes, again, question.touched, question.anchor_mm, _PARTS)
    finer = finer.select(question.unblocked(finer))
    return _both(regions.select(np.flatnonzero(~doubtful)), settled(question, finer, refinements - 1))


def _both(one: Regions, two: Regions) -> Regions:
    return Regions(
        joined_cells([one.cells, two.cells]),
        np.concatenate([one.first, one.first[-1] + two.first[1:]]),
        np.concatenate([one.theta, two.theta]),
        np.concatenate([one.position, two.position]),
        np.concatenate([one.verified, two.verified]),
        np.concatenate([one.node, two.node]),
    )


def _boxes(question: Question, cells: Cells) -> Boxes:
    lo, hi = position_boxes(cells, np.zeros((len(cells), 2)), question.anchor_mm)
    return Boxes(cells.state, cells.middle, cells.half_width, _turn(question.catalogue, cells), lo, hi)


def _turn(catalogue: Catalogue, cells: Cells) -> Floats:
    """Smallest turn (k,) rad that leaves each cell's state as it was."""
    result: Floats = 2 * np.pi / catalogue.symmetry_orders[cells.state]
    return result


@dataclass(frozen=True, eq=False)
class _Branch:
    """How each cell is brought to its region's branch: θ less `shift` (k,), s turned by `angle` (k,).

    p = R(θ) s is the same for θ − kτ and R(kτ) s.
    """

    shift: Floats
    angle: Floats


def _branch(catalogue: Catalogue, cells: Cells, first: Ints, label: Ints) -> _Branch:
    """The reference of a region is its largest cell, brought into [−π, π)."""
    turn = _turn(catalogue, cells)
    middle = cells.middle
    reference = middle[_best(cells.volume, first, label)][label]
    angle = np.rint((middle - reference) / turn) * turn
    whole = 2 * np.pi * np.floor((reference + np.pi) / (2 * np.pi))
    return _Branch(angle + whole, angle)


def _best(value: Floats, first: Ints, label: Ints) -> Ints:
    """Row (h,) with the largest value (k,) in each run of labels; of equals the first."""
    most = np.maximum.reduceat(value, first[:-1]) if len(first) > 1 else np.empty(0)
    rows = np.flatnonzero(value >= most[label]) if len(most) else np.empty(0, np.int64)
    result: Ints = rows[np.searchsorted(label[rows], np.arange(len(first) - 1))]
    return result


def _turned_cells(cells: Cells, branch: _Branch) -> Cells:
    polygon = cells.polygon
    if np.any(branch.angle != 0):
        polygon = _turned(polygon, branch.angle[:, None])
    return Cells(cells.node, cells.state, cells.lo - branch.shift, cells.hi - branch.shift, polygon)


def _turned(vector: Floats, angle: Floats) -> Floats:
    """Vectors (…, 2) turned by angles (…)."""
    cos, sin = np.cos(angle), np.sin(angle)
    x, y = vector[..., 0], vector[..., 1]
    return np.stack([cos * x - sin * y, sin * x + cos * y], axis=-1)


def _witnessed(
    question: Question, cells: Cells, first: Ints, label: Ints, branch: _Branch, refinable: Bools
) -> Regions:
    """Regions with a configuration that satisfies everything exactly, near their middle if one is there.

    Tried first at the region's mean orientation, then at its largest cells' middles; if none holds, the
    middle of the largest cell is given, unverified. Only cells of interpretations with the fewest null
    contacts count, and after them, where the region (h,) is not `refinable`, the others.
    """
    turned = _turned_cells(cells, branch)
    regions, volume = len(first) - 1, cells.volume
    theta, position = np.zeros(regions), np.zeros((regions, 2))
    verified = np.zeros(regions, dtype=bool)
    if not regions:
        return Regions(turned, first, theta, position, verified, np.empty(0, np.int64))
    nulls = question.nulls[cells.node]
    plain = nulls == np.minimum.reduceat(nulls, first[:-1])[label]
    share = np.where(plain, volume + 1e-300, 0.0)
    mean = np.add.reduceat(share * turned.middle, first[:-1]) / np.add.reduceat(share, first[:-1])
    mean = mean[label]
    holds = (turned.lo <= mean) & (mean <= turned.hi)
    rank = np.where(holds, 1.0 + volume, volume / (1.0 + volume))
    chosen = _best(np.where(plain, rank, -1.0), first, label)
    at = np.where(holds[chosen], mean[chosen], turned.middle[chosen])
    largest_cell = _best(np.where(plain, volume, -1.0), first, label)
    node = cells.node[largest_cell]
    theta[:], position[:] = turned.middle[largest_cell], turned.centre[largest_cell]

    def attempt(cell: Ints, at: Floats) -> None:
        found, where = _holds(question, cells, cell, at + branch.shift[cell])
        # Of several that hold in a region the first counts.
        region, row = np.unique(label[cell[found]], return_index=True)
        row = np.flatnonzero(found)[row]
        theta[region], verified[region], node[region] = at[row], True, cells.node[cell[row]]
        position[region] = _turned(where[row], branch.angle[cell[row]])

    attempt(chosen, at)
    failed = np.flatnonzero(~verified[label] & (plain | ~refinable[label]))
    if len(failed):
        by_size = failed[np.lexsort((-volume[failed], nulls[failed], label[failed]))]
        group = 2 * label[by_size] + ~plain[by_size]
        begin = np.searchsorted(group, group)
        tries = by_size[np.arange(len(by_size)) - begin < _WITNESS_TRIES]
        attempt(tries, turned.middle[tries])
    return Regions(turned, first, theta, position, verified, node)


def _holds(question: Question, cells: Cells, cell: Ints, theta: Floats) -> tuple[Bools, Floats]:
    """Whether everything holds somewhere in each cell (n,) at exactly θ (n,), and the position s (n, 2)."""
    catalogue, anchor = question.catalogue, question.anchor_mm
    owner = question.nodes.select(cells.node[cell])
    position, found = exact_position(catalogue, owner, question.touched, anchor, theta)
    some = np.flatnonzero(found)
    points = Cells(
        cells.node[cell[some]], cells.state[cell[some]], theta[some], theta[some], position[some, None]
    )
    found[some] = question.unblocked(points)
    return found, position


def position_boxes(cells: Cells, origin_mm: Floats, anchor_mm: Floats) -> tuple[Floats, Floats]:
    """Smallest boxes (k, 2) in W that contain every position of `origin_mm` (k, 2), rounded outward.

    The origin is a point of the object, seen from its centroid, that stands for its position.
    """
    rel = cells.polygon - origin_mm[:, None]
    x, y = rel[..., 0], rel[..., 1]
    lo, hi = cells.lo[:, None], cells.hi[:, None]
    zero = np.zeros_like(x)
    waves = np.stack([np.stack([zero, x, -y], axis=2), np.stack([zero, y, x], axis=2)], axis=3)
    both = np.concatenate([np.moveaxis(waves, 3, 1), -np.moveaxis(waves, 3, 1)], axis=1)
    most = largest(both, lo[:, None], hi[:, None]).max(axis=2, initial=-np.inf)
    return anchor_mm - most[:, 2:] - 1e-9, anchor_mm + most[:, :2] + 1e-9
