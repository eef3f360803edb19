"""Search loop from an untouched table to a verdict: grip, recognise, choose the next grip, grip again.

It connects hand, recogniser and planner, and always ends with a verdict: identified, indistinguishable (no
reachable approach separates what is left), unknown (nothing in the catalogue fits), moving (grips contradict
each other, again and again, and touches made again show that the part moved), or unresolved. It ends when
there is one answer, placed as finely as the rig's goals ask, as it lies now; when no reachable grip promises
to place it much more finely; or, between two grips, by the rig's `max_grips` or `max_seconds`. Before it says
that nothing fits it makes a few more grips, by which the set-up can be doubted (`doubt`). An answer is given
only after some touches have matched its predictions: bounds prove which of the catalogue's objects it is, but
not that it is in the catalogue. If a grip contradicts the earlier ones, touches are made again
(`contradiction`); the search then begins again with that grip, unless they show that nothing moved. If the
rig file or an object declares the force at which parts slide, the motion that fingers may have caused is
bounded and taken into account (`motion_bounds`). A rig that is known too inaccurately to tell parts apart is
refused beforehand.
"""

import math
from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import replace
from functools import cached_property

import numpy as np

from palpate.base.geometry import Ints
from palpate.base.vocabulary import (
    ContradictionCause,
    IdentificationVerdict,
    RecognitionVerdict,
    RunLimit,
)
from palpate.config import RigFile
from palpate.recognizer import (
    Budget,
    Catalogue,
    Contact,
    FingerApproach,
    Hypothesis,
    Motion,
    Recognition,
    contact_after_motion,
    contact_in_motion,
    is_explained,
)
from palpate.rig.conversion import finger_of
from palpate.rig.identification.contradiction import (
    Contradiction,
    ContradictoryGrips,
    RepeatedTouches,
    grip_to_repeat,
)
from palpate.rig.identification.events import (
    MoveEvent,
    Observers,
    PlanEvent,
    RecognitionEvent,
    TouchEvent,
)
from palpate.rig.identification.exploration import (
    InscribedDisc,
    exploring_grip,
    fast_to_workspace,
    inscribed_discs,
    is_swept,
    sweeping_grip,
    unswept_places,
)
from palpate.rig.identification.grip_choice import GripChooser
from palpate.rig.identification.grip_evidence import GripEvidence
from palpate.rig.identification.motion_bounds import GripLoads, GripMotion, MotionBounds
from palpate.rig.identification.outcome import Identification
from palpate.rig.motion.touch import Touch

OwnChoice = Callable[["Search"], Sequence[FingerApproach] | None]
"""Chooses the approaches of the next grip in place of a strategy; None if there is to be no further one."""

_MAX_MOVES = 1
_DOUBT_GRIPS, _MAX_DOUBTING_GRIPS = 4, 3  # that met something, by which the set-up is doubted; to get there
_LIGHTER_SPEED_SHARE = 0.5  # of the speed, once the part has moved, or while it may be in many states
_MANY_STATES = 50  # more are told apart only by contacts that motions have not widened by millimetres
_LONGEST_CREEP_S = 8.0
_MAX_CARRIED_MOTION_MM = 12.0  # a motion by more leaves nothing worth keeping of earlier contacts


