"""Is enough known of a rig to tell parts apart with it? Between the rig file and `identify`."""

import math

from palpate.base.errors import InputError
from palpate.config import RigFile
from palpate.drivers.finger import Line
from palpate.rig.conversion import kinematics_of, tip_bound_mm
from palpate.rig.pads import has_pads

__all__ = ["check_known_well"]


def check_known_well(rig: RigFile, file: str | None) -> None:
    """Refuse a rig whose contacts may be further off than a tip's radius, or half a pad's width.

    `file`: where it is described, None: only its name is known.

    Nearly everything of a catalogue fits such contacts: the search would take minutes and find no answer.
    Raises InputError that says what to do.
    """
    name = f'rig "{rig.name}"' if file is None else file
    for finger in rig.fingers:
        kinematics = kinematics_of(finger)
        x, y = finger.base_mm
        middle = kinematics.servos_rad(Line((x, y), math.atan2(-y, -x)), math.hypot(x, y))
        off = kinematics.position_bound_mm(middle) + tip_bound_mm(finger)
        if off > finger.tip.radius_mm:  # an arm that does not get to the middle has no bound there
            size = "half its pad's width" if finger.tip.is_pad else "its tip's radius"
            remedy = (
                "measure it more finely (docs/rig-file.md, Measuring a rig with pads), and narrow its bounds"
                if has_pads(rig)
                else f"measure it with `palpate calibrate --rig {file or 'FILE'}`, or narrow its bounds "
                "if they hold"
            )
            raise InputError(
                f"{name}: by its bounds, contacts of finger {finger.name} may be off by {off:.1f} mm, more "
                f"than {size} ({finger.tip.radius_mm:g} mm): too little is known of this rig to identify "
                f"parts; {remedy}"
            )
