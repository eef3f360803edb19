"""The loop from an untouched table to a verdict: grip, recognise, plan, grip again.

Joins hand, recogniser and planner. It ends in every case: identified, indistinguishable (no reachable
approach separates what is left), unknown (nothing in the catalogue fits), or unresolved after the rig's
`max_grips`.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import Enum
from typing import Protocol

import numpy as np

from palpate.config import Search
from palpate.recognizer import (
    Catalogue,
    Grip,
    Hypothesis,
    Recognition,
    Verdict,
    plan_grip,
    recognise,
    separable,
)
from palpate.recognizer.arrays import Floats
from palpate.rig.closing import Stage, Touch, close_fingers
from palpate.rig.convert import resolution_of
from palpate.rig.hand import Hand
from palpate.rig.reach import Close, Reach, reach_of

__all__ = ["Identification", "Observer", "Outcome", "identify"]

_FIRST_CONTACTS = 3  # fewer leave too much for a plan to be worth its time
_USED_MM = 6.0  # exploring approaches keep this far from earlier ones of the same finger
_INWARD_MM = 6.0
_SPARE_MM = 5.0  # beyond the furthest predicted stop
_LEAST_GAIN = 0.1


class Outcome(Enum):
    """How a run on the bench ended (`palpate/identification@1`)."""

    IDENTIFIED = "identified"
    INDISTINGUISHABLE = "indistinguishable"
    UNKNOWN = "unknown"
    UNRESOLVED = "unresolved"


class Observer(Protocol):
    """Somebody who is told what happens, as it happens: progress display, session log."""

    def stage(self, grip: int, stage: Stage) -> None:
        """Fingers began something."""
        ...

    def touches(self, grip: int, touches: Sequence[Touch]) -> None:
        """A grip was carried out."""
        ...

    def recognised(self, grip: int, recognition: Recognition) -> None:
        """All contacts so far were understood."""
        ...

    def planned(self, grip: int, plan: Grip) -> None:
        """The next grip was chosen to tell hypotheses apart."""
        ...


@dataclass(frozen=True, eq=False)
class Identification:
    """What a run found. `grips` holds the touches of every grip; `ruled_out` what earlier grips allowed.

    `ruled_out` pairs each hypothesis with the number of the grip that ruled it out.
    """

    outcome: Outcome
    recognition: Recognition | None
    grips: tuple[tuple[Touch, ...], ...]
    ruled_out: tuple[tuple[int, Hypothesis], ...]

    @property
    def touches(self) -> int:
        """Approaches carried out, misses included."""
        return sum(len(grip) for grip in self.grips)


@dataclass
class _Search:
    """What the loop has gathered so far."""

    hand: Hand
    catalogue: Catalogue
    reach: Reach
    observers: Sequence[Observer]
    grips: list[tuple[Touch, ...]] = field(default_factory=list)
    used: list[int] = field(default_factory=list)
    recognition: Recognition | None = None
    before: Recognition | None = None
    ruled_out: list[tuple[int, Hypothesis]] = field(default_factory=list)


def identify(hand: Hand, catalogue: Catalogue, observers: Sequence[Observer] = ()) -> Identification:
    """Touch until there is one answer, as finely placed as the rig file's goals ask, or none to be had.

    Raises what `close_fingers` raises; the hand must be prepared.
    """
    search = _Search(hand, catalogue, reach_of(hand.rig), observers)
    outcome = Outcome.UNRESOLVED
    while len(search.grips) < hand.rig.search.max_grips:
        verdict, grip = _next(search)
        if verdict is not None:
            outcome = verdict
            break
        _carry_out(search, grip)
    else:
        outcome = _at_the_end(search)
    return Identification(outcome, search.recognition, tuple(search.grips), tuple(search.ruled_out))


def _next(search: _Search) -> tuple[Outcome | None, list[Close]]:
    """The verdict if there is one already, else the next grip."""
    recognition = search.recognition
    if recognition is None:
        return None, _explore(search)
    if recognition.verdict is Verdict.NONE:
        return Outcome.UNKNOWN, []
    rig = search.hand.rig
    fine = all(_is_fine(item, rig.search) for item in recognition.hypotheses)
    settled = fine or not _still_gains(search, recognition)
    if recognition.verdict is Verdict.UNIQUE and settled:
        return Outcome.IDENTIFIED, []
    if recognition.verdict is Verdict.AMBIGUOUS and settled and not _may_separate(search, recognition):
        return Outcome.INDISTINGUISHABLE, []
    plan = plan_grip(
        recognition, search.reach.candidates, search.reach.compatible, resolution_of(rig), search.used
    )
    if plan is None:
        return _at_the_end(search), []
    for observer in search.observers:
        observer.planned(len(search.grips) + 1, plan)
    return None, _closes(search, plan)


def _at_the_end(search: _Search) -> Outcome:
    """Verdict when no further grip is to be had."""
    recognition = search.recognition
    if recognition is None:
        return Outcome.UNRESOLVED
    if recognition.verdict is Verdict.AMBIGUOUS:
        return Outcome.UNRESOLVED if _may_separate(search, recognition) else Outcome.INDISTINGUISHABLE
    return Outcome.UNKNOWN if recognition.verdict is Verdict.NONE else Outcome.IDENTIFIED


def _may_separate(search: _Search, recognition: Recognition) -> bool:
    """Whether an approach that has not been carried out yet may tell hypotheses apart."""
    used = set(search.used)
    left = [item for index, item in enumerate(search.reach.candidates) if index not in used]
    return bool(left) and separable(recognition, left, resolution_of(search.hand.rig))


def _is_fine(hypothesis: Hypothesis, goals: Search) -> bool:
    return (
        hypothesis.bounds.position_half_mm <= goals.goal_position_mm
        and hypothesis.bounds.orientation_half_rad <= math.radians(goals.goal_orientation_deg)
    )


def _still_gains(search: _Search, recognition: Recognition) -> bool:
    """Whether the last grip ruled something out, or narrowed some bounds enough to make another worth it.

    Every touch is as blunt as the rig is: a small part's orientation may be out of reach of the goals.
    """
    before = search.before
    if before is None or len(recognition.hypotheses) < len(before.hypotheses):
        return True
    return any(
        new < (1 - _LEAST_GAIN) * old for old, new in zip(_extent(before), _extent(recognition), strict=True)
    )


def _extent(recognition: Recognition) -> tuple[float, float]:
    """Half-widths of all hypotheses' bounds, added up: position (mm) and orientation (rad)."""
    return (
        sum(item.bounds.position_half_mm for item in recognition.hypotheses),
        sum(item.bounds.orientation_half_rad for item in recognition.hypotheses),
    )


