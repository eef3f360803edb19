"""Preparation of catalogues: on all cores if it takes long, and cached for later.

Prepared data are bit for bit the same whether computed now or cached. They are cached under a digest of
everything that they depend on: the states' outlines and tolerances, the finger, the code and its libraries.
If an object is changed or added, only this object is prepared; cached data are used for the others.
"""

import hashlib
import os
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from multiprocessing import parent_process
from typing import Generic, Protocol, Self, TypeVar

import numpy as np

from palpate.base.array_cache import Cache, code_digest, user_cache
from palpate.base.geometry import Ints, ObjectModel
from palpate.recognizer import (
    DIGEST_BYTES,
    FACET_ERROR_MM,
    Arrays,
    Catalogue,
    CatalogueState,
    Finger,
    FingerPreparation,
    NamedArrays,
    PreparedStates,
    is_exact,
    prepare_finger,
    prepare_states,
    state_digest,
)
from palpate.rig.workers import in_processes

_SERIAL_VERTICES = 2000  # of a catalogue that is prepared in hardly more time than it takes to look for it
_SERIAL_S = 1.0  # after which the rest is prepared on all cores
_CHUNK_VERTICES = 2000  # of states that are prepared at once
_CODE = "palpate.recognizer", "palpate.base.geometry"
_MAX_OTHER_FILES = 3  # files of other catalogues, for states that are the same

_T = TypeVar("_T")


def prepare_catalogue(
    objects: Sequence[ObjectModel],
    fingers: Iterable[Finger],
    progress: Callable[[str], None] = lambda _: None,
    cache: Cache | None = None,
    *,
    alone_s: float = _SERIAL_S,
    workers: int | None = None,
) -> Catalogue:
    """A catalogue of objects that is prepared for some fingers; for others it will be when they come.

    `progress` is told how far that is. `cache`: None for the user's own. `alone_s`: after so long other
    processes help, so many `workers`, None: on all cores. Raises InputError for objects that are wrong.
    """
    if sum(map(_vertices, objects)) < _SERIAL_VERTICES:
        return Catalogue(objects)
    cache = user_cache() if cache is None else cache
    single = [replace(item, states=(state,)) for item in objects for state in item.states]
    digests = [state_digest(item, item.states[0]) for item in single]
    keeper = _Keeper(cache, digests, progress, alone_s, workers)
    states = _prepare_states(single, keeper).states(objects)
    catalogue = Catalogue(objects, states=states)
    wanted = sorted({finger.face_point for finger in fingers})
    for number, finger in enumerate(wanted, 1):
        what = "" if len(wanted) == 1 else f" (finger {number} of {len(wanted)})"
        catalogue.take(finger, _prepare_for_finger(states, finger, replace(keeper, what=what)))
    return catalogue


def _prepare_states(single: Sequence[ObjectModel], keeper: "_Keeper") -> PreparedStates:
    """States of objects that have one each."""

    def make(chosen: Sequence[int]) -> Iterator[PreparedStates]:
        chunks = _chunks(chosen, [_vertices(single[number]) for number in chosen])
        return keeper.run(_states_of, [([single[number] for number in chunk],) for chunk in chunks])

    return keeper.prepared(_Kind("states", PreparedStates.from_arrays, PreparedStates.join, make))


def _prepare_for_finger(
    states: Sequence[CatalogueState], finger: Finger, keeper: "_Keeper"
) -> FingerPreparation:
    exact = all(is_exact(state, finger) for state in states)

    def make(chosen: Sequence[int]) -> Iterator[FingerPreparation]:
        chunks = _chunks(chosen, [_vertices_met(states[number], finger) for number in chosen])
        return keeper.run(
            prepare_finger,
            [([states[number] for number in chunk], finger, FACET_ERROR_MM, exact) for chunk in chunks],
        )

    about = [*asdict(finger).values(), FACET_ERROR_MM, float(exact)]
    name = f"finger-{hashlib.sha256(repr(about).encode()).hexdigest()[:16]}"
    return keeper.prepared(_Kind(name, FingerPreparation.from_arrays, FingerPreparation.join, make))


def _states_of(objects: Sequence[ObjectModel]) -> PreparedStates:
    return PreparedStates.of(objects, prepare_states(objects))


class _Prepared(Protocol):
    """Prepared arrays of some states."""

    def __len__(self) -> int: ...

    def select(self, states: Ints) -> Self:
        """Select some of these states, in that order."""
        ...

    def arrays(self) -> dict[str, Arrays]:
        """Arrays to be kept."""
        ...


_P = TypeVar("_P", bound=_Prepared)


