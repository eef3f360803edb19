"""A plan as a picture: hypotheses, contacts so far, and the next approaches with their predictions."""

from palpate.recognizer import Grip, Hypothesis, Prediction
from palpate.rig.identification.next_grip import Planned
from palpate.views.explanation import ContactRecord
from palpate.views.plan_text import (
    certainty,
    direction,
    left_over,
    may_miss,
    named,
    normal_words,
    rests_on,
    stop_words,
)
from palpate.views.recognition import rings_at, touch_mark
from palpate.views.table_picture import picture

__all__ = ["plan_picture"]

_SETS_SHOWN = 3


def plan_picture(planned: Planned, record: ContactRecord, title: str) -> str:
    """SVG of a plan; `title` names the contacts and the rig."""
    recognition, rig = planned.recognition, planned.rig
    count = len(recognition.hypotheses)
    touched = sum(contact.touched for contact in recognition.contacts)
    found = "1 hypothesis" if count == 1 else f"{count} hypotheses"
    return picture.draw(
        picture.Picture(
            title=_title(planned),
            subtitle=(
                f"{title}; {recognition.verdict.value}: {found} after {touched} contacts",
                *(certainty(planned) if count else ("nothing in the catalogue fits all contacts",)),
            ),
            others=tuple(_hypothesis(item) for item in recognition.hypotheses),
            touches=tuple(
                touch_mark(number, contact)
                for number, grip in enumerate(record.grips, start=1)
                for contact in grip
            ),
            bases=tuple(picture.FingerBase(item.name, item.base_mm) for item in rig.fingers),
            workspace_radius_mm=rig.workspace.radius_mm,
            facts=tuple(_facts(planned)),
            approaches=()
            if planned.grip is None
            else tuple(_approach(planned, planned.grip, row) for row in planned.rows),
        )
    )


def _title(planned: Planned) -> str:
    grip = planned.grip
    if grip is None:
        return "No next grip"
    names = [planned.rig.fingers[grip.approaches[row].finger_index].name for row in planned.rows]
    return f"Next grip: {', '.join(names)}"


def _hypothesis(item: Hypothesis) -> picture.OtherHypothesis:
    name = f"{item.state.object_name}, {item.state.state.name}"
    return picture.OtherHypothesis(name, f"{100 * item.weight:.0f} %", rings_at(item))


def _facts(planned: Planned) -> list[tuple[str, str]]:
    rows = [("strategy", planned.strategy.value)]
    grip = planned.grip
    if grip is not None:
        rows.append(("time, about", f"{grip.seconds:.0f} s"))
        if len(planned.recognition.hypotheses) > 1 and not planned.hopeless:
            rows.append(("decisive", "yes" if grip.decisive else "no"))
            if grip.decisive:
                rows.append(("for contacts within", rests_on(planned, grip)))
    share = left_over(planned)
    if share is not None:
        rows.append(("remaining confusion", share))
    rows += [("indistinguishable", named(group)) for group in planned.alike[:_SETS_SHOWN]]
    if len(planned.alike) > _SETS_SHOWN:
        rows.append(("more such sets", str(len(planned.alike) - _SETS_SHOWN)))
    return rows


def _approach(planned: Planned, grip: Grip, row: int) -> picture.ApproachArrow:
    candidate, travel = grip.approaches[row], grip.travels_mm[row]
    x, y = (f"{value:.1f}".replace("-", "−") for value in candidate.start_mm)
    return picture.ApproachArrow(
        planned.rig.fingers[candidate.finger_index].name,
        candidate.start_mm,
        candidate.direction_rad,
        travel,
        candidate.finger.tip_radius_mm,
        (f"{x}, {y}", direction(candidate.direction_rad), f"{travel:.1f}"),
        tuple(_predicted_stop(item) for item in grip.predictions.of_approach(row)),
    )


def _predicted_stop(item: Prediction) -> picture.PredictedStop:
    stop, normal = stop_words(item), normal_words(item)
    if stop is None or normal is None:
        return picture.PredictedStop(None, True, ("misses",))
    words = (stop, normal, *(["or misses"] if may_miss(item) else []))
    return picture.PredictedStop((item.earliest_mm, item.furthest_mm), may_miss(item), words)
