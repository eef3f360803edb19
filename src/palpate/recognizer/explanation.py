"""Explanation of a rejection: the test that ruled an object out, a minimal conflict, possible causes.

A minimal conflict is a set of contacts that rules the object out, none of which can be left out. Possible
causes are an object that moved between grips, and spurious contacts.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from itertools import combinations

import numpy as np

from palpate.base.errors import InputError
from palpate.base.geometry import ObjectModel
from palpate.base.short_repr import ShortRepr
from palpate.recognizer.catalogue import Catalogue
from palpate.recognizer.contact import Contact
from palpate.recognizer.hypotheses import Hypothesis
from palpate.recognizer.interpretation_tree import filter_by_distance, first_level, narrow_by, pair_by_angle
from palpate.recognizer.interpretations import Interpretations, Query
from palpate.recognizer.pose_region import Cells
from palpate.recognizer.recognition import anchor_of, intervals_of, recognise
from palpate.recognizer.steps import STEPS

_LEAST_SUSPECTS = 2


class SearchTest(Enum):
    """Test made by a step of the search (docs/recogniser.md)."""

    EDGES = "edges"  # that the first contact may lie on, at its height
    NORMAL = "normal"
    DISTANCE = "distance"
    TWO = "model of two contacts"
    THREE = "model of three contacts"
    REGION = "region"
    PATH = "free path"
    FINER = "finer cells"


@dataclass(frozen=True, eq=False, repr=False)
class SearchStep(ShortRepr):
    """`left` interpretations after a test of `contacts`; the newest of them is the last."""

    reason: SearchTest
    contacts: tuple[Contact, ...]
    left: int


@dataclass(frozen=True, eq=False, repr=False)
class ObjectExplanation(ShortRepr):
    """Result of the search for one object, or of one of its states.

    `conflict`: contacts and misses that cannot all be true of it, none of which can be left out; empty if the
    object is not ruled out. Then `hypotheses` are its own.
    """

    object_name: str
    state_name: str | None
    steps: tuple[SearchStep, ...]
    conflict: tuple[Contact, ...]
    hypotheses: tuple[Hypothesis, ...]

    @property
    def refuting_step(self) -> SearchStep | None:
        """The step that left nothing; None if something is left."""
        return None if self.steps[-1].left else self.steps[-1]


def explain_object(
    catalogue: Catalogue, contacts: Sequence[Contact], object_name: str, state_name: str | None = None
) -> ObjectExplanation:
    """Search for one object alone, step by step, until nothing is left of it or all contacts are used.

    No contact is taken as spurious. Raises InputError if none of the contacts touched anything, and for an
    object or a state that is not in the catalogue.
    """
    alone = _catalogue_of_one(catalogue, object_name, state_name)
    if not any(contact.touched for contact in contacts):
        raise InputError("no finger touched anything: nothing can be ruled out")
    steps = tuple(_steps(alone, contacts))
    if not steps[-1].left:
        return ObjectExplanation(object_name, state_name, steps, _conflict(alone, contacts), ())
    return ObjectExplanation(object_name, state_name, steps, (), tuple(recognise(alone, contacts).hypotheses))


def grips_before_move(
    catalogue: Catalogue, grips: Sequence[Sequence[Contact]], max_spurious: int = 0
) -> int | None:
    """Number of the first grips that fit together, if the object may have moved after them.

    That is so if every grip that touched something fits an object on its own, but all together fit none. None
    otherwise.
    """
    if is_explained(catalogue, _together(grips), max_spurious):
        return None
    if not all(is_explained(catalogue, grip, max_spurious) for grip in grips):
        return None
    return next(
        count - 1
        for count in range(1, len(grips) + 1)
        if not is_explained(catalogue, _together(grips[:count]), max_spurious)
    )


def suspected_contacts(
    catalogue: Catalogue, contacts: Sequence[Contact], max_spurious: int = 0
) -> tuple[Contact, ...]:
    """Contacts that are spurious in some hypothesis if `max_spurious` + 1 may be; in the order given.

    Empty if that does not help, or if less than two contacts would be left: one alone nearly always fits.
    """
    if sum(contact.touched for contact in contacts) - max_spurious - 1 < _LEAST_SUSPECTS:
        return ()
    try:
        found = recognise(catalogue, contacts, max_spurious + 1)
    except InputError:  # the others say too little: everything fits
        return ()
    named = {id(contact) for item in found.hypotheses for contact in item.null_contacts}
    return tuple(contact for contact in contacts if id(contact) in named)


def is_explained(catalogue: Catalogue, contacts: Sequence[Contact], max_spurious: int = 0) -> bool:
    """Return whether something explains the contacts; anything does without a touch, or with too few."""
    touched = sum(contact.touched for contact in contacts)
    if not touched:
        return True
    try:
        return bool(recognise(catalogue, contacts, min(max_spurious, touched - 1)).hypotheses)
    except InputError:
        return True


def _together(grips: Sequence[Sequence[Contact]]) -> list[Contact]:
    return [contact for grip in grips for contact in grip]


def _catalogue_of_one(catalogue: Catalogue, object_name: str, state_name: str | None) -> Catalogue:
    """A catalogue of one object, with one state or with all that it has."""
    named = [state for state in catalogue.states if state.object_name == object_name]
    if not named:
        known = ", ".join(dict.fromkeys(state.object_name for state in catalogue.states))
        raise InputError(f'no object "{object_name}" in the catalogue; there are: {known}')
    chosen = [item.state for item in named if state_name in {None, item.state.name}]
    if not chosen:
        known = ", ".join(item.state.name for item in named)
        raise InputError(f'object "{object_name}" has no state "{state_name}"; it has: {known}')
    model = ObjectModel(
        object_name,
        tuple(chosen),
        named[0].tolerance_mm,
        normal_bound_rad=named[0].normal_bound_rad,
    )
    return Catalogue([model], facet_error_mm=catalogue.facet_error_mm, flat_edges=catalogue.flat_edges)


def _steps(alone: Catalogue, contacts: Sequence[Contact]) -> Iterator[SearchStep]:
    """The tests of the search with what they leave, up to the first that leaves nothing."""
    for step in _all_steps(alone, contacts):
        yield step
        if not step.left:
            return


def _all_steps(alone: Catalogue, contacts: Sequence[Contact]) -> Iterator[SearchStep]:
    """Pairs and triples of contacts are tested at every level; `recognise` has the last word."""
    touched = [contact for contact in contacts if contact.touched]
    query = Query(alone, touched, anchor_of(touched))
    nodes, _ = first_level(alone, touched[0])
    yield SearchStep(SearchTest.EDGES, (touched[0],), len(nodes))
    for size in range(2, len(touched) + 1):
        for step, grown in _level(query.select(range(size)), nodes):
            nodes = grown
            yield step
    cells, _ = STEPS.cut_cells(query, nodes, intervals_of(nodes))
    yield SearchStep(SearchTest.REGION, tuple(touched), _interpretations(cells))
    for contact in contacts:
        path = replace(query, contacts=[contact])
        cells = cells.select(STEPS.free_cells(path, cells, None))
        yield SearchStep(SearchTest.PATH, (contact,), _interpretations(cells))
    found = recognise(alone, contacts).hypotheses
    yield SearchStep(SearchTest.FINER, tuple(contacts), sum(_interpretations(item.cells) for item in found))


def _level(query: Query, nodes: Interpretations) -> Iterator[tuple[SearchStep, Interpretations]]:
    """The tests of a level of the tree, one by one."""
    *earlier, new = query.contacts
    nodes = pair_by_angle(query, nodes)
    yield SearchStep(SearchTest.NORMAL, (new,), len(nodes)), nodes
    for level, other in enumerate(earlier):
        nodes = filter_by_distance(query, nodes, level)
        yield SearchStep(SearchTest.DISTANCE, (other, new), len(nodes)), nodes
    for test, size in ((SearchTest.TWO, 1), (SearchTest.THREE, 2)):
        for group in combinations(range(len(earlier)), size):
            nodes = narrow_by(query, nodes, *group)
            yield SearchStep(test, (*(earlier[k] for k in group), new), len(nodes)), nodes


def _interpretations(cells: Cells) -> int:
    return len(np.unique(cells.node))


def _conflict(alone: Catalogue, contacts: Sequence[Contact]) -> tuple[Contact, ...]:
    """Contacts that rule the object out, until none of them can be left out; misses are tried first."""
    left = list(contacts)
    shrunk = True
    while shrunk:
        shrunk = False
        missed = [contact for contact in reversed(left) if not contact.touched]
        for contact in (*missed, *(contact for contact in reversed(left) if contact.touched)):
            fewer = [other for other in left if other is not contact]
            if _is_ruled_out(alone, fewer):
                left, shrunk = fewer, True
    return tuple(left)


def _is_ruled_out(alone: Catalogue, contacts: Sequence[Contact]) -> bool:
    if not any(contact.touched for contact in contacts):
        return False
    *_, last = _steps(alone, contacts)
    return not last.left
