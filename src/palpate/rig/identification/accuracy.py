"""Accuracy of a rig: what is too coarse to identify parts by, and what the bounds of an answer come from."""

from collections.abc import Sequence

from palpate.base.errors import InputError
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


def check_accuracy(rig: RigFile, file: str | None) -> None:
    """Refuse a rig whose contacts may be further off than a tip's radius, or half a pad's width.

    `file`: where it is described, None: only its name is known.

    Nearly everything of a catalogue fits such contacts: the search would take minutes and find no answer.
    Raises InputError that says what to do.
    """
    name = f'rig "{rig.name}"' if file is None else file
    for finger in rig.fingers:
        off = mechanism_of(finger).middle_bound_mm + tip_bound_mm(finger)
        if off > finger.tip.radius_mm:  # an arm that does not get to the middle has no bound there
            remedy = (
                "measure it more finely (docs/pads.md), and narrow its bounds"
                if rig.why_not("calibrate")
                else f"measure it with `palpate calibrate --rig {file or 'FILE'}`, or narrow its bounds "
                "if they hold"
            )
            known = finger.replace_in_tables(bounds={"encoder_deg": 0.0})
            encoders = off - mechanism_of(known).middle_bound_mm - tip_bound_mm(known)
            raise InputError(
                f"{name}: by its bounds, contacts of finger {finger.name} may be off by {off:.1f} mm, more "
                f"than {finger.tip.kind.radius_words} ({finger.tip.radius_mm:g} mm), {encoders:.1f} mm of it "
                f"through its servos' encoders (bounds.encoder_deg): too little is known of this rig to "
                f"identify parts; {remedy}"
            )


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
