"""Recognitions as JSON, pictures, text and a file of contacts; why an object fits or does not."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from palpate.base.errors import InputError, join_words, nearest, quantity
from palpate.base.geometry import Floats
from palpate.base.geometry.outlines import rings_of
from palpate.base.short_repr import ShortRepr
from palpate.config import RigFile
from palpate.config.problems import excerpt
from palpate.config.recognition_results import (
    ContactReferenceOut,
    EliminationStepOut,
    ExplanationOut,
    HypothesisOut,
    IdentificationOut,
    InterpretationOut,
    ObjectExplanationOut,
    RecognitionOut,
    StatisticsOut,
)
from palpate.recognizer import (
    Bounds,
    Catalogue,
    Configuration,
    Contact,
    Hypothesis,
    MemoCounts,
    ObjectExplanation,
    Recognition,
    SearchTest,
    grips_before_move,
    suspected_contacts,
)
from palpate.rig.emulated.scene import Placement, shape_of
from palpate.rig.identification.outcome import Identification
from palpate.rig.identification.result import hypotheses_of, state_names, unfinished_out
from palpate.views.answer import headline, picture_facts
from palpate.views.run_scene import placed_rings
from palpate.views.table_picture import picture, values


def recognition_out(
    recognition: Recognition, seconds: float, memo: MemoCounts | None = None
) -> RecognitionOut:
    """The recognition as `palpate/recognition@1`; `seconds` is what it took."""
    return RecognitionOut(
        verdict=recognition.verdict,
        hypotheses=tuple(_hypothesis_out(item) for item in recognition.hypotheses),
        statistics=StatisticsOut(
            levels=recognition.levels,
            model_tests=sum(level.after_distance for level in recognition.levels[1:]),
            seconds=seconds,
            memo=memo,
        ),
        unfinished=unfinished_out(recognition),
    )


def recognition_picture(recognition: Recognition, title: str) -> str:
    """SVG of a recognition without a rig."""
    hypotheses = recognition.hypotheses
    only = hypotheses[0] if len(hypotheses) == 1 else None
    return picture.draw(
        values.Picture(
            title=title,
            subtitle=(_verdict_line(recognition),),
            found=() if only is None else rings_at(only),
            pose=None if only is None else bounded_pose(only.configuration, only.bounds),
            others=tuple(_other_hypothesis(item) for item in hypotheses if item is not only),
            touches=tuple(touch_mark(1, contact) for contact in recognition.contacts),
        )
    )


def _hypothesis_out(item: Hypothesis) -> HypothesisOut:
    """One hypothesis as a JSON value."""
    return HypothesisOut.of(
        item,
        **state_names(item),
        symmetry_order=item.state.symmetry_order,
        interpretations=tuple(
            InterpretationOut(
                edges=tuple(None if k is None else _edge(k) for k in row),
                features=tuple(None if k is None else _feature(k) for k in row),
            )
            for row in item.features
        ),
    )


def _edge(feature: int) -> int:
    """The edge that a feature belongs to; an arc about a vertex, to the edge that begins there."""
    return feature if feature >= 0 else -1 - feature


def _feature(feature: int) -> str:
    return f"edge {feature}" if feature >= 0 else f"vertex {_edge(feature)}"


def _verdict_line(recognition: Recognition) -> str:
    touched = sum(contact.touched for contact in recognition.contacts)
    return f"{recognition.verdict.value}: {len(recognition.hypotheses)} hypotheses after {touched} contacts"


def bounded_pose(at: Configuration, bounds: Bounds) -> values.BoundedPose:
    """A configuration with its bounds, for a picture."""
    return values.BoundedPose(
        (at.x_mm, *bounds.x_mm), (at.y_mm, *bounds.y_mm), (at.theta_rad, *bounds.theta_rad)
    )


def _other_hypothesis(item: Hypothesis) -> values.OtherHypothesis:
    """A hypothesis beside the first one, for a picture."""
    return values.OtherHypothesis(
        item.state.object_name, f"still possible, {100 * item.weight:.0f} %", rings_at(item)
    )


def rings_at(item: Hypothesis) -> tuple[Floats, ...]:
    """Outlines of the lowest section, in W, at the hypothesis's configuration."""
    return placed_rings(item.state.state, item.configuration)


