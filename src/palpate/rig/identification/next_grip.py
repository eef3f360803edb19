"""Choosing the next grip, or the verdict: the one rule of `palpate identify` and `palpate plan`."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from palpate.base.errors import InputError
from palpate.base.geometry import Bools
from palpate.base.vocabulary import IdentificationVerdict, RecognitionVerdict, Strategy
from palpate.base.vocabulary.short_repr import ShortRepr
from palpate.config import RigFile
from palpate.recognizer import (
    Budget,
    Catalogue,
    Confirmation,
    Contact,
    Finger,
    Grip,
    PushLimits,
    Recognition,
    Resolution,
    StrangerEvidence,
    already_used,
    checking_grip,
    next_grip,
    recognise,
    twins,
)
from palpate.rig.conversion import finger_of, goals_of, resolution_of
from palpate.rig.identification.grip_evidence import GripEvidence
from palpate.rig.identification.stability_table import StabilityTable
from palpate.rig.pads import refuse_pads
from palpate.rig.reach.approaches import Reach, reach_of

__all__ = ["Choice", "GripChooser", "Planned", "plan_for", "sets_alike"]

_IDLE_TOUCHES = 3  # as many without gain, and more will not help
_MOST_CHECKS = 2  # in a row: where they do not detect small shifts, further ones would not either
_VAIN = 0.15  # share of what is too coarse: a grip that leaves more of it is not worth its time


@dataclass(frozen=True, eq=False)
class Choice:
    """The grip to carry out next, or the verdict if there is none. `is_check`: it is to confirm an answer."""

    verdict: IdentificationVerdict | None
    grip: Grip | None = None
    is_check: bool = False


@dataclass(frozen=True, eq=False)
class GripChooser:
    """Chooses grips for a rig; of good ones, such as do not tip or roll parts.

    `rng` is used by the strategy `random` alone. `feels`: what touches resolve, None: as the rig file says.
    `tables`: stabilities that have been worked out before, by catalogue.
    """

    rig: RigFile
    reach: Reach
    strategy: Strategy
    rng: np.random.Generator
    feels: Resolution | None = None
    tables: dict[Catalogue, StabilityTable] = field(default_factory=dict)

    @cached_property
    def resolution(self) -> Resolution:
        """What touches resolve."""
        return self.feels or resolution_of(self.rig)

    def choose(self, evidence: GripEvidence, recognition: Recognition) -> Choice:
        """The next grip, or the verdict; `recognition` must have hypotheses."""
        answer = self.answer(recognition)
        settled = answer is not None and (self.is_fine(recognition) or evidence.idle >= _IDLE_TOUCHES)
        if settled and self.is_confirmed(evidence):
            return Choice(answer)
        grip = None if settled else self._plan(recognition, one_class=answer is not None)
        if grip is not None and not (answer is not None and self._is_vain(grip)):
            return Choice(None, grip)
        if self.is_confirmed(evidence):
            return Choice(answer or IdentificationVerdict.UNRESOLVED)
        grip = self._check(evidence, recognition)
        return Choice(IdentificationVerdict.UNRESOLVED if grip is None else None, grip, is_check=True)

    def reason(self, choice: Choice, evidence: GripEvidence, recognition: Recognition) -> str:
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
        """The verdict once it is confirmed: one hypothesis is left, or some that no approach tells apart."""
        if recognition.verdict is RecognitionVerdict.UNIQUE:
            return IdentificationVerdict.IDENTIFIED
        return IdentificationVerdict.INDISTINGUISHABLE if self.twins(recognition).all() else None

    def twins(self, recognition: Recognition) -> Bools:
        """Which hypotheses no approach that is left tells apart: (h, h)."""
        used = already_used(recognition.contacts, self.reach.approaches)
        return twins(recognition, self.reach, self.resolution, used)

    def is_fine(self, recognition: Recognition) -> bool:
        """Whether every hypothesis is placed as finely as the rig file's goals ask."""
        goals = goals_of(self.rig)
        return all(goals.met_by(item.search_bounds) for item in recognition.hypotheses)

    def is_confirmed(self, evidence: GripEvidence) -> bool:
        """Whether enough came out as predicted, and the last grip would have detected a shift of the part.

        On some parts no reachable touches detect it: then the checks that were made must do. Where it is
        declared what force parts bear, it is known how far touches shift them.
        """
        limits = self.rig.search
        steady = evidence.detectable_shift_mm <= limits.detectable_shift_mm or evidence.checks >= _MOST_CHECKS
        steady |= evidence.is_bounded
        strangers = evidence.strangers
        return steady and strangers is not None and strangers.probability <= limits.false_match_probability

    def _plan(self, recognition: Recognition, *, one_class: bool) -> Grip | None:
        # A grip that may be the last one has to meet the part from two sides.
        return next_grip(
            self.strategy,
            recognition,
            self.reach,
            self.resolution,
            goals_of(self.rig),
            self.rng,
            fingers=2 if one_class else 1,
            limits=self._limits(recognition),
        )

    def _is_vain(self, grip: Grip) -> bool:
        """Whether even the best grip would hardly place things more finely."""
        return self.strategy is Strategy.PLANNED and grip.remaining > _VAIN

    def _check(self, evidence: GripEvidence, recognition: Recognition) -> Grip | None:
        """Touches to confirm what seems to be the answer."""
        if self.strategy is Strategy.PLANNED:
            wanted = Confirmation(
                self.rig.search.detectable_shift_mm,
                evidence.strangers or StrangerEvidence.none(),
                self.rig.search.false_match_probability,
            )
            limits = self._limits(recognition)
            return checking_grip(recognition, self.reach, self.resolution, wanted, limits)
        return self._plan(recognition, one_class=True)

    def _limits(self, recognition: Recognition) -> PushLimits:
        """What pushes may do to the parts of the recognition's catalogue."""
        catalogue = recognition.catalogue
        if catalogue not in self.tables:
            self.tables[catalogue] = StabilityTable(self.rig, catalogue)
        return self.tables[catalogue]


