"""Finger model of a rig for comparing parts: heights, tip radii and the bound on contacts."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from palpate.base.errors import InputError
from palpate.base.vocabulary import TipShape
from palpate.config import FingerConfig, RigFile
from palpate.drivers.finger import Line
from palpate.rig.conversion import dent_allowance_mm, kinematics_of, tip_bound_mm
from palpate.rig.turning_stage import planned_turn

__all__ = ["AtHeight", "RigFingers", "at_heights", "contact_bound_mm", "heights_in_words", "rig_fingers"]


@dataclass(frozen=True)
class AtHeight:
    """The fingers at one height over the support plane; `tip_radius_mm` is that of the slimmest.

    Their tips reach `half_length_mm` above it and below: of tips of other lengths there is another value. So
    there is of balls of another radius, and of pads, each of which counts as a disc as wide as it is.
    """

    height_mm: float
    tip_radius_mm: float
    fingers: tuple[str, ...]
    half_length_mm: float = 0.0
    shape: TipShape = TipShape.CYLINDER

    @property
    def is_ball(self) -> bool:
        """Whether the tips are balls."""
        return self.shape is TipShape.BALL

    @property
    def span_mm(self) -> tuple[float, float]:
        """Heights (from, to) of the tips' lower and upper ends."""
        return self.height_mm - self.half_length_mm, self.height_mm + self.half_length_mm


@dataclass(frozen=True)
class RigFingers:
    """Fingers by height, ascending. `bound_mm`: a contact is nowhere further off than this."""

    rig_name: str
    at: tuple[AtHeight, ...]
    bound_mm: float

    @property
    def slimmest_mm(self) -> float:
        """Radius of the slimmest tip of the rig."""
        return min(item.tip_radius_mm for item in self.at)

    @property
    def all_balls(self) -> bool:
        """Whether no tip of the rig is upright."""
        return all(item.is_ball for item in self.at)

    def another(self, height_mm: float) -> AtHeight:
        """One more finger at a height, with the slimmest, shortest upright tip, or else the smallest ball."""
        kinds = [item for item in self.at if item.is_ball == self.all_balls]
        radius, half = min(item.tip_radius_mm for item in kinds), min(item.half_length_mm for item in kinds)
        shape = TipShape.BALL if self.all_balls else TipShape.CYLINDER
        return AtHeight(height_mm, radius, ("",), half, shape)


def rig_fingers(rig: RigFile) -> RigFingers:
    """The rig's fingers, with the largest bound of a contact that the rig makes about its middle.

    Raises InputError if no finger gets to the middle: there is no such bound then.
    """
    bound_mm = contact_bound_mm(rig)
    if bound_mm is None:
        raise InputError(
            f"rig {rig.name}: no finger gets to the middle of the table (0, 0), so how far off contacts may "
            "be is not known; check base_mm and the fingers' ranges"
        )
    return RigFingers(rig.name, at_heights(rig), bound_mm)


def contact_bound_mm(rig: RigFile) -> float | None:
    """Largest bound of a contact about the middle of the table; None if no finger gets there."""
    bounds = [_bound_mm(finger, rig) for finger in rig.fingers]
    return max((bound for bound in bounds if math.isfinite(bound)), default=None)


def at_heights(rig: RigFile) -> tuple[AtHeight, ...]:
    """The rig's fingers by height, ascending."""
    alike: dict[tuple[float, float, TipShape], list[FingerConfig]] = {}
    for finger in rig.fingers:
        key = finger.height_mm, finger.tip.half_height_mm, TipShape(finger.tip.shape)
        alike.setdefault(key, []).append(finger)
    at = []
    for (height, half, shape), here in sorted(alike.items(), key=lambda item: item[0]):
        slimmest = min(finger.tip.radius_mm for finger in here)
        at.append(AtHeight(height, slimmest, tuple(finger.name for finger in here), half, shape))
    return tuple(at)


def heights_in_words(at: Sequence[AtHeight]) -> str:
    """Such as "10 mm (f1, f2) and 25 mm (f3)"."""
    words = [f"{item.height_mm:g} mm ({', '.join(item.fingers)})" for item in at]
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} and {words[-1]}"


def _bound_mm(finger: FingerConfig, rig: RigFile) -> float:
    """Bound of a contact in the middle of the table, of all that adds to it; infinite out of reach."""
    kinematics = kinematics_of(finger)
    x, y = finger.base_mm
    servos = kinematics.servos_rad(Line((x, y), math.atan2(-y, -x)), math.hypot(x, y))
    own = kinematics.position_bound_mm(servos) + planned_turn(rig.stage, 0.0).position_bound_mm((0.0, 0.0))
    return own + dent_allowance_mm(finger, rig.closing) + tip_bound_mm(finger)
