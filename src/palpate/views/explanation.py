"""Explanations in words and as JSON: why no object fits a file of contacts, or why one does not."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from palpate.base.errors import InputError
from palpate.base.vocabulary.short_repr import ShortRepr
from palpate.config.problems import nearest, shown
from palpate.config.recognition_result import ExplanationOut, FeltOut, StepOut, WhyOut
from palpate.recognizer import Catalogue, Contact
from palpate.recognizer.explanation import (
    ObjectExplanation,
    SearchTest,
    grips_before_move,
    suspected_contacts,
)
from palpate.views.recognition import hypothesis_out

__all__ = [
    "ContactRecord",
    "Explanation",
    "explain",
    "explanation_lines",
    "explanation_out",
    "state_named",
    "why_lines",
    "why_out",
]

_TESTS: Mapping[SearchTest, str] = {
    SearchTest.EDGES: "{new}: edges it may lie on",
    SearchTest.NORMAL: "{new}: its normal",
    SearchTest.DISTANCE: "{new}: its distance to {others}",
    SearchTest.TWO: "{new}: its position, given {others}",
    SearchTest.THREE: "{new}: its position, given {others}",
    SearchTest.REGION: "the positions of all contacts together",
    SearchTest.PATH: "{new}: its free path",
    SearchTest.FINER: "everything together, more finely",
}
_CAUSES: Mapping[SearchTest, str] = {
    SearchTest.EDGES: "by the height and the normal of {all}",
    SearchTest.NORMAL: "by the normal of {all}",
    SearchTest.DISTANCE: "by the distance between {all}",
    SearchTest.TWO: "by the positions of {all} together",
    SearchTest.THREE: "by the positions of {all} together",
    SearchTest.REGION: "by the positions of {all} together",
    SearchTest.PATH: "by the free path of {all}",
    SearchTest.FINER: "by {all} together",
}


@dataclass(frozen=True, eq=False, repr=False)
class ContactRecord(ShortRepr):
    """The contacts of a file, grip by grip; says which of them a contact (the same object) is."""

    grips: Sequence[Sequence[Contact]]

    @property
    def contacts(self) -> list[Contact]:
        """All of them in order, misses included."""
        return [contact for grip in self.grips for contact in grip]

    def out(self, contact: Contact) -> FeltOut:
        """The contact as a JSON value."""
        return FeltOut(grip=self._grip(contact), finger=contact.name, touched=contact.touched)

    def words(self, contact: Contact) -> str:
        """The contact's name for people, who count grips from 1."""
        of_grip = f" of grip {self._grip(contact) + 1}" if len(self.grips) > 1 else ""
        return f"{'' if contact.touched else 'the miss of '}{contact.name}{of_grip}"

    def listed(self, contacts: Sequence[Contact]) -> str:
        """Several contacts in words."""
        names = [self.words(contact) for contact in contacts]
        return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"

    def _grip(self, contact: Contact) -> int:
        return next(k for k, grip in enumerate(self.grips) if any(other is contact for other in grip))


@dataclass(frozen=True, repr=False)
class Explanation(ShortRepr):
    """What may be the matter when nothing fits: see `grips_before_move` and `suspected_contacts`."""

    moved_after_grip: int | None
    spurious: tuple[Contact, ...]
    max_spurious: int


def explain(catalogue: Catalogue, record: ContactRecord, max_spurious: int) -> Explanation:
    """Look for an explanation of the verdict none, given with `max_spurious` contacts left out."""
    return Explanation(
        grips_before_move(catalogue, record.grips, max_spurious),
        suspected_contacts(catalogue, record.contacts, max_spurious),
        max_spurious,
    )


def explanation_lines(explanation: Explanation, record: ContactRecord) -> list[str]:
    """The verdict none, for people."""
    lines = ["nothing in the catalogue fits all contacts"]
    if explanation.max_spurious:
        lines = [f"nothing in the catalogue fits all contacts but {explanation.max_spurious}"]
    if explanation.moved_after_grip is not None:
        lines.append(
            f"each grip alone fits: the object may have moved after grip {explanation.moved_after_grip}"
        )
    more = explanation.max_spurious + 1
    lines += [
        f"without contact {record.words(contact)} something fits: it may be spurious (allow {more} spurious)"
        for contact in explanation.spurious
    ]
    return lines


def explanation_out(explanation: Explanation, record: ContactRecord) -> ExplanationOut:
    """The explanation as a JSON value."""
    return ExplanationOut(
        moved_after_grip=explanation.moved_after_grip,
        spurious=tuple(record.out(contact) for contact in explanation.spurious),
    )


def state_named(catalogue: Catalogue, text: str) -> tuple[str, str | None]:
    """The object, or object and state, that "OBJECT" or "OBJECT/STATE" means. Raises InputError if none."""
    names: dict[str, tuple[str, str | None]] = {
        f"{item.object_name}/{item.state.name}": (item.object_name, item.state.name)
        for item in catalogue.states
    }
    names |= {item.object_name: (item.object_name, None) for item in catalogue.states}
    if text in names:
        return names[text]
    near = nearest(text, names)
    objects = ", ".join(dict.fromkeys(item.object_name for item in catalogue.states))
    hint = f"; there are: {objects}" if near is None else f'; did you mean "{near}"?'
    raise InputError(f"no object {shown(text)} in the catalogue{hint}")


def why_lines(why: ObjectExplanation, record: ContactRecord) -> list[str]:
    """Why the object was ruled out, or that it was not, as a table of the tests that left fewer or more."""
    name = why.object_name if why.state_name is None else f"{why.object_name}, {why.state_name}"
    rows = [("after a look at", "interpretations left")]
    before = -1
    for step in why.steps:
        if step.left != before or step is why.steps[-1]:
            *others, new = step.contacts
            test = _TESTS[step.reason]
            words = test.format(new=record.words(new), others=record.listed(others) if others else "")
            rows.append((words, str(step.left)))
        before = step.left
    width = max(len(test) for test, _ in rows)
    lines = [f"{name}: {_cause(why, record)}", *(f"  {test:<{width}}  {left}" for test, left in rows)]
    if why.conflict:
        lines.append(_conflict(record, why.conflict))
    return lines


def _cause(why: ObjectExplanation, record: ContactRecord) -> str:
    step = why.ruled_out
    if step is None:
        return "not ruled out"
    missed = step.reason is SearchTest.PATH and not step.contacts[0].touched
    cause = "by {all}" if missed else _CAUSES[step.reason]
    return f"ruled out {cause.format(all=record.listed(step.contacts))}"


def _conflict(record: ContactRecord, contacts: Sequence[Contact]) -> str:
    if len(contacts) == 1:
        return f"{record.words(contacts[0])} alone cannot be true of it"
    return f"{record.listed(contacts)} cannot {'both' if len(contacts) == 2 else 'all'} be true of it"


def why_out(why: ObjectExplanation, record: ContactRecord) -> WhyOut:
    """Why the object was ruled out, as a JSON value."""
    return WhyOut(
        object=why.object_name,
        state=why.state_name,
        ruled_out=why.ruled_out is not None,
        steps=tuple(
            StepOut(
                reason=step.reason.value,
                contacts=tuple(record.out(contact) for contact in step.contacts),
                left=step.left,
            )
            for step in why.steps
        ),
        conflict=tuple(record.out(contact) for contact in why.conflict),
        hypotheses=tuple(hypothesis_out(item) for item in why.hypotheses),
    )
