"""A plan (the next grip) as `palpate/grip@1`, in words and as a picture.

Numbers are rounded so that what is printed still holds.
"""

import math
from collections.abc import Sequence

from palpate.base.errors import join_words
from palpate.base.vocabulary import RecognitionVerdict, Strategy
from palpate.config import RigFile
from palpate.config.recognition_results import (
    ApproachOut,
    AssumptionsOut,
    GripOut,
    PossibleHypothesisOut,
    PredictionOut,
)
from palpate.recognizer import Grip, Hypothesis, Prediction
from palpate.rig.identification.grip_choice import GripPlan
from palpate.rig.identification.result import state_names
from palpate.views.numerals import at_least, at_most, decimal, floor_to, minus_signs
from palpate.views.recognition import ContactRecord, rings_at, touch_mark
from palpate.views.table_picture import picture, values


def grip_out(planned: GripPlan) -> GripOut:
    """The plan as `palpate/grip@1`."""
    grip, recognition = planned.grip, planned.recognition
    foresees = planned.strategy is Strategy.PLANNED
    return GripOut(
        strategy=planned.strategy,
        verdict=recognition.verdict,
        fine=planned.fine,
        hypotheses=tuple(
            PossibleHypothesisOut.of(item, **state_names(item), symmetry_order=item.state.symmetry_order)
            for item in recognition.hypotheses
        ),
        approaches=() if grip is None else tuple(_approach_out(planned, grip, row) for row in planned.rows),
        decisive=grip and grip.decisive,
        remaining=grip.remaining if grip is not None and foresees else None,
        seconds=grip and grip.seconds,
        assumes=AssumptionsOut(normal_half_range=planned.resolution.normal_half_rad),
        indistinguishable=planned.alike,
    )


def outward_normals(prediction: Prediction) -> tuple[float, float] | None:
    """The interval of normals (rad, W) with its middle from −π to π; None if nothing is met."""
    if prediction.normal_rad is None:
        return None
    lo, hi = prediction.normal_rad
    shift = 2 * math.pi * round((lo + hi) / 2 / (2 * math.pi))
    return lo - shift, hi - shift


def _approach_out(planned: GripPlan, grip: Grip, row: int) -> ApproachOut:
    candidate = grip.approaches[row]
    return ApproachOut.of(
        candidate,
        finger=planned.finger_name(candidate),
        travel=grip.travels_mm[row],
        predictions=tuple(
            _prediction_out(index, item) for index, item in enumerate(grip.predictions.of_approach(row))
        ),
    )


def _prediction_out(index: int, item: Prediction) -> PredictionOut:
    met = math.isfinite(item.earliest_mm)
    return PredictionOut(
        hypothesis=index,
        stop=(item.earliest_mm, item.furthest_mm) if met else None,
        may_miss=not math.isfinite(item.latest_mm),
        normal=outward_normals(item) if met else None,
    )


MAX_LETTERS = 12
"""So many hypotheses are shown one by one; the picture draws as many."""


def letter(index: int) -> str:
    """Name of a hypothesis where it is shown: letters for the first `MAX_LETTERS`, then numbers."""
    return chr(ord("a") + index) if index < MAX_LETTERS else str(index)


def direction_text(angle_rad: float) -> str:
    """A direction in degrees from −180 to 180."""
    degrees = math.degrees(math.remainder(angle_rad, 2 * math.pi))
    return f"{decimal(degrees, 1)}°"


def stop_words(item: Prediction) -> str | None:
    """Say where a finger is stopped, in mm, rounded outward; None if nothing stops it."""
    if not math.isfinite(item.earliest_mm):
        return None
    return f"{at_least(item.earliest_mm, 1)} … {at_most(item.furthest_mm, 1)}"


def normal_words(item: Prediction) -> str | None:
    """Interval of the contact normal, in whole degrees rounded outward; None if nothing stops it."""
    interval = outward_normals(item)
    if interval is None or not math.isfinite(item.earliest_mm):
        return None
    lo, hi = math.floor(math.degrees(interval[0])), math.ceil(math.degrees(interval[1]))
    return "any" if hi - lo >= 360 else minus_signs(f"{lo} … {hi}°")


def may_miss(item: Prediction) -> bool:
    """True if perhaps nothing stops the finger."""
    return not math.isfinite(item.latest_mm)


def _certificate_bounds(planned: GripPlan, grip: Grip) -> str:
    """The bounds on contacts for which the grip is decisive."""
    ordered = [grip.approaches[row] for row in planned.rows]
    names = [planned.finger_name(item) for item in ordered]
    bounds = [at_least(item.position_bound_mm) for item in ordered]
    half_rad = planned.resolution.normal_half_rad
    normal = f" and ± {floor_to(math.degrees(half_rad), 1):g}°" if half_rad < math.pi else ""
    if len(set(bounds)) == 1:
        return f"± {bounds[0]} mm{normal}"
    each = ", ".join(f"± {bound} mm ({name})" for name, bound in zip(names, bounds, strict=True))
    return f"{each}{normal}"


