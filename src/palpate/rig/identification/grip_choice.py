"""Choice of the next grip, or the verdict: one rule for `palpate identify` and `palpate plan`.

Of good grips such are preferred as do not tip or roll parts: a table of all states' stabilities against the
rig's fingers says which, and which states of an answer motion bounds do not cover.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Self

import numpy as np

from palpate.base.errors import InputError
from palpate.base.geometry import Bools, Floats, Ints
from palpate.base.short_repr import ShortRepr
from palpate.base.vocabulary import IdentificationVerdict, PushResponse, RecognitionVerdict, Strategy
from palpate.config import RigFile
from palpate.recognizer import (
    Budget,
    Catalogue,
    Confirmation,
    Contact,
    Finger,
    FingerApproach,
    Goals,
    Grip,
    PushLimits,
    Reachable,
    Recognition,
    Resolution,
    StrangerEvidence,
    confirmation_grip,
    extend_to_confirm,
    heuristic_grip,
    near_equal,
    plan_grip,
    recognise,
    twins,
    used_approaches,
)
from palpate.rig.contact_peak import expected_peak_n
from palpate.rig.conversion import finger_of, goals_of
from palpate.rig.fingers import resolution_of
from palpate.rig.identification.grip_evidence import GripEvidence
from palpate.rig.identification.motion_bounds import MotionBounds
from palpate.rig.identification.pushing_mechanics import (
    DIRECTION_COUNT,
    INERTIA_RESERVE,
    MAX_TABLE_FRICTION,
    Stability,
    stability_of,
)
from palpate.rig.reach.approaches import Reach, reach_of
from palpate.rig.reach.carrier import Carrier


@dataclass(frozen=True)
class NotBounded:
    """A state of an answer in which the part may have tipped or rolled, and why, in one line."""

    object_name: str
    state_name: str
    response: PushResponse
    why: str


@dataclass(frozen=True, eq=False)
class StabilityTable:
    """Stabilities of a catalogue's states on a rig, each computed when it is first asked for.

    `bounds`: those of the same run, whose supports are used; None: they are worked out again.
    """

    rig: RigFile
    catalogue: Catalogue
    bounds: MotionBounds | None = None

    def of(self, state: int) -> Stability:
        """Stability of the state of an index."""
        return self._of(state)[0]

    def safe_heights_mm(self, states: Ints) -> Floats:
        """As `palpate.recognizer.PushLimits` has it."""
        result: Floats = np.array([self._of(state)[1] for state in states.tolist()]).reshape(
            -1, DIRECTION_COUNT
        )
        return result

    def slide_shares(self, states: Ints) -> Floats:
        """As `palpate.recognizer.PushLimits` has it."""
        return self._slide_shares[states]

    def touch_mm_s(self, states: Ints) -> float:
        """As `palpate.recognizer.PushLimits` has it."""
        return self._bounds.touch_mm_s(states) or self.rig.closing.search_mm_s

    @cached_property
    def _bounds(self) -> MotionBounds:
        return self.bounds or MotionBounds(self.rig, self.catalogue)

    @cached_property
    def _slide_shares(self) -> Floats:
        supports = self._bounds.supports
        slide = expected_peak_n(self.rig, self.rig.closing.touch_speed_mm_s) / supports.holds_n
        return np.column_stack([slide, slide * supports.turn_rad_per_mm])

    def not_bounded(self, recognition: Recognition | None, pushed_n: float) -> tuple[NotBounded, ...]:
        """States that are left in which the part may have tipped or rolled, each once, the heaviest first.

        `pushed_n`: the largest force that fingers together have put on it.
        """
        found = []
        hypotheses = () if recognition is None else recognition.hypotheses
        for index in dict.fromkeys(item.state_index for item in hypotheses):
            item, stability = self.catalogue.states[index], self.of(index)
            if stability.response is not PushResponse.SLIDES and not self._is_upright(index, pushed_n):
                names = item.object_name, item.state.name
                found.append(NotBounded(*names, stability.response, stability.why))
        return tuple(found)

    def _is_upright(self, state: int, pushed_n: float) -> bool:
        """Return whether a state has not tipped: a part that holds F weighs F / μ at least."""
        stability, item = self.of(state), self.catalogue.states[state]
        holds = item.holds_n or self.rig.search.part_holds_n
        if holds is None or stability.response is PushResponse.MAY_ROLL:
            return False
        weight = holds / MAX_TABLE_FRICTION
        return pushed_n * stability.height_mm * INERTIA_RESERVE <= weight * stability.margin_mm

    @cached_property
    def _by_state(self) -> dict[int, tuple[Stability, Floats]]:
        return {}

    def _of(self, state: int) -> tuple[Stability, Floats]:
        if state not in self._by_state:
            item = self.catalogue.states[state]
            spans = [finger.span_mm for finger in self.rig.fingers]
            stability = stability_of(item.state, item.tolerance_mm, spans)
            self._by_state[state] = stability, stability.safe_heights_mm()
        return self._by_state[state]


@dataclass(frozen=True, eq=False)
class PushTables:
    """Tables of a rig and a catalogue: how pushes move its parts, and which may tip."""

    bounds: MotionBounds
    stability: StabilityTable

    @classmethod
    def of(cls, rig: RigFile, catalogue: Catalogue) -> Self:
        """Return tables, of which none is worked out before it is asked for."""
        bounds = MotionBounds(rig, catalogue)
        return cls(bounds, StabilityTable(rig, catalogue, bounds))


_MAX_IDLE_GRIPS = 2  # as many in a row without gain, and more will not help
_CHECKS, _CHECKS_IN_MOTION = 2, 3  # touches that confirm an answer, at least
_MAX_CHECKS = 2  # in a row: where they do not detect small shifts, further ones would not either
_VAIN_SHARE = 0.15  # share of what is too coarse: a grip that leaves more of it is not worth its time
_VAIN_SHARE_OF_ONE = 0.8  # of a carrier's single touches, each of which places things in one direction


@dataclass(frozen=True, eq=False)
class GripChoice:
    """The grip to carry out next, or the verdict if there is none. `is_check`: it is to confirm an answer."""

    verdict: IdentificationVerdict | None
    grip: Grip | None = None
    is_check: bool = False


def strategy_rng(seed: int) -> np.random.Generator:
    """Generator of what the strategy `random` draws."""
    return np.random.default_rng([seed, 2])


@dataclass(frozen=True, eq=False)
class CarrierChooser:
    """Chooses grips for a rig, or a carrier; of good ones, such as do not tip or roll parts.

    `rng` is used by the strategy `random` alone. `feels`: what touches resolve, None: as the rig says.
    `tables`: stabilities that have been worked out before, by catalogue.
    """

    rig: RigFile | Carrier
    reach: Reachable
    strategy: Strategy
    rng: np.random.Generator
    feels: Resolution | None = None
    tables: dict[Catalogue, StabilityTable] = field(default_factory=dict)

    @cached_property
    def resolution(self) -> Resolution:
        """Resolution of touches."""
        own = self.rig.resolution if isinstance(self.rig, Carrier) else resolution_of(self.rig)
        return self.feels or own

    @property
    def goals(self) -> Goals:
        """Bounds that are called fine enough."""
        return self.rig.goals if isinstance(self.rig, Carrier) else goals_of(self.rig)

    def choose(self, evidence: GripEvidence, recognition: Recognition) -> GripChoice:
        """The next grip, or the verdict; `recognition` must have hypotheses."""
        answer = self.answer(recognition)
        settled = answer is not None and (self.is_fine(recognition) or evidence.idle >= _MAX_IDLE_GRIPS)
        if settled and self.is_confirmed(evidence):
            return GripChoice(answer)
        grip = None if settled else self._plan(recognition, one_class=answer is not None)
        if grip is not None and answer is None:
            return GripChoice(None, grip)
        if grip is not None and not self._is_vain(grip):
            return GripChoice(None, self._with_confirmation(grip, evidence, recognition) or grip)
        if self.is_confirmed(evidence):
            return GripChoice(answer or IdentificationVerdict.UNRESOLVED)
        grip = self._check(evidence, recognition)
        if grip is not None:
            return GripChoice(None, grip, is_check=True)
        # Nothing within reach checks it again: the checks that were made must do.
        final = evidence.checks > 0 and self._is_no_stranger(evidence)
        return GripChoice((answer if final else None) or IdentificationVerdict.UNRESOLVED)

    def reason(self, choice: GripChoice, evidence: GripEvidence, recognition: Recognition) -> str:
        """Why a grip is made though hypotheses are left, in words."""
        limits = self.rig.search
        if not choice.is_check and self.answer(recognition) is None:
            return f"to tell {len(recognition.hypotheses)} hypotheses apart"
        if not choice.is_check:
            return f"to place it within {limits.goal_position_mm:g} mm and {limits.goal_orientation_deg:g}°"
        strangers = evidence.strangers
        if strangers is not None and strangers.probability > limits.false_match_probability:
            found, allowed = 100 * strangers.probability, 100 * limits.false_match_probability
            shown = f"{found:.0f}" if found >= 10 else f"{found:.2g}"
            return f"to confirm it: something else would match with {shown} %, limit {allowed:g} %"
        return f"to confirm it: a shift of {limits.detectable_shift_mm:g} mm could have gone unnoticed"

    def answer(self, recognition: Recognition) -> IdentificationVerdict | None:
        """The verdict once it is confirmed: one hypothesis is left, or some that need not be told apart.

        No approach can, or they are states of one object whose configurations agree within the goals.
        """
        if recognition.verdict is RecognitionVerdict.UNIQUE:
            return IdentificationVerdict.IDENTIFIED
        alike = near_equal(recognition.hypotheses, self.goals)
        if alike.all() or (alike | self.twins(recognition)).all():
            return IdentificationVerdict.INDISTINGUISHABLE
        return None

    def twins(self, recognition: Recognition) -> Bools:
        """Pairs of hypotheses that no approach that is left tells apart: (h, h)."""
        used = used_approaches(recognition.contacts, self.reach.approaches)
        return twins(recognition, self.reach, self.resolution, used)

    def is_fine(self, recognition: Recognition) -> bool:
        """Return whether every hypothesis is placed as finely as the rig file's goals ask."""
        return all(self.goals.are_met_by(item.search_bounds) for item in recognition.hypotheses)

    def is_confirmed(self, evidence: GripEvidence) -> bool:
        """Return whether enough came out as predicted, and the last grip would have detected a shift.

        On some parts no reachable touches detect it: then the checks that were made must do. Where it is
        declared what force parts bear, it is known how far touches shift them.
        """
        limits = self.rig.search
        steady = evidence.detectable_shift_mm <= limits.detectable_shift_mm or evidence.checks >= _MAX_CHECKS
        return (steady or evidence.is_bounded) and self._is_no_stranger(evidence)

    def _is_no_stranger(self, evidence: GripEvidence) -> bool:
        """Return whether something else would hardly have agreed with all touches."""
        strangers, most = evidence.strangers, self.rig.search.false_match_probability
        return strangers is not None and strangers.probability <= most

    def _plan(self, recognition: Recognition, *, one_class: bool) -> Grip | None:
        if self.strategy is not Strategy.PLANNED:
            return heuristic_grip(self.strategy, recognition, self.reach, self.resolution, self.rng)
        used = used_approaches(recognition.contacts, self.reach.approaches)
        # A grip that may be the last one has to meet the part from two sides.
        fingers, limits = 2 if one_class else 1, self._limits(recognition)
        return plan_grip(recognition, self.reach, self.resolution, self.goals, used, fingers, limits)

    def _is_vain(self, grip: Grip) -> bool:
        """Return whether even the best grip would hardly place things more finely."""
        most = _VAIN_SHARE_OF_ONE if isinstance(self.rig, Carrier) else _VAIN_SHARE
        return self.strategy is Strategy.PLANNED and grip.remaining > most

    def _check(self, evidence: GripEvidence, recognition: Recognition) -> Grip | None:
        """Touches to confirm what seems to be the answer."""
        if self.strategy is Strategy.PLANNED:
            wanted, limits = self._wanted(evidence), self._limits(recognition)
            return confirmation_grip(recognition, self.reach, self.resolution, wanted, limits)
        return self._plan(recognition, one_class=True)

    def _with_confirmation(self, grip: Grip, evidence: GripEvidence, recognition: Recognition) -> Grip | None:
        """A grip that places the answer, with what confirms it at the same time; None if nothing does."""
        if self.strategy is not Strategy.PLANNED or self.is_confirmed(evidence):
            return None
        wanted, limits = self._wanted(evidence), self._limits(recognition)
        return extend_to_confirm(grip, recognition, self.reach, self.resolution, wanted, limits)

    def _wanted(self, evidence: GripEvidence) -> Confirmation:
        """What touches must show before the answer is given.

        A grip moves the part: one more touch of it places the part more finely than it moves it.
        """
        return Confirmation(
            _CHECKS_IN_MOTION if evidence.is_bounded else _CHECKS,
            math.inf if evidence.is_bounded else self.rig.search.detectable_shift_mm,
            evidence.strangers or StrangerEvidence.none(),
            self.rig.search.false_match_probability,
        )

    def _limits(self, recognition: Recognition) -> PushLimits:
        """Limits of what pushes may do to the parts of the recognition's catalogue."""
        if isinstance(self.rig, Carrier):
            return self.rig
        catalogue = recognition.catalogue
        if catalogue not in self.tables:
            self.tables[catalogue] = StabilityTable(self.rig, catalogue)
        return self.tables[catalogue]


