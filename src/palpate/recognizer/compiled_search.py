"""Kernel calls of the search: levels of the interpretation tree, and cells that are cut, narrowed and sifted.

The same as `interpretation_tree`, `tree_branches`, `pose_region` and `witness_candidates` have by whole
arrays, without tables of pairs.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from types import ModuleType
from typing import Any

import numpy as np

from palpate.base.geometry import Bools, Floats, Ints
from palpate.recognizer.budget import BudgetSpentError
from palpate.recognizer.contact import Contact, NormalRange
from palpate.recognizer.edges import EdgeSet

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


def narrow_orientations(
    kernel: ModuleType,
    sets: Sequence[EdgeSet],
    contacts: Sequence[Contact],
    paired: Ints,
    lo: Floats,
    hi: Floats,
    anchor_mm: Floats | None = None,
) -> tuple[Floats, Floats]:
    """Intervals of θ, narrowed by the model test of two or three contacts on edges `paired` (n, 2 or 3)."""
    tips = tuple(tip_from_anchor(contact, anchor_mm) for contact in contacts)
    arrays = tuple(item.prepared for item in sets)
    arguments = [np.ascontiguousarray(item) for item in (paired, lo, hi)]
    data = kernel.narrow(arrays, tips, *arguments, len(lo))
    return np.frombuffer(data[0]), np.frombuffer(data[1])


def tip_from_anchor(contact: Contact, anchor_mm: Floats | None) -> tuple[float, float, float]:
    """Where a contact is, seen from the anchor, and its bound: x, y, bound (mm)."""
    x, y = contact.end_mm
    if anchor_mm is not None:
        x, y = x - float(anchor_mm[0]), y - float(anchor_mm[1])
    return x, y, contact.position_bound_mm


def _tip(
    contact: Contact, normals: NormalRange, anchor_mm: Floats | None = None
) -> tuple[float, float, float, float, float]:
    return *tip_from_anchor(contact, anchor_mm), normals.lo_rad, normals.hi_rad


Pairings = tuple[object, ...]
"""Interpretations as the kernel takes them: edge sets and tips of contacts, edges, states, and how many."""


@dataclass(frozen=True, eq=False)
class FreePaths:
    """Paths (m) as the kernel takes them: `outlines` that may be in their way, and `rows` (m, 6).

    `null` (nodes, m): those that are no evidence for an interpretation; None if all are for all.
    """

    outlines: tuple[object, ...]
    rows: Floats
    null: Bools | None


@dataclass(frozen=True, eq=False)
class SiftedArrays:
    """Cells (k): `row` (k,) of what they are of, `lo`, `hi` (k,), `polygon` (k, v, 2); `spot`, `holds`."""

    row: Ints
    lo: Floats
    hi: Floats
    polygon: Floats
    spot: Floats
    holds: Bools

    @classmethod
    def of(cls, found: tuple[Any, ...]) -> "SiftedArrays":
        """From what the kernel returns."""
        row, lo, hi, polygon, vertices, spot, holds = found
        return cls(
            np.frombuffer(row, np.int64),
            np.frombuffer(lo),
            np.frombuffer(hi),
            np.frombuffer(polygon).reshape(-1, vertices, 2),
            np.frombuffer(spot).reshape(-1, 2),
            np.frombuffer(holds, dtype=bool),
        )


def pairings_of(
    sets: Sequence[EdgeSet],
    contacts: Sequence[Contact],
    anchor_mm: Floats,
    edges: Ints,
    states: Ints | None = None,
) -> Pairings:
    """Interpretations: `edges` (n, m) of contacts, and their `states` (n,) where these are needed."""
    return (
        tuple(item.prepared for item in sets),
        tuple(tip_from_anchor(contact, anchor_mm) for contact in contacts),
        np.ascontiguousarray(edges),
        None if states is None else np.ascontiguousarray(states),
        len(edges),
    )


def cut_polygons(
    kernel: ModuleType, pairings: Pairings, node: Ints, lo: Floats, hi: Floats
) -> tuple[Ints, Floats]:
    """Polygons (k, v, 2) of positions that intervals [lo, hi] (n,) of interpretations `node` (n,) leave.

    Returned first: which intervals are not empty, (k,).
    """
    most, rows, points = kernel.cut_cells(pairings, *contiguous(node, lo, hi), len(node))
    return np.frombuffer(rows, np.int64), np.frombuffer(points).reshape(-1, most, 2)


def narrow_parts(
    kernel: ModuleType,
    pairings: Pairings,
    cells: tuple[Ints, Floats, Floats],
    parts: Ints,
    *,
    triples: bool,
) -> tuple[Ints, Floats, Floats]:
    """Cells (node, lo, hi; k) in `parts` (k,), as far as the model test leaves them: owner, lo, hi (n,).

    The test is that of contacts in twos, and with `triples` in threes.
    """
    rows = contiguous(*cells)
    owner, lo, hi = kernel.refine(
        pairings, *rows, np.ascontiguousarray(parts, dtype=np.int64), len(parts), triples
    )
    return np.frombuffer(owner, np.int64), np.frombuffer(lo), np.frombuffer(hi)


def sift_intervals(
    kernel: ModuleType,
    pairings: Pairings,
    paths: FreePaths,
    intervals: tuple[Ints, Floats, Floats],
    tried: Bools | None,
    *,
    corners: bool,
) -> SiftedArrays:
    """Cells of intervals (node, lo, hi; n) that the paths leave, and candidates in those `tried` (n,)."""
    return SiftedArrays.of(
        kernel.sift_intervals(
            pairings,
            paths.outlines,
            paths.rows,
            paths.null,
            *contiguous(*intervals),
            tried,
            len(intervals[0]),
            corners,
        )
    )


def sift_parts(
    kernel: ModuleType,
    cells: tuple[Ints, Ints, Floats, Floats, Floats],
    lever_mm: float,
    parts: int,
    paths: FreePaths,
    nodes: int,
) -> SiftedArrays:
    """Cells (node, state, lo, hi, polygon; k) in parts, those that the paths leave, with candidates."""
    node, state, lo, hi, polygon = contiguous(*cells)
    by = (paths.outlines, paths.rows, paths.null, nodes, state, node)
    return SiftedArrays.of(kernel.sift_parts(lo, hi, polygon, *polygon.shape[:2], lever_mm, parts, by))


def divide_cells(
    kernel: ModuleType, lo: Floats, hi: Floats, polygon: Floats, lever_mm: float, parts: int
) -> SiftedArrays:
    """Cells (k) in parts, all of them."""
    lo, hi, polygon = contiguous(lo, hi, polygon)
    return SiftedArrays.of(kernel.sift_parts(lo, hi, polygon, *polygon.shape[:2], lever_mm, parts, None))


def contiguous(*arrays: Any) -> tuple[Any, ...]:
    """The arrays as the kernel takes them."""
    return tuple(np.ascontiguousarray(item) for item in arrays)
