"""Preparation for one kind of finger: the edges and the true boundary of every state, as arrays and back.

Every state is prepared by itself. So what was prepared of some states can be joined with what was prepared of
others, in other processes or long ago, and is the same, bit for bit, as all prepared at once.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from palpate.base.geometry import Ints
from palpate.recognizer.boundary_pieces import Pieces, Sides
from palpate.recognizer.contact import Finger
from palpate.recognizer.edge_sets import outline_set, pairing_set
from palpate.recognizer.edges import CatalogueState, EdgeSet
from palpate.recognizer.flat_arrays import Arrays, NamedArrays, begins, begins_of, joined_begins
from palpate.recognizer.tables import expand_ranges
from palpate.recognizer.true_boundary import TrueBoundary, true_boundary

__all__ = ["FingerPreparation", "prepare_finger"]

_PLANE = ("start", "end", "direction", "normal", "along")
"""Columns of points and directions."""
_COUNTED = ("feature", "ring")
"""Columns of whole numbers."""
_SUPPORTS = "supports"


@dataclass(frozen=True, eq=False)
class FingerPreparation:
    """Of S states, for one kind of finger: `outlines` that stop it, `edges` that it may be paired with, and
    the true `boundary`. `edges` are the `outlines` where no state has a tolerance.
    """

    outlines: EdgeSet
    edges: EdgeSet
    boundary: TrueBoundary

    def __len__(self) -> int:
        return len(self.boundary.clearance_mm)

    @classmethod
    def joined(cls, parts: Sequence["FingerPreparation"]) -> "FingerPreparation":
        """Of the states of all parts, one part after the other."""
        same = all(part.outlines is part.edges for part in parts)
        supports = np.concatenate([part.outlines.supports for part in parts])
        outlines = _joined_edges([part.outlines for part in parts]).with_supports(supports)
        edges = outlines if same else _joined_edges([part.edges for part in parts])
        return cls(outlines, edges, _joined_boundary([part.boundary for part in parts]))

    def select(self, states: Ints) -> "FingerPreparation":
        """Of some of the states, in that order."""
        outlines = _selected_edges(self.outlines, states).with_supports(self.outlines.supports[states])
        edges = outlines if self.edges is self.outlines else _selected_edges(self.edges, states)
        return FingerPreparation(outlines, edges, _selected_boundary(self.boundary, states))

    def arrays(self) -> dict[str, Arrays]:
        """To be kept."""
        found = _named("outlines.", self.outlines) | {f"outlines.{_SUPPORTS}": self.outlines.supports}
        if self.edges is not self.outlines:
            found |= _named("edges.", self.edges)
        boundary = self.boundary
        found |= _named("pieces.", boundary.pieces) | {"pieces.first": boundary.first_piece}
        found |= _named("sides.", boundary.sides) | {"sides.first": boundary.first_side}
        return found | {"radius_mm": boundary.radius_mm, "clearance_mm": boundary.clearance_mm}

    @classmethod
    def from_arrays(cls, arrays: NamedArrays, count: int) -> "FingerPreparation":
        """What `arrays` gave, of so many states. Raises ValueError for arrays that are none of these."""
        own, same = replace(arrays, prefix="outlines."), "edges.first" not in arrays
        outlines = _edges_from(own, count)
        outlines = outlines.with_supports(own.floats(_SUPPORTS, (count, *outlines.supports_shape)))
        edges = outlines if same else _edges_from(replace(arrays, prefix="edges."), count)
        first_piece = begins(arrays, "pieces.first", count)
        first_side = begins(arrays, "sides.first", count)
        boundary = TrueBoundary(
            arrays.floats("radius_mm", (count,)),
            Pieces(**_columns(Pieces, replace(arrays, prefix="pieces."), first_piece)),
            Sides(**_columns(Sides, replace(arrays, prefix="sides."), first_side)),
            first_piece,
            first_side,
            arrays.floats("clearance_mm", (count,)),
        )
        return cls(outlines, edges, boundary)


def prepare_finger(
    states: Sequence[CatalogueState], finger: Finger, facet_error_mm: float, is_exact: bool
) -> FingerPreparation:
    """Prepare states for a finger; `is_exact`: none of the states that these are part of has a tolerance."""
    outlines = outline_set(states, finger, facet_error_mm)
    edges = pairing_set(states, finger, facet_error_mm, outlines)
    if not is_exact and edges is outlines:
        edges = replace(outlines)
    _ = outlines.supports  # kept with the rest; where processes share the work, each has its states'
    return FingerPreparation(outlines, edges, true_boundary(states, finger))


def _named(prefix: str, table: Any) -> dict[str, Arrays]:
    """The columns of a table but for `state`, which `first` says as well."""
    return {prefix + item.name: getattr(table, item.name) for item in fields(table) if item.name != "state"}


def _columns(kind: type[Any], arrays: NamedArrays, first: Ints) -> dict[str, Arrays]:
    """The columns of a table of some kind, whose states' rows begin at `first` (S + 1,)."""
    size = int(first[-1])
    found: dict[str, Arrays] = {"state": np.repeat(np.arange(len(first) - 1), np.diff(first))}
    for name in (item.name for item in fields(kind)):
        if name in _COUNTED:
            found[name] = arrays.ints(name, (size,))
        elif name == "representative":
            found[name] = arrays.bools(name, (size,))
        elif name not in {"state", "first"}:
            found[name] = arrays.floats(name, (size, 2) if name in _PLANE else (size,))
    return found


