"""A run on the bench as JSON values and as a picture. The end of the data's way, beside `report`."""

import math
from collections.abc import Sequence

from palpate.config import RigFile
from palpate.config.identification_result import (
    AlternativeOut,
    CalibrationUsedOut,
    IdentificationOut,
    IdentificationVerdict,
    Relation,
    StrategyName,
    TruthOut,
)
from palpate.recognizer import Hypothesis, Strategy
from palpate.recognizer.arrays import Floats
from palpate.rig import picture
from palpate.rig.identify import Identification
from palpate.rig.report import bounds_out, configuration_out, pose_of, rings_at, still_possible, touch_of
from palpate.rig.scene import Placement, rings_of
from palpate.rig.truth import Comparison, compare

__all__ = ["identification_out", "identification_picture"]


def identification_out(
    result: Identification,
    placement: Placement | None,
    *,
    emulated: bool,
    rig_seconds: float,
    wall_seconds: float,
    session: str | None,
    strategy: Strategy = Strategy.PLANNED,
    calibration: CalibrationUsedOut | None = None,
) -> IdentificationOut:
    """A run's result as `palpate/identification@1`: the heaviest hypothesis first, the others beside it."""
    hypotheses = _hypotheses(result)
    first = hypotheses[0] if hypotheses else None
    truth = None if placement is None else compare(placement, hypotheses)
    return IdentificationOut(
        verdict=IdentificationVerdict(result.outcome.value),
        object=first and first.state.object_name,
        state=first and first.state.state.name,
        configuration=None if first is None else configuration_out(first.configuration),
        bounds=None if first is None else bounds_out(first.bounds),
        alternatives=tuple(_alternative(item, hypotheses[0]) for item in hypotheses[1:]),
        symmetry_order=1 if first is None else first.state.symmetry_order,
        strategy=StrategyName(strategy.value),
        grips=len(result.grips),
        touches=result.touches,
        contacts=sum(touch.contact.touched for grip in result.grips for touch in grip),
        swept=result.swept,
        foretold=result.foretold,
        moved_before=result.moved_before,
        unnoticed_shift=result.unnoticed_mm if math.isfinite(result.unnoticed_mm) else None,
        emulated=emulated,
        rig_seconds=rig_seconds,
        wall_seconds=wall_seconds,
        session=session,
        calibration=calibration,
        truth=None if placement is None or truth is None else _truth(placement, truth),
    )


def _alternative(item: Hypothesis, first: Hypothesis) -> AlternativeOut:
    same = item.state_index == first.state_index
    turned, moved = _displacement(first, item) if same else (None, None)
    return AlternativeOut(
        object=item.state.object_name,
        state=item.state.state.name,
        configuration=configuration_out(item.configuration),
        bounds=bounds_out(item.bounds),
        weight=item.weight,
        relation=Relation.SYMMETRY if same else Relation.TWIN,
        turned=turned,
        moved=moved,
    )


def _displacement(first: Hypothesis, other: Hypothesis) -> tuple[float, float]:
    """From one configuration of a state to another: turned (rad) and how far its centre of area is (mm).

    Of the turns that the state's symmetry makes equal, the smallest.
    """
    turn = 2 * math.pi / first.state.symmetry_order
    turned = other.configuration.theta_rad - first.configuration.theta_rad
    turned -= turn * round(turned / turn)
    return turned, math.dist(_centre(first), _centre(other))


def _centre(item: Hypothesis) -> tuple[float, float]:
    """Centre of area in W."""
    at, (u, v) = item.configuration, item.state.origin_mm.tolist()
    cos, sin = math.cos(at.theta_rad), math.sin(at.theta_rad)
    return at.x_mm + cos * u - sin * v, at.y_mm + sin * u + cos * v


def identification_picture(
    result: Identification, placement: Placement | None, rig: RigFile, facts: Sequence[tuple[str, str]]
) -> str:
    """SVG of a run: the object found, contacts, approaches, and what was ruled out when."""
    hypotheses = _hypotheses(result)
    others = [still_possible(item) for item in hypotheses[1:]]
    others += [
        picture.OtherHypothesis(item.state.object_name, f"ruled out by grip {grip}", rings_at(item))
        for grip, item in sorted(result.ruled_out, key=lambda pair: -pair[1].weight)
    ]
    first = hypotheses[0] if hypotheses else None
    name = (
        "nothing in the catalogue"
        if first is None
        else f"{first.state.object_name}, {first.state.state.name}"
    )
    truth: tuple[Floats, ...] = ()
    if placement is not None:
        truth = tuple(rings_of(placement, placement.state.sections[0]))
    return picture.draw(
        picture.Picture(
            title=f"{result.outcome.value.capitalize()}: {name}",
            subtitle=(f"rig {rig.name}",),
            found=() if first is None else rings_at(first),
            pose=None if first is None else pose_of(first),
            truth=truth,
            others=tuple(others),
            touches=tuple(
                touch_of(number, touch.contact)
                for number, grip in enumerate(result.grips, start=1)
                for touch in grip
            ),
            bases=tuple(picture.FingerBase(item.name, item.base_mm) for item in rig.fingers),
            workspace_radius_mm=rig.workspace.radius_mm,
            facts=tuple(facts),
        )
    )


def _hypotheses(result: Identification) -> Sequence[Hypothesis]:
    return () if result.recognition is None else result.recognition.hypotheses


def _truth(placement: Placement, found: Comparison) -> TruthOut:
    return TruthOut(
        object=placement.model.name,
        state=placement.state.name,
        configuration=configuration_out(found.configuration),
        named=found.hypothesis is not None,
        inside_bounds=found.inside_bounds,
        position_error_mm=found.position_error_mm,
        orientation_error_rad=found.orientation_error_rad,
    )
