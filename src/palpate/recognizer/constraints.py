"""Constraints: what all contacts and free paths together ask of the cells of interpretations."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from palpate.base.geometry import Bools, Floats, Ints
from palpate.recognizer.budget import STANDARD_BUDGET, Budget
from palpate.recognizer.catalogue import Catalogue
from palpate.recognizer.compiled_cells import FreePaths, Pairings, pairings_of
from palpate.recognizer.compiled_regions import RegionRules
from palpate.recognizer.compiled_sweep import path_rows
from palpate.recognizer.compiled_verification import Evidence, evidence_of
from palpate.recognizer.contact import Contact
from palpate.recognizer.edges import NULL_EDGE
from palpate.recognizer.null_branch import null_mask
from palpate.recognizer.region import Cells
from palpate.recognizer.sweep import free_path_test, free_paths_of
from palpate.recognizer.tree import Interpretations

__all__ = ["Constraints"]


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
