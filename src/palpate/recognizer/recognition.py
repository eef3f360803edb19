"""Recognition: from contacts to hypotheses, extended by every further contact.

    contacts → interpretation tree (levels 1–3, null branches) → cells → free-path evidence → hypotheses

Further contacts extend the surviving interpretations; nothing is started again. The tree is grown at once,
the rest when it is asked for. A contact of a part that has moved since is a contact of the part as it lies
now, of a finger that was moved with it: the *carried* contact, as far from the measured one as the part was
moved there (docs/motion-bounds.md). Pure computation.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from palpate.base.errors import InputError
from palpate.base.geometry import Floats, Ints
from palpate.base.short_repr import ShortRepr
from palpate.base.vocabulary import RecognitionVerdict
from palpate.recognizer.budget import STANDARD_BUDGET, Budget, BudgetSpentError
from palpate.recognizer.carried_region import CarriedRegion
from palpate.recognizer.catalogue import Catalogue
from palpate.recognizer.constraints import Constraints
from palpate.recognizer.contact import LARGEST_MM, Contact, NormalRange
from palpate.recognizer.edges import CatalogueState
from palpate.recognizer.hypotheses import Hypotheses, hypotheses_of
from palpate.recognizer.interpretation_tree import (
    COARSE_RAD,
    ROOT_BRANCH,
    TREE_LEVELS,
    Branch,
    branches_of,
    contact_in_object,
    first_level,
    grow_branches,
    join_branches,
    split_into_runs,
)
from palpate.recognizer.interpretations import Interpretations, LevelCount, Query
from palpate.recognizer.pose_region import PARTS_PER_CELL, Cells, Intervals, Regions, divide_orientations
from palpate.recognizer.witness_search import PAVED_RAD, connected_regions


@dataclass(frozen=True, eq=False)
class Motion:
    """Bounds on one motion of the part, for each of a catalogue's S states: all (S,).

    Its centroid is moved by at most `shift_mm`, and it is turned by at most `turn_rad`.
    """

    shift_mm: Floats
    turn_rad: Floats

    @classmethod
    def none(cls, catalogue: Catalogue) -> "Motion":
        """No motion."""
        return cls(np.zeros(len(catalogue.states)), np.zeros(len(catalogue.states)))

    def __bool__(self) -> bool:
        return bool(self.shift_mm.any() or self.turn_rad.any())

    def displacements_mm(self, catalogue: Catalogue) -> Floats:
        """Largest displacement of any point of the part, in each state (S,); infinite: no bound."""
        result: Floats = self.shift_mm + self.turn_rad * catalogue.reach_mm
        return result

    def furthest_mm(self, catalogue: Catalogue, states: Ints) -> float:
        """The largest of these displacements in any of `states` (indices)."""
        return _largest(self.displacements_mm(catalogue), states)

    def __add__(self, other: "Motion") -> "Motion":
        """One motion after the other."""
        return Motion(self.shift_mm + other.shift_mm, self.turn_rad + other.turn_rad)


def contact_after_motion(
    motion: Motion, catalogue: Catalogue, contact: Contact, states: Ints, distance_mm: Floats | None = None
) -> Contact:
    """The contact after a motion of the part, which is in one of `states` (indices).

    Position, path, normal and direction of travel are widened by what the motion may have been.
    `distance_mm` (S,): from the centroid to where the contact was, at most; None: as far as the part reaches.
    """
    at_end, on_path = _displacements_mm(motion, catalogue, contact, states)
    if distance_mm is not None:
        at_end = min(at_end, _largest(motion.shift_mm + motion.turn_rad * distance_mm, states))
    turn = _largest(motion.turn_rad, states)
    normal = contact.normal
    if normal is not None:
        lo, hi = normal.lo_rad - turn, normal.hi_rad + turn
        normal = NormalRange(lo, hi) if hi - lo < 2 * math.pi else None
    return replace(
        contact,
        position_bound_mm=min(contact.position_bound_mm + at_end, LARGEST_MM),
        path_bound_mm=min(contact.free_path_bound_mm + on_path, LARGEST_MM),
        normal=normal,
        turn_bound_rad=min(contact.turn_bound_rad + turn, math.pi),
    )


def contact_in_motion(motion: Motion, catalogue: Catalogue, contact: Contact, states: Ints) -> Contact:
    """A contact of a grip that may have moved the part, in one of `states`, before the contact was measured.

    Where the tip was, and the normal, are those of the part as it lay then. The path was free of a part that
    lay elsewhere, and the part may have been pushed against the tip from any side.
    """
    _, on_path = _displacements_mm(motion, catalogue, contact, states)
    if not on_path:
        return contact
    bound = min(contact.free_path_bound_mm + on_path, LARGEST_MM)
    return replace(contact, path_bound_mm=bound, turn_bound_rad=math.pi)


def _displacements_mm(
    motion: Motion, catalogue: Catalogue, contact: Contact, states: Ints
) -> tuple[float, float]:
    """Largest way that a motion takes the tip: at its contact, and on its path beside the part."""
    shift, turn = motion.shift_mm, motion.turn_rad
    lever = catalogue.reach_mm + contact.finger.tip_radius_mm
    # A point of the path that can be beside the moved part was no further from it before than it has moved.
    beside = lever + shift + contact.free_path_bound_mm
    return _largest(shift + turn * lever, states), _largest(shift + turn * beside, states)


def _largest(values: Floats, states: Ints) -> float:
    return float(np.max(values[states], initial=0.0))


_WIDENED_FACTOR = 2.0  # by which carried contacts are wider than others: a new tree says more
_CELLS_IF_FEW, _MAX_CELLS_EACH = 24, 8


@dataclass(frozen=True)
class PossibleState:
    """A state that pairings of contacts with edges leave, in so many `interpretations`."""

    state: CatalogueState
    interpretations: int


@dataclass(frozen=True, eq=False, repr=False)
class Recognition(ShortRepr):
    """All that is known after some contacts. `contacts` includes misses; `levels` counts per paired contact.

    At most `max_spurious` of the touched contacts are taken as spurious in any interpretation. `unpaired`:
    indices of touched contacts that are paired with no edges, because that would only have multiplied
    interpretations or spent the `budget`; every configuration has to satisfy them all the same. While some
    state that is left has rough walls, all but the first are.

    Hypotheses are worked out when they, or the verdict, are first asked for; `possible_states` needs no more
    than the `constraints`, whose interpretations the tree has left.
    """

    constraints: Constraints
    contacts: tuple[Contact, ...]
    levels: tuple[LevelCount, ...]
    max_spurious: int = 0
    unpaired: frozenset[int] = frozenset()

    @property
    def budget(self) -> Budget:
        """Limits of what is looked at."""
        return self.constraints.budget

    @property
    def catalogue(self) -> Catalogue:
        """The catalogue that was searched."""
        return self.constraints.catalogue

    @property
    def anchor_mm(self) -> Floats:
        """Point (2,) in W from which positions of cells are counted."""
        return self.constraints.anchor_mm

    @cached_property
    def possible_states(self) -> tuple[PossibleState, ...]:
        """States that may be the one that was touched, those with the most interpretations first.

        None that has a hypothesis is left out; free paths and the exact check may yet rule some out.
        """
        state, count = np.unique(self.constraints.nodes.state, return_counts=True)
        order = np.argsort(-count, kind="stable")
        states = self.catalogue.states
        return tuple(PossibleState(states[state[k]], int(count[k])) for k in order.tolist())

    @cached_property
    def _regions(self) -> Regions:
        step_rad = PAVED_RAD if self.constraints.is_paved else COARSE_RAD
        intervals = intervals_of(self.constraints.nodes, self.budget, step_rad)
        return connected_regions(self.constraints, intervals)

    @cached_property
    def hypotheses(self) -> Hypotheses:
        """Objects that may have been touched, and where; their bounds are worked out when they are read."""
        return hypotheses_of(self.constraints, self._regions)

    @cached_property
    def _left(self) -> tuple[Interpretations, Cells]:
        cells = self._regions.unturned
        return split_into_runs(self.constraints.nodes, cells.select(np.lexsort((cells.lo, cells.node))))

    @property
    def interpretations(self) -> Interpretations:
        """Interpretations that have cells left, narrowed to them."""
        return self._left[0]

    @property
    def cells(self) -> Cells:
        """Cells of the `interpretations`, in their order."""
        return self._left[1]

    @property
    def unpaired_contacts(self) -> tuple[Contact, ...]:
        """The contacts that are `unpaired` for want of budget."""
        return () if self.constraints.is_paved else self._unpaired_contacts

    @property
    def _unpaired_contacts(self) -> tuple[Contact, ...]:
        return tuple(self.contacts[number] for number in sorted(self.unpaired))

    @property
    def has_coarse_cells(self) -> bool:
        """True if cells, and so bounds, are wider than they would be with a larger budget."""
        if self.constraints.is_paved:
            return PARTS_PER_CELL * len(self.cells) > self.budget.paving
        return _step_rad(self.constraints.nodes, self.budget, COARSE_RAD) > COARSE_RAD

    @property
    def verdict(self) -> RecognitionVerdict:
        """Unique if one hypothesis is left, whatever its extent."""
        if not self.hypotheses:
            return RecognitionVerdict.NONE
        return RecognitionVerdict.UNIQUE if len(self.hypotheses) == 1 else RecognitionVerdict.AMBIGUOUS

    def extend(self, contacts: Sequence[Contact], motion: Motion | None = None) -> "Recognition":
        """The same with further contacts and misses; keeps only what survives them.

        `motion`: of the part since the last of the earlier contacts was measured; None if it lay still.
        """
        earlier = self.move(motion) if motion else self
        branches = branches_of(earlier.interpretations, earlier.cells)
        extended = earlier._with(contacts, branches, earlier.constraints.carried)
        return earlier._extend_anew(contacts) if extended._is_led_by_widened else extended

    def allows(self, contacts: Sequence[Contact]) -> bool:
        """Return whether further contacts can be paired with edges: far less work than to `extend`.

        Free paths and the exact check, which are left out, may yet rule them out.
        """
        branches = branches_of(self.interpretations, self.cells)
        return bool(len(self._with(contacts, branches, None).constraints.nodes))

    def move(self, motion: Motion) -> "Recognition":
        """All that is known after a motion of the part; its earlier contacts are widened by it.

        So is the region in which it was.
        """
        if not motion:
            return self
        cells = self.hypotheses.cells
        region = CarriedRegion.of(cells, motion.shift_mm[cells.state], motion.turn_rad[cells.state])
        states = np.unique(self.interpretations.state)
        carried = tuple(
            contact_after_motion(motion, self.catalogue, contact, states, self._distance_mm(contact))
            for contact in self.contacts
        )
        nodes = self.interpretations.turn(motion.turn_rad[self.interpretations.state])
        return replace(self, contacts=carried)._with((), branches_of(nodes, self.cells), region)

    @property
    def _is_led_by_widened(self) -> bool:
        """True if motions have widened the contacts with which the tree begins so much that others, which
        are narrow, could not be paired.
        """
        if self.max_spurious or not self.unpaired:
            return False
        root = self.constraints.touched[:TREE_LEVELS]
        widest = max(item.position_bound_mm for item in root)
        narrowest = min(item.position_bound_mm for item in self._unpaired_contacts)
        return any(item.turn_bound_rad for item in root) and widest > _WIDENED_FACTOR * narrowest

    def _extend_anew(self, new: Sequence[Contact]) -> "Recognition":
        """The same as `extend`, by a new tree of the states that are left: narrow contacts come first.

        It is clipped by the region that is known. Contacts are in another order.
        """
        cells = self.hypotheses.cells
        still = np.zeros(len(cells))
        known = CarriedRegion.of(cells, still, still)
        order = narrow_first((*self.contacts, *new))
        nodes, count = first_level(self.catalogue, order[0])
        left = nodes.select(np.flatnonzero(np.isin(nodes.state, cells.state)))
        first = _SearchState((order[0],), frozenset(), [Branch((0,), left)], (count,))
        region = None if known is None else known.on_all_branches(self.catalogue)
        return _search(self.constraints.paired, 0, first, order[1:], region)

    def _distance_mm(self, contact: Contact) -> Floats:
        """Largest distance of a contact from each state's centroid (S,); 0 for states that are ruled out."""
        point, reach = contact_in_object(self.cells, contact, self.anchor_mm)
        result = np.zeros(len(self.catalogue.states))
        np.maximum.at(result, self.cells.state, np.hypot(*point.T) + reach)
        return result

    def _with(
        self, contacts: Sequence[Contact], branches: list[Branch], region: CarriedRegion | None
    ) -> "Recognition":
        known = _SearchState(self.contacts, self.unpaired, branches, self.levels)
        return _search(self.constraints.paired, self.max_spurious, known, contacts, region)


