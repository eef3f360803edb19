"""Recognition and planning from contacts alone, and the answers of these and of identifications."""

import os
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from palpate import recognizer
from palpate.base.errors import InputError, PalpateError, quantity, warn_operator
from palpate.base.vocabulary import DEFAULT_BUDGET, IdentificationVerdict, RecognitionVerdict, Strategy
from palpate.config import ContactsFile, ObjectsFile, RigFile
from palpate.config.fields import BoundsOut, ConfigurationOut, to_json
from palpate.config.recognition_results import (
    AlternativeOut,
    GripOut,
    IdentificationOut,
    PartOut,
    UnknownStateOut,
)
from palpate.jobs.files import (
    ContactLists,
    ObjectsLike,
    PathLike,
    check_arguments,
    load_contacts,
    objects_from,
    select_known,
)
from palpate.recognizer import (
    Budget,
    Catalogue,
    Contact,
    Finger,
    FingerApproach,
    Hypothesis,
    MemoCounts,
    ObjectExplanation,
    Recognition,
    explain_object,
)
from palpate.rig.catalogue.finger_model import FingerAtHeight, HasHeight, fingers_of
from palpate.rig.catalogue.preparation import prepare_catalogue
from palpate.rig.catalogue.reachability import untouched_lines
from palpate.rig.conversion import grips_of
from palpate.rig.identification.grip_choice import GripPlan, grip_plan, tips_of
from palpate.rig.identification.result import IdentificationRun
from palpate.rig.motion.touch import Touch
from palpate.rig.reach.carrier import Carrier
from palpate.views.answer import answer_lines
from palpate.views.plan import grip_out, plan_picture
from palpate.views.recognition import (
    ContactRecord,
    Explanation,
    explain,
    explanation_lines,
    explanation_out,
    identification_picture,
    parse_state_name,
    recognition_out,
    recognition_picture,
    why_out,
)


@dataclass(frozen=True, eq=False, repr=False)
class Answer:
    """Answer of an identification (`palpate/identification@1`): which object, how it rests and where.

    Configuration and bounds map object coordinates to the support-plane frame W; mm and rad. `failure`: an
    output (session log, display) that failed after the run had completed; the answer is whole.
    """

    result: IdentificationOut
    run: IdentificationRun
    objects: ObjectsFile
    failure: PalpateError | None

    @property
    def verdict(self) -> IdentificationVerdict:
        """`identified`, `indistinguishable`, `unknown`, `unresolved` or `moving`."""
        return self.result.verdict

    @property
    def object(self) -> str | None:
        """Name of the object with the largest weight; None if no hypothesis is left."""
        return self.result.object

    @property
    def state(self) -> str | None:
        """Name of its stable state."""
        return self.result.state

    @property
    def configuration(self) -> ConfigurationOut | None:
        """x, y (mm) and theta (rad) of the object frame in W."""
        return self.result.configuration

    @property
    def bounds(self) -> BoundsOut | None:
        """Proven intervals of x, y (mm) and theta (rad)."""
        return self.result.bounds

    @property
    def alternatives(self) -> Sequence[AlternativeOut]:
        """Hypotheses that are left beside the first one."""
        return self.result.alternatives

    @property
    def parts(self) -> Sequence[PartOut]:
        """The parts that were found, where several were sought."""
        return self.result.parts

    @property
    def goal_met(self) -> bool | None:
        """True if `bounds` are as narrow as the rig file's goals; None without an answer."""
        return self.result.goal_met

    @property
    def grips(self) -> tuple[tuple[Contact, ...], ...]:
        """Contacts of each grip, misses included, as `recognise` takes them."""
        return tuple(tuple(c for touch in grip for c in touch.evidence) for grip in self.run.result.grips)

    @property
    def touches(self) -> tuple[Touch, ...]:
        """All touches in order, misses included, with what was measured."""
        return tuple(touch for grip in self.run.result.grips for touch in grip)

    @property
    def rig_seconds(self) -> float:
        """Duration by the rig's clock, which is virtual on an emulated one."""
        return self.result.rig_seconds

    @property
    def wall_seconds(self) -> float:
        """Duration by this computer's clock."""
        return self.result.wall_seconds

    @property
    def session(self) -> str | None:
        """Folder of the session log; None if none was kept."""
        return self.result.session

    def to_json(self) -> str:
        """`palpate/identification@1`."""
        return to_json(self.result)

    def text(self) -> str:
        """The answer in sentences, a line each."""
        advice = untouched_lines(self.run.job.rig, self.objects.objects)
        return "\n".join(answer_lines(self.result, advice))

    def picture(self) -> str:
        """SVG: the object found, contacts, approaches, and which grip eliminated what."""
        run = self.run
        placements = () if run.truth is None else run.truth.placements
        return identification_picture(run.result, placements, run.job.rig, self.result)

    def _repr_svg_(self) -> str:
        return self.picture()

    def __repr__(self) -> str:
        failed = [] if self.failure is None else [str(self.failure)]
        lines = [" ".join(line.split()) for line in answer_lines(self.result)[: 1 if self.parts else 4]]
        return f"<Answer {'; '.join([*lines, *failed])}>"


