"""Search for several parts on one table: as `loop` does for one, over all divisions of the touches.

Touches are divided among as few parts as explain all of them; one more is taken to be there once none are
left, and all grips are divided again. Where as many parts were found as there are said to be, every division
has been looked at. The likeliest division leads: a part of it that has been touched is touched further until
it is told from all others, then what is missing is sought where it may still be, and then each part is placed
and confirmed. Fingers keep away from all parts but the one that they are to touch, by what is proven of
these. Nothing is concluded of a part unless every division that is left agrees.
"""

import math
from collections.abc import Sequence
from copy import copy
from dataclasses import replace

import numpy as np
import shapely

from palpate.base.geometry import Floats
from palpate.base.vocabulary import IdentificationVerdict, RunLimit
from palpate.config import RigFile
from palpate.recognizer import FREE_MARGIN_MM, FingerApproach, Recognition, predict
from palpate.rig.conversion import finger_of
from palpate.rig.identification.divisions import Division, GripDivider, PartSearch, TakenGrip
from palpate.rig.identification.events import Observers, PlanEvent, RecognitionEvent, TouchEvent
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
from palpate.rig.identification.loop import Search
from palpate.rig.identification.outcome import Identification, TableParts
from palpate.rig.identification.part_count import PartCount
from palpate.rig.motion.touch import Touch
from palpate.rig.reach.approaches import Reach

_LEAST_WAY_MM = 5.0  # a shorter approach meets nothing
_CIRCLE_TOLERANCE_MM = 0.1
_KEPT_APART_MM = 1.0  # fingers end so far before a part that they are not to touch


