"""A plan as `palpate/grip@1`."""

import math

from palpate.base.vocabulary import Strategy
from palpate.config.grip_result import ApproachOut, AssumptionsOut, GripOut, PossibleOut, PredictionOut
from palpate.recognizer import Grip, Prediction
from palpate.rig.identification.next_grip import Planned
from palpate.rig.identification.result import state_names

__all__ = ["grip_out", "outward_normals"]


def grip_out(planned: Planned) -> GripOut:
    """The plan as `palpate/grip@1`."""
    grip, recognition = planned.grip, planned.recognition
    foresees = planned.strategy is Strategy.PLANNED
    return GripOut(
        strategy=planned.strategy,
        verdict=recognition.verdict,
        fine=planned.fine,
        hypotheses=tuple(
            PossibleOut.of(item, **state_names(item), symmetry_order=item.state.symmetry_order)
            for item in recognition.hypotheses
        ),
        approaches=() if grip is None else tuple(_approach(planned, grip, row) for row in planned.rows),
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


def _approach(planned: Planned, grip: Grip, row: int) -> ApproachOut:
    candidate = grip.approaches[row]
    return ApproachOut.of(
        candidate,
        finger=planned.rig.fingers[candidate.finger_index].name,
        travel=grip.travels_mm[row],
        predictions=tuple(
            _prediction(index, item) for index, item in enumerate(grip.predictions.of_approach(row))
        ),
    )


def _prediction(index: int, item: Prediction) -> PredictionOut:
    met = math.isfinite(item.earliest_mm)
    return PredictionOut(
        hypothesis=index,
        stop=(item.earliest_mm, item.furthest_mm) if met else None,
        may_miss=not math.isfinite(item.latest_mm),
        normal=outward_normals(item) if met else None,
    )