def certainty(planned: GripPlan) -> list[str]:
    """The certificate of the grip, or why there is no grip."""
    grip, recognition = planned.grip, planned.recognition
    if planned.hopeless:
        more = [] if grip is None else ["the grip can only place them more finely"]
        return ["no approach within reach distinguishes the hypotheses that are left", *more]
    if recognition.verdict is RecognitionVerdict.UNIQUE:
        return [_one_left_words(planned)]
    if grip is None:
        return ["no grip: no approach that is left is expected to distinguish the hypotheses"]
    if not grip.decisive:
        return ["not decisive: some outcomes leave hypotheses that another touch may distinguish"]
    left = "one indistinguishable set" if planned.alike else "one hypothesis"
    return [
        f"decisive: every outcome leaves {left}, if contacts are within {_certificate_bounds(planned, grip)}"
    ]


def remaining_confusion(planned: GripPlan) -> str | None:
    """Expected share of confusion after the grip, as a percentage; None if it was not foreseen."""
    if planned.grip is None or planned.strategy is not Strategy.PLANNED:
        return None
    share = 100 * planned.grip.remaining
    return f"{share:.0f} %" if share >= 0.95 else f"{share:.1f} %" if share >= 0.05 else "under 0.1 %"


def hypotheses_words(indices: Sequence[int]) -> str:
    """Hypotheses by their letters; those that are not shown are counted."""
    shown = [letter(index) for index in indices if index < MAX_LETTERS]
    hidden = len(indices) - len(shown)
    if hidden:
        shown.append(f"{hidden} {'more' if shown else 'of the hypotheses not shown'}")
    return join_words(shown)


def _one_left_words(planned: GripPlan) -> str:
    if planned.fine:
        needed = "no grip is needed" if planned.grip is None else "the grip confirms it"
        return f"one hypothesis is left, placed as finely as the rig file asks: {needed}"
    if planned.grip is not None:
        return "one hypothesis is left: the grip places it more finely, or confirms it"
    return "one hypothesis is left, and no approach that is left would place it much more finely"


_MAX_OUTCOME_SETS = 3


def plan_picture(planned: GripPlan, record: ContactRecord, title: str) -> str:
    """SVG of a plan; `title` names the contacts and the rig."""
    recognition, rig = planned.recognition, planned.rig
    count = len(recognition.hypotheses)
    touched = sum(contact.touched for contact in recognition.contacts)
    found = "1 hypothesis" if count == 1 else f"{count} hypotheses"
    return picture.draw(
        values.Picture(
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
            bases=tuple(values.FingerBase(item.name, item.base_mm) for item in getattr(rig, "fingers", ())),
            workspace_radius_mm=rig.workspace.radius_mm if isinstance(rig, RigFile) else None,
            facts=tuple(_facts(planned)),
            approaches=()
            if planned.grip is None
            else tuple(_approach_arrow(planned, planned.grip, row) for row in planned.rows),
        )
    )


def _title(planned: GripPlan) -> str:
    grip = planned.grip
    if grip is None:
        return "No next grip"
    names = [planned.finger_name(grip.approaches[row]) for row in planned.rows]
    return f"Next grip: {', '.join(names)}"


def _hypothesis(item: Hypothesis) -> values.OtherHypothesis:
    name = f"{item.state.object_name}, {item.state.state.name}"
    return values.OtherHypothesis(name, f"{100 * item.weight:.0f} %", rings_at(item))


def _facts(planned: GripPlan) -> list[tuple[str, str]]:
    rows = [("strategy", planned.strategy.value)]
    grip = planned.grip
    if grip is not None:
        rows.append(("time, about", f"{grip.seconds:.0f} s"))
        if len(planned.recognition.hypotheses) > 1 and not planned.hopeless:
            rows.append(("decisive", "yes" if grip.decisive else "no"))
            if grip.decisive:
                rows.append(("for contacts within", _certificate_bounds(planned, grip)))
    share = remaining_confusion(planned)
    if share is not None:
        rows.append(("remaining confusion", share))
    rows += [("indistinguishable", hypotheses_words(group)) for group in planned.alike[:_MAX_OUTCOME_SETS]]
    if len(planned.alike) > _MAX_OUTCOME_SETS:
        rows.append(("more such sets", str(len(planned.alike) - _MAX_OUTCOME_SETS)))
    return rows


def _approach_arrow(planned: GripPlan, grip: Grip, row: int) -> values.ApproachArrow:
    candidate, travel = grip.approaches[row], grip.travels_mm[row]
    x, y = (decimal(value, 1) for value in candidate.start_mm)
    return values.ApproachArrow(
        planned.finger_name(candidate),
        candidate.start_mm,
        candidate.direction_rad,
        travel,
        candidate.finger.tip_radius_mm,
        (f"{x}, {y}", direction_text(candidate.direction_rad), f"{travel:.1f}"),
        tuple(_predicted_stop(item) for item in grip.predictions.of_approach(row)),
    )


def _predicted_stop(item: Prediction) -> values.PredictedStop:
    stop, normal = stop_words(item), normal_words(item)
    if stop is None or normal is None:
        return values.PredictedStop(None, True, ("misses",))
    words = (stop, normal, *(["or misses"] if may_miss(item) else []))
    return values.PredictedStop((item.earliest_mm, item.furthest_mm), may_miss(item), words)