def recognise(
    catalogue: Catalogue, contacts: Sequence[Contact], max_spurious: int = 0, budget: Budget = STANDARD_BUDGET
) -> Recognition:
    """Find every way to understand the contacts (misses included) as touches of one catalogued object.

    As many as `max_spurious` of the touched contacts may be spurious: nothing that they say need be true.
    With a smaller `budget` there are more hypotheses, with wider bounds; the truth is always among them.
    Raises InputError if none of the contacts touched anything, because misses alone bound no configuration,
    and unless 0 ≤ `max_spurious` < number of touched contacts.
    """
    touched = [contact for contact in contacts if contact.touched]
    if not touched:
        raise InputError("no finger touched anything: at least one contact is needed to place an object")
    if not 0 <= max_spurious < len(touched):
        raise InputError(
            f"max_spurious is {max_spurious}; with {len(touched)} touched contacts it must be from 0 to "
            f"{len(touched) - 1}, so that one at least is not spurious"
        )
    nothing = _SearchState((), frozenset(), [ROOT_BRANCH], ())
    return _search(Query(catalogue, touched, anchor_of(touched), budget), max_spurious, nothing, contacts)


def narrow_first(contacts: Sequence[Contact]) -> list[Contact]:
    """The contacts in the order in which a tree is smallest: those of narrow bounds first, misses last."""
    return sorted(contacts, key=lambda item: (not item.touched, item.position_bound_mm))


