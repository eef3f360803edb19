"""Prepared states: what a catalogue finds out of every state before any finger is known, as arrays and back.

Their digests say of two states whether everything that is prepared of them is the same.
"""

import hashlib
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from palpate.base.geometry import Circle, Floats, Ints, ObjectModel, Polygon, State
from palpate.recognizer.edges import CatalogueState
from palpate.recognizer.flat_arrays import Arrays, NamedArrays, begins, begins_of, joined_begins
from palpate.recognizer.symmetry import Symmetry
from palpate.recognizer.tables import Table, expand_ranges

__all__ = ["DIGEST_BYTES", "PreparedStates", "state_digest"]

DIGEST_BYTES = 16


@dataclass(frozen=True, eq=False)
class _Columns(Table):
    """Of each state (S,): as in `CatalogueState`; `normal_bound_rad` is NaN where there is none."""

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
        """As arrays, the states that were prepared of the objects."""
        given = [state for item in objects for state in item.states]
        columns = _Columns(
            np.array([item.origin_mm for item in states], np.float64).reshape(-1, 2),
            np.array([item.symmetry.order for item in states], np.int64),
            np.array([item.symmetry.off_mm for item in states], np.float64),
            np.array([item.symmetry.lean_rad for item in states], np.float64),
            np.array([item.tolerance_mm for item in states], np.float64),
            np.array([_number(item.normal_bound_rad) for item in states], np.float64),
        )
        moved = [
            [] if item.state is state else [ring for section in item.state.sections for ring in section.rings]
            for item, state in zip(states, given, strict=True)
        ]
        vertices = np.concatenate([np.empty((0, 2)), *(ring for rings in moved for ring in rings)])
        return cls(columns, vertices, begins_of([sum(map(len, rings)) for rings in moved]))

    @classmethod
    def joined(cls, parts: Sequence["PreparedStates"]) -> "PreparedStates":
        """The states of all parts, one part after the other."""
        return cls(
            _Columns.joined([part.columns for part in parts]),
            np.concatenate([part.vertices for part in parts]),
            joined_begins([part.first for part in parts]),
        )

    def select(self, states: Ints) -> "PreparedStates":
        """Some of the states, in that order."""
        count = np.diff(self.first)[states]
        rows = expand_ranges(self.first[states], count)[1]
        return PreparedStates(self.columns.select(states), self.vertices[rows], begins_of(count))

    def arrays(self) -> dict[str, Arrays]:
        """To be kept."""
        return {**vars(self.columns), "vertices": self.vertices, "first": self.first}

    @classmethod
    def from_arrays(cls, arrays: NamedArrays, count: int) -> "PreparedStates":
        """What `arrays` gave, of so many states. Raises ValueError for arrays that are none of these."""
        first = begins(arrays, "first", count)
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
                    self._moved(number, state),
                    self.columns.origin_mm[number],
                    Symmetry(order, off_mm, lean_rad),
                    tolerance_mm,
                    item.holds_n,
                    item.support_mm,
                    None if math.isnan(bound_rad) else bound_rad,
                )
            )
        return tuple(found)

    def _moved(self, number: int, state: State) -> State:
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


def _number(value: float | None) -> float:
    return math.nan if value is None else value


def state_digest(item: ObjectModel, state: State) -> bytes:
    """Digest of everything about a state of an object that what is prepared of it depends on."""
    digest = hashlib.blake2b(digest_size=DIGEST_BYTES)
    numbers = [
        item.tolerance_mm,
        _number(item.normal_bound_rad),
        _number(state.normal_bound_rad),
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
