"""Compiled levels of the interpretation tree: calls of the kernel, and their arrays.

The same pairings and orientations as `tree` finds with whole arrays, without tables of pairs.
"""

from collections.abc import Sequence
from types import ModuleType

import numpy as np

from palpate.base.geometry import Floats, Ints
from palpate.recognizer.budget import BudgetSpentError
from palpate.recognizer.contact import Contact, NormalRange
from palpate.recognizer.edges import EdgeSet

__all__ = [
    "Children",
    "further_children",
    "narrowed",
    "placed_tip",
    "second_level_children",
    "third_level_children",
]

_CHILD = np.dtype([("parent", np.int64), ("edge", np.int64), ("lo", np.float64), ("hi", np.float64)])


class Children:
    """n pairings: of `edge` (n,), under the row `parent` (n,), for θ in [`lo`, `hi`] (n,) rad.

    `looked_up`: edges whose normals fit; `near`: those that could be as far from the others as the contacts.
    """

    def __init__(self, found: tuple[int, int, int, bytearray]) -> None:
        spent, self.looked_up, self.near, data = found
        if spent:
            raise BudgetSpentError
        rows = np.frombuffer(data, dtype=_CHILD)
        self.parent: Ints = np.ascontiguousarray(rows["parent"])
        self.edge: Ints = np.ascontiguousarray(rows["edge"])
        self.lo: Floats = np.ascontiguousarray(rows["lo"])
        self.hi: Floats = np.ascontiguousarray(rows["hi"])


def second_level_children(
    kernel: ModuleType,
    sets: tuple[EdgeSet, EdgeSet],
    contacts: Sequence[Contact],
    normals: tuple[NormalRange, NormalRange],
    most: int | None,
    *,
    modelled: bool,
) -> Children:
    """Pairings of the second contact under each representative edge of the first, its `parent`.

    Unless they are `modelled`, the model test is left out. Raises BudgetSpentError if more than `most` are to
    be looked at; None: there cannot be too many.
    """
    limit = -1 if most is None else most
    one, two = (_tip(contact, of) for contact, of in zip(contacts, normals, strict=True))
    return Children(kernel.second_level(sets[0].prepared, sets[1].prepared, one, two, limit, modelled))


def third_level_children(
    kernel: ModuleType,
    sets: tuple[EdgeSet, EdgeSet, EdgeSet],
    contacts: Sequence[Contact],
    normals: Sequence[NormalRange],
    anchor_mm: Floats,
    nodes: tuple[Ints, Ints, Floats, Floats],
    most: int,
    *,
    modelled: bool,
) -> Children:
    """Pairings of the third contact under interpretations of two: state (n,), edges (n, 2), lo, hi (n,)."""
    tips = [_tip(contact, of, anchor_mm) for contact, of in zip(contacts, normals, strict=True)]
    arrays = tuple(item.prepared for item in sets)
    rows = [np.ascontiguousarray(item) for item in nodes]
    return Children(kernel.third_level(arrays, *tips, *rows, len(nodes[0]), most, modelled))


def further_children(
    kernel: ModuleType,
    edges: EdgeSet,
    contact: Contact,
    normals: NormalRange,
    cells: tuple[Ints, Floats, Floats],
    place: tuple[Floats, Floats],
    most: int,
) -> Children:
    """Pairings of a further contact under k cells: state, lo, hi (k,); `parent` is the cell.

    `place`: in the object's frame the contact lies within reach (k,) mm of a point (k, 2).
    """
    arrays = [np.ascontiguousarray(item) for item in (*cells, *place)]
    return Children(kernel.extend(edges.prepared, _tip(contact, normals), *arrays, len(cells[0]), most))


def narrowed(
    kernel: ModuleType,
    sets: Sequence[EdgeSet],
    contacts: Sequence[Contact],
    paired: Ints,
    lo: Floats,
    hi: Floats,
    anchor_mm: Floats | None = None,
) -> tuple[Floats, Floats]:
    """Intervals of θ, narrowed by the model test of two or three contacts on edges `paired` (n, 2 or 3)."""
    tips = tuple(placed_tip(contact, anchor_mm) for contact in contacts)
    arrays = tuple(item.prepared for item in sets)
    arguments = [np.ascontiguousarray(item) for item in (paired, lo, hi)]
    data = kernel.narrow(arrays, tips, *arguments, len(lo))
    return np.frombuffer(data[0]), np.frombuffer(data[1])


def placed_tip(contact: Contact, anchor_mm: Floats | None) -> tuple[float, float, float]:
    """Where a contact is, seen from the anchor, and its bound: x, y, bound (mm)."""
    x, y = contact.end_mm
    if anchor_mm is not None:
        x, y = x - float(anchor_mm[0]), y - float(anchor_mm[1])
    return x, y, contact.position_bound_mm


def _tip(
    contact: Contact, normals: NormalRange, anchor_mm: Floats | None = None
) -> tuple[float, float, float, float, float]:
    return *placed_tip(contact, anchor_mm), normals.lo_rad, normals.hi_rad
