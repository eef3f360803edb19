"""What palpate does not do with pads, said in one line before anything moves."""

from collections.abc import Sequence

from palpate.base.errors import InputError
from palpate.base.geometry import ObjectModel
from palpate.config import RigFile

__all__ = ["has_pads", "refuse_pads", "refuse_parts_that_move"]


def has_pads(rig: RigFile) -> bool:
    """Whether some finger has a pad: such a rig is measured by hand, and not calibrated."""
    return any(finger.tip.is_pad for finger in rig.fingers)


def refuse_pads(rig: RigFile, why: str) -> None:
    """Raise InputError that names the first finger with a pad, and says why not; nothing for other rigs."""
    for finger in rig.fingers:
        if finger.tip.is_pad:
            raise InputError(f"finger {finger.name}: its tip is a pad, and {why}")


def refuse_parts_that_move(rig: RigFile, models: Sequence[ObjectModel]) -> None:
    """Raise InputError for objects of which it is declared that fingers move them, on a rig with pads."""
    moved = [model.name for model in models if model.holds_n is not None]
    if moved:
        refuse_pads(
            rig,
            f'object "{moved[0]}" declares part_holds_n, and how pads move parts is not known: hold parts '
            "down, and leave that out",
        )