@dataclass(frozen=True, eq=False, repr=False)
class Plan:
    """The next grip for some contacts (`palpate/grip@1`), and what each hypothesis predicts of it."""

    planned: GripPlan
    contacts: ContactRecord
    catalogue: Catalogue
    title: str
    left_out: tuple[UnknownStateOut, ...] = ()

    @property
    def result(self) -> GripOut:
        """The plan in the words of the JSON."""
        return grip_out(self.planned).model_copy(update={"left_out": self.left_out})

    @property
    def is_dead_end(self) -> bool:
        """True if no grip can lead to one answer: nothing fits, or no approach tells apart what is left."""
        return self.planned.is_dead_end

    @property
    def verdict(self) -> IdentificationVerdict | None:
        """Verdict if no further grip is worth making; None: the grip comes first."""
        if self.planned.recognition.verdict is RecognitionVerdict.NONE:
            return IdentificationVerdict.UNKNOWN
        return self.planned.verdict

    @property
    def approaches(self) -> tuple[FingerApproach, ...]:
        """Approaches of the grip, each as far as it has to go; `fast_mm` of it are proven free."""
        return () if self.planned.grip is None else self.planned.grip.limited_approaches

    @property
    def hypotheses(self) -> Sequence[Hypothesis]:
        """Hypotheses that agree with the contacts, the largest weight first."""
        return self.planned.recognition.hypotheses

    def to_json(self) -> str:
        """`palpate/grip@1`."""
        return to_json(self.result)

    def picture(self) -> str:
        """SVG: hypotheses, contacts so far, the approaches and where each hypothesis predicts their stop."""
        return plan_picture(self.planned, self.contacts, self.title)

    def _repr_svg_(self) -> str:
        return self.picture()

    def __repr__(self) -> str:
        grip, count = self.planned.grip, len(self.planned.recognition.hypotheses)
        what = "no grip" if grip is None else quantity(len(grip.approaches), "approach", "approaches")
        decisive = ", decisive" if grip is not None and grip.decisive else ""
        return f"<Plan {what}{decisive}; {quantity(count, 'hypothesis', 'hypotheses')}>"


@dataclass(frozen=True, eq=False, repr=False)
class RecognitionAnswer:
    """Hypotheses that agree with some contacts (`palpate/recognition@1`)."""

    recognition: Recognition
    contacts: ContactRecord
    catalogue: Catalogue
    max_spurious: int
    seconds: float
    title: str
    left_out: tuple[UnknownStateOut, ...] = ()

    @property
    def verdict(self) -> RecognitionVerdict:
        """Verdict: one hypothesis is left, several or none."""
        return self.recognition.verdict

    @property
    def hypotheses(self) -> Sequence[Hypothesis]:
        """Hypotheses that agree with the contacts, the largest weight first."""
        return self.recognition.hypotheses

    @check_arguments
    def extend(self, contacts: Sequence[Contact]) -> "RecognitionAnswer":
        """The same with the contacts of one more grip, misses included; the part lay still.

        For grips that a rig has made: `extend` of what its `recognise` returns, which knows how parts move.
        """
        begin = time.perf_counter()
        extended = self.recognition.extend(contacts)
        _ = extended.hypotheses
        record = ContactRecord([*self.contacts.grips, contacts])
        seconds = time.perf_counter() - begin
        return replace(self, recognition=extended, contacts=record, seconds=seconds)

    def explanation(self) -> Explanation | None:
        """Why nothing agrees; None if something does."""
        if self.verdict is not RecognitionVerdict.NONE:
            return None
        return explain(self.catalogue, self.contacts, self.max_spurious)

    @check_arguments
    def why(self, name: str) -> ObjectExplanation:
        """Why an object, "object" or "object/state", is eliminated; InputError if there is none such."""
        return explain_object(self.catalogue, self.contacts.contacts, *parse_state_name(self.catalogue, name))

    def to_json(self, because: ObjectExplanation | None = None, memo: MemoCounts | None = None) -> str:
        """`palpate/recognition@1`, with why an object is eliminated and the memo's counts if given."""
        explanation = self.explanation()
        more = {
            "explanation": explanation and explanation_out(explanation, self.contacts),
            "why": because and why_out(because, self.contacts),
            "left_out": self.left_out,
        }
        return to_json(recognition_out(self.recognition, self.seconds, memo).model_copy(update=more))

    def picture(self) -> str:
        """SVG: the hypotheses and the contacts."""
        return recognition_picture(self.recognition, self.title)

    def _repr_svg_(self) -> str:
        return self.picture()

    def __repr__(self) -> str:
        names = ", ".join(dict.fromkeys(item.state.object_name for item in self.hypotheses[:5]))
        explanation = self.explanation()
        reasons = [] if explanation is None else explanation_lines(explanation, self.contacts)
        return f"<RecognitionAnswer {self.verdict.value}: {'; '.join([names, *reasons[:1]])}>"


Contacts = ContactsFile | PathLike | ContactLists
"""Contacts, misses included: from a file, or lists of them."""

