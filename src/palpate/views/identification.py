"""Picture of an identification: the object found, contacts, approaches, and what each grip eliminated."""

from collections.abc import Sequence

from palpate.base.geometry import Floats
from palpate.config import RigFile
from palpate.rig.emulated.scene import Placement, rings_of
from palpate.rig.identification.loop import Identification
from palpate.rig.identification.result import hypotheses_of
from palpate.views.recognition import bounded_pose, other_hypothesis, rings_at, touch_mark
from palpate.views.table_picture import picture

__all__ = ["identification_picture"]


def identification_picture(
    result: Identification, placement: Placement | None, rig: RigFile, facts: Sequence[tuple[str, str]]
) -> str:
    """SVG of a run: the object found, contacts, approaches, and what was ruled out when."""
    hypotheses = hypotheses_of(result)
    others = [other_hypothesis(item) for item in hypotheses[1:]]
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
            pose=None if first is None else bounded_pose(first),
            truth=truth,
            others=tuple(others),
            touches=tuple(
                touch_mark(number, touch.contact, touch.touched_points)
                for number, grip in enumerate(result.grips, start=1)
                for touch in grip
            ),
            bases=tuple(picture.FingerBase(item.name, item.base_mm) for item in rig.fingers),
            workspace_radius_mm=rig.workspace.radius_mm,
            facts=tuple(facts),
        )
    )
