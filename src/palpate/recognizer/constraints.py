"""Constraints: conditions that all contacts and free paths impose on the cells of interpretations.

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
from palpate.recognizer.approach import Approach
from palpate.recognizer.budget import Budget
from palpate.recognizer.carried_region import CarriedRegion
from palpate.recognizer.catalogue import Catalogue
from palpate.recognizer.contact import Contact
from palpate.recognizer.edges import NULL_EDGE
from palpate.recognizer.interpretations import Interpretations, Query


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


@dataclass(frozen=True, eq=False)
class Constraints:
    """Constraints on every region: pairings of contacts with edges, free paths of all contacts and misses.

    Interpretations, `nodes`, pair the contacts of `paired`. Touched contacts of the `evidence` that are not
    among these are paired with nothing; what satisfies all constraints exactly satisfies them, too. A contact
    that an interpretation takes as spurious is no evidence for its cells. `carried`: where the part may be by
    what was known before it was moved; None if it was not.
    """

    paired: Query
    nodes: Interpretations
    evidence: Query
    carried: CarriedRegion | None = None

    @property
    def catalogue(self) -> Catalogue:
        """The catalogue that is searched."""
        return self.paired.catalogue

    @property
    def touched(self) -> Sequence[Contact]:
        """Contacts that interpretations pair with edges."""
        return self.paired.contacts

    @property
    def anchor_mm(self) -> Floats:
        """Point (2,) in W from which positions of cells are counted."""
        return self.paired.anchor_mm

    @property
    def budget(self) -> Budget:
        """Limits of what is looked at."""
        return self.paired.budget

    @cached_property
    def nulls(self) -> Ints:
        """Number of null contacts of each interpretation, (n,)."""
        count: Ints = np.count_nonzero(self.nodes.edges == NULL_EDGE, axis=1)
        return count

    @cached_property
    def null_evidence(self) -> Bools | None:
        """Contacts and misses (n, m) that say nothing of interpretations (n,); None if all say something."""
        return self.nodes.null_mask(self.evidence.contacts)

    def null_rows(self, node: Ints) -> Bools | None:
        """Rows (k, m) of `null_evidence` of the interpretations `node` (k,)."""
        return None if self.null_evidence is None else self.null_evidence[node]

    @cached_property
    def has_unpaired(self) -> bool:
        """True if something was touched that no interpretation pairs with an edge."""
        return sum(contact.touched for contact in self.evidence.contacts) > len(self.touched)

    @property
    def is_paved(self) -> bool:
        """True if one contact is paired and others are not: then cells are divided by what all say."""
        return self.has_unpaired and len(self.touched) == 1

    def all_columns(self, edges: Ints) -> Ints:
        """Pairings (n, paired) with a column for every touch of the evidence: null if it is not paired."""
        rows = np.full((len(edges), len(self.evidence.contacts)), NULL_EDGE)
        rows[:, self._columns] = edges
        return rows[:, [k for k, contact in enumerate(self.evidence.contacts) if contact.touched]]

    @cached_property
    def _columns(self) -> list[int]:
        """Indices of the paired contacts in `evidence`."""
        paired = {id(contact) for contact in self.touched}
        return [column for column, contact in enumerate(self.evidence.contacts) if id(contact) in paired]