@dataclass(frozen=True, eq=False)
class GripChooser(CarrierChooser):
    """Chooses grips for a rig."""

    rig: RigFile
    reach: Reach


@dataclass(frozen=True, eq=False, repr=False)
class GripPlan(ShortRepr):
    """Plan after some contacts: what is left, and the grip that comes next; None if there is none.

    `alike`: sets of hypotheses, by ascending index, of which no approach that is left tells any two apart.
    `fine`: every hypothesis is placed as finely as the rig file's goals ask. `verdict`: what `identify` would
    end with, None if it would carry out the grip.
    """

    rig: RigFile | Carrier
    strategy: Strategy
    recognition: Recognition
    grip: Grip | None
    resolution: Resolution
    alike: tuple[tuple[int, ...], ...]
    fine: bool
    verdict: IdentificationVerdict | None = None

    @property
    def rows(self) -> tuple[int, ...]:
        """Rows of the grip's approaches in the order of the rig's fingers; none without a grip."""
        if self.grip is None:
            return ()
        fingers = [item.finger_index for item in self.grip.approaches]
        return tuple(sorted(range(len(fingers)), key=fingers.__getitem__))

    def finger_name(self, approach: FingerApproach) -> str:
        """Name of the finger that makes an approach; a carrier's own name."""
        return (
            self.rig.name if isinstance(self.rig, Carrier) else self.rig.fingers[approach.finger_index].name
        )

    @property
    def hopeless(self) -> bool:
        """True if several hypotheses are left, and nothing within reach tells any of them apart."""
        count = len(self.recognition.hypotheses)
        return count > 1 and any(len(group) == count for group in self.alike)

    @property
    def is_dead_end(self) -> bool:
        """True if no grip can lead to one answer: nothing fits, or no approach tells apart what is left."""
        if self.recognition.verdict is RecognitionVerdict.NONE or self.hopeless:
            return True
        return self.grip is None and self.verdict is not IdentificationVerdict.IDENTIFIED


