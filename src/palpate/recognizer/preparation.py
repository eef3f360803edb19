"""Preparation of a catalogue, to and from arrays: its states, and the edges each kind of finger can meet.

Independent of fingers, each state's symmetry and exactly symmetric vertices are prepared; for one kind of
finger, edges and true boundary. Every state is prepared separately, so results of different processes or
earlier runs can be joined, and are bit for bit the same as if prepared together. Equal digests of two states
mean that all prepared data of them are equal.
"""

import hashlib
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palpate.base.geometry import Bools, Circle, Floats, Ints, ObjectModel, Polygon, State
from palpate.recognizer.boundary_pieces import Pieces, Sides
from palpate.recognizer.contact import Finger
from palpate.recognizer.edges import CatalogueState, EdgeSet
from palpate.recognizer.grown_edges import outline_set, pairing_set
from palpate.recognizer.symmetry import Symmetry
from palpate.recognizer.tables import Table, expand_ranges
from palpate.recognizer.true_boundary import TrueBoundary, true_boundary

Arrays = NDArray[Any]
"""An array of floats, ints or bools."""


@dataclass(frozen=True, eq=False)
class NamedArrays:
    """Arrays whose names begin with a `prefix`. What is not there, or not of its kind, raises ValueError."""

    arrays: Mapping[str, Arrays]
    prefix: str = ""

    def __contains__(self, name: str) -> bool:
        return self.prefix + name in self.arrays

    def floats(self, name: str, shape: tuple[int, ...]) -> Floats:
        """Array of float64."""
        return self._check(name, np.float64, shape)

    def ints(self, name: str, shape: tuple[int, ...]) -> Ints:
        """Array of int64."""
        return self._check(name, np.int64, shape)

    def bools(self, name: str, shape: tuple[int, ...]) -> Bools:
        """Array of bool."""
        return self._check(name, np.bool_, shape)

    def _check(self, name: str, kind: type[np.generic], shape: tuple[int, ...]) -> Arrays:
        found = self.arrays.get(self.prefix + name)
        if found is None or found.dtype != kind or found.shape != shape:
            raise ValueError(f"{self.prefix}{name} is not {kind.__name__} of shape {shape}")
        return found


def _read_offsets(arrays: NamedArrays, name: str, count: int) -> Ints:
    """Offsets of the rows of each of so many states, and of the last one's end: (count + 1,)."""
    first = arrays.ints(name, (count + 1,))
    if first[0] != 0 or bool(np.any(np.diff(first) < 0)):
        raise ValueError(f"{name} does not ascend from 0")
    return first


def _offsets_of_counts(count: Sequence[int] | Ints) -> Ints:
    """The same from the number of rows of each (S,)."""
    return np.concatenate([[0], np.cumsum(np.asarray(count, np.int64))]).astype(np.int64)


def _join_offsets(parts: Sequence[Ints]) -> Ints:
    """The same of parts that are put one after the other."""
    return _offsets_of_counts(np.concatenate([np.diff(part) for part in parts]))


DIGEST_BYTES = 16


@dataclass(frozen=True, eq=False)
class _Columns(Table):
    """Columns of S states, as in `CatalogueState`; `normal_bound_rad` is NaN where there is none."""

    origin_mm: Floats
    order: Ints
    off_mm: Floats
    lean_rad: Floats
    tolerance_mm: Floats
    normal_bound_rad: Floats