def _edges_from(arrays: NamedArrays, count: int) -> EdgeSet:
    first = begins(arrays, "first", count)
    return EdgeSet(**_columns(EdgeSet, arrays, first), first=first)


def _joined_edges(parts: Sequence[EdgeSet]) -> EdgeSet:
    first = joined_begins([part.first for part in parts])
    columns = {
        item.name: np.concatenate([getattr(part, item.name) for part in parts]) for item in fields(EdgeSet)
    }
    columns |= {"state": np.repeat(np.arange(len(first) - 1), np.diff(first)), "first": first}
    return EdgeSet(**columns)


def _selected_edges(edges: EdgeSet, states: Ints) -> EdgeSet:
    count = edges.count[states]
    owner, rows = expand_ranges(edges.first[states], count)
    columns = {item.name: getattr(edges, item.name)[rows] for item in fields(EdgeSet) if item.name != "first"}
    return EdgeSet(**(columns | {"state": owner}), first=begins_of(count))


def _joined_boundary(parts: Sequence[TrueBoundary]) -> TrueBoundary:
    first_piece = joined_begins([part.first_piece for part in parts])
    first_side = joined_begins([part.first_side for part in parts])
    numbers = np.arange(len(first_piece) - 1)
    return TrueBoundary(
        np.concatenate([part.radius_mm for part in parts]),
        replace(
            Pieces.joined([part.pieces for part in parts]), state=np.repeat(numbers, np.diff(first_piece))
        ),
        replace(Sides.joined([part.sides for part in parts]), state=np.repeat(numbers, np.diff(first_side))),
        first_piece,
        first_side,
        np.concatenate([part.clearance_mm for part in parts]),
    )


def _selected_boundary(boundary: TrueBoundary, states: Ints) -> TrueBoundary:
    pieces, sides = (np.diff(first)[states] for first in (boundary.first_piece, boundary.first_side))
    own_piece, piece = expand_ranges(boundary.first_piece[states], pieces)
    own_side, side = expand_ranges(boundary.first_side[states], sides)
    return replace(
        boundary,
        pieces=replace(boundary.pieces.select(piece), state=own_piece),
        sides=replace(boundary.sides.select(side), state=own_side),
        first_piece=begins_of(pieces),
        first_side=begins_of(sides),
        radius_mm=boundary.radius_mm[states],
        clearance_mm=boundary.clearance_mm[states],
    )