class Search:
    """One identification under way; grips before the last move of the part count no longer.

    `next` and `take` in turn make an identification, whoever carries out the grips.
    """

    def __init__(
        self,
        chooser: GripChooser,
        catalogue: Catalogue,
        bounds: MotionBounds,
        observers: Observers | None = None,
        own: OwnChoice | None = None,
    ) -> None:
        self._chooser, self._observers, self._own = chooser, observers or Observers(), own
        self._rig, self._reach, self._catalogue = chooser.rig, chooser.reach, catalogue
        self._grips: list[tuple[Touch, ...]] = []
        self._made: list[Sequence[FingerApproach]] = []
        self._contradictions: list[Contradiction] = []
        self._moved_before: list[int] = []
        self._eliminated: list[tuple[int, Hypothesis]] = []
        self._swept = False
        self._evidence = self._no_evidence()
        self._bounds = bounds
        self._motions: list[GripMotion] = []
        self._hold_contradicted = False
        self._doubted: IdentificationVerdict | None = None
        self._understood = 0  # grips that hypotheses rest on
        self._repeated: int | None = None  # grip (index) whose touches are made again
        self._most_at_once = len(self._rig.fingers)  # that may touch the part in one grip
        self._doubting = 0  # grips by which the set-up is doubted
        self._refuted: Recognition | None = None  # the last of which nothing was left
        self._present: tuple[int, Recognition | None] = 0, None  # after so many grips

    def copy(self) -> "Search":
        """A search that knows the same, and goes on by itself."""
        other = copy(self)
        other._evidence = replace(self._evidence)
        for name in ("_grips", "_made", "_contradictions", "_moved_before", "_eliminated", "_motions"):
            setattr(other, name, list(getattr(self, name)))
        return other

    @property
    def rig(self) -> RigFile:
        """The rig whose touches it understands."""
        return self._rig

    @property
    def bounds(self) -> MotionBounds:
        """What bounds the motions of its grips."""
        return self._bounds

    @property
    def chooser(self) -> GripChooser:
        """What chooses its grips."""
        return self._chooser

    @property
    def catalogue(self) -> Catalogue:
        """The catalogue that is searched."""
        return self._catalogue

    @property
    def moved_before(self) -> Sequence[int]:
        """Grips (from 1) before which the part may have been moved by too much to carry contacts over."""
        return tuple(self._moved_before)

    @property
    def pushed_mm(self) -> float:
        """Distance by which the last grip has moved any point of the part at most; infinite: no bound."""
        return self._motions[-1].whole.furthest_mm(self._catalogue, self._states())

    @property
    def evidence(self) -> GripEvidence:
        """Evidence of the grips that count."""
        return self._evidence

    @property
    def made_grips(self) -> Sequence[tuple[Sequence[FingerApproach], tuple[Touch, ...]]]:
        """Approaches and touches of every grip that was taken."""
        return list(zip(self._made, self._grips, strict=True))

    @property
    def recognition(self) -> Recognition | None:
        """All that is known of the part as it lies now; None before enough was touched."""
        return self._present_recognition()

    @property
    def recognitions(self) -> tuple[Recognition, ...]:
        """The same of every part on the table: one at most."""
        return () if self.recognition is None else (self.recognition,)

    def with_chooser(self, chooser: GripChooser) -> "Search":
        """The same with other goals."""
        other = self.copy()
        other._chooser = chooser
        return other

    def without_own_choice(self) -> "Search":
        """The same, whose grips a strategy of palpate's chooses."""
        other = self.copy()
        other._own, other._observers = None, Observers()
        return other

    def prepare(self) -> None:
        """Work out what a touched part would have to wait for."""
        _ = self._bounds.supports

    def conclude(
        self, verdict: IdentificationVerdict | None = None, limit: RunLimit | None = None
    ) -> Identification:
        """The result, with the verdict that `next` gave, or the one that what is known allows."""
        verdict, recognition = verdict or self._last_verdict(), self._present_recognition()
        stranger, altered = self._evidence.stranger_probability, self._evidence.altered_probability
        if verdict is IdentificationVerdict.UNKNOWN and self._refuted is not None:
            recognition, stranger, altered = self._refuted, None, None
        answered = verdict.is_answer
        fine = recognition is not None and self._chooser.is_fine(recognition)
        states = self._states(recognition)
        assumed = self._bounds.holds_n(states)
        return Identification(
            verdict,
            recognition,
            tuple(self._grips),
            tuple(self._eliminated),
            tuple(self._moved_before),
            self._evidence.predicted,
            self._evidence.detectable_shift_mm,
            self._swept,
            () if assumed is None else tuple(item.within(states) for item in self._motions),
            assumed,
            self._hold_contradicted,
            stranger,
            fine if answered else None,
            None if answered and fine else limit,
            tuple(self._contradictions),
            altered,
            tuple(self._motions),
        )

    def limit(self, passed_s: float) -> RunLimit | None:
        """The rig's limit that is reached after so many seconds."""
        limits = self._rig.search
        if len(self._grips) >= limits.max_grips:
            return RunLimit.MAX_GRIPS
        return RunLimit.MAX_SECONDS if passed_s >= (limits.max_seconds or math.inf) else None

    def _no_evidence(self) -> GripEvidence:
        budget = Budget(self._rig.search.budget)
        return GripEvidence(self._catalogue, self._chooser.resolution, budget)

    def next(self) -> tuple[IdentificationVerdict | None, tuple[FingerApproach, ...]]:
        """The verdict if there is one already, else the next grip, with speeds that the part bears."""
        verdict, grip = self._next()
        if self._repeated is None:
            grip = grip[: self._most_at_once]
        most = [item.touch_mm_s if self._own else None for item in grip]
        speeds = [min(self.touch_mm_s(item), own or math.inf) for item, own in zip(grip, most, strict=True)]
        return verdict, tuple(replace(item, touch_mm_s=v) for item, v in zip(grip, speeds, strict=True))

    def _next(self) -> tuple[IdentificationVerdict | None, Sequence[FingerApproach]]:
        """The verdict if there is one already, else the next grip."""
        recognition = self._evidence.recognition
        if self._doubted is not None:
            return self._doubt(self._doubted)
        if recognition is not None and recognition.verdict is RecognitionVerdict.NONE:
            return self._resolve_contradiction()
        if self._moves_too_often:
            return self._doubt(self._moving())
        if self._own is not None:
            chosen = self._own(self)
            return (None, chosen) if chosen else (self._last_verdict(), ())
        return self._explore() if recognition is None else self._choose(recognition)

    def _choose(
        self, recognition: Recognition
    ) -> tuple[IdentificationVerdict | None, Sequence[FingerApproach]]:
        """The verdict on what is left, or the grip that tells most of it apart."""
        now = self._present_recognition() or recognition
        choice = self._chooser.choose(self._evidence, now)
        if choice.grip is None:
            return choice.verdict, ()
        self._evidence.checks += choice.is_check
        reason = self._chooser.reason(choice, self._evidence, now)
        self._observers(PlanEvent(len(self._grips) + 1, choice.grip, reason))
        return None, choice.grip.limited_approaches

    def _touches_again(self) -> list[FingerApproach]:
        """Approaches of an earlier grip, to be made again: nothing is taken to be where it was; none met."""
        begin = self._moved_before[-1] - 1 if self._moved_before else 0
        self._repeated = grip_to_repeat(self._grips[:-1], begin)
        again = () if self._repeated is None else self._made[self._repeated]
        return [fast_to_workspace(item, self._rig.workspace.radius_mm) for item in again]

    def _judge_contradiction(self) -> Contradiction:
        """What the touches made again, if any, say of the grip that contradicts the earlier ones."""
        found = Contradiction(self._understood)
        if self._repeated is not None:
            touches, number = (
                RepeatedTouches.of(self._grips[self._repeated], self._grips[-1]),
                len(self._grips),
            )
            last, again = self._contacts(self._understood), self._contacts(number)
            grips = ContradictoryGrips(self._catalogue, self._evidence.earlier, last, again)
            found = touches.contradiction(found.grip, number, grips)
        if ContradictionCause.MOVED in {item.cause for item in self._contradictions}:
            found = found.of_what_moves()
        self._contradictions.append(found)
        self._repeated = None
        return found

    def _resolve_contradiction(self) -> tuple[IdentificationVerdict | None, Sequence[FingerApproach]]:
        """Once nothing fits: touch again; then, unless nothing has moved, begin anew with the last grip."""
        self._refuted = self._evidence.recognition
        if self._repeated is None and not self._may_have_moved():
            return self._doubt(IdentificationVerdict.UNKNOWN)
        if self._moves_too_often:
            return self._doubt(self._moving())
        if self._repeated is None and (again := self._touches_again()):
            return None, again
        number = self._understood
        if self._judge_contradiction().cause is ContradictionCause.NOT_IN_CATALOGUE:
            return self._doubt(IdentificationVerdict.UNKNOWN)
        self._hold_contradicted |= self._bounds.holds_n(self._states()) is not None
        self._begin_again(number, None)
        for later in range(number + 1, len(self._grips) + 1):
            self._understand(later)
        return self._next()

    @property
    def _moves_too_often(self) -> bool:
        """True if it was moved again although fingers touched it one by one, where that was why."""
        one_by_one = len(self._rig.fingers) - self._most_at_once
        return len(self._moved_before) > _MAX_MOVES + one_by_one

    def _moving(self) -> IdentificationVerdict:
        """Verdict where grips contradict each other again: moving only if it is known to have moved."""
        far = len(self._moved_before) > len(self._contradictions)
        moved = far or any(item.cause is ContradictionCause.MOVED for item in self._contradictions)
        return IdentificationVerdict.MOVING if moved else IdentificationVerdict.UNKNOWN

    def _doubt(
        self, verdict: IdentificationVerdict
    ) -> tuple[IdentificationVerdict | None, Sequence[FingerApproach]]:
        """The verdict that nothing fits, once grips are enough to doubt the set-up by; else one more."""
        self._doubted = verdict
        again = {item.repeated_in for item in self._contradictions}
        grips = [grip for number, grip in enumerate(self._grips, start=1) if number not in again]
        met = [grip for grip in grips if any(touch.contact.touched for touch in grip)]
        grip: Sequence[FingerApproach] = ()
        if len(met) < _DOUBT_GRIPS and self._doubting < _MAX_DOUBTING_GRIPS:
            self._doubting += 1
            contacts = [touch.contact for touches in self._grips for touch in touches]
            radius = self._rig.workspace.radius_mm
            grip = [fast_to_workspace(item, radius) for item in exploring_grip(self._reach, contacts)]
        return None if grip else verdict, grip

    def _explore(self) -> tuple[IdentificationVerdict | None, Sequence[FingerApproach]]:
        """A grip to find the part; the verdict if it cannot be there, or no approach is left."""
        grip = [fast_to_workspace(item, self._rig.workspace.radius_mm) for item in self._finding_grip()]
        return None if grip else IdentificationVerdict.UNRESOLVED, grip

    def _finding_grip(self) -> list[FingerApproach]:
        contacts = self._evidence.contacts
        if not contacts or any(contact.touched for contact in contacts):
            return exploring_grip(self._reach, contacts)
        left = unswept_places(contacts, self._discs, self._rig.workspace.radius_mm)
        self._swept = is_swept(left, self._discs)
        if self._swept:
            return []
        # Ways that free nothing may still meet a part that reaches far beyond its disc.
        return sweeping_grip(self._reach, contacts, left, self._discs) or exploring_grip(
            self._reach, contacts
        )

    @cached_property
    def _discs(self) -> dict[tuple[float, float], InscribedDisc]:
        """Discs that fit into every state of the catalogue, beside the fingers' tips."""
        return inscribed_discs(self._catalogue, {finger_of(finger) for finger in self._rig.fingers})

    def _last_verdict(self) -> IdentificationVerdict:
        """Verdict when no further grip may be made."""
        recognition = self._evidence.recognition
        if self._doubted is not None:
            return self._doubted
        if recognition is None:
            return IdentificationVerdict.UNRESOLVED
        if recognition.verdict is RecognitionVerdict.NONE:
            if self._repeated is None and not self._may_have_moved():
                return IdentificationVerdict.UNKNOWN
            moved = self._judge_contradiction().cause is not ContradictionCause.NOT_IN_CATALOGUE
            return IdentificationVerdict.UNRESOLVED if moved else IdentificationVerdict.UNKNOWN
        if self._moves_too_often:
            return self._moving()
        answer = self._chooser.answer(recognition)
        confirmed = answer is not None and self._chooser.is_confirmed(self._evidence)
        return answer if answer is not None and confirmed else IdentificationVerdict.UNRESOLVED

    def _may_have_moved(self) -> bool:
        """Return whether the last grip contradicts earlier ones, but nothing speaks against it by itself."""
        last = self._contacts(self._understood)
        return len(self._evidence.contacts) > len(last) and is_explained(self._catalogue, last)

    def _begin_again(self, number: int, furthest_mm: float | None) -> None:
        """Keep a grip only, and touch more lightly from now on; the reason as `MoveEvent` has it."""
        self._moved_before.append(number)
        self._evidence = self._no_evidence()
        self._observers(MoveEvent(number, furthest_mm))
        self._add(number, None)

    def take(
        self,
        grip: Sequence[FingerApproach],
        touches: tuple[Touch, ...],
        loads: Sequence[GripLoads] | None = None,
    ) -> None:
        """Interpret the contacts of a grip that was carried out; `loads` as `MotionBounds.of_grip` has it."""
        number = len(self._grips) + 1
        self._grips.append(touches)
        self._made.append(grip)
        since = self._motions[-1].after if self._motions else None
        self._observers(TouchEvent(number, touches))
        known = self._evidence.recognition if self._doubted is None else None
        self._motions.append(self._bounds.of_grip(touches, known, since, loads))
        if self._doubted is None and self._repeated is None:
            self._understand(number)
        # Contacts of one grip are of the part as it lay then, so fewer fingers say less. Only a part that is
        # light in most of the states that are left gets fewer: together they may press too much unfelt.
        moved_mm = self._motions[-1].whole.displacements_mm(self._catalogue)[self._states()]
        if len(grip) > 1 and np.median(moved_mm) > _MAX_CARRIED_MOTION_MM:
            self._most_at_once = len(grip) - 1

    def may_have_met(self, contacts: Sequence[Contact], motion: GripMotion) -> bool:
        """Return whether contacts of the next grip may be of the part, which it moves by `motion` at most.

        Far less work than to take the grip, which may yet rule it out.
        """
        known, states = self._evidence.recognition, self._states()
        if known is None:
            return True
        moved = self._motions[-1].after + motion.before
        if not self._is_bounded(moved):
            return True
        # Seen from the part as it lay in the last grip: a motion back is as wide as the motion.
        measured = [contact_in_motion(motion.before, self._catalogue, item, states) for item in contacts]
        return known.allows([contact_after_motion(moved, self._catalogue, item, states) for item in measured])

    def touch_mm_s(self, approach: FingerApproach) -> float:
        """Speed at which an approach of the next grip may meet the part.

        As long as it may be several, intervals are wide, and there is no pose to spoil: none creeps long.
        Only among many states contacts tell too little if each grip moves the part far.
        """
        closing, lighter = self._rig.closing, _LIGHTER_SPEED_SHARE if self._moved_before else 1.0
        known, states = self._evidence.recognition, self._states()
        gentle = self._bounds.touch_mm_s(states) or closing.search_mm_s
        if known is None or known.verdict is RecognitionVerdict.AMBIGUOUS:
            share = _LIGHTER_SPEED_SHARE if len(states) > _MANY_STATES else 1.0
            quick = max(gentle, share * closing.search_mm_s)
            way_mm = approach.travel_mm - approach.fast_mm
            in_time = quick if known is None else way_mm / _LONGEST_CREEP_S
            gentle = min(max(gentle, in_time), quick)
        return lighter * gentle

    def _contacts(self, number: int) -> list[Contact]:
        """Contacts of a grip, of the part as it lay when they were measured."""
        grip = self._grips[number - 1]
        return self._in_motion(number, [contact for touch in grip for contact in touch.evidence])

    def _in_motion(self, number: int, contacts: Sequence[Contact]) -> list[Contact]:
        """Some contacts of a grip, of the part as it lay when they were measured."""
        before, states = self._motions[number - 1].before, self._states()
        return [contact_in_motion(before, self._catalogue, contact, states) for contact in contacts]

    def _understand(self, number: int) -> None:
        """Add the next grip to the evidence; alone, if there is no saying where the part was before."""
        self._understood = number
        moved = self._motions[number - 1].before
        if number > 1:
            moved = self._motions[number - 2].after + moved
        if self._is_bounded(moved) or not any(contact.touched for contact in self._evidence.contacts):
            self._add(number, moved)
        else:
            self._begin_again(number, moved.furthest_mm(self._catalogue, self._states()))

    def _add(self, number: int, motion: Motion | None) -> None:
        contacts = self._contacts(number)
        paths = self._in_motion(number, [touch.contact for touch in self._grips[number - 1]])
        self._eliminated += [(number, item) for item in self._evidence.add(contacts, motion, paths)]
        declared = self._bounds.holds_n(self._states()) is not None
        self._evidence.is_bounded = declared and not self._hold_contradicted
        if self._evidence.recognition is not None:
            self._observers(RecognitionEvent(number, self._evidence.recognition))

    def _states(self, recognition: Recognition | None = None) -> Ints:
        """States (indices) in which the part may be: those that are left, or all."""
        recognition = recognition or self._evidence.recognition
        if recognition is None or not recognition.hypotheses:
            return np.arange(len(self._catalogue.states))
        return np.unique(recognition.interpretations.state)

    def _is_bounded(self, motion: Motion) -> bool:
        return motion.furthest_mm(self._catalogue, self._states()) <= _MAX_CARRIED_MOTION_MM

    def _present_recognition(self) -> Recognition | None:
        """Recognition of the part as it lies when the fingers have left; None if it may be anywhere."""
        recognition, grips = self._evidence.recognition, len(self._motions)
        if recognition is None or not grips:
            return recognition
        if self._present[0] != grips:
            after = self._motions[self._understood - 1].after
            for motion in self._motions[self._understood :]:
                after += motion.whole
            self._present = grips, recognition.move(after) if self._is_bounded(after) else None
        return self._present[1]