def grip_plan(
    rig: RigFile | Carrier,
    catalogue: Catalogue,
    grips: Sequence[Sequence[Contact]],
    strategy: Strategy,
    seed: int,
) -> GripPlan:
    """Recognise the contacts of `grips`, misses included, and choose what `identify` would do next.

    Where `identify` would still explore, because too few touches were made, a grip is planned all the same.
    `seed` matters to `random` only. Raises InputError if no finger touched anything, one is not the rig's, or
    one has a pad.
    """
    if isinstance(rig, RigFile):
        rig.require("plan")
    contacts = [contact for grip in grips for contact in grip]
    _check_fingers(rig, contacts)
    reach = rig if isinstance(rig, Carrier) else reach_of(rig)
    chooser = CarrierChooser(rig, reach, strategy, strategy_rng(seed))
    resolution, budget = chooser.resolution, Budget(rig.search.budget)
    evidence = GripEvidence(catalogue, resolution, budget, is_bounded=isinstance(rig, Carrier))
    for grip in grips:
        if evidence.recognition is None or evidence.recognition.hypotheses:
            evidence.add(grip)
    recognition = evidence.recognition or recognise(catalogue, contacts, budget=budget)
    if recognition.verdict is RecognitionVerdict.NONE:
        return GripPlan(rig, strategy, recognition, None, resolution, (), False)
    choice = chooser.choose(evidence, recognition)
    alike = indistinguishable_sets(chooser.twins(recognition))
    fine = chooser.is_fine(recognition)
    return GripPlan(rig, strategy, recognition, choice.grip, resolution, alike, fine, choice.verdict)