@dataclass(frozen=True)
class _Kind(Generic[_P]):
    """A kind of preparation: how it is made of states (their numbers), joined, and taken from arrays."""

    name: str
    load: Callable[[NamedArrays, int], _P]
    join: Callable[[Sequence[_P]], _P]
    make: Callable[[Sequence[int]], Iterator[_P]]


@dataclass(frozen=True)
class _Keeper:
    """Keeps and finds what is prepared of states with some `digests`, and makes what is missing."""

    cache: Cache
    digests: Sequence[bytes]
    progress: Callable[[str], None]
    alone_s: float
    workers: int | None
    what: str = ""

    def prepared(self, kind: _Kind[_P]) -> _P:
        """Return what was kept of just these states, or else of some, with the others made now."""
        name = f"{kind.name}-{code_digest(*_CODE)}"
        key = hashlib.sha256(b"".join(self.digests)).hexdigest()[:32]
        found = self._load(kind, self.cache.fetch(name, key))
        if found is not None and found[1] == self.digests:
            return found[0]
        made = self._completed(kind, name)
        digests = np.frombuffer(b"".join(self.digests), np.uint8).reshape(-1, DIGEST_BYTES)
        self.cache.keep(name, key, made.arrays() | {"digests": digests})
        # From its file it takes no memory of this process alone.
        found = self._load(kind, self.cache.fetch(name, key))
        return made if found is None or found[1] != self.digests else found[0]

    def _completed(self, kind: _Kind[_P], name: str) -> _P:
        """Join what was kept of some states and what is made of the others, in the states' order.

        What is the same of several states is prepared once.
        """
        missing, row, parts = set(self.digests), dict[bytes, int](), list[_P]()
        for arrays in self.cache.newest(name, _MAX_OTHER_FILES):
            found = self._load(kind, arrays)
            if found is None or missing.isdisjoint(found[1]):
                continue
            known = {digest: number for number, digest in enumerate(found[1]) if digest in missing}
            row |= {digest: len(row) + number for number, digest in enumerate(known)}
            parts.append(found[0].select(np.array(list(known.values()))))
            missing -= known.keys()
        first = {digest: number for number, digest in reversed(list(enumerate(self.digests)))}
        chosen = sorted(first[digest] for digest in missing)
        row |= {self.digests[number]: len(row) + at for at, number in enumerate(chosen)}
        parts += kind.make(chosen)
        whole, order = kind.join(parts), np.array([row[digest] for digest in self.digests])
        in_order = len(order) == len(row) and bool(np.all(order[1:] > order[:-1]))
        return whole if in_order else whole.select(order)

    def _load(self, kind: _Kind[_P], arrays: dict[str, Arrays] | None) -> tuple[_P, list[bytes]] | None:
        """A preparation, and the digests of its states; None for arrays that are not what they should be."""
        if arrays is None:
            return None
        try:
            digests = arrays["digests"]
            if digests.dtype != np.uint8 or digests.shape[1:] != (DIGEST_BYTES,):
                return None
            return kind.load(NamedArrays(arrays), len(digests)), [bytes(row) for row in digests]
        except (KeyError, ValueError):
            return None

    def run(
        self, function: Callable[..., _T], arguments: Sequence[tuple[Sequence[object], *tuple[object, ...]]]
    ) -> Iterator[_T]:
        """Call a function with each of the arguments, of which the first are states; results in order."""
        total, done, begun = sum(len(states) for states, *_ in arguments), 0, time.monotonic()
        alone = parent_process() is not None or (self.workers or os.cpu_count() or 1) == 1
        at = 0
        while at < len(arguments) and (alone or time.monotonic() - begun < self.alone_s):
            self._tell(done, total)
            yield function(*arguments[at])
            done += len(arguments[at][0])
            at += 1
        if at == len(arguments):
            return
        rest, found = arguments[at:], dict[int, _T]()
        for number, result in in_processes(function, rest, self.workers):
            found[number] = result
            done += len(rest[number][0])
            self._tell(done, total)
        for number in range(len(rest)):
            yield found.pop(number)

    def _tell(self, done: int, total: int) -> None:
        self.progress(f"preparing outlines: {done} of {total}{self.what}")


def _chunks(chosen: Sequence[int], weights: Sequence[int]) -> list[list[int]]:
    """Numbers of states in order, so many at once that their weights (vertices) add up to about as much."""
    ends = np.cumsum(weights)
    chunk = ends // _CHUNK_VERTICES
    return [
        list(part) for part in np.split(np.array(chosen), np.flatnonzero(np.diff(chunk)) + 1) if len(part)
    ]


def _vertices(item: ObjectModel) -> int:
    return sum(len(ring) for state in item.states for section in state.sections for ring in section.rings)


def _vertices_met(item: CatalogueState, finger: Finger) -> int:
    return sum(len(ring) for section in item.state.sections_within(finger.span_mm) for ring in section.rings)
