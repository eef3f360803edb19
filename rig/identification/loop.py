"""The loop from an untouched table to a verdict: grip, recognise, choose the next grip, grip again.

Joins hand, recogniser and planner. It ends in every case: identified, indistinguishable (no reachable
approach separates what is left), unknown (nothing in the catalogue fits), or unresolved after the rig's
`max_grips`. An answer is only given after some touches that it foretold: bounds prove which of the
catalogue's objects it is, but not that it is one of these. If a grip contradicts the earlier ones, the part
may have been moved; the search then begins again with that grip.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial

import numpy as np

from palpate.config import RigFile
from palpate.recognizer import (
    Catalogue,
    Contact,
    FingerApproach,
    Grip,
    Hypothesis,
    Recognition,
    chance_of_agreeing,
    checking_grip,
    fits_something,
    next_grip,
    recognise,
    twins,
    used_by,
)
from palpate.rig.conversion import goals_of, resolution_of
from palpate.rig.identification.exploration import exploring_grip
from palpate.rig.identification.grip_evidence import extent_of, foretold_by, survives, unnoticed_mm
from palpate.rig.identification.observers import (
    MoveEvent,
    Observers,
    PlanEvent,
    RecognitionEvent,
    StageEvent,
    TouchEvent,
)
from palpate.rig.identification.unswept_space import Disc, discs_at, is_swept, places_left, sweeping_grip
from palpate.rig.motion.guarded_approach import GripPhase, Touch, carry_out_grip
from palpate.rig.motion.hand import Hand
from palpate.rig.reach.approaches import Reach, reach_of
from palpate.vocabulary import IdentificationVerdict, RecognitionVerdict, Strategy

__all__ = ["Carry", "Identification", "identify", "search"]

Carry = Callable[[Sequence[FingerApproach], Callable[[GripPhase], None]], Sequence[Touch]]
"""Carries out a grip and reports its stages."""

_FIRST_CONTACTS = 3  # fewer leave too much for a plan to be worth its time
_LEAST_GAIN = 0.1
_IDLE_TOUCHES = 3  # as many without gain, and more will not help
_MOST_MOVES = 1
_MOST_CHECKS = 2  # in a row: where they do not notice small shifts, further ones would not either
_VAIN = 0.15  # share of what is too coarse: a grip that leaves more of it is not worth its time


@dataclass(frozen=True, eq=False)
class Identification:
    """What a run found. `grips` holds the touches of every grip; `ruled_out` what earlier grips allowed.

    `ruled_out` pairs each hypothesis with the number of the grip that ruled it out. `moved_before`: grips
    (from 1) before which the part seems to have been moved. `foretold`: touches that came out as everything
    that is left had foretold. `unnoticed_mm`: a part shifted before the last grip by more would surely have
    been noticed. `swept`: nothing was touched (since a move), and no state that fingers can feel has room in
    the rest of the workspace.
    """

    outcome: IdentificationVerdict
    recognition: Recognition | None
    grips: tuple[tuple[Touch, ...], ...]
    ruled_out: tuple[tuple[int, Hypothesis], ...]
    moved_before: tuple[int, ...] = ()
    foretold: int = 0
    unnoticed_mm: float = math.inf
    swept: bool = False

    @property
    def touches(self) -> int:
        """Approaches carried out, misses included."""
        return sum(len(grip) for grip in self.grips)


@dataclass
class _Search:
    """What the loop has gathered so far; grips before `since` no longer count."""

    rig: RigFile
    reach: Reach
    carry: Carry
    catalogue: Catalogue
    strategy: Strategy
    rng: np.random.Generator
    observers: Observers
    grips: list[tuple[Touch, ...]] = field(default_factory=list)
    since: int = 0
    moved_before: list[int] = field(default_factory=list)
    recognition: Recognition | None = None
    ruled_out: list[tuple[int, Hypothesis]] = field(default_factory=list)
    idle: int = 0
    foretold: int = 0
    chance: float = 1.0
    unnoticed_mm: float = math.inf
    checks: int = 0
    swept: bool = False

    @cached_property
    def discs(self) -> dict[float, Disc]:
        """What fits into every state of the catalogue, at the fingers' heights."""
        return discs_at(self.catalogue, {finger.height_mm for finger in self.rig.fingers})

    @property
    def contacts(self) -> list[Contact]:
        """Everything that counts."""
        return [touch.contact for grip in self.grips[self.since :] for touch in grip]


