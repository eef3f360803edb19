"""Bounds of an answer by their sources: contacts as the rig measured them, and motions of the part since."""

from collections.abc import Sequence

from palpate.base.vocabulary import BoundSource
from palpate.config import RigFile
from palpate.recognizer import (
    Catalogue,
    HalfWidths,
    MeasuredContact,
    Motion,
    Recognition,
    widths_without_source,
)
from palpate.rig.conversion import tip_bound_mm
from palpate.rig.fingers import Stage
from palpate.rig.identification.motion_bounds import GripMotion
from palpate.rig.mechanisms import mechanism_of
from palpate.rig.motion.touch import Touch


def widths_by_source(
    rig: RigFile,
    catalogue: Catalogue,
    recognition: Recognition,
    grips: Sequence[tuple[Sequence[Touch], GripMotion]],
) -> dict[BoundSource, HalfWidths]:
    """Half-widths of the first hypothesis's bounds if one source were nil, by sources that matter.

    `grips`: those that the recognition rests on, with what they may have moved. Empty where that is not
    known: for round states, and for pads, whose contacts are bounded otherwise.
    """
    if not recognition.hypotheses or any(finger.tip.kind.has_face for finger in rig.fingers):
        return {}
    found = recognition.hypotheses[0]
    contacts: list[MeasuredContact] = []
    since: Motion | None = None
    for touches, motion in reversed(grips):
        since = motion.after if since is None else motion.after + since
        shift, turn = (float(item[found.state_index]) for item in (since.shift_mm, since.turn_rad))
        contacts += [
            MeasuredContact(touch.contact, _dent_mm(rig, touch), shift, turn)
            for touch in touches
            if touch.contact.touched
        ]
        since = motion.before + since
    return widths_without_source(catalogue, found, contacts)


def _dent_mm(rig: RigFile, touch: Touch) -> float:
    """Part of a contact's bound that the touch adds to where its finger is; 0 where that is not known."""
    finger = rig.fingers[touch.finger_index]
    kinematics, turn = mechanism_of(finger).kinematics, Stage.of(rig).planned_turn(touch.stage_rad)
    centre = kinematics.position_bound_mm(touch.servos)
    centre += turn.position_bound_mm(kinematics.centre_mm(touch.servos)) + tip_bound_mm(finger)
    dent = touch.contact.position_bound_mm - centre
    return dent if dent > 0 else 0.0