def touch_mark(grip: int, contact: Contact, points: Sequence[Contact] = ()) -> values.TouchMark:
    """A contact or a miss of a grip, counted from 1, for a picture; `points`: where a pad was touched."""
    normal = contact.normal
    return values.TouchMark(
        contact.name,
        grip,
        contact.start_mm,
        contact.end_mm,
        contact.finger.tip_radius_mm,
        contact.touched,
        None if normal is None else (normal.lo_rad, normal.hi_rad),
        contact.finger.tip.has_face,
        tuple(point.end_mm for point in points),
    )


def identification_picture(
    result: Identification, placements: Sequence[Placement], rig: RigFile, out: IdentificationOut
) -> str:
    """SVG of a run: the object found, if one was, contacts, approaches, and what was ruled out when."""
    found, others = list[Hypothesis](), list[values.OtherHypothesis]()
    for part in (result,) if result.table is None else result.table.parts:
        hypotheses = hypotheses_of(part)
        answered = hypotheses[:1] if part.outcome.is_answer else ()
        found += answered
        others += [_other_hypothesis(item) for item in hypotheses if item not in answered]
        others += [
            values.OtherHypothesis(item.state.object_name, f"ruled out by grip {grip}", rings_at(item))
            for grip, item in sorted(part.ruled_out, key=lambda pair: -pair[1].weight)
            if result.table is None  # of several parts they would cover each other
        ]
    only = hypotheses_of(result) if result.table is None else ()
    placed = found[0] if found and only else only[0] if len(only) == 1 else None
    return picture.draw(
        values.Picture(
            title=headline(out),
            subtitle=(f"rig {rig.name}",),
            found=tuple(ring for item in found for ring in rings_at(item)),
            pose=None if placed is None else bounded_pose(placed.configuration, placed.bounds),
            truth=tuple(
                ring for lies in placements for ring in rings_of(shape_of(lies, lies.state.sections[0]))
            ),
            others=tuple(others),
            touches=tuple(
                touch_mark(number, touch.contact, touch.touched_points)
                for number, grip in enumerate(result.grips, start=1)
                for touch in grip
            ),
            bases=tuple(values.FingerBase(item.name, item.base_mm) for item in rig.fingers),
            workspace_radius_mm=rig.workspace.radius_mm,
            facts=tuple(picture_facts(out)),
        )
    )


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

    def out(self, contact: Contact) -> ContactReferenceOut:
        """The contact as a JSON value."""
        return ContactReferenceOut(grip=self._grip(contact), finger=contact.name, touched=contact.touched)

    def words(self, contact: Contact) -> str:
        """The contact's name for people, who count grips from 1."""
        of_grip = f" of grip {self._grip(contact) + 1}" if len(self.grips) > 1 else ""
        return f"{'' if contact.touched else 'the miss of '}{contact.name}{of_grip}"

    def listed(self, contacts: Sequence[Contact]) -> str:
        """Several contacts in words."""
        return join_words([self.words(contact) for contact in contacts])

    def _grip(self, contact: Contact) -> int:
        return next(k for k, grip in enumerate(self.grips) if any(other is contact for other in grip))


@dataclass(frozen=True, repr=False)
class Explanation(ShortRepr):
    """Explanation of why nothing fits: see `grips_before_move` and `suspected_contacts`."""

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


def parse_state_name(catalogue: Catalogue, text: str) -> tuple[str, str | None]:
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
    raise InputError(f"no object {excerpt(text)} in the catalogue{hint}")


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
    step = why.refuting_step
    if step is None:
        return "not ruled out"
    missed = step.reason is SearchTest.PATH and not step.contacts[0].touched
    cause = "by {all}" if missed else _CAUSES[step.reason]
    return f"ruled out {cause.format(all=record.listed(step.contacts))}"


def _conflict(record: ContactRecord, contacts: Sequence[Contact]) -> str:
    if len(contacts) == 1:
        return f"{record.words(contacts[0])} alone cannot be true of it"
    return f"{record.listed(contacts)} cannot {'both' if len(contacts) == 2 else 'all'} be true of it"


def why_out(why: ObjectExplanation, record: ContactRecord) -> ObjectExplanationOut:
    """Why the object was ruled out, as a JSON value."""
    return ObjectExplanationOut(
        object=why.object_name,
        state=why.state_name,
        ruled_out=why.refuting_step is not None,
        steps=tuple(
            EliminationStepOut(
                reason=step.reason.value,
                contacts=tuple(record.out(contact) for contact in step.contacts),
                left=step.left,
            )
            for step in why.steps
        ),
        conflict=tuple(record.out(contact) for contact in why.conflict),
        hypotheses=tuple(_hypothesis_out(item) for item in why.hypotheses),
    )