def identify(
    hand: Hand,
    catalogue: Catalogue,
    observers: Observers | None = None,
    *,
    strategy: Strategy = Strategy.PLANNED,
    seed: int = 0,
) -> Identification:
    """Touch until there is one answer, as finely placed as the rig file's goals ask, or none to be had.

    `seed` decides what the strategy `random` draws. The hand must be prepared. Raises what `carry_out_grip`
    raises, and OutputError before a grip once an observer has raised.
    """
    reach, carry = reach_of(hand.rig), partial(carry_out_grip, hand)
    return search(hand.rig, reach, carry, catalogue, observers, strategy=strategy, seed=seed)


def search(
    rig: RigFile,
    reach: Reach,
    carry: Carry,
    catalogue: Catalogue,
    observers: Observers | None = None,
    *,
    strategy: Strategy = Strategy.PLANNED,
    seed: int = 0,
) -> Identification:
    """`identify` with whatever carries out grips."""
    rng = np.random.default_rng([seed, 2])
    return _searched(_Search(rig, reach, carry, catalogue, strategy, rng, observers or Observers()))


def _searched(state: _Search) -> Identification:
    outcome = IdentificationVerdict.UNRESOLVED
    while len(state.grips) < state.rig.search.max_grips:
        verdict, grip = _next(state)
        if verdict is not None:
            outcome = verdict
            break
        _carry_out(state, grip)
    else:
        outcome = _at_the_end(state)
    return Identification(
        outcome,
        state.recognition,
        tuple(state.grips),
        tuple(state.ruled_out),
        tuple(state.moved_before),
        state.foretold,
        state.unnoticed_mm,
        state.swept,
    )


def _next(state: _Search) -> tuple[IdentificationVerdict | None, Sequence[FingerApproach]]:
    """The verdict if there is one already, else the next grip."""
    if state.recognition is not None and state.recognition.verdict is RecognitionVerdict.NONE:
        if not _may_have_moved(state):
            return IdentificationVerdict.UNKNOWN, []
        _begin_again(state)
    recognition = state.recognition
    if recognition is None:
        grip = _explore(state)
        return None if grip else IdentificationVerdict.UNRESOLVED, grip
    answer = _answer(state, recognition)
    settled = answer is not None and _is_settled(state, recognition)
    if settled and _is_confirmed(state):
        return answer, []
    plan = None if settled else _plan(state, recognition, one_class=answer is not None)
    if plan is None or (answer is not None and _is_vain(state, plan)):
        if _is_confirmed(state):
            return answer or IdentificationVerdict.UNRESOLVED, []
        plan = _check(state, recognition)
        state.checks += 1
    if plan is None:
        return IdentificationVerdict.UNRESOLVED, []
    state.observers(PlanEvent(len(state.grips) + 1, plan))
    return None, plan.limited_approaches


def _explore(state: _Search) -> list[FingerApproach]:
    """A grip to find the part; none if it cannot be there, or no approach is left."""
    contacts = state.contacts
    if not contacts or any(contact.touched for contact in contacts):
        return exploring_grip(state.reach, contacts)
    left = places_left(contacts, state.discs, state.rig.workspace.radius_mm)
    state.swept = is_swept(left, state.discs)
    if state.swept:
        return []
    # Ways that free nothing may still meet a part that reaches far beyond its disc.
    return sweeping_grip(state.reach, contacts, left, state.discs) or exploring_grip(state.reach, contacts)


def _answer(state: _Search, recognition: Recognition) -> IdentificationVerdict | None:
    """What could be said if it is confirmed: one hypothesis is left, or some that nothing tells apart."""
    if recognition.verdict is RecognitionVerdict.UNIQUE:
        return IdentificationVerdict.IDENTIFIED
    used = used_by(recognition.contacts, state.reach.approaches)
    same = twins(recognition, state.reach, resolution_of(state.rig), used)
    return IdentificationVerdict.INDISTINGUISHABLE if same.all() else None


def _is_settled(state: _Search, recognition: Recognition) -> bool:
    """Whether everything that is left is placed finely enough, or the last touches did nothing for it."""
    goals = goals_of(state.rig)
    fine = all(goals.met_by(item.bounds) for item in recognition.hypotheses)
    return fine or state.idle >= _IDLE_TOUCHES