@dataclass(frozen=True, eq=False)
class PreparedStates:
    """The S states of some objects, prepared.

    `vertices` (n, 2) mm: those of states that were made exactly symmetric, ring after ring; the others have
    none. `first` (S + 1,): where each state's begin.
    """

    columns: _Columns
    vertices: Floats
    first: Ints

    def __len__(self) -> int:
        return len(self.columns)

    @classmethod
    def of(cls, objects: Sequence[ObjectModel], states: Sequence[CatalogueState]) -> "PreparedStates":
        """Arrays of the states that were prepared of the objects."""
        given = [state for item in objects for state in item.states]
        columns = _Columns(
            np.array([item.origin_mm for item in states], np.float64).reshape(-1, 2),
            np.array([item.symmetry.order for item in states], np.int64),
            np.array([item.symmetry.off_mm for item in states], np.float64),
            np.array([item.symmetry.lean_rad for item in states], np.float64),
            np.array([item.tolerance_mm for item in states], np.float64),
            np.array([_nan_if_none(item.normal_bound_rad) for item in states], np.float64),
        )
        moved = [
            [] if item.state is state else [ring for section in item.state.sections for ring in section.rings]
            for item, state in zip(states, given, strict=True)
        ]
        vertices = np.concatenate([np.empty((0, 2)), *(ring for rings in moved for ring in rings)])
        return cls(columns, vertices, _offsets_of_counts([sum(map(len, rings)) for rings in moved]))

    @classmethod
    def join(cls, parts: Sequence["PreparedStates"]) -> "PreparedStates":
        """The states of all parts, one part after the other."""
        return cls(
            _Columns.join([part.columns for part in parts]),
            np.concatenate([part.vertices for part in parts]),
            _join_offsets([part.first for part in parts]),
        )

    def select(self, states: Ints) -> "PreparedStates":
        """The same of the states `states`, in that order."""
        count = np.diff(self.first)[states]
        rows = expand_ranges(self.first[states], count)[1]
        return PreparedStates(self.columns.select(states), self.vertices[rows], _offsets_of_counts(count))

    def arrays(self) -> dict[str, Arrays]:
        """Arrays to be kept, by name."""
        return {**vars(self.columns), "vertices": self.vertices, "first": self.first}

    @classmethod
    def from_arrays(cls, arrays: NamedArrays, count: int) -> "PreparedStates":
        """Read what `arrays` gave, of so many states. Raises ValueError for arrays that are none of these."""
        first = _read_offsets(arrays, "first", count)
        columns = _Columns(
            arrays.floats("origin_mm", (count, 2)),
            arrays.ints("order", (count,)),
            arrays.floats("off_mm", (count,)),
            arrays.floats("lean_rad", (count,)),
            arrays.floats("tolerance_mm", (count,)),
            arrays.floats("normal_bound_rad", (count,)),
        )
        return cls(columns, arrays.floats("vertices", (int(first[-1]), 2)), first)

    def states(self, objects: Sequence[ObjectModel]) -> tuple[CatalogueState, ...]:
        """The states of the objects of which these are the arrays. Raises ValueError for other objects."""
        given = [(item, state) for item in objects for state in item.states]
        if len(given) != len(self):
            raise ValueError("these are other objects' states")
        names = ("order", "off_mm", "lean_rad", "tolerance_mm", "normal_bound_rad")
        columns = [getattr(self.columns, name).tolist() for name in names]
        found = []
        for number, ((item, state), *values) in enumerate(zip(given, *columns, strict=True)):
            order, off_mm, lean_rad, tolerance_mm, bound_rad = values
            found.append(
                CatalogueState(
                    item.name,
                    self._symmetrize(number, state),
                    self.columns.origin_mm[number],
                    Symmetry(order, off_mm, lean_rad),
                    tolerance_mm,
                    item.holds_n,
                    item.support_mm,
                    None if math.isnan(bound_rad) else bound_rad,
                )
            )
        return tuple(found)

    def _symmetrize(self, number: int, state: State) -> State:
        """The state with the vertices that it was given to be exactly symmetric, if it was."""
        at, end = (int(value) for value in self.first[number : number + 2])
        if at == end:
            return state
        sizes = [len(ring) for section in state.sections for ring in section.rings]
        if sum(sizes) != end - at:
            raise ValueError("these are other objects' states")
        rings = iter(np.split(self.vertices[at:end], np.cumsum(sizes)[:-1]))
        return replace(
            state,
            sections=tuple(
                replace(section, polygons=tuple(_polygon(polygon, rings) for polygon in section.polygons))
                for section in state.sections
            ),
        )


