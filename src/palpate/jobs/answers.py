"""Answers of `Rig.identify`, `Rig.plan` and `recognise`: values, JSON, and a picture for notebooks."""

from collections.abc import Sequence
from dataclasses import dataclass

from palpate.base.errors import PalpateError, quantity
from palpate.base.vocabulary import IdentificationVerdict, RecognitionVerdict
from palpate.config import ObjectsFile
from palpate.config.recognition_results import AlternativeOut, GripOut, IdentificationOut
from palpate.config.result_model import BoundsOut, ConfigurationOut, to_json
from palpate.jobs.files import check_arguments
from palpate.recognizer import (
    Catalogue,
    Hypothesis,
    MemoCounts,
    ObjectExplanation,
    Recognition,
    explain_object,
)
from palpate.rig.catalogue.reachability import untouched_lines
from palpate.rig.identification.grip_choice import GripPlan
from palpate.rig.identification.result import IdentificationRun
from palpate.views.answer import answer_lines, picture_facts
from palpate.views.plan import grip_out, plan_picture
from palpate.views.recognition import identification_picture, recognition_out, recognition_picture
from palpate.views.recognition_text import (
    ContactRecord,
    Explanation,
    explain,
    explanation_lines,
    explanation_out,
    parse_state_name,
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
        placement = None if run.truth is None else run.truth.placement
        return identification_picture(run.result, placement, run.job.rig, picture_facts(self.result))

    def _repr_svg_(self) -> str:
        return self.picture()

    def __repr__(self) -> str:
        failed = [] if self.failure is None else [str(self.failure)]
        lines = [" ".join(line.split()) for line in answer_lines(self.result)[:4]]
        return f"<Answer {'; '.join([*lines, *failed])}>"


@dataclass(frozen=True, eq=False, repr=False)
class Plan:
    """The next grip for some contacts (`palpate/grip@1`), and what each hypothesis predicts of it."""

    planned: GripPlan
    contacts: ContactRecord
    catalogue: Catalogue
    title: str

    @property
    def result(self) -> GripOut:
        """The plan in the words of the JSON."""
        return grip_out(self.planned)

    @property
    def is_dead_end(self) -> bool:
        """True if no grip can lead to one answer: nothing fits, or no approach tells apart what is left."""
        return self.planned.is_dead_end

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

    @property
    def verdict(self) -> RecognitionVerdict:
        """Verdict: one hypothesis is left, several or none."""
        return self.recognition.verdict

    @property
    def hypotheses(self) -> Sequence[Hypothesis]:
        """Hypotheses that agree with the contacts, the largest weight first."""
        return self.recognition.hypotheses

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
