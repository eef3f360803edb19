"""Result of an identification as `palpate/identification@1`."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from palpate.base.vocabulary import Strategy
from palpate.config.recognition_results import (
    AlternativeOut,
    CalibrationUsedOut,
    IdentificationOut,
    MotionBoundOut,
    NotBoundedOut,
    Relation,
    TouchRecordOut,
    TruthOut,
)
from palpate.config.result_model import UnfinishedOut
from palpate.recognizer import Configuration, Hypothesis, Recognition
from palpate.rig.emulated.ground_truth import Comparison, compare_answer
from palpate.rig.emulated.scene import Placement
from palpate.rig.identification.grip_choice import NotBounded
from palpate.rig.identification.loop import Identification


@dataclass(frozen=True, slots=True)
class RunFacts:
    """Facts of a run beside its result. `session`: folder of its log; `calibration`: None if none is used."""

    emulated: bool
    rig_seconds: float
    wall_seconds: float = 0.0
    session: str | None = None
    strategy: Strategy = Strategy.PLANNED
    calibration: CalibrationUsedOut | None = None


def identification_out(
    result: Identification,
    placement: Placement | None,
    facts: RunFacts,
    at_measurement: Sequence[Configuration] | None = None,
    not_bounded: Sequence[NotBounded] = (),
) -> IdentificationOut:
    """A run's result as `palpate/identification@1`: the heaviest hypothesis first, the others beside it.

    `placement`: what lies on an emulated table at the end, `at_measurement`: where it was at each grip.
    `not_bounded`: states of the answer that may tip or roll.
    """
    hypotheses = hypotheses_of(result)
    first = hypotheses[0] if hypotheses else None
    truth = None if placement is None else compare_answer(placement, hypotheses)
    return IdentificationOut(
        verdict=result.outcome,
        object=first and first.state.object_name,
        state=first and first.state.state.name,
        configuration=first and first.configuration,
        bounds=first and first.bounds,
        alternatives=tuple(_alternative(item, hypotheses[0]) for item in hypotheses[1:]),
        symmetry_order=1 if first is None else first.state.symmetry_order,
        strategy=facts.strategy,
        grips=len(result.grips),
        touches=result.touches,
        touch_records=_touch_records(result),
        contacts=sum(touch.contact.touched for grip in result.grips for touch in grip),
        swept=result.swept,
        predicted=result.predicted,
        stranger_probability=result.stranger_probability,
        moved_before=result.moved_before,
        detectable_shift=result.detectable_shift_mm if math.isfinite(result.detectable_shift_mm) else None,
        emulated=facts.emulated,
        rig_seconds=facts.rig_seconds,
        wall_seconds=facts.wall_seconds,
        session=facts.session,
        calibration=facts.calibration,
        motion_bounds=tuple(
            MotionBoundOut(grip=number, position=bound and bound[0], orientation=bound and bound[1])
            for number, bound in enumerate(result.motions, start=1)
        ),
        assumed_holds_n=result.assumed_holds_n,
        hold_contradicted=result.hold_contradicted,
        not_bounded=tuple(
            NotBoundedOut.of(item, object=item.object_name, state=item.state_name, when_pushed=item.response)
            for item in not_bounded
        ),
        unfinished=None if result.recognition is None else unfinished_out(result.recognition),
        truth=None if placement is None or truth is None else _truth(placement, truth, at_measurement),
    )


def unfinished_out(recognition: Recognition) -> UnfinishedOut | None:
    """Part of the work that the budget did not suffice for; None if it did."""
    unpaired = tuple(contact.name for contact in recognition.unpaired_contacts)
    if not unpaired and not recognition.has_coarse_cells:
        return None
    return UnfinishedOut(
        budget=recognition.budget.units, unpaired=unpaired, coarse=recognition.has_coarse_cells
    )


def _touch_records(result: Identification) -> tuple[TouchRecordOut, ...]:
    """Records of what loaded the part in every touch, in the order of grips."""
    return tuple(
        TouchRecordOut(
            grip=number,
            finger=touch.contact.name,
            stage=load.stage.value,
            peak_force_n=load.peak_force_n,
            travel_in_contact_mm=load.travel_mm,
            work_mj=load.work_mj,
        )
        for number, grip in enumerate(result.grips, start=1)
        for touch in grip
        for load in touch.loads
    )


def state_names(item: Hypothesis) -> dict[str, object]:
    """The names of a hypothesis's object and state, as results have them."""
    return {"object": item.state.object_name, "state": item.state.state.name}


def _alternative(item: Hypothesis, first: Hypothesis) -> AlternativeOut:
    same = item.state_index == first.state_index
    turned, moved = _displacement(first, item) if same else (None, None)
    return AlternativeOut.of(
        item,
        **state_names(item),
        relation=Relation.SYMMETRY if same else Relation.TWIN,
        turned=turned,
        moved=moved,
    )


def _displacement(first: Hypothesis, other: Hypothesis) -> tuple[float, float]:
    """Displacement from one configuration of a state to another: angle (rad), way of its centre of area (mm).

    Of the turns that the state's symmetry makes equal, the smallest; 0 of a round one.
    """
    if first.state.state.is_round:
        return 0.0, math.dist(_centre(first), _centre(other))
    turn = 2 * math.pi / first.state.symmetry.order
    turned = other.configuration.theta_rad - first.configuration.theta_rad
    turned -= turn * round(turned / turn)
    return turned, math.dist(_centre(first), _centre(other))


def _centre(item: Hypothesis) -> tuple[float, float]:
    """Centre of area in W."""
    at, (u, v) = item.configuration, item.state.origin_mm.tolist()
    cos, sin = math.cos(at.theta_rad), math.sin(at.theta_rad)
    return at.x_mm + cos * u - sin * v, at.y_mm + sin * u + cos * v


def hypotheses_of(result: Identification) -> Sequence[Hypothesis]:
    """Hypotheses of the last recognition, the heaviest first; none if nothing was touched."""
    return () if result.recognition is None else result.recognition.hypotheses


def _truth(
    placement: Placement, found: Comparison, at_measurement: Sequence[Configuration] | None
) -> TruthOut:
    return TruthOut.of(
        found,
        object=placement.model.name,
        state=placement.state.name,
        named=found.hypothesis is not None,
        at_measurement=at_measurement,
    )