_MAX_HYPOTHESES = 12


def recognition_lines(
    recognition: Recognition,
    record: ContactRecord,
    explanation: Explanation | None,
    because: ObjectExplanation | None,
    memo: MemoCounts | None,
    seconds: float,
) -> Iterator[str]:
    """The result for a person; `because`: of the object asked for, `memo`: counts as in the memo's tables."""
    touched = sum(contact.touched for contact in recognition.contacts)
    missed = len(recognition.contacts) - touched
    found = quantity(len(recognition.hypotheses), "hypothesis", "hypotheses")
    yield f"{recognition.verdict.value}: {found} after {touched} contacts and {missed} misses"
    for line in () if explanation is None else explanation_lines(explanation, record):
        yield f"  {line}"
    for item in recognition.hypotheses[:_MAX_HYPOTHESES]:
        spurious = f"  without {record.listed(item.null_contacts)}" if item.null_contacts else ""
        yield f"  {_hypothesis_line(item)}{spurious}"
    if len(recognition.hypotheses) > _MAX_HYPOTHESES:
        yield f"  and {len(recognition.hypotheses) - _MAX_HYPOTHESES} more; --json lists them all"
    yield from _unfinished_lines(recognition, record)
    yield f"{1000 * seconds:.1f} ms"
    if because is not None:
        yield from why_lines(because, record)
        for item in because.hypotheses[:_MAX_HYPOTHESES]:
            yield f"  {_hypothesis_line(item)}"
    if memo is not None:
        yield from _memo_lines(memo)


def _unfinished_lines(recognition: Recognition, record: ContactRecord) -> Iterator[str]:
    """Say what the work budget did not suffice for; nothing if it did."""
    unpaired = recognition.unpaired_contacts
    parts = [f"not paired with edges: {record.listed(unpaired)}"] if unpaired else []
    parts += ["cells are coarse"] if recognition.has_coarse_cells else []
    if parts:
        units = recognition.budget.units
        yield f"  budget of {units} units spent: {'; '.join(parts)}; more of it may leave less"


def _memo_lines(memo: MemoCounts) -> list[str]:
    """The memo's Tables I and II for this search, a column for each test at each level."""
    depth = len(memo.levels) + 2
    lines = ["Interpretations left (the memo's Tables I and II):"]
    for order, tests, counts in (
        ("distance first", "DA", memo.distance_first),
        ("angle first", "AD", memo.angle_first),
    ):
        names = ["1", *(f"{level}{test}" for level in range(2, depth) for test in ("", *tests)), "M"]
        wide = [max(len(name), len(f"{count:,}")) for name, count in zip(names, counts, strict=True)]
        lines.append(
            f"  {order:<15}" + "  ".join(f"{name:>{w}}" for name, w in zip(names, wide, strict=True))
        )
        lines.append(" " * 17 + "  ".join(f"{count:>{w},}" for count, w in zip(counts, wide, strict=True)))
    return lines


def _hypothesis_line(item: Hypothesis) -> str:
    """A hypothesis in one line: name, state, weight, configuration with the half-widths of its bounds."""
    at, bounds = item.configuration, item.bounds
    unsure = "" if item.verified else "  (no witness found)"
    half = math.degrees(_half(bounds.theta_rad))
    turned = (
        f"θ {math.degrees(at.theta_rad):.2f} ± {half:.2f}°" if item.state.symmetry_order else "θ any (round)"
    )
    slides = ""
    if item.slide is not None:
        lo, hi = item.slide.extent_mm
        slides = f"  slides {hi - lo:.1f} mm along {math.degrees(item.slide.direction_rad):.0f}°"
    return (
        f"{item.state.object_name}, {item.state.state.name}  {100 * item.weight:5.1f} %  "
        f"x {at.x_mm:.2f} ± {_half(bounds.x_mm):.2f} mm  y {at.y_mm:.2f} ± {_half(bounds.y_mm):.2f} mm  "
        f"{turned}{slides}{unsure}"
    )


def _half(interval: tuple[float, float]) -> float:
    return (interval[1] - interval[0]) / 2
