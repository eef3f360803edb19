"""From contacts to hypotheses, and on from there with every further contact. The recogniser's front door.

    contacts → interpretation tree (levels 1–3, null branches) → cells → free-path evidence → hypotheses

Further contacts extend the surviving interpretations; nothing is started again. Pure computation.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from palpate.errors import InputError
from palpate.geometry import Floats
from palpate.recognizer.catalogue import Catalogue
from palpate.recognizer.contact import Contact
from palpate.recognizer.extension import split_into_runs
from palpate.recognizer.hypotheses import Hypotheses, hypotheses_of
from palpate.recognizer.null_branch import (
    COARSE_RAD,
    ROOT,
    TREE_LEVELS,
    Branch,
    branches_of,
    grown,
    joined,
)
from palpate.recognizer.region import Cells, Intervals, stepped
from palpate.recognizer.tree import Interpretations, LevelCount
from palpate.recognizer.witness_search import Question, settled, witnessed_cells
from palpate.vocabulary import RecognitionVerdict

__all__ = ["Recognition", "anchor_of", "intervals_of", "recognise"]

_FINE_CELLS, _MOST_FINE = 24, 8
_MOST_CELLS = 60_000


@dataclass(frozen=True, eq=False)
class Recognition:
    """All that is known after some contacts. `contacts` includes misses; `levels` counts per contact.

    At most `max_spurious` of the touched contacts are taken as spurious in any interpretation.
    """

    catalogue: Catalogue
    contacts: tuple[Contact, ...]
    interpretations: Interpretations
    cells: Cells
    anchor_mm: Floats
    hypotheses: Hypotheses
    levels: tuple[LevelCount, ...]
    max_spurious: int = 0

    @property
    def verdict(self) -> RecognitionVerdict:
        """Unique if one hypothesis is left, whatever its extent."""
        if not self.hypotheses:
            return RecognitionVerdict.NONE
        return RecognitionVerdict.UNIQUE if len(self.hypotheses) == 1 else RecognitionVerdict.AMBIGUOUS

    def extend(self, contacts: Sequence[Contact]) -> "Recognition":
        """The same with further contacts and misses; keeps only what survives them."""
        search = _Search(self.catalogue, self.anchor_mm, self.max_spurious)
        branches = branches_of(self.interpretations, self.cells)
        return search.after(self.contacts, tuple(contacts), branches, self.levels)


def recognise(catalogue: Catalogue, contacts: Sequence[Contact], max_spurious: int = 0) -> Recognition:
    """Find every way to understand the contacts (misses included) as touches of one catalogued object.

    As many as `max_spurious` of the touched contacts may be spurious: nothing that they say need be true.
    Raises InputError if none of the contacts touched anything, because misses alone bound no configuration,
    and unless 0 ≤ `max_spurious` < number of touched contacts.
    """
    touched = [contact for contact in contacts if contact.touched]
    if not touched:
        raise InputError("no finger touched anything: at least one contact is needed to place an object")
    if not 0 <= max_spurious < len(touched):
        raise InputError(
            f"max_spurious is {max_spurious}; with {len(touched)} touched contacts it must be from 0 to "
            f"{len(touched) - 1}, so that one at least is not spurious"
        )
    return _Search(catalogue, anchor_of(touched), max_spurious).after((), tuple(contacts), [ROOT], ())


def anchor_of(touched: Sequence[Contact]) -> Floats:
    """The first contacts' middle (2,) in W: orientation and position are least entangled near the object."""
    anchor: Floats = np.mean([contact.end_mm for contact in touched[:TREE_LEVELS]], axis=0)
    return anchor


def intervals_of(nodes: Interpretations) -> Intervals:
    """Where the cells of interpretations of all contacts are cut: the fewer are left, the finer."""
    least = int(np.clip(_FINE_CELLS // max(len(nodes), 1), 1, _MOST_FINE))
    # Contacts that say little leave wide intervals: those get fewer cells and wider bounds, not long waits.
    step = max(COARSE_RAD, float(np.sum(nodes.hi - nodes.lo)) / _MOST_CELLS)
    return stepped(nodes, step_rad=step, least=least)


@dataclass(frozen=True, eq=False)
class _Search:
    """What stays the same from contact to contact."""

    catalogue: Catalogue
    anchor_mm: Floats
    max_spurious: int

    def after(
        self,
        known: tuple[Contact, ...],
        new: tuple[Contact, ...],
        branches: list[Branch],
        levels: tuple[LevelCount, ...],
    ) -> Recognition:
        """Pair every new contact in turn, then conclude."""
        touched = [contact for contact in known if contact.touched]
        for contact in new:
            if contact.touched:
                touched.append(contact)
                branches, count = grown(self.catalogue, branches, touched, self.anchor_mm, self.max_spurious)
                levels = (*levels, count)
        return self._concluded((*known, *new), touched, joined(branches, len(touched)), levels)

    def _concluded(
        self,
        contacts: tuple[Contact, ...],
        touched: list[Contact],
        nodes: Interpretations,
        levels: tuple[LevelCount, ...],
    ) -> Recognition:
        """Cells, evidence and hypotheses of the interpretations that are left."""
        question = Question(self.catalogue, nodes, touched, list(contacts), self.anchor_mm)
        found = witnessed_cells(question, intervals_of(nodes))
        hypotheses = hypotheses_of(question, settled(question, found))
        left, cells = split_into_runs(nodes, found.cells)
        return Recognition(
            self.catalogue,
            contacts,
            left,
            cells,
            self.anchor_mm,
            hypotheses,
            levels,
            self.max_spurious,
        )