def _polygon(polygon: Polygon, rings: Iterator[Floats]) -> Polygon:
    outer, *holes = (next(rings) for _ in polygon.rings)
    return Polygon(outer, tuple(holes))


def _nan_if_none(value: float | None) -> float:
    return math.nan if value is None else value


def state_digest(item: ObjectModel, state: State) -> bytes:
    """Digest of everything about a state of an object that what is prepared of it depends on."""
    digest = hashlib.blake2b(digest_size=DIGEST_BYTES)
    numbers = [
        item.tolerance_mm,
        _nan_if_none(item.normal_bound_rad),
        _nan_if_none(state.normal_bound_rad),
        state.curves_off_mm,
        state.curves_turn_rad,
        len(state.sections),
    ]
    for section in state.sections:
        numbers += [*section.z_mm, len(section.polygons)]
        for polygon in section.polygons:
            numbers += [len(polygon.rings), *map(len, polygon.rings), len(polygon.curves)]
            for ring in polygon.rings:
                digest.update(np.ascontiguousarray(ring, np.float64).data)
            for curve in polygon.curves:
                if isinstance(curve, Circle):
                    numbers += [1, *curve.centre_mm, curve.radius_mm]
                elif curve is None:
                    numbers.append(0)
                else:
                    numbers += [2, len(curve), *np.ravel(curve).tolist()]
    # How long rings and lists are says where each of what came before ends.
    digest.update(np.array(numbers, np.float64).data)
    return digest.digest()


_VECTOR_COLUMNS = ("start", "end", "direction", "normal", "along")
"""Columns of points and directions."""
_INTEGER_COLUMNS = ("feature", "ring")
"""Columns of whole numbers."""
_SUPPORTS = "supports"


@dataclass(frozen=True, eq=False)
class FingerPreparation:
    """Outlines of S states as one kind of finger meets them, prepared.

    `outlines` stop the finger, `edges` may be paired with it, `boundary` is the true one. `edges` are the
    `outlines` where no state has a tolerance.
    """

    outlines: EdgeSet
    edges: EdgeSet
    boundary: TrueBoundary

    def __len__(self) -> int:
        return len(self.boundary.clearance_mm)

    @classmethod
    def join(cls, parts: Sequence["FingerPreparation"]) -> "FingerPreparation":
        """The same of the states of all parts, one part after the other."""
        same = all(part.outlines is part.edges for part in parts)
        supports = np.concatenate([part.outlines.supports for part in parts])
        outlines = _join_edges([part.outlines for part in parts]).with_supports(supports)
        edges = outlines if same else _join_edges([part.edges for part in parts])
        return cls(outlines, edges, _join_boundaries([part.boundary for part in parts]))

    def select(self, states: Ints) -> "FingerPreparation":
        """The same of the states `states`, in that order."""
        outlines = _select_edges(self.outlines, states).with_supports(self.outlines.supports[states])
        edges = outlines if self.edges is self.outlines else _select_edges(self.edges, states)
        return FingerPreparation(outlines, edges, _select_boundary(self.boundary, states))

    def arrays(self) -> dict[str, Arrays]:
        """Arrays to be kept, by name."""
        found = _named_columns("outlines.", self.outlines) | {f"outlines.{_SUPPORTS}": self.outlines.supports}
        if self.edges is not self.outlines:
            found |= _named_columns("edges.", self.edges)
        boundary = self.boundary
        found |= _named_columns("pieces.", boundary.pieces) | {"pieces.first": boundary.first_piece}
        found |= _named_columns("sides.", boundary.sides) | {"sides.first": boundary.first_side}
        return found | {"radius_mm": boundary.radius_mm, "clearance_mm": boundary.clearance_mm}

    @classmethod
    def from_arrays(cls, arrays: NamedArrays, count: int) -> "FingerPreparation":
        """Read what `arrays` gave, of so many states. Raises ValueError for arrays that are none of these."""
        own, same = replace(arrays, prefix="outlines."), "edges.first" not in arrays
        outlines = _edges_from(own, count)
        outlines = outlines.with_supports(own.floats(_SUPPORTS, (count, *outlines.supports_shape)))
        edges = outlines if same else _edges_from(replace(arrays, prefix="edges."), count)
        first_piece = _read_offsets(arrays, "pieces.first", count)
        first_side = _read_offsets(arrays, "sides.first", count)
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


