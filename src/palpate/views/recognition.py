"""Recognitions and identifications as JSON, as pictures, and their contacts as a file."""

from collections.abc import Sequence

from palpate.base.geometry import Floats
from palpate.base.geometry.outlines import rings_of
from palpate.base.tips import TipShape
from palpate.config import RigFile
from palpate.config.recognition_results import HypothesisOut, InterpretationOut, RecognitionOut, StatisticsOut
from palpate.recognizer import Bounds, Configuration, Contact, Hypothesis, MemoCounts, Recognition
from palpate.rig.emulated.scene import Placement, shape_of
from palpate.rig.identification.loop import Identification
from palpate.rig.identification.result import hypotheses_of, state_names, unfinished_out
from palpate.views.run_scene import placed_rings
from palpate.views.table_picture import picture, values


def recognition_out(
    recognition: Recognition, seconds: float, memo: MemoCounts | None = None
) -> RecognitionOut:
    """The recognition as `palpate/recognition@1`; `seconds` is what it took."""
    return RecognitionOut(
        verdict=recognition.verdict,
        hypotheses=tuple(hypothesis_out(item) for item in recognition.hypotheses),
        statistics=StatisticsOut(
            levels=recognition.levels,
            model_tests=sum(level.after_distance for level in recognition.levels[1:]),
            seconds=seconds,
            memo=memo,
        ),
        unfinished=unfinished_out(recognition),
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
        values.Picture(
            title=title,
            subtitle=(_verdict_line(recognition),),
            found=rings_at(hypotheses[0]) if hypotheses else (),
            pose=bounded_pose(hypotheses[0].configuration, hypotheses[0].bounds) if hypotheses else None,
            others=tuple(other_hypothesis(item) for item in hypotheses[1:]),
            touches=tuple(touch_mark(1, contact) for contact in recognition.contacts),
        )
    )


def hypothesis_out(item: Hypothesis) -> HypothesisOut:
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


def _contact(contact: Contact) -> dict[str, object]:
    approach: dict[str, object] = {"direction": contact.direction_rad, "start": list(contact.start_mm)}
    entry: dict[str, object] = {
        "finger": contact.name,
        "touched": contact.touched,
        "height": contact.finger.height_mm,
        "tip_radius": contact.finger.tip_radius_mm,
        "position_bound": contact.position_bound_mm,
    }
    if contact.finger.half_length_mm:
        entry["tip_length"] = 2 * contact.finger.half_length_mm
    if contact.finger.shape is not TipShape.CYLINDER:
        entry["tip_shape"] = str(contact.finger.shape)
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


def bounded_pose(at: Configuration, bounds: Bounds) -> values.BoundedPose:
    """A configuration with its bounds, for a picture."""
    return values.BoundedPose(
        (at.x_mm, *bounds.x_mm), (at.y_mm, *bounds.y_mm), (at.theta_rad, *bounds.theta_rad)
    )


def other_hypothesis(item: Hypothesis) -> values.OtherHypothesis:
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
    result: Identification, placement: Placement | None, rig: RigFile, facts: Sequence[tuple[str, str]]
) -> str:
    """SVG of a run: the object found, contacts, approaches, and what was ruled out when."""
    hypotheses = hypotheses_of(result)
    others = [other_hypothesis(item) for item in hypotheses[1:]]
    others += [
        values.OtherHypothesis(item.state.object_name, f"ruled out by grip {grip}", rings_at(item))
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
        truth = tuple(rings_of(shape_of(placement, placement.state.sections[0])))
    return picture.draw(
        values.Picture(
            title=f"{result.outcome.value.capitalize()}: {name}",
            subtitle=(f"rig {rig.name}",),
            found=() if first is None else rings_at(first),
            pose=None if first is None else bounded_pose(first.configuration, first.bounds),
            truth=truth,
            others=tuple(others),
            touches=tuple(
                touch_mark(number, touch.contact, touch.touched_points)
                for number, grip in enumerate(result.grips, start=1)
                for touch in grip
            ),
            bases=tuple(values.FingerBase(item.name, item.base_mm) for item in rig.fingers),
            workspace_radius_mm=rig.workspace.radius_mm,
            facts=tuple(facts),
        )
    )
