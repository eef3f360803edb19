"""Recognition grip by grip on a rig: what its touches have shown so far, and the grip that comes next.

An identification in two steps, for programs that carry out or choose grips themselves. It is the search of
`identify` that decides and understands, so motions of the part and contradictions are dealt with alike.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, Self

from palpate.base.errors import InputError, quantity
from palpate.base.vocabulary import OWN_STRATEGY, IdentificationVerdict, Strategy
from palpate.config import RigFile
from palpate.recognizer import Catalogue, Contact, FingerApproach, Goals, Hypothesis, Recognition
from palpate.rig.identification.exploration import fast_to_workspace
from palpate.rig.identification.identify import begin_search, with_goals
from palpate.rig.identification.loop import OwnChoice, Search
from palpate.rig.identification.part_count import PartCount
from palpate.rig.identification.several_parts import SeveralSearch
from palpate.rig.motion.touch import Touch
from palpate.rig.reach.approaches import Reach, line_of, reach_of


class MadeGrip(tuple[Contact, ...]):
    """Contacts of a grip that a rig carried out, misses included, and the touches that they come from."""

    rig: RigFile
    approaches: tuple[FingerApproach, ...]
    touches: tuple[Touch, ...]

    @classmethod
    def of(cls, rig: RigFile, approaches: Sequence[FingerApproach], touches: Sequence[Touch]) -> Self:
        """A grip of these approaches on a rig."""
        made = cls(contact for touch in touches for contact in touch.evidence)
        made.rig, made.approaches, made.touches = rig, tuple(approaches), tuple(touches)
        return made

    def __repr__(self) -> str:
        met = sum(contact.touched for contact in self)
        return f"<MadeGrip {quantity(len(self.touches), 'touch', 'touches')}, {met} of {len(self)} met>"


@dataclass(frozen=True, eq=False)
class _Planned:
    """A plan for a goal, and the search that has made it: it understands these approaches, and no others."""

    goal: Goals | None
    search: Search | SeveralSearch
    approaches: tuple[FingerApproach, ...]
    verdict: IdentificationVerdict | None


class RigRecognition:
    """All that a rig's grips have shown of the part on its table, as `identify` understands them.

    Of several parts it has what every part's own touches show, by the likeliest way to divide them.
    A value: `extend` returns another one. Where the rig file or an object declares what force parts bear, the
    motion that grips may have caused is taken into account; if grips contradict one another, the part is
    taken to have moved, and only the later ones count.
    """

    def __init__(self, search: Search | SeveralSearch) -> None:
        """`ReadyRig.recognise` makes the first one."""
        self._search = search
        self._planned: _Planned | None = None

    @property
    def grips(self) -> tuple[MadeGrip, ...]:
        """Contacts of all grips, as `palpate.recognise` takes them."""
        return tuple(MadeGrip.of(self._search.rig, *made) for made in self._search.made_grips)

    @property
    def recognition(self) -> Recognition | None:
        """Hypotheses with all that computing needs, of the first part; None before enough was touched."""
        return next(iter(self.parts), None)

    @property
    def parts(self) -> tuple[Recognition, ...]:
        """The same of every part that was touched enough; numbers of parts may be others after each grip."""
        return self._search.recognitions

    @property
    def hypotheses(self) -> Sequence[Hypothesis]:
        """Hypotheses on the (first) part as it lies now, the largest weight first; none before enough was
        touched.
        """
        return () if self.recognition is None else self.recognition.hypotheses

    @property
    def verdict(self) -> IdentificationVerdict:
        """Verdict of `identify` if no further grip were made: `unresolved` while there is too little."""
        if self._planned is None:
            return self._search.copy().conclude().outcome
        return self._planned.search.copy().conclude(self._planned.verdict).outcome

    @property
    def goal_met(self) -> bool:
        """True if every hypothesis is placed as finely as the last plan's goal, or the rig file's, asks."""
        search = self._search if self._planned is None else self._planned.search
        known = search.recognitions
        return bool(known) and all(bool(item.hypotheses) and search.chooser.is_fine(item) for item in known)

    def extend(self, grip: MadeGrip) -> "RigRecognition":
        """The same with one more grip, misses included; InputError for contacts of no rig, or another's.

        Contacts from elsewhere are for `palpate.recognise(...).extend`, which takes parts to lie still.
        """
        if not isinstance(grip, MadeGrip):
            raise InputError(
                f"extend: grip is a {type(grip).__name__}; it must be the MadeGrip that rig.grip or "
                "rig.touch has returned, whole: a list of its contacts lacks what was measured; contacts "
                "from elsewhere go into palpate.recognise(objects, contacts).extend(more)"
            )
        if grip.rig != self._search.rig:
            raise InputError(f'extend: the grip is of rig "{grip.rig.name}" with other values in its file')
        planned = self._planned
        follows = planned is not None and planned.approaches == grip.approaches
        search = (planned.search if planned is not None and follows else self._search).copy()
        search.take(grip.approaches, grip.touches)
        return RigRecognition(search)

    def _plan(self, goal: Goals | None) -> tuple[FingerApproach, ...]:
        if self._planned is None or self._planned.goal != goal:
            search = self._search.with_chooser(with_goals(self._search.chooser, goal))
            verdict, approaches = None, tuple[FingerApproach, ...]()
            if search.limit(0.0) is None:
                verdict, approaches = search.next()
            self._planned = _Planned(goal, search, approaches, verdict)
        return self._planned.approaches

    def __repr__(self) -> str:
        after = quantity(len(self._search.made_grips), "grip", "grips")
        left = quantity(len(self.hypotheses), "hypothesis", "hypotheses")
        return f"<RigRecognition {self.verdict.value}: {left} after {after}>"


class GripPlanner:
    """Planner of a rig's grips: approaches within reach, and which of them come next."""

    def __init__(self, rig: RigFile, reach: Reach | None = None) -> None:
        """`reach`: the rig's, if it is known already."""
        self.file = rig
        self._known_reach = reach
        self._free_mm: dict[object, float] = {}  # by line: what the last plan has proven free

    @property
    def approaches(self) -> tuple[FingerApproach, ...]:
        """Every approach that a finger can make: straight lines into the workspace; `up_to` shortens one."""
        return self._reach.approaches

    @cached_property
    def _reach(self) -> Reach:
        return self._known_reach or reach_of(self.file)

    @cached_property
    def _longest_mm(self) -> dict[object, float]:
        return {line_of(item): item.travel_mm for item in self.approaches}

    def _begin(self, catalogue: Catalogue, count: PartCount) -> RigRecognition:
        """Recognition of parts of a catalogue before anything was touched."""
        single = begin_search(self.file, self._reach, catalogue)
        single.prepare()
        return RigRecognition(single if count.is_single else SeveralSearch(single, count))

    def plan(self, recognition: RigRecognition, goal: Goals | None = None) -> tuple[FingerApproach, ...]:
        """Plan the next grip as `identify` does; none if that would end now: `recognition.verdict` says how.

        Asked again, the answer is the same. `goal`: how finely to place the part; None: as the rig file's
        `[search]` says. `max_grips` of the rig file counts, `max_seconds` does not.
        """
        if not isinstance(recognition, RigRecognition):
            raise InputError(
                f"plan: recognition is {type(recognition).__name__}; it must be what this rig's recognise, "
                "or extend of that, has returned"
            )
        if goal is not None and not isinstance(goal, Goals):
            raise InputError(f"plan: goal is {goal!r}; it must be palpate.Goals(mm, rad), or None")
        planned = recognition._plan(goal)
        self._free_mm = {line_of(item): item.fast_mm for item in planned}
        return planned

    def check(self, approaches: Sequence[FingerApproach]) -> tuple[FingerApproach, ...]:
        """The approaches of one grip; InputError for such as the fingers cannot make, or not together."""
        asked = tuple(approaches) if isinstance(approaches, Iterable) else ()
        if not asked or not all(isinstance(item, FingerApproach) for item in asked):
            raise InputError("a grip is one approach or several, each of `approaches` or of a plan")
        if len({item.finger_index for item in asked}) < len(asked):
            raise InputError("a finger has two approaches in one grip; make two grips of them")
        if len({item.stage_rad for item in asked}) > 1:
            raise InputError("approaches of one grip are for different stage angles; make a grip of each")
        for item in asked:
            self._check_one(item)
        return asked

    def _check_one(self, item: FingerApproach) -> None:
        longest, name = self._longest_mm.get(line_of(item)), "of no finger"
        if 0 <= item.finger_index < len(self.file.fingers):
            name = f"of finger {self.file.fingers[item.finger_index].name}"
        if longest is None:
            raise InputError(f"an approach {name} is none of this rig's `approaches`, nor a part of one")
        if not 0 < item.travel_mm <= longest:
            raise InputError(
                f"an approach {name} goes {item.travel_mm:g} mm; it must be more than 0, and {longest:g} mm "
                "at most"
            )
        outside = fast_to_workspace(item, self.file.workspace.radius_mm).fast_mm
        free = min(max(outside, self._free_mm.get(line_of(item), 0.0)), item.travel_mm)
        if not 0 <= item.fast_mm <= free:
            raise InputError(
                f"an approach {name} is fast for {item.fast_mm:g} mm; {free:g} mm of its way are known to be "
                "free: outside of the workspace, or by the last plan"
            )
        fastest = self.file.closing.search_mm_s
        if item.touch_mm_s is not None and not 0 < item.touch_mm_s <= fastest:
            raise InputError(
                f"an approach {name} touches at {item.touch_mm_s:g} mm/s; it must be more than 0, and the "
                f"rig file's {fastest:g} mm/s at most"
            )

    def __repr__(self) -> str:
        return f"<{type(self).__name__} {self.file.name}: {len(self.approaches)} approaches>"


GripStrategy = Callable[[RigRecognition, GripPlanner], Sequence[FingerApproach] | None]
"""Strategy of one's own: the approaches of the next grip; None or nothing to make no further one."""


def name_strategy(strategy: Strategy | GripStrategy) -> Strategy | Literal["own"]:
    """Name of a strategy in results and logs: a function's is "own"."""
    return strategy if isinstance(strategy, Strategy) else OWN_STRATEGY


def own_choice(strategy: GripStrategy) -> OwnChoice:
    """Wrap a strategy of one's own for `identify`. Its approaches are checked as those of a grip are."""
    planners: list[GripPlanner] = []

    def choose(search: Search) -> Sequence[FingerApproach] | None:
        if not planners:
            planners.append(GripPlanner(search.rig, search.chooser.reach))
        found = strategy(RigRecognition(search.without_own_choice()), planners[0])
        return planners[0].check(found) if found else None

    return choose