def _plan(state: _Search, recognition: Recognition, *, one_class: bool) -> Grip | None:
    # A grip that may be the last one has to meet the part from two sides.
    return next_grip(
        state.strategy,
        recognition,
        state.reach,
        resolution_of(state.rig),
        goals_of(state.rig),
        state.rng,
        fingers=2 if one_class else 1,
    )


def _is_vain(state: _Search, plan: Grip) -> bool:
    """Whether even the best plan would hardly place things more finely."""
    return state.strategy is Strategy.PLANNED and plan.remaining > _VAIN


def _check(state: _Search, recognition: Recognition) -> Grip | None:
    """Touches to confirm what seems to be the answer."""
    if state.strategy is Strategy.PLANNED:
        return checking_grip(
            recognition, state.reach, resolution_of(state.rig), state.rig.search.unnoticed_shift_mm
        )
    return _plan(state, recognition, one_class=True)


def _is_confirmed(state: _Search) -> bool:
    """Whether enough came out as foretold, and the last grip would have noticed a shift of the part.

    On some parts no reachable touches notice it: then the checks that were made must do.
    """
    limits = state.rig.search
    steady = state.unnoticed_mm <= limits.unnoticed_shift_mm or state.checks >= _MOST_CHECKS
    return steady and state.chance <= limits.stranger_chance


def _at_the_end(state: _Search) -> IdentificationVerdict:
    """Verdict when no further grip may be made."""
    recognition = state.recognition
    if recognition is None:
        return IdentificationVerdict.UNRESOLVED
    if recognition.verdict is RecognitionVerdict.NONE:
        return IdentificationVerdict.UNRESOLVED if _may_have_moved(state) else IdentificationVerdict.UNKNOWN
    answer = _answer(state, recognition)
    return answer if answer is not None and _is_confirmed(state) else IdentificationVerdict.UNRESOLVED


def _may_have_moved(state: _Search) -> bool:
    """Whether the last grip contradicts the earlier ones, but nothing speaks against it by itself."""
    if len(state.moved_before) >= _MOST_MOVES or len(state.grips) - state.since < 2:
        return False
    return fits_something(state.catalogue, [touch.contact for touch in state.grips[-1]])


def _begin_again(state: _Search) -> None:
    """Keep the last grip only."""
    number = len(state.grips)
    state.since = number - 1
    state.moved_before.append(number)
    state.recognition = None
    state.idle = state.foretold = 0
    state.checks = 0
    state.chance, state.unnoticed_mm = 1.0, math.inf
    state.observers(MoveEvent(number))
    _understand(state, [touch.contact for touch in state.grips[-1]])


def _carry_out(state: _Search, grip: Sequence[FingerApproach]) -> None:
    """Do the grip and understand what it felt."""
    number = len(state.grips) + 1

    def tell(stage: GripPhase) -> None:
        state.observers(StageEvent(number, stage))

    state.observers.check()
    touches = tuple(state.carry(grip, tell))
    state.grips.append(touches)
    state.observers(TouchEvent(number, touches))
    _understand(state, [touch.contact for touch in touches])


def _understand(state: _Search, contacts: Sequence[Contact]) -> None:
    before = state.recognition
    if before is None:
        if sum(contact.touched for contact in state.contacts) < _FIRST_CONTACTS:
            return
        state.recognition = recognise(state.catalogue, state.contacts)
    else:
        state.recognition = before.extend(contacts)
        _compare(state, before, state.recognition, contacts)
    state.observers(RecognitionEvent(len(state.grips), state.recognition))


def _compare(state: _Search, before: Recognition, after: Recognition, contacts: Sequence[Contact]) -> None:
    """Note what the last grip ruled out, and whether it was worth its touches."""
    number = len(state.grips)
    gone = [item for item in before.hypotheses if not survives(item, after)]
    state.ruled_out += [(number, item) for item in gone]
    fewer = len(after.hypotheses) < len(before.hypotheses)
    narrower = any(
        new < (1 - _LEAST_GAIN) * old for old, new in zip(extent_of(before), extent_of(after), strict=True)
    )
    state.idle = 0 if fewer or narrower else state.idle + len(contacts)
    state.foretold += sum(contact.touched for contact in contacts)
    foretold = foretold_by(before, contacts)
    state.chance *= chance_of_agreeing(foretold, contacts, resolution_of(state.rig).normal_half_rad)
    state.unnoticed_mm = math.inf if gone else unnoticed_mm(foretold, contacts)
    state.checks = 0 if gone else state.checks
