"""The null branch of the interpretation tree: interpretations in which some contacts are spurious.

Besides its edges every contact may be paired with none, as long as few are (Grimson and Lozano-Pérez 1987,
docs/recogniser.md). Such a contact is no evidence at all. Interpretations with the same null contacts are one
branch. It grows as if its paired contacts were the only ones.
"""

from collections.abc import Sequence
from dataclasses import astuple, dataclass, replace

import numpy as np

from palpate.base.geometry import Bools, Floats, Ints
from palpate.recognizer.budget import STANDARD_BUDGET, Budget
from palpate.recognizer.catalogue import Catalogue
from palpate.recognizer.contact import Contact
from palpate.recognizer.edges import NULL_EDGE
from palpate.recognizer.extension import extend_by_region
from palpate.recognizer.region import Cells, build_cells, divide_orientations
from palpate.recognizer.tree import Interpretations, LevelCount, first_level, next_level, second_level

__all__ = [
    "COARSE_RAD",
    "ROOT_BRANCH",
    "TREE_LEVELS",
    "Branch",
    "branches_of",
    "grow_branches",
    "join_branches",
    "null_mask",
]

TREE_LEVELS = 3  # from the fourth contact on, pose regions prune better than tests on triples
COARSE_RAD = 0.015


@dataclass(frozen=True, eq=False)
class Branch:
    """Interpretations of the touched contacts at `paired`, in order; all others are null.

    `nodes` has a column for each paired contact. `cells`: their region, or None if it is not known yet.
    """

    paired: tuple[int, ...]
    nodes: Interpretations
    cells: Cells | None = None


ROOT_BRANCH = Branch(
    (), Interpretations(np.empty(0, np.int64), np.empty((0, 0), np.int64), np.empty(0), np.empty(0))
)
"""The branch with which a search begins: nothing is paired."""


def grow_branches(
    catalogue: Catalogue,
    branches: Sequence[Branch],
    touched: Sequence[Contact],
    anchor_mm: Floats,
    max_spurious: int,
    budget: Budget = STANDARD_BUDGET,
) -> tuple[list[Branch], LevelCount]:
    """The branches with the last of `touched` paired, and with it null where fewer than `max_spurious` are.

    Also the counts of the level, over all branches. Raises BudgetSpentError where there are too many ways.
    """
    new = len(touched) - 1
    found, counts = [], []
    for branch in branches:
        nodes, count = _paired(catalogue, branch, touched, anchor_mm, budget)
        found.append(Branch((*branch.paired, new), nodes))
        counts.append(count)
        if new - len(branch.paired) < max_spurious:
            found.append(branch)
    if len(counts) == 1:
        return found, replace(counts[0], level=len(touched))
    columns = zip(*(astuple(count)[1:] for count in counts), strict=True)
    return found, LevelCount(len(touched), *(sum(column) for column in columns))


def _paired(
    catalogue: Catalogue, branch: Branch, touched: Sequence[Contact], anchor_mm: Floats, budget: Budget
) -> tuple[Interpretations, LevelCount]:
    """The branch's interpretations with one more pairing, that of the last contact."""
    earlier, new = [touched[k] for k in branch.paired], touched[-1]
    if not earlier:
        return first_level(catalogue, new)
    if len(earlier) == 1:
        return second_level(catalogue, [*earlier, new], budget)
    if len(earlier) < TREE_LEVELS:
        return next_level(catalogue, branch.nodes, [*earlier, new], anchor_mm, budget)
    cells = branch.cells
    if cells is None:
        cells = build_cells(
            catalogue,
            branch.nodes,
            earlier,
            anchor_mm,
            divide_orientations(branch.nodes, step_rad=COARSE_RAD, least=1),
        )
    return extend_by_region(catalogue, branch.nodes, cells, new, len(touched), anchor_mm, budget)


def join_branches(branches: Sequence[Branch], contacts: int) -> Interpretations:
    """Interpretations of all branches in one, a column for each of `contacts`: null where not paired."""
    parts = []
    for branch in branches:
        columns = np.full((len(branch.nodes), contacts), NULL_EDGE)
        columns[:, list(branch.paired)] = branch.nodes.edges
        parts.append(replace(branch.nodes, edges=columns))
    return Interpretations.joined(parts)


def branches_of(nodes: Interpretations, cells: Cells) -> list[Branch]:
    """The branches that were joined to `nodes`, each with its share of the cells. Empty ones are left out."""
    null = nodes.edges < 0
    if not null.any():
        return [Branch(tuple(range(nodes.edges.shape[1])), nodes, cells)]
    patterns, member = np.unique(null, axis=0, return_inverse=True)
    member = member.ravel()
    return [_part(nodes, cells, pattern, member == k) for k, pattern in enumerate(patterns)]


def _part(nodes: Interpretations, cells: Cells, null: Bools, chosen: Bools) -> Branch:
    columns = np.flatnonzero(~null)
    part = nodes.select(np.flatnonzero(chosen))
    some = cells.select(chosen[cells.node])
    number = np.cumsum(chosen) - 1
    return Branch(
        tuple(int(column) for column in columns),
        replace(part, edges=part.edges[:, columns]),
        replace(some, node=number[some.node]),
    )


def null_mask(nodes: Interpretations, node: Ints, contacts: Sequence[Contact]) -> Bools | None:
    """Which of m contacts, misses included, are null in the interpretations `node` (k,): (k, m).

    None if none of them is. Misses are never null.
    """
    null = nodes.edges[node] < 0
    if not null.any():
        return None
    result = np.zeros((len(node), len(contacts)), dtype=bool)
    result[:, [k for k, contact in enumerate(contacts) if contact.touched]] = null
    return result
