"""Slide bounds: how far forces on a part, and the work done on it, can have moved it, in many states.

While the part may slide, friction at the table takes at least `holds_n` for every mm, so its slide is at most
the work done on it over that (docs/recogniser.md, "A part that moves").
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from palpate.base.geometry import Bools, Floats, Ints
from palpate.rig.identification.support import SupportTable

__all__ = ["Loads", "slides_mm"]

_ROUNDING = 1e-9


@dataclass(frozen=True, eq=False)
class Loads:
    """Upper bounds on what g fingers did in b periods of time, one after the other; all (g, b).

    `at_contact_n`: force where its contact was measured; `anywhere_n`: elsewhere; `work_mj` by the finger;
    `stored_mj` in its skin. `measured`: the period in which the contacts were measured. All of that holds as
    long as the part has moved by `within_mm` at most: further, ways that were free may no longer be.
    """

    at_contact_n: Floats
    anywhere_n: Floats
    work_mj: Floats
    stored_mj: Floats
    measured: int
    within_mm: float


def slides_mm(table: SupportTable, loads: Sequence[Loads], leverages: Floats) -> Floats:
    """Largest slide of n states (n, 3) before the measurement, after it, and in all.

    `leverages` (n, g): of the contacts. Infinite where there are no `loads`, nothing for a part that is taken
    to lie still.
    """
    found = np.where(np.isinf(table.holds_n)[:, None], 0.0, np.full((len(table), 3), np.inf))
    left = np.flatnonzero(np.isfinite(table.holds_n))
    for item in loads:
        found[left] = _slides_under(table.select(left), item, leverages[left])
        left = left[found[left, 2] * table.leverage[left] > item.within_mm]
    return found


def _slides_under(table: SupportTable, loads: Loads, leverages: Floats) -> Floats:
    push_n = (loads.at_contact_n + loads.anywhere_n).sum(axis=0)
    # In all other periods, which are most, every part lies still.
    least_n = np.min(table.holds_n / (table.leverage + table.carried), initial=np.inf)
    periods = np.flatnonzero(push_n > least_n * (1 - _ROUNDING))
    pushed = _Pushed(
        periods,
        _moving(table, loads, leverages, periods),
        loads.work_mj.sum(axis=0),
        loads.stored_mj.sum(axis=0),
    )
    count, measured = len(push_n), loads.measured
    before, after = pushed.dissipated_mj(0, measured), pushed.dissipated_mj(measured, count)
    whole = np.minimum(pushed.dissipated_mj(0, count), before + after)
    parts = np.stack([np.minimum(before, whole), np.minimum(after, whole), whole], axis=1)
    result: Floats = parts / table.holds_n[:, None]
    return result


def _moving(table: SupportTable, loads: Loads, leverages: Floats, periods: Ints) -> Bools:
    """In which of some periods (p,) each state may slide, (n, p)."""
    at_contact, holds = loads.at_contact_n[:, periods], table.holds_n[:, None]
    elsewhere = loads.anywhere_n[:, periods].sum(axis=0)
    push = at_contact.sum(axis=0) + elsewhere
    pull = leverages @ at_contact + table.leverage[:, None] * elsewhere
    pull += push * table.carried[:, None] * np.minimum(push / holds, 1.0)
    result: Bools = pull > holds
    return result


@dataclass(frozen=True, eq=False)
class _Pushed:
    """States that may be `moving` (n, p) in some `periods` (p,), in order; of all periods (b,) what fingers
    do, `work_mj`, and what their skin has stored, `stored_mj`.
    """

    periods: Ints
    moving: Bools
    work_mj: Floats
    stored_mj: Floats

    def dissipated_mj(self, begin: int, end: int) -> Floats:
        """Most that friction at the table can have taken (n,) from one period to another.

        While the part may move: what fingers do, and what their skin has stored when it begins to.
        """
        some = slice(*np.searchsorted(self.periods, [begin, end]))
        periods, moving = self.periods[some], self.moving[:, some]
        begins = moving.copy()
        begins[:, 1:] &= ~(moving[:, :-1] & (np.diff(periods) == 1))
        stored = self.stored_mj[np.maximum(periods - 1, 0)]
        result: Floats = begins @ stored + moving @ self.work_mj[periods]
        return result