def anchor_of(touched: Sequence[Contact]) -> Floats:
    """The first contacts' middle (2,) in W: orientation and position are least entangled near the object."""
    anchor: Floats = np.mean([contact.end_mm for contact in touched[:TREE_LEVELS]], axis=0)
    return anchor


def intervals_of(
    nodes: Interpretations, budget: Budget = STANDARD_BUDGET, step_rad: float = COARSE_RAD
) -> Intervals:
    """Intervals in which interpretations are cut into cells: the fewer are left, the finer."""
    least = int(np.clip(_CELLS_IF_FEW // max(len(nodes), 1), 1, _MAX_CELLS_EACH))
    return divide_orientations(nodes, step_rad=_step_rad(nodes, budget, step_rad), least=least)


def _step_rad(nodes: Interpretations, budget: Budget, least_rad: float) -> float:
    """Width of cells: contacts that say little leave wide intervals, which get coarser cells."""
    return max(least_rad, float(np.sum(nodes.hi - nodes.lo)) / budget.cells)


@dataclass(frozen=True, eq=False)
class _SearchState:
    """State of a search; `unpaired` are indices of contacts, `levels` counts per touched contact."""

    contacts: tuple[Contact, ...]
    unpaired: frozenset[int]
    branches: list[Branch]
    levels: tuple[LevelCount, ...]

    @property
    def paired(self) -> list[Contact]:
        """Contacts that interpretations have columns for."""
        return [
            contact
            for number, contact in enumerate(self.contacts)
            if contact.touched and number not in self.unpaired
        ]

    def _is_rough(self, catalogue: Catalogue) -> bool:
        """Return whether one contact is paired, and some state that it leaves has rough walls."""
        if len(self.paired) != 1:
            return False
        rough = catalogue.edges(self.paired[0].finger).is_rough
        return any(bool(rough[branch.nodes.state].any()) for branch in self.branches)

    def evidence(self, max_spurious: int) -> list[Contact]:
        """Contacts that hold in every interpretation; unpaired ones need not, where some may be spurious."""
        return [
            contact
            for number, contact in enumerate(self.contacts)
            if not (max_spurious and number in self.unpaired)
        ]

    def with_contact(self, contact: Contact, query: Query, max_spurious: int) -> "_SearchState":
        """The same with one more contact: paired, unless it touched nothing or costs more than it says."""
        number, contacts = len(self.contacts), (*self.contacts, contact)
        if not contact.touched:
            return replace(self, contacts=contacts)
        if not max_spurious and self._is_rough(query.catalogue):
            return replace(self, contacts=contacts, unpaired=self.unpaired | {number})
        query = replace(query, contacts=[*self.paired, contact])
        try:
            branches, narrowed, count = grow_branches(query, self.branches, max_spurious)
        except BudgetSpentError:
            return replace(self, contacts=contacts, unpaired=self.unpaired | {number})
        before, after = _interpretations(self.branches), _interpretations(branches)
        worthwhile = max(query.budget.worthwhile, before)
        if len(query.contacts) > TREE_LEVELS and not max_spurious and after > worthwhile:
            unpaired = self.unpaired | {number}
            return replace(self, contacts=contacts, branches=narrowed, unpaired=unpaired)
        return replace(self, contacts=contacts, branches=branches, levels=(*self.levels, count))


def _interpretations(branches: Sequence[Branch]) -> int:
    return sum(len(branch.nodes) for branch in branches)


def _search(
    query: Query,
    max_spurious: int,
    known: _SearchState,
    new: Sequence[Contact],
    region: CarriedRegion | None = None,
) -> Recognition:
    """Pair every new contact in turn; hypotheses of what is left, in the `region`, are worked out later."""
    for contact in new:
        known = known.with_contact(contact, query, max_spurious)
    paired = replace(query, contacts=known.paired)
    evidence = replace(query, contacts=known.evidence(max_spurious))
    nodes = join_branches(known.branches, len(paired.contacts))
    constraints = Constraints(paired, nodes, evidence, region)
    return Recognition(constraints, known.contacts, known.levels, max_spurious, known.unpaired)
