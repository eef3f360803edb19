"""Compiled regions: the call of the kernel for a round of the witness search."""

from dataclasses import dataclass
from types import ModuleType

import numpy as np

from palpate.base.geometry import Bools, Floats, Ints
from palpate.recognizer.compiled_cells import contiguous
from palpate.recognizer.compiled_verification import Evidence

__all__ = ["FoundRegions", "RegionRules", "found_regions"]


@dataclass(frozen=True, eq=False)
class RegionRules:
    """What holds for all rounds: symmetry `orders` (S,) of states, and the `anchor_mm` (2,).

    Contacts that are spurious in interpretations: among those `paired` with edges (n, p), and among `all`
    (n, m); None if none is. `shape` (n, p). Whether something was touched that is `unpaired`. `pieces` of the
    boundary that are looked at, at most.
    """

    orders: Ints
    anchor_mm: Floats
    paired: Bools | None
    all: Bools | None
    shape: tuple[int, int]
    unpaired: bool
    pieces: int


@dataclass(frozen=True, eq=False)
class FoundRegions:
    """h regions that are done, and the cells to be cut finer, `again`, by their rows.

    Of their cells (k): `row`, and on the region's branch of the symmetry `lo`, `hi` (k,), `polygon`
    (k, v, 2). `first` (h + 1,): where regions begin; `theta` (h,), `position` (h, 2), `verified` (h,) and
    `node` (h,).
    """

    row: Ints
    lo: Floats
    hi: Floats
    polygon: Floats
    first: Ints
    theta: Floats
    position: Floats
    verified: Bools
    node: Ints
    again: Ints


def found_regions(
    kernel: ModuleType,
    evidence: Evidence,
    rules: RegionRules,
    cells: tuple[Ints, Ints, Floats, Floats, Floats, Floats, Bools],
    component: Ints | None,
    room: int,
    *,
    refinable: bool,
) -> FoundRegions:
    """A round of the witness search over cells: node, state, lo, hi, polygon, spot, holds, each (k, …).

    `component` (k,): of each cell, None where states have few each, to be found by comparing all of these.
    `room`: so many cells, times contacts, may be cut finer, if they are `refinable`.
    """
    shape = cells[4].shape[:2]
    found = kernel.regions(
        (evidence.boundaries, evidence.rows),
        (*contiguous(*cells), component, *shape),
        (rules.orders, rules.anchor_mm, rules.paired, rules.all, len(rules.orders), *rules.shape),
        (room, rules.pieces, refinable, rules.unpaired),
    )
    row, lo, hi, polygon, first, theta, position, verified, node, again = found
    return FoundRegions(
        np.frombuffer(row, np.int64),
        np.frombuffer(lo),
        np.frombuffer(hi),
        np.frombuffer(polygon).reshape(-1, shape[1], 2),
        np.frombuffer(first, np.int64),
        np.frombuffer(theta),
        np.frombuffer(position).reshape(-1, 2),
        np.frombuffer(verified, dtype=bool),
        np.frombuffer(node, np.int64),
        np.frombuffer(again, np.int64),
    )
