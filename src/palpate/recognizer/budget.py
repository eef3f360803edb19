"""Work budget: limits on the work of one query, in units of work instead of time.

Every step of a query has a share. A step that would need more is left out, or done more coarsely, where that
loses nothing: a contact is then paired with no edges (what lies there still has to satisfy it), cells stay
wide, and bounds with them. Shares do not depend on what earlier steps took: an answer depends on its inputs
alone. Indispensable work is done regardless of the budget: the first contact is paired with every edge of
the catalogue, and every remaining interpretation is examined once.
"""

from dataclasses import dataclass

from palpate.base.errors import InputError
from palpate.base.vocabulary import DEFAULT_BUDGET, LEAST_BUDGET


class BudgetSpentError(Exception):
    """A step would need more than its share, and has no result. Never leaves the recogniser."""


@dataclass(frozen=True)
class Budget:
    """`units` of work: one is an interpretation, a cell or a configuration that is tested against a contact.

    Raises InputError if there are fewer than `LEAST_BUDGET`.
    """

    units: int = DEFAULT_BUDGET

    def __post_init__(self) -> None:
        if self.units < LEAST_BUDGET:
            raise InputError(f"a budget of {self.units} units of work is too small: at least {LEAST_BUDGET}")

    @property
    def pairs(self) -> int:
        """Pairs of edges of the first two contacts that their normals allow: a look at one is cheap."""
        return 50 * self.units

    @property
    def candidates(self) -> int:
        """Ways to pair a contact, that are looked at: a look at one is cheap."""
        return 8 * self.units

    @property
    def interpretations(self) -> int:
        """Interpretations that the pairing of the second or third contact may leave.

        Large catalogues have many after the second contact, and few after the third. A contact that is left
        unpaired costs them more than its interpretations would.
        """
        return 4 * self.units

    @property
    def worthwhile(self) -> int:
        """Interpretations that a further contact may leave, if that is more than there were.

        They cover the same few regions again and again, and each costs its own cells.
        """
        return self.units // 4000

    @property
    def pairing_cells(self) -> int:
        """Cells in which a further contact is looked for, of all interpretations, unless these are more."""
        return self.units // 8

    @property
    def cells(self) -> int:
        """Cells of all interpretations together, unless these are more."""
        return self.units // 32

    @property
    def paving(self) -> int:
        """Cells into which the configurations of states with rough walls are divided."""
        return self.units // 25

    @property
    def refinements(self) -> int:
        """Cells, times contacts, that are cut finer at once where no configuration has been found."""
        return self.units // 30

    @property
    def pieces(self) -> int:
        """Pieces of the true boundary that cells are compared with at once, to see which are empty."""
        return self.units

    @property
    def fine(self) -> int:
        """Cells from which the bounds that are reported are taken, of all hypotheses together."""
        return self.units // 1950


STANDARD_BUDGET = Budget()
"""The budget that a rig file has by default."""
