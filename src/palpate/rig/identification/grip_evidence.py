"""Evidence gathered grip by grip: hypotheses eliminated, bounds tightened, contacts as predicted,
smallest detectable shift.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from palpate.base.geometry import Floats
from palpate.base.vocabulary import RecognitionVerdict
from palpate.recognizer import (
    STANDARD_BUDGET,
    Approach,
    Budget,
    Catalogue,
    Contact,
    Hypothesis,
    Motion,
    Predictions,
    Recognition,
    Resolution,
    StrangerEvidence,
    contact_after_motion,
    detectable_shift_mm,
    narrow_first,
    predict,
    recognise,
    recognised_shift_mm,
    stranger_terms,
)

_MIN_CONTACTS = 3  # fewer leave too much for a plan to be worth its time
_MIN_GAIN_SHARE = 0.1
_PATH_EXTENSION_MM = 50.0  # than a finger got: it might have been stopped there


@dataclass
class GripEvidence:
    """Evidence of some grips, those before a move of the part left out.

    `contacts`: all of them, of the part as it lies now; `earlier`: those before the last grip.
    `recognition`: None before enough contacts were made. `idle`: grips in a row without gain. `predicted`:
    touches that came out as the hypotheses had predicted, and `strangers`: how probable that is if the part
    is none of the catalogue; None before `recognition`. `narrowest`: the least extent that the present
    hypotheses had.
    `detectable_shift_mm`: a shift of the part by more before the last grip would have been detected for
    certain. `is_bounded`: how far touches shift it is known. `checks`: grips in a row that were made to
    confirm an answer.
    """

    catalogue: Catalogue
    resolution: Resolution
    budget: Budget = STANDARD_BUDGET
    contacts: list[Contact] = field(default_factory=list)
    earlier: list[Contact] = field(default_factory=list)
    recognition: Recognition | None = None
    idle: int = 0
    predicted: int = 0
    strangers: StrangerEvidence | None = None
    detectable_shift_mm: float = math.inf
    is_bounded: bool = False
    checks: int = 0
    narrowest: tuple[float, float] | None = None

    def add(
        self,
        contacts: Sequence[Contact],
        motion: Motion | None = None,
        touches: Sequence[Contact] | None = None,
    ) -> list[Hypothesis]:
        """Take the contacts of a grip, misses included; returns the hypotheses that they eliminate.

        `motion`: of the part since the contacts before were measured; None if it lay still. `touches`: where
        the contacts are points of pads' faces, the pads' own, which count as predicted; None: the contacts.
        """
        before = self.recognition
        if before is not None:
            moved = before if motion is None else before.move(motion)
            self.earlier = list(moved.contacts)
            self.recognition = moved.extend(contacts)
            self.contacts = list(self.recognition.contacts)
            return self._compare(before, moved, self.recognition, contacts, touches or contacts)
        self.earlier, self.contacts = self.contacts, [*self.contacts, *contacts]
        if motion:
            states = np.arange(len(self.catalogue.states))
            self.earlier = [
                contact_after_motion(motion, self.catalogue, item, states) for item in self.earlier
            ]
            self.contacts = narrow_first([*self.earlier, *contacts])
        if sum(contact.touched for contact in self.contacts) >= _MIN_CONTACTS:
            self.recognition = recognise(self.catalogue, self.contacts, budget=self.budget)
            self.strangers = StrangerEvidence.none()
        return []

    def keep_judgement_of(self, before: "GripEvidence") -> None:
        """Judge as before the last grip, which did not touch the part, what grips on it have gained."""
        self.idle, self.checks = before.idle, before.checks
        self.detectable_shift_mm = before.detectable_shift_mm

    @property
    def is_refuted(self) -> bool:
        """True if no state of the catalogue fits the contacts."""
        if self.recognition is not None:
            return self.recognition.verdict is RecognitionVerdict.NONE
        touched = [contact for contact in self.contacts if contact.touched]
        # Of so few, pairings with edges say all that is worth its time.
        return len(touched) > 1 and not recognise(self.catalogue, touched, budget=self.budget).possible_states

    @property
    def stranger_probability(self) -> float | None:
        """Probability that something outside the catalogue which agreed with the first contacts would have
        agreed with all touches since; None where nothing is left to agree with.
        """
        if self.recognition is None or self.strangers is None or not self.recognition.hypotheses:
            return None
        return self.strangers.probability

    @property
    def altered_probability(self) -> float | None:
        """The same of something that differs less, such as a part of the catalogue but for one feature."""
        if self.stranger_probability is None or self.strangers is None:
            return None
        return self.strangers.altered_probability

    def _with_strangers(
        self, moved: Recognition, contacts: Sequence[Contact], predictions: Predictions
    ) -> StrangerEvidence | None:
        """Evidence with what is known of strangers once contacts have agreed."""
        if self.strangers is None or not moved.hypotheses:
            return self.strangers
        halves = normal_halves_rad(contacts, self.resolution.normal_half_rad)
        terms = stranger_terms(moved, paths_of(contacts), halves, predictions)
        return self.strangers.after(terms.with_any())

    def _compare(
        self,
        before: Recognition,
        moved: Recognition,
        after: Recognition,
        contacts: Sequence[Contact],
        touches: Sequence[Contact],
    ) -> list[Hypothesis]:
        """Note whether the last grip was worth its touches, and what it confirmed.

        `moved`: what was known before it, of the part as it lay when it was measured; `touches` as in `add`.
        """
        eliminated = [item for item in moved.hypotheses if not _survives(item, after)]
        fewer = len(after.hypotheses) < len(before.hypotheses)
        # What a part may have moved widens bounds again: gained is what was never as narrow.
        best, new = self.narrowest or _extent(before), _extent(after)
        narrower = any(now < (1 - _MIN_GAIN_SHARE) * least for least, now in zip(best, new, strict=True))
        self.narrowest = new if fewer else (min(best[0], new[0]), min(best[1], new[1]))
        self.idle = 0 if fewer or narrower else self.idle + 1
        self.predicted += sum(touch.touched for touch in touches)
        predictions = _predictions(moved, touches)
        self.strangers = self._with_strangers(moved, touches, predictions)
        if eliminated:
            self.detectable_shift_mm = math.inf
        elif not all(
            touch.finger.tip.measures_normal and (touch.normal is not None or not touch.touched)
            for touch in touches
        ):
            # Where along its face a pad is touched, and on what slope, only its points say; where a touch has
            # no normal, only all of them together.
            self.detectable_shift_mm = recognised_shift_mm(moved, contacts)
        else:
            self.detectable_shift_mm = _detectable_shift_mm(predictions, touches)
        self.checks = 0 if eliminated else self.checks
        return eliminated


def paths_of(contacts: Sequence[Contact]) -> list[Approach]:
    """The paths of contacts as they were measured, and further than they got."""
    return [
        Approach(
            contact.finger,
            contact.start_mm,
            contact.direction_rad,
            contact.travel_mm + _PATH_EXTENSION_MM,
            contact.free_path_bound_mm,
        )
        for contact in contacts
    ]


def _predictions(before: Recognition, contacts: Sequence[Contact]) -> Predictions:
    """Predictions of the contacts by the recognition before them."""
    return predict(before.catalogue, before.hypotheses, before.anchor_mm, paths_of(contacts))


def normal_halves_rad(contacts: Sequence[Contact], unknown_rad: float) -> Floats:
    """Halves (t,) of the contacts' normal ranges (rad); `unknown_rad` where a contact has none.

    Pads measure nothing of the surface's.
    """

    def half_rad(contact: Contact) -> float:
        if not contact.finger.tip.measures_normal:
            return math.pi
        item = contact.normal
        return unknown_rad if item is None else (item.hi_rad - item.lo_rad) / 2

    return np.array([half_rad(contact) for contact in contacts])


def _detectable_shift_mm(predictions: Predictions, contacts: Sequence[Contact]) -> float:
    """Distance by which the part may have been shifted before these contacts, which came out as predicted."""
    rows = [k for k, contact in enumerate(contacts) if contact.touched]
    some = [contacts[k] for k in rows]
    return detectable_shift_mm(
        predictions.select(rows),
        np.array([contact.middle_normal_rad for contact in some]),
        np.array([contact.direction_rad for contact in some]),
    )


def _extent(recognition: Recognition) -> tuple[float, float]:
    """Half-widths of all hypotheses' bounds, added up: position (mm) and orientation (rad)."""
    return (
        sum(item.search_bounds.position_half_mm for item in recognition.hypotheses),
        sum(item.search_bounds.orientation_half_rad for item in recognition.hypotheses),
    )


def _survives(hypothesis: Hypothesis, recognition: Recognition) -> bool:
    """Return whether some part of a hypothesis's region is still among the hypotheses."""
    return any(
        item.state_index == hypothesis.state_index and _overlap(item, hypothesis)
        for item in recognition.hypotheses
    )


def _overlap(a: Hypothesis, b: Hypothesis) -> bool:
    if a.state.state.is_round:
        return True
    turn = 2 * math.pi / a.state.symmetry.order
    lo, hi = a.search_bounds.theta_rad
    other_lo, other_hi = b.search_bounds.theta_rad
    apart = abs(((lo + hi) / 2 - (other_lo + other_hi) / 2 + turn / 2) % turn - turn / 2)
    if apart > (hi - lo + other_hi - other_lo) / 2:
        return False
    if a.state.symmetry.order > 1:
        return True
    return all(
        p[0] <= q[1] and q[0] <= p[1]
        for p, q in (
            (a.search_bounds.x_mm, b.search_bounds.x_mm),
            (a.search_bounds.y_mm, b.search_bounds.y_mm),
        )
    )