def _closes(search: _Search, plan: Grip) -> list[Close]:
    closes = []
    for candidate, predictions in zip(plan.candidates, plan.predictions, strict=True):
        index = search.reach.candidates.index(candidate)
        search.used.append(index)
        furthest = max(item.latest_mm for item in predictions)
        travel = min(candidate.approach.travel_mm, furthest + _SPARE_MM)
        closes.append(search.reach.close(index, travel))
    return closes


def _explore(search: _Search) -> list[Close]:
    """Aim every finger at the table's middle, or at what was felt so far, along lines not tried yet."""
    contacts = [touch.contact for grip in search.grips for touch in grip if touch.contact.touched]
    target = np.zeros(2)
    if contacts:
        inward = []
        for contact in contacts:
            normal = contact.normal
            angle = (normal.lo_rad + normal.hi_rad) / 2 if normal else contact.direction_rad + math.pi
            inward.append(
                np.array(contact.end_mm) - _INWARD_MM * np.array([math.cos(angle), math.sin(angle)])
            )
        target = np.mean(inward, axis=0)
    closes = []
    for finger_index in range(len(search.hand.fingers)):
        best = _nearest_unused(search, finger_index, target)
        if best is not None:
            search.used.append(best)
            candidate = search.reach.candidates[best]
            closes.append(search.reach.close(best, candidate.approach.travel_mm))
    return closes


def _nearest_unused(search: _Search, finger_index: int, target: Floats) -> int | None:
    """The finger's approach that passes nearest to the target and not too near to one it has taken."""
    own = search.reach.of_finger(finger_index, search.reach.middle_rad)
    taken = [_offset(search, k, target) for k in search.used if k in own]
    free = [k for k in own if all(abs(_offset(search, k, target) - offset) >= _USED_MM for offset in taken)]
    return min(free, key=lambda k: abs(_offset(search, k, target)), default=None)


def _offset(search: _Search, index: int, target: Floats) -> float:
    """Signed distance (mm) of the target from an approach's line."""
    approach = search.reach.candidates[index].approach
    x, y = target - np.asarray(approach.start_mm)
    return float(math.cos(approach.direction_rad) * y - math.sin(approach.direction_rad) * x)


def _carry_out(search: _Search, grip: Sequence[Close]) -> None:
    """Do the grip and understand what it felt."""
    number = len(search.grips) + 1

    def tell(stage: Stage) -> None:
        for observer in search.observers:
            observer.stage(number, stage)

    touches = tuple(close_fingers(search.hand, grip, tell))
    search.grips.append(touches)
    for observer in search.observers:
        observer.touches(number, touches)
    contacts = [touch.contact for touch in touches]
    if search.recognition is not None:
        search.before = search.recognition
        search.recognition = search.before.extend(contacts)
        search.ruled_out += [
            (number, item) for item in search.before.hypotheses if not _survives(item, search.recognition)
        ]
    else:
        every = [touch.contact for each in search.grips for touch in each]
        if sum(contact.touched for contact in every) < _FIRST_CONTACTS:
            return
        search.recognition = recognise(search.catalogue, every)
    for observer in search.observers:
        observer.recognised(number, search.recognition)


def _survives(hypothesis: Hypothesis, recognition: Recognition) -> bool:
    """Whether some part of a hypothesis's region is still among the hypotheses."""
    return any(
        item.state_index == hypothesis.state_index and _overlap(item, hypothesis)
        for item in recognition.hypotheses
    )


def _overlap(a: Hypothesis, b: Hypothesis) -> bool:
    turn = 2 * math.pi / a.state.symmetry_order
    lo, hi = a.bounds.theta_rad
    other_lo, other_hi = b.bounds.theta_rad
    apart = abs(((lo + hi) / 2 - (other_lo + other_hi) / 2 + turn / 2) % turn - turn / 2)
    if apart > (hi - lo + other_hi - other_lo) / 2:
        return False
    if a.state.symmetry_order > 1:
        return True
    return all(
        p[0] <= q[1] and q[0] <= p[1]
        for p, q in ((a.bounds.x_mm, b.bounds.x_mm), (a.bounds.y_mm, b.bounds.y_mm))
    )