def indistinguishable_sets(alike: Bools) -> tuple[tuple[int, ...], ...]:
    """Sets, of two at least, in which any two are alike: (h, h), symmetric. Every such pair is in one.

    Being alike to within what can be felt is not transitive, so sets may overlap.
    """
    open_pairs = np.triu(alike, 1)
    found = []
    while open_pairs.any():
        first, second = divmod(int(np.argmax(open_pairs)), len(alike))
        group = [first, second]
        fits = alike[first] & alike[second]
        fits[group] = False
        while fits.any():
            group.append(int(np.argmax(fits)))
            fits = fits & alike[group[-1]]
            fits[group] = False
        open_pairs[np.ix_(group, group)] = False
        found.append(tuple(sorted(group)))
    return tuple(found)


def _check_fingers(rig: RigFile | Carrier, contacts: Sequence[Contact]) -> None:
    """Refuse contacts that none of the rig's fingers can have felt: approaches used would not be known."""
    own = sorted(tips_of(rig))
    for contact in contacts:
        if contact.finger not in own:
            raise InputError(
                f"finger {contact.name} has {_tip_text(contact.finger)}; "
                f'rig "{rig.name}" has none like it, only: {", ".join(map(_tip_text, own))}'
            )


def tips_of(rig: RigFile | Carrier) -> set[Finger]:
    """Kinds of fingers that a rig or a carrier has."""
    if isinstance(rig, Carrier):
        return {item.finger for item in rig.approaches}
    return {finger_of(finger) for finger in rig.fingers}


def _tip_text(finger: Finger) -> str:
    """Shape, size, length and height of a tip, in words."""
    tip, long = finger.tip, f", {2 * finger.half_length_mm:g} mm long," if finger.half_length_mm else ""
    return f"{tip.with_article} {tip.size_text(finger.tip_radius_mm)}{long} at height {finger.height_mm:g} mm"