class SeveralSearch:
    """Search for several parts under way; used as `Search` is."""

    def __init__(self, single: Search, count: PartCount, observers: Observers | None = None) -> None:
        """`single`: a search for one part that has no grips yet."""
        self._count = count
        self._observers = observers or Observers()
        self._chooser: GripChooser = single.chooser
        self._reach: Reach = single.chooser.reach
        self._rig: RigFile = single.rig
        self._nothing = self._untouched = PartSearch(single, frozenset())
        self._fewest = 1  # parts that may explain all touches, as far as is known
        self._divisions = [Division(())]
        self._grips: list[tuple[Touch, ...]] = []
        self._made: list[Sequence[FingerApproach]] = []
        self._no_room = False  # beside the leading division's parts
        self._settled: dict[PartSearch, IdentificationVerdict | None] = {}  # no grip promises more of it
        self._discs = inscribed_discs(single.catalogue, {finger_of(item) for item in self._rig.fingers})

    def copy(self) -> "SeveralSearch":
        """A search that knows the same, and goes on by itself."""
        return self.with_chooser(self._chooser)

    def with_chooser(self, chooser: GripChooser) -> "SeveralSearch":
        """The same with other goals."""
        other = copy(self)
        every = {part for division in self._divisions for part in division.parts}
        every |= {self._nothing, self._untouched}
        own = {part: replace(part, search=part.search.with_chooser(chooser)) for part in every}
        other._chooser = chooser
        other._nothing, other._untouched = own[self._nothing], own[self._untouched]
        other._divisions = [Division(tuple(own[part] for part in item.parts)) for item in self._divisions]
        other._settled = {own[part]: verdict for part, verdict in self._settled.items() if part in own}
        other._grips, other._made = list(self._grips), list(self._made)
        return other

    @property
    def rig(self) -> RigFile:
        """The rig whose touches it understands."""
        return self._rig

    @property
    def chooser(self) -> GripChooser:
        """What chooses its grips."""
        return self._chooser

    @property
    def recognitions(self) -> tuple[Recognition, ...]:
        """All that is known of each part of the leading division as it lies now, if it was touched enough."""
        parts = self._divisions[0].parts if self._divisions else ()
        return tuple(known for part in parts if (known := part.recognition) is not None)

    @property
    def divisions(self) -> Sequence[Division]:
        """Divisions that nothing refutes, the leading one first."""
        return self._divisions

    @property
    def made_grips(self) -> Sequence[tuple[Sequence[FingerApproach], tuple[Touch, ...]]]:
        """Approaches and touches of every grip that was taken."""
        return list(zip(self._made, self._grips, strict=True))

    def prepare(self) -> None:
        """Work out what a touched part would have to wait for."""
        self._untouched.search.prepare()

    def limit(self, passed_s: float) -> RunLimit | None:
        """The rig's limit, for as many parts, that is reached after so many seconds."""
        limits = self._rig.search
        if len(self._grips) >= self._count.most * limits.max_grips:
            return RunLimit.MAX_GRIPS
        seconds = self._count.most * (limits.max_seconds or math.inf)
        return RunLimit.MAX_SECONDS if passed_s >= seconds else None

    def take(self, grip: Sequence[FingerApproach], touches: tuple[Touch, ...]) -> None:
        """Divide the touches of a grip that was carried out."""
        self._grips.append(touches)
        self._made.append(grip)
        self._observers(TouchEvent(len(self._grips), touches))
        self._settled, self._no_room = {}, False
        self._divide(grip, touches)
        while not self._divisions and self._fewest < self._count.most:
            self._fewest += 1
            self._divisions, self._untouched = [Division(())], self._nothing
            for made in self.made_grips:
                self._divide(*made)
        parts = self._divisions[0].parts if self._divisions else ()
        known = [item for part in parts if (item := part.search.evidence.recognition) is not None]
        if known:
            divisions = len(self._divisions)
            self._observers(RecognitionEvent(len(self._grips), known[0], tuple(known[1:]), divisions))

    def _divide(self, grip: Sequence[FingerApproach], touches: tuple[Touch, ...]) -> None:
        """Divide the touches of one more grip among the fewest parts that may explain all."""
        count = PartCount(self._fewest, self._count.exactly and self._fewest == self._count.most)
        found, self._untouched = GripDivider(TakenGrip(grip, touches, self._nothing.search.bounds)).divide(
            self._divisions, self._untouched, count
        )
        self._divisions = sorted(found, key=lambda item: -item.log_volume)

    def next(self) -> tuple[IdentificationVerdict | None, tuple[FingerApproach, ...]]:
        """The verdict if there is one already, else the next grip."""
        if not self._divisions:
            return IdentificationVerdict.UNKNOWN, ()
        for division in self._divisions:
            for job in (self._tell_apart, self._find, self._place):
                part, grip = job(division)
                if grip:
                    return None, self._bearable(part, grip)
        return self._verdict(), ()

    def _tell_apart(self, division: Division) -> tuple[PartSearch, Sequence[FingerApproach]]:
        """A grip on a part of which more than one answer is left."""
        for part in division.parts:
            known = part.recognition
            if known is None:
                grip = self._explore_near(division, part)
            elif self._chooser.answer(known) is None:
                grip = self._choose(division, part)
            else:
                continue
            if grip:
                return part, grip
        return self._untouched, ()

    def _place(self, division: Division) -> tuple[PartSearch, Sequence[FingerApproach]]:
        """A grip that places a part more finely, or confirms what it is."""
        for part in division.parts:
            grip = () if part.recognition is None else self._choose(division, part)
            if grip:
                return part, grip
        return self._untouched, ()

    def _find(self, division: Division) -> tuple[PartSearch, Sequence[FingerApproach]]:
        """A grip where a part that is missing may be."""
        if len(division.parts) >= self._count.most:
            return self._untouched, ()
        contacts = self._untouched.search.evidence.contacts
        reach = self._open_reach(division, None)
        if not contacts:
            return self._untouched, exploring_grip(reach, contacts)
        left = unswept_places(contacts, self._discs, self._rig.workspace.radius_mm)
        for span, disc in self._discs.items():
            for part in division.parts:
                room = part.room(span).buffer(max(disc.radius_mm, 0.0))
                left[span] = left[span].difference(room)
        no_room = is_swept(left, self._discs)
        if division is self._divisions[0]:
            self._no_room = no_room
        if no_room:
            return self._untouched, ()
        return self._untouched, sweeping_grip(reach, contacts, left, self._discs)

    def _explore_near(self, division: Division, part: PartSearch) -> Sequence[FingerApproach]:
        return exploring_grip(self._open_reach(division, part), part.search.evidence.contacts)

    def _choose(self, division: Division, part: PartSearch) -> Sequence[FingerApproach]:
        known = part.recognition
        assert known is not None, "a part that was told apart"
        chooser: GripChooser = replace(self._chooser, reach=self._open_reach(division, part))
        choice = chooser.choose(part.search.evidence, known)
        if choice.grip is None:
            self._settled[part] = choice.verdict
            return ()
        why = chooser.reason(choice, part.search.evidence, known)
        whose = f"for part {1 + division.parts.index(part)}: " if division is self._divisions[0] else ""
        self._observers(PlanEvent(len(self._grips) + 1, choice.grip, whose + why))
        part.search.evidence.checks += choice.is_check
        return choice.grip.limited_approaches

    def _open_reach(self, division: Division, focus: PartSearch | None) -> Reach:
        """All approaches, each ending before it may meet any part but the one that it is to touch."""
        free = np.array([item.travel_mm for item in self._reach.approaches])
        for part in division.parts:
            if part is not focus and part.recognition is not None and self._all_have(part):
                free = np.minimum(free, self._free_mm(part, self._reach.approaches) - _KEPT_APART_MM)
        rows = np.flatnonzero(free > _LEAST_WAY_MM)
        some = self._reach.only(rows)
        shorter = zip(some.approaches, free[rows].tolist(), strict=True)
        return replace(some, approaches=tuple(item.up_to(far) for item, far in shorter))

    def _free_mm(self, part: PartSearch, approaches: Sequence[FingerApproach]) -> Floats:
        """Travel (n,) that is proven free of a part."""
        known = part.recognition
        if known is None or not known.hypotheses:
            outside = [fast_to_workspace(item, self._rig.workspace.radius_mm) for item in approaches]
            return np.array([item.fast_mm for item in outside])
        found = predict(known.catalogue, known.hypotheses, known.anchor_mm, approaches)
        result: Floats = found.earliest.min(axis=1)
        return result

    def _bearable(self, part: PartSearch, grip: Sequence[FingerApproach]) -> tuple[FingerApproach, ...]:
        """The grip at speeds that parts bear, and fast only where no division has anything."""
        every = {id(item): item for division in self._divisions for item in division.parts}
        parts = list(every.values())
        if any(len(division.parts) < self._count.most for division in self._divisions):
            parts.append(self._untouched)
        free = np.min([self._free_mm(item, grip) for item in parts], axis=0) - FREE_MARGIN_MM
        outside = [fast_to_workspace(item, self._rig.workspace.radius_mm).fast_mm for item in grip]
        fast = np.maximum(np.maximum(free, 0.0), outside)
        speeds = [part.search.touch_mm_s(item) for item in grip]
        return tuple(
            replace(item, fast_mm=min(far, item.travel_mm), touch_mm_s=speed)
            for item, far, speed in zip(grip, fast.tolist(), speeds, strict=True)
        )

    def _is_complete(self, parts: Sequence[PartSearch]) -> bool:
        if self._count.exactly:
            return len(parts) == self._count.most
        return bool(parts) and (len(parts) == self._count.most or self._no_room)

    def _conclude(self, part: PartSearch) -> Identification:
        return part.search.copy().conclude(self._settled.get(part))

    def _all_have(self, part: PartSearch) -> bool:
        return all(any(other is part for other in item.parts) for item in self._divisions)

    def _verdict(self) -> IdentificationVerdict:
        """Verdict on the whole table: of the parts, the weakest."""
        if not self._divisions:
            return IdentificationVerdict.UNKNOWN
        leading = self._divisions[0]
        if not self._is_complete(leading.parts) or not all(map(self._all_have, leading.parts)):
            return IdentificationVerdict.UNRESOLVED
        verdicts = {self._conclude(part).outcome for part in leading.parts}
        if not all(item.is_answer for item in verdicts):
            return IdentificationVerdict.UNRESOLVED
        indistinguishable = IdentificationVerdict.INDISTINGUISHABLE
        return indistinguishable if indistinguishable in verdicts else IdentificationVerdict.IDENTIFIED

    def conclude(
        self, verdict: IdentificationVerdict | None = None, limit: RunLimit | None = None
    ) -> Identification:
        """The result, with the verdict that `next` gave, or the one that what is known allows."""
        parts = self._divisions[0].parts if self._divisions else ()
        found = tuple(map(self._conclude, parts))
        rest_mm, rest_z_mm = self._rest(parts)
        table = TableParts(
            found,
            tuple(map(self._all_have, parts)),
            len(self._divisions),
            self._is_complete(parts),
            rest_mm,
            rest_z_mm,
        )
        first = found[0] if found else self._untouched.search.copy().conclude()
        outcome = verdict or self._verdict()
        answered = outcome.is_answer
        fine = answered and all(item.goal_met for item in found)
        return replace(
            first,
            outcome=outcome,
            grips=tuple(self._grips),
            goal_met=fine if answered else None,
            limit=None if fine else limit,
            table=table,
        )

    def _rest(self, parts: Sequence[PartSearch]) -> tuple[float, tuple[float, float]]:
        """Radius (mm) of the largest circle that is left, and between which heights nothing else has room."""
        contacts = self._untouched.search.evidence.contacts
        points = {finger_of(item).span_mm: InscribedDisc(0.0, frozenset()) for item in self._rig.fingers}
        found = []
        for span, left in unswept_places(contacts, points, self._rig.workspace.radius_mm).items():
            free = left.difference(shapely.union_all([part.room(span) for part in parts]))
            circle = shapely.maximum_inscribed_circle(free, _CIRCLE_TOLERANCE_MM)
            found.append((float(shapely.length(circle)) + _CIRCLE_TOLERANCE_MM if free.area else 0.0, span))
        return min(found)
