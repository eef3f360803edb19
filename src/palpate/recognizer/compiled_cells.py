"""Compiled cells: calls of the kernel that cut, narrow, divide and sift cells.

The same as `region` and `witness_candidates` have by whole arrays.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from types import ModuleType
from typing import Any

import numpy as np

from palpate.base.geometry import Bools, Floats, Ints
from palpate.recognizer.compiled_tree import placed_tip
from palpate.recognizer.contact import Contact
from palpate.recognizer.edges import EdgeSet

__all__ = [
    "FreePaths",
    "Pairings",
    "SiftedArrays",
    "contiguous",
    "cut_polygons",
    "divided",
    "narrowed_parts",
    "pairings_of",
    "sifted_intervals",
    "sifted_parts",
]

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
        tuple(placed_tip(contact, anchor_mm) for contact in contacts),
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


def narrowed_parts(
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


def sifted_intervals(
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


def sifted_parts(
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


def divided(
    kernel: ModuleType, lo: Floats, hi: Floats, polygon: Floats, lever_mm: float, parts: int
) -> SiftedArrays:
    """Cells (k) in parts, all of them."""
    lo, hi, polygon = contiguous(lo, hi, polygon)
    return SiftedArrays.of(kernel.sift_parts(lo, hi, polygon, *polygon.shape[:2], lever_mm, parts, None))


def contiguous(*arrays: Any) -> tuple[Any, ...]:
    """The arrays as the kernel takes them."""
    return tuple(np.ascontiguousarray(item) for item in arrays)
