"""Constraints: what all contacts and free paths together ask of the cells of interpretations.

The path before a contact was free; a missed approach was free all along. If no point of the object is further
than ρ from where the cell's middle configuration puts it, a finger cannot stop before it comes within ρ of
the middle outline, and cannot pass a point that lies deeper than ρ in it: a cell goes only if every
configuration in it would have stopped a finger before the end of its path.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from palpate.base.geometry import Bools, Floats, Ints
from palpate.recognizer.approach import Approach, Rays, capsules_of, rays_of, split_rays
from palpate.recognizer.budget import STANDARD_BUDGET, Budget
from palpate.recognizer.catalogue import Catalogue
from palpate.recognizer.compiled import KERNEL
from palpate.recognizer.compiled_judgement import (
    Evidence,
    RegionRules,
    evidence_of,
    free_cells,
    path_rows,
    stop_intervals,
)
from palpate.recognizer.compiled_search import FreePaths, Pairings, pairings_of
from palpate.recognizer.contact import Contact
from palpate.recognizer.edges import NULL_EDGE, EdgeSet
from palpate.recognizer.interpretation_tree import Interpretations
from palpate.recognizer.pose_region import Cells
from palpate.recognizer.strip_trees import StripForest
from palpate.recognizer.tree_branches import null_mask


@dataclass(frozen=True, eq=False)
class StopIntervals:
    """For k cells and m approaches: the finger stops after a travel within [`earliest`, `latest`] (k, m) mm.

    `earliest` is infinite where nothing can be met; `latest` is infinite where the finger may miss.
    """

    earliest: Floats
    latest: Floats


def sweep(
    catalogue: Catalogue,
    cells: Cells,
    anchor_mm: Floats,
    approaches: Sequence[Approach],
    skipped: Bools | None = None,
) -> StopIntervals:
    """Enclose the travel at which the object stops the finger, for k cells, all of each, and m approaches.

    Those `skipped` (k, m) are not looked at and come back as infinite.
    """
    shape = (len(cells), len(approaches))
    if KERNEL is not None:
        outlines = [catalogue.outlines(approach.finger) for approach in approaches]
        return StopIntervals(*stop_intervals(KERNEL, outlines, cells, anchor_mm, approaches, skipped))
    earliest, latest = np.full(shape, np.inf), np.full(shape, np.inf)
    for finger in dict.fromkeys(approach.finger for approach in approaches):
        edges = catalogue.outlines(finger)
        columns = [k for k, approach in enumerate(approaches) if approach.finger == finger]
        rays = rays_of(edges, cells, anchor_mm, [approaches[k] for k in columns])
        row, column = np.divmod(np.arange(len(rays.state)), len(columns))
        column = np.array(columns)[column]
        if skipped is not None:
            wanted = np.flatnonzero(~skipped[row, column])
            rays, row, column = rays.select(wanted), row[wanted], column[wanted]
        if len(row):
            earliest[row, column], latest[row, column] = _stops(edges, catalogue.outline_strips(finger), rays)
    return StopIntervals(earliest, latest)


def free_path_test(
    catalogue: Catalogue,
    cells: Cells,
    anchor_mm: Floats,
    contacts: Sequence[Contact],
    skipped: Bools | None = None,
) -> Bools:
    """Cells (k,) that the free paths of m contacts, and of misses, do not rule out altogether.

    A cell goes only if every configuration in it would have stopped a finger before the end of its path.
    `skipped` (k, m): paths that are no evidence for a cell, or that are known to leave it.
    """
    paths = free_paths_of(contacts)
    if KERNEL is not None:
        outlines = [catalogue.outlines(path.finger) for path in paths]
        return free_cells(KERNEL, outlines, cells, anchor_mm, paths, skipped)
    travel = np.array([path.travel_mm for path in paths])
    result: Bools = np.all(sweep(catalogue, cells, anchor_mm, paths, skipped).latest >= travel, axis=1)
    return result


def free_paths_of(contacts: Sequence[Contact]) -> list[Approach]:
    """Paths of contacts, and of misses, that were free."""
    return [
        Approach(
            contact.finger,
            contact.start_mm,
            contact.direction_rad,
            contact.travel_mm,
            contact.free_path_bound_mm,
        )
        for contact in contacts
    ]


def _stops(edges: EdgeSet, strips: StripForest, rays: Rays) -> tuple[Floats, Floats]:
    """Earliest and latest stop (r,) of rays on the edges of their states."""
    parts = [capsules_of(edges, strips, some) for some in split_rays(edges, strips, rays)]
    if len(parts) == 1:
        return parts[0].earliest, parts[0].latest
    return np.concatenate([part.earliest for part in parts]), np.concatenate([part.latest for part in parts])


@dataclass(frozen=True, eq=False)
class Constraints:
    """Constraints on every region: pairings of `touched`, and free paths of all contacts and misses.

    Touched contacts of the `evidence` that are not in `touched` are paired with nothing; what satisfies all
    constraints exactly satisfies them, too.

    A contact that an interpretation takes as spurious is no evidence for its cells.
    """

    catalogue: Catalogue
    nodes: Interpretations
    touched: list[Contact]
    evidence: list[Contact]
    anchor_mm: Floats
    budget: Budget = STANDARD_BUDGET

    @cached_property
    def nulls(self) -> Ints:
        """Number of null contacts of each interpretation, (n,)."""
        count: Ints = np.count_nonzero(self.nodes.edges < 0, axis=1)
        return count

    @cached_property
    def compiled_evidence(self) -> Evidence:
        """The evidence as the compiled kernel takes it for verification."""
        return evidence_of(self.catalogue, self.evidence, self.anchor_mm)

    @cached_property
    def compiled_pairings(self) -> Pairings:
        """The interpretations as the compiled kernel takes them."""
        sets = [self.catalogue.edges(contact.finger) for contact in self.touched]
        return pairings_of(sets, self.touched, self.anchor_mm, self.nodes.edges, self.nodes.state)

    @cached_property
    def compiled_paths(self) -> FreePaths:
        """The free paths of the evidence as the compiled kernel takes them."""
        return FreePaths(
            tuple(self.catalogue.outlines(contact.finger).prepared for contact in self.evidence),
            path_rows(free_paths_of(self.evidence), self.anchor_mm),
            self._null_evidence,
        )

    @cached_property
    def compiled_rules(self) -> RegionRules:
        """What regions have to agree with, as the compiled kernel takes it."""
        null = self._null_evidence
        return RegionRules(
            self.catalogue.symmetry_orders,
            self.anchor_mm,
            None if null is None else self.nodes.edges < 0,
            null,
            (len(self.nodes), len(self.touched)),
            self.has_unpaired,
            self.budget.pieces,
        )

    @cached_property
    def _null_evidence(self) -> Bools | None:
        return null_mask(self.nodes, np.arange(len(self.nodes)), self.evidence)

    @cached_property
    def has_unpaired(self) -> bool:
        """Whether something was touched that no interpretation pairs with an edge."""
        return sum(contact.touched for contact in self.evidence) > len(self.touched)

    def all_columns(self, edges: Ints) -> Ints:
        """Pairings (n, paired) with a column for every touch of the evidence: null if it is not paired."""
        rows = np.full((len(edges), len(self.evidence)), NULL_EDGE)
        rows[:, self._columns] = edges
        return rows[:, [k for k, contact in enumerate(self.evidence) if contact.touched]]

    @cached_property
    def _columns(self) -> list[int]:
        """Where in `evidence` the paired contacts are."""
        paired = {id(contact) for contact in self.touched}
        return [column for column, contact in enumerate(self.evidence) if id(contact) in paired]

    def allow(self, cells: Cells) -> Bools:
        """Cells (k,) that the free paths do not rule out."""
        skipped = null_mask(self.nodes, cells.node, self.evidence)
        return free_path_test(self.catalogue, cells, self.anchor_mm, self.evidence, skipped)