@dataclass(frozen=True, eq=False, repr=False)
class Planned(ShortRepr):
    """What is left after some contacts, and the grip that comes next; None if there is none.

    `alike`: sets of hypotheses, by ascending index, of which no approach that is left tells any two apart.
    `fine`: every hypothesis is placed as finely as the rig file's goals ask. `verdict`: what `identify` would
    end with, None if it would carry out the grip.
    """

    rig: RigFile
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

    @property
    def hopeless(self) -> bool:
        """Whether several hypotheses are left, and nothing within reach tells any of them apart."""
        count = len(self.recognition.hypotheses)
        return count > 1 and any(len(group) == count for group in self.alike)

    @property
    def is_dead_end(self) -> bool:
        """Whether no grip can lead to one answer: nothing fits, or no approach tells apart what is left."""
        if self.recognition.verdict is RecognitionVerdict.NONE or self.hopeless:
            return True
        return self.grip is None and self.verdict is not IdentificationVerdict.IDENTIFIED


def plan_for(
    rig: RigFile, catalogue: Catalogue, grips: Sequence[Sequence[Contact]], strategy: Strategy, seed: int
) -> Planned:
    """Recognise the contacts of `grips`, misses included, and choose what `identify` would do next.

    Where `identify` would still explore, because too few touches were made, a grip is planned all the same.
    `seed` matters to `random` only. Raises InputError if no finger touched anything, one is not the rig's, or
    one has a pad.
    """
    refuse_pads(rig, "files of contacts do not say which of them are of one touch; use palpate identify")
    contacts = [contact for grip in grips for contact in grip]
    _check_fingers(rig, contacts)
    resolution = resolution_of(rig)
    budget = Budget(rig.search.budget)
    evidence = GripEvidence(catalogue, resolution, budget)
    for grip in grips:
        if evidence.recognition is None or evidence.recognition.hypotheses:
            evidence.add(grip)
    recognition = evidence.recognition or recognise(catalogue, contacts, budget=budget)
    if recognition.verdict is RecognitionVerdict.NONE:
        return Planned(rig, strategy, recognition, None, resolution, (), False)
    chooser = GripChooser(rig, reach_of(rig), strategy, np.random.default_rng([seed, 2]))
    choice = chooser.choose(evidence, recognition)
    alike = sets_alike(chooser.twins(recognition))
    fine = chooser.is_fine(recognition)
    return Planned(rig, strategy, recognition, choice.grip, resolution, alike, fine, choice.verdict)


def sets_alike(alike: Bools) -> tuple[tuple[int, ...], ...]:
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


def _check_fingers(rig: RigFile, contacts: Sequence[Contact]) -> None:
    """Refuse contacts that none of the rig's fingers can have felt: approaches used would not be known."""
    own = list(dict.fromkeys(finger_of(finger) for finger in rig.fingers))
    for contact in contacts:
        if contact.finger not in own:
            has = ", ".join(f"{item.tip_radius_mm:g} mm at {_height(item)}" for item in own)
            raise InputError(
                f"finger {contact.name} has a tip of radius {contact.finger.tip_radius_mm:g} mm at height "
                f'{_height(contact.finger)}; rig "{rig.name}" has none like it, only: {has}'
            )


def _height(finger: Finger) -> str:
    """Of a tip, and its length if it has one, or that it is a ball."""
    if finger.is_ball:
        return f"{finger.height_mm:g} mm, a ball"
    along = f" and {2 * finger.half_length_mm:g} mm long" if finger.half_length_mm else ""
    return f"{finger.height_mm:g} mm{along}"
