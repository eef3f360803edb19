"""From contacts to hypotheses, and on from there with every further contact. The recogniser's front door.

    contacts → interpretation tree (levels 1–3) → cells → free-path evidence → hypotheses

Further contacts extend the surviving interpretations; nothing is started again. Pure computation.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum

import numpy as np

from palpate.errors import InputError
from palpate.recognizer.arrays import Floats
from palpate.recognizer.catalogue import Catalogue
from palpate.recognizer.contact import Contact
from palpate.recognizer.extension import extend_by_region, split_into_runs
from palpate.recognizer.hypotheses import Hypotheses, hypotheses_of
from palpate.recognizer.region import Cells, build_cells, stepped
from palpate.recognizer.settle import Question, settled, witnessed_cells
from palpate.recognizer.tree import Interpretations, LevelCount, first_level, next_level, second_level

__all__ = ["Recognition", "Verdict", "recognise"]

_TREE_LEVELS = 3  # from the fourth contact on, pose regions prune better than tests on triples
_COARSE_RAD = 0.015
_FINE_CELLS, _MOST_FINE = 24, 8
_MOST_CELLS = 60_000


class Verdict(Enum):
    """What the contacts leave (docs/recogniser.md, "Hypotheses")."""

    UNIQUE = "unique"
    AMBIGUOUS = "ambiguous"
    NONE = "none"


@dataclass(frozen=True, eq=False)
class Recognition:
    """All that is known after some contacts. `contacts` includes misses; `levels` counts per contact."""

    catalogue: Catalogue
    contacts: tuple[Contact, ...]
    interpretations: Interpretations
    cells: Cells
    anchor_mm: Floats
    hypotheses: Hypotheses
    levels: tuple[LevelCount, ...]

    @property
    def verdict(self) -> Verdict:
        """Unique if one hypothesis is left, whatever its extent."""
        if not self.hypotheses:
            return Verdict.NONE
        return Verdict.UNIQUE if len(self.hypotheses) == 1 else Verdict.AMBIGUOUS

    def extend(self, contacts: Sequence[Contact]) -> "Recognition":
        """The same with further contacts and misses; keeps only what survives them."""
        return _grown(
            self.catalogue,
            self.contacts,
            tuple(contacts),
            self.interpretations,
            self.cells,
            self.anchor_mm,
            self.levels,
        )


def recognise(catalogue: Catalogue, contacts: Sequence[Contact]) -> Recognition:
    """Find every way to understand the contacts (misses included) as touches of one catalogued object.

    Raises InputError if none of the contacts touched anything: misses alone bound no configuration.
    """
    touched = [contact for contact in contacts if contact.touched]
    if not touched:
        raise InputError("no finger touched anything: at least one contact is needed to place an object")
    # The first contacts' middle: orientation and position are least entangled near the object.
    anchor = np.mean([contact.end_mm for contact in touched[:_TREE_LEVELS]], axis=0)
    nodes, count = first_level(catalogue, touched[0])
    first = contacts.index(touched[0])
    rest = tuple(contacts[first + 1 :])
    return _grown(catalogue, tuple(contacts[: first + 1]), rest, nodes, None, anchor, (count,))


def _grown(
    catalogue: Catalogue,
    known: tuple[Contact, ...],
    new: tuple[Contact, ...],
    nodes: Interpretations,
    cells: Cells | None,
    anchor: Floats,
    levels: tuple[LevelCount, ...],
) -> Recognition:
    """Pair every new contact in turn, then conclude."""
    touched = [contact for contact in known if contact.touched]
    for contact in new:
        if not contact.touched:
            continue
        touched.append(contact)
        if len(touched) == 2:
            nodes, count = second_level(catalogue, touched)
        elif len(touched) <= _TREE_LEVELS:
            nodes, count = next_level(catalogue, nodes, touched, anchor)
        else:
            known_cells = _coarse(catalogue, nodes, touched[:-1], anchor) if cells is None else cells
            nodes, count = extend_by_region(catalogue, nodes, known_cells, contact, len(touched), anchor)
        cells = None
        levels = (*levels, count)
    return _concluded(catalogue, (*known, *new), nodes, anchor, levels)


def _coarse(catalogue: Catalogue, nodes: Interpretations, touched: list[Contact], anchor: Floats) -> Cells:
    return build_cells(catalogue, nodes, touched, anchor, stepped(nodes, step_rad=_COARSE_RAD, least=1))


def _concluded(
    catalogue: Catalogue,
    contacts: tuple[Contact, ...],
    nodes: Interpretations,
    anchor: Floats,
    levels: tuple[LevelCount, ...],
) -> Recognition:
    """Cells, evidence and hypotheses of the interpretations that are left."""
    touched = [contact for contact in contacts if contact.touched]
    # The fewer are left, the finer they are bounded.
    least = int(np.clip(_FINE_CELLS // max(len(nodes), 1), 1, _MOST_FINE))
    question = Question(catalogue, nodes, touched, list(contacts), anchor)
    # Contacts that say little leave wide intervals: those get fewer cells and wider bounds, not long waits.
    step = max(_COARSE_RAD, float(np.sum(nodes.hi - nodes.lo)) / _MOST_CELLS)
    found = witnessed_cells(question, stepped(nodes, step_rad=step, least=least))
    regions = settled(question, found)
    left, cells = split_into_runs(nodes, found.cells)
    return Recognition(catalogue, contacts, left, cells, anchor, hypotheses_of(question, regions), levels)