def _named_columns(prefix: str, table: Any) -> dict[str, Arrays]:
    """The columns of a table but for `state`, which `first` says as well."""
    return {prefix + item.name: getattr(table, item.name) for item in fields(table) if item.name != "state"}


def _columns(kind: type[Any], arrays: NamedArrays, first: Ints) -> dict[str, Arrays]:
    """The columns of a table of some kind, whose states' rows begin at `first` (S + 1,)."""
    size = int(first[-1])
    found: dict[str, Arrays] = {"state": np.repeat(np.arange(len(first) - 1), np.diff(first))}
    for name in (item.name for item in fields(kind)):
        if name in _INTEGER_COLUMNS:
            found[name] = arrays.ints(name, (size,))
        elif name == "representative":
            found[name] = arrays.bools(name, (size,))
        elif name not in {"state", "first"}:
            found[name] = arrays.floats(name, (size, 2) if name in _VECTOR_COLUMNS else (size,))
    return found


def _edges_from(arrays: NamedArrays, count: int) -> EdgeSet:
    first = _read_offsets(arrays, "first", count)
    return EdgeSet(**_columns(EdgeSet, arrays, first), first=first)


def _join_edges(parts: Sequence[EdgeSet]) -> EdgeSet:
    first = _join_offsets([part.first for part in parts])
    columns = {
        item.name: np.concatenate([getattr(part, item.name) for part in parts]) for item in fields(EdgeSet)
    }
    columns |= {"state": np.repeat(np.arange(len(first) - 1), np.diff(first)), "first": first}
    return EdgeSet(**columns)


def _select_edges(edges: EdgeSet, states: Ints) -> EdgeSet:
    count = edges.count[states]
    owner, rows = expand_ranges(edges.first[states], count)
    columns = {item.name: getattr(edges, item.name)[rows] for item in fields(EdgeSet) if item.name != "first"}
    return EdgeSet(**(columns | {"state": owner}), first=_offsets_of_counts(count))


def _join_boundaries(parts: Sequence[TrueBoundary]) -> TrueBoundary:
    first_piece = _join_offsets([part.first_piece for part in parts])
    first_side = _join_offsets([part.first_side for part in parts])
    numbers = np.arange(len(first_piece) - 1)
    return TrueBoundary(
        np.concatenate([part.radius_mm for part in parts]),
        replace(Pieces.join([part.pieces for part in parts]), state=np.repeat(numbers, np.diff(first_piece))),
        replace(Sides.join([part.sides for part in parts]), state=np.repeat(numbers, np.diff(first_side))),
        first_piece,
        first_side,
        np.concatenate([part.clearance_mm for part in parts]),
    )


def _select_boundary(boundary: TrueBoundary, states: Ints) -> TrueBoundary:
    pieces, sides = (np.diff(first)[states] for first in (boundary.first_piece, boundary.first_side))
    own_piece, piece = expand_ranges(boundary.first_piece[states], pieces)
    own_side, side = expand_ranges(boundary.first_side[states], sides)
    return replace(
        boundary,
        pieces=replace(boundary.pieces.select(piece), state=own_piece),
        sides=replace(boundary.sides.select(side), state=own_side),
        first_piece=_offsets_of_counts(pieces),
        first_side=_offsets_of_counts(sides),
        radius_mm=boundary.radius_mm[states],
        clearance_mm=boundary.clearance_mm[states],
    )
