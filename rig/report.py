"""A recognition or a run as JSON values, a picture, a contacts file. The end of the data's way."""

import math
from collections.abc import Sequence

import numpy as np

from palpate.config import RigFile
from palpate.config.results import (
    AlternativeOut,
    BoundsOut,
    ConfigurationOut,
    HypothesisOut,
    IdentificationOut,
    IdentificationVerdict,
    InterpretationOut,
    LevelOut,
    MemoOut,
    RecognitionOut,
    RecognitionVerdict,
    SlideOut,
    StatisticsOut,
    TruthOut,
)
from palpate.recognizer import Bounds, Configuration, Contact, Hypothesis, Recognition, State
from palpate.recognizer.arrays import Floats
from palpate.recognizer.statistics import MemoCounts
from palpate.rig import picture
from palpate.rig.identify import Identification
from palpate.rig.scene import Placement, rings_of
from palpate.rig.truth import Comparison, compare

__all__ = [
    "contacts_json",
    "hypothesis_out",
    "identification_out",
    "identification_picture",
    "recognition_out",
    "recognition_picture",
]


def recognition_out(
    recognition: Recognition, seconds: float, memo: MemoCounts | None = None
) -> RecognitionOut:
    """The recognition as `palpate/recognition@1`; `seconds` is what it took."""
    return RecognitionOut(
        verdict=RecognitionVerdict(recognition.verdict.value),
        hypotheses=tuple(hypothesis_out(item) for item in recognition.hypotheses),
        statistics=StatisticsOut(
            levels=tuple(
                LevelOut(
                    level=level.level,
                    candidates=level.candidates,
                    after_distance=level.after_distance,
                    after_angle=level.after_angle,
                )
                for level in recognition.levels
            ),
            model_tests=sum(level.after_distance for level in recognition.levels[1:]),
            seconds=seconds,
            memo=memo and MemoOut(distance_first=memo.distance_first, angle_first=memo.angle_first),
        ),
    )


def identification_out(
    result: Identification,
    placement: Placement | None,
    *,
    emulated: bool,
    rig_seconds: float,
    wall_seconds: float,
    session: str | None,
) -> IdentificationOut:
    """A run's result as `palpate/identification@1`: the heaviest hypothesis first, the others beside it."""
    hypotheses = _hypotheses(result)
    first = hypotheses[0] if hypotheses else None
    truth = None if placement is None else compare(placement, hypotheses)
    return IdentificationOut(
        verdict=IdentificationVerdict(result.outcome.value),
        object=first and first.state.object_name,
        state=first and first.state.state.name,
        configuration=None if first is None else _configuration(first.configuration),
        bounds=None if first is None else _bounds(first.bounds),
        alternatives=tuple(
            AlternativeOut(
                object=item.state.object_name,
                state=item.state.state.name,
                configuration=_configuration(item.configuration),
                bounds=_bounds(item.bounds),
                weight=item.weight,
            )
            for item in hypotheses[1:]
        ),
        symmetry_order=1 if first is None else first.state.symmetry_order,
        grips=len(result.grips),
        touches=result.touches,
        emulated=emulated,
        rig_seconds=rig_seconds,
        wall_seconds=wall_seconds,
        session=session,
        truth=None if placement is None or truth is None else _truth(placement, truth),
    )


def contacts_json(grips: Sequence[Sequence[Contact]]) -> dict[str, object]:
    """Contacts as `palpate/contacts@1`, for `palpate recognize`."""
    return {
        "format": "palpate/contacts@1",
        "units": "mm, rad",
        "grips": [{"contacts": [_contact(contact) for contact in grip]} for grip in grips],
    }


def recognition_picture(recognition: Recognition, title: str) -> str:
    """SVG of a recognition without a rig."""
    hypotheses = recognition.hypotheses
    return picture.draw(
        picture.Picture(
            title=title,
            subtitle=(_verdict_line(recognition),),
            found=_rings(hypotheses[0]) if hypotheses else (),
            pose=_pose(hypotheses[0]) if hypotheses else None,
            others=tuple(_still_possible(item) for item in hypotheses[1:]),
            touches=tuple(_touch(1, contact) for contact in recognition.contacts),
        )
    )