_MANY_INTERPRETATIONS = 10_000  # interpretations that take noticeably long


@check_arguments
def recognise(
    objects: ObjectsLike | None,
    contacts: Contacts,
    *,
    max_spurious: int = 0,
    budget: int = DEFAULT_BUDGET,
    progress: Callable[[str], None] = lambda _: None,
) -> RecognitionAnswer:
    """Recognise: which objects, states and configurations agree with contacts.

    `objects`: None for the shipped ones. `max_spurious`: as many contacts need not be the object's.
    `budget`: units of work; with fewer there are more hypotheses, with wider bounds. `progress` is told of
    the preparation of a large catalogue, and of many ways to understand the contacts before the hypotheses
    are worked out. Raises InputError for files that are wrong, and if no state is known at
    the contacts' heights; those that are not are left out, with a warning.
    """
    models, given = objects_from(objects), contact_record(contacts)
    heights, name = fingers_of(given.contacts), _name(objects, "objects")
    models, left_out = select_known(models, heights, name, warn_operator)
    catalogue = prepare_catalogue(models.objects, _fingers_in(given), progress)
    begin = time.perf_counter()
    recognition = recognizer.recognise(catalogue, given.contacts, max_spurious, Budget(budget))
    count = len(recognition.constraints.nodes)
    if count > _MANY_INTERPRETATIONS:
        states = quantity(len(recognition.possible_states), "state", "states")
        progress(f"{states} left in {count} interpretations; working out hypotheses")
    _ = recognition.hypotheses
    seconds = time.perf_counter() - begin
    title = f"{_name(contacts, 'contacts')} in {name}"
    return RecognitionAnswer(recognition, given, catalogue, max_spurious, seconds, title, left_out)


@check_arguments
def plan(
    rig: RigFile | Carrier,
    objects: ObjectsLike | None,
    contacts: Contacts,
    *,
    strategy: Strategy | str = Strategy.PLANNED,
    seed: int = 0,
    progress: Callable[[str], None] = lambda _: None,
) -> Plan:
    """Plan: the grip of a rig that follows on contacts (memo §3.2), and what each hypothesis predicts of it.

    `rig`: a rig file, or what else moves a tip, a `Carrier`; its grips are single touches, so that every
    contact counts as a grip. With a rig file one list of contacts is one grip.
    `seed` draws the grip of the strategy `random`. `progress` is told of a large catalogue's preparation.
    States that are not known at the fingers' heights are left out, with a warning. Raises InputError for
    files that are wrong, if no state is left, if no finger touched anything, and for a grip of a rig in which
    a finger has two contacts.
    """
    models, given = objects_from(objects), _as_made(rig, contact_record(contacts))
    touching = [*_tips_of(rig), *fingers_of(given.contacts)]
    models, left_out = select_known(models, touching, _name(objects, "objects"), warn_operator)
    fingers = tips_of(rig) | _fingers_in(given)
    catalogue = prepare_catalogue(models.objects, fingers, progress)
    planned = grip_plan(rig, catalogue, given.grips, parse_strategy(strategy), seed)
    return Plan(planned, given, catalogue, f"{_name(contacts, 'contacts')} on rig {rig.name}", left_out)


def parse_strategy(name: Strategy | str) -> Strategy:
    """The strategy of this name; InputError for an unknown one."""
    if name not in list(Strategy):
        raise InputError(f'there is no strategy "{name}"; allowed: {", ".join(Strategy)}')
    return Strategy(name)


def contact_record(contacts: Contacts) -> ContactRecord:
    """Contacts as given or from their file, grip by grip; InputError if the file is wrong."""
    if isinstance(contacts, str | os.PathLike):
        contacts = load_contacts(contacts)
    if isinstance(contacts, ContactsFile):
        return ContactRecord(grips_of(contacts))
    alone = [item for item in contacts if isinstance(item, Contact)]
    return ContactRecord([alone] if alone else [item for item in contacts if not isinstance(item, Contact)])


def _as_made(rig: RigFile | Carrier, given: ContactRecord) -> ContactRecord:
    """Contacts in the grips in which they can have been made: confirmation counts by grips."""
    if isinstance(rig, Carrier):
        return ContactRecord([[contact] for contact in given.contacts])
    for grip in given.grips:
        names = [contact.name for contact in grip]
        twice = next((name for name in names if names.count(name) > 1), None)
        if twice is not None:
            raise InputError(
                f"plan: finger {twice} has two contacts in one grip; give a list of grips, each a list of "
                "contacts, as they were made"
            )
    return given


def _tips_of(rig: RigFile | Carrier) -> Sequence[HasHeight]:
    if isinstance(rig, RigFile):
        return rig.fingers
    return [FingerAtHeight(rig.name, item.height_mm, item.half_height_mm) for item in sorted(tips_of(rig))]


def _fingers_in(given: ContactRecord) -> set[Finger]:
    return {contact.finger for contact in given.contacts}


def _name(given: object, otherwise: str) -> str:
    return Path(given).name if isinstance(given, str | Path) else otherwise