def identification_picture(
    result: Identification, placement: Placement | None, rig: RigFile, facts: Sequence[tuple[str, str]]
) -> str:
    """SVG of a run: the object found, contacts, approaches, and what was ruled out when."""
    hypotheses = _hypotheses(result)
    others = [_still_possible(item) for item in hypotheses[1:]]
    others += [
        picture.OtherHypothesis(item.state.object_name, f"ruled out by grip {grip}", _rings(item))
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
            found=() if first is None else _rings(first),
            pose=None if first is None else _pose(first),
            truth=truth,
            others=tuple(others),
            touches=tuple(
                _touch(number, touch.contact)
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


def hypothesis_out(item: Hypothesis) -> HypothesisOut:
    """One hypothesis as a JSON value."""
    return HypothesisOut(
        object=item.state.object_name,
        state=item.state.state.name,
        configuration=_configuration(item.configuration),
        bounds=_bounds(item.bounds),
        weight=item.weight,
        verified=item.verified,
        symmetry_order=item.state.symmetry_order,
        interpretations=tuple(
            InterpretationOut(
                edges=tuple(None if k is None else _edge(k) for k in row),
                features=tuple(None if k is None else _feature(k) for k in row),
            )
            for row in item.features
        ),
        spurious=item.spurious,
        slide=item.slide and SlideOut(direction=item.slide.direction_rad, extent=item.slide.extent_mm),
    )


def _edge(feature: int) -> int:
    """The edge that a feature belongs to; an arc about a vertex, to the edge that begins there."""
    return feature if feature >= 0 else -1 - feature


def _feature(feature: int) -> str:
    return f"edge {feature}" if feature >= 0 else f"vertex {_edge(feature)}"


def _configuration(value: Configuration) -> ConfigurationOut:
    return ConfigurationOut(x=value.x_mm, y=value.y_mm, theta=value.theta_rad)


def _bounds(value: Bounds) -> BoundsOut:
    return BoundsOut(x=value.x_mm, y=value.y_mm, theta=value.theta_rad)


def _truth(placement: Placement, found: Comparison) -> TruthOut:
    return TruthOut(
        object=placement.model.name,
        state=placement.state.name,
        configuration=_configuration(found.configuration),
        named=found.hypothesis is not None,
        inside_bounds=found.inside_bounds,
        position_error_mm=found.position_error_mm,
        orientation_error_rad=found.orientation_error_rad,
    )


def _contact(contact: Contact) -> dict[str, object]:
    approach: dict[str, object] = {"direction": contact.direction_rad, "start": list(contact.start_mm)}
    entry: dict[str, object] = {
        "finger": contact.name,
        "touched": contact.touched,
        "height": contact.finger.height_mm,
        "tip_radius": contact.finger.tip_radius_mm,
        "position_bound": contact.position_bound_mm,
    }
    if contact.path_bound_mm is not None:
        entry["path_bound"] = contact.path_bound_mm
    if contact.touched:
        entry["centre"] = list(contact.end_mm)
        if contact.normal is not None:
            entry["normal"] = [contact.normal.lo_rad, contact.normal.hi_rad]
    else:
        approach["end"] = list(contact.end_mm)
    return entry | {"approach": approach}


def _verdict_line(recognition: Recognition) -> str:
    touched = sum(contact.touched for contact in recognition.contacts)
    return f"{recognition.verdict.value}: {len(recognition.hypotheses)} hypotheses after {touched} contacts"


def _pose(item: Hypothesis) -> picture.Pose:
    at, bounds = item.configuration, item.bounds
    return picture.Pose((at.x_mm, *bounds.x_mm), (at.y_mm, *bounds.y_mm), (at.theta_rad, *bounds.theta_rad))


def _still_possible(item: Hypothesis) -> picture.OtherHypothesis:
    return picture.OtherHypothesis(
        item.state.object_name, f"still possible, {100 * item.weight:.0f} %", _rings(item)
    )


def _rings(item: Hypothesis) -> tuple[Floats, ...]:
    """Outlines of the lowest section, in W, at the hypothesis's configuration."""
    at = item.configuration
    turn = np.array(
        [[math.cos(at.theta_rad), -math.sin(at.theta_rad)], [math.sin(at.theta_rad), math.cos(at.theta_rad)]]
    )
    return tuple(ring @ turn.T + [at.x_mm, at.y_mm] for ring in _lowest_rings(item.state.state))


def _lowest_rings(state: State) -> list[Floats]:
    section = min(state.sections, key=lambda part: part.z_lo_mm)
    return [ring for polygon in section.polygons for ring in (polygon.outer, *polygon.holes)]


def _touch(grip: int, contact: Contact) -> picture.Touch:
    normal = contact.normal
    return picture.Touch(
        contact.name,
        grip,
        contact.start_mm,
        contact.end_mm,
        contact.finger.tip_radius_mm,
        contact.touched,
        None if normal is None else (normal.lo_rad, normal.hi_rad),
    )
