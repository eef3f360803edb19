"""Tips that are driven along given ways against an emulated part, in the emulated bench's engines.

The bench without its devices: no servos, arrays, bytes or frames. Where tips are is given, what they press
with and where the part slides come out.
"""

import math
from collections.abc import Sequence

import numpy as np

from palpate.base.geometry import Floats
from palpate.drivers.emulators.part import Displacement, Part, PointForce
from palpate.drivers.emulators.skin import Press, Skin
from palpate.drivers.emulators.tip import PartSection, TipLoad, separation_mm

__all__ = ["DrivenTip", "DrivenTips"]

_NOWHERE = np.full(2, np.inf)


class DrivenTip:
    """One tip, against the outline of a part at its height, as it was put; None for nothing."""

    def __init__(self, skin: Skin, height_mm: float, outline: PartSection | None) -> None:
        self.skin = skin
        self.press: Press[TipLoad] | None = None
        self._height_mm, self._outline = height_mm, outline
        self._centre = _NOWHERE
        self._before: Press[TipLoad] | None = None
        self._found: dict[tuple[float, ...], Press[TipLoad] | None] = {}  # of this step

    @property
    def force_n(self) -> float:
        """What its taxels bear together."""
        return 0.0 if self.press is None else float(self.press.load.by_ray_n.sum())

    def move_to(self, centre_mm: Floats) -> None:
        """Be elsewhere (2,), in W."""
        self._centre, self._before = centre_mm, self.press
        self._found.clear()

    def gap_mm(self, displacement: Displacement) -> float:
        """How far it is from touching the part; negative where it does."""
        if self._outline is None:
            return math.inf
        return separation_mm(self._outline, displacement.back(self._centre)) - self.skin.radius_mm

    def meet(self, displacement: Displacement) -> None:
        """Meet the part where it has come to lie."""
        self.press = self._press(displacement)

    def forces_on(self, displacement: Displacement) -> list[PointForce]:
        """What it would do to the part at a displacement."""
        found = self._press(displacement)
        return [] if found is None else found.on_part(self._centre, displacement, self._height_mm)

    def _press(self, displacement: Displacement) -> Press[TipLoad] | None:
        if self._outline is None:
            return None
        place = (*displacement.shift_mm.tolist(), displacement.turn_rad)
        if place not in self._found:
            shear = None if self._before is None else self._before.shear
            found = self.skin.press(self._outline, self._centre, displacement, shear)
            self._found[place] = found
        return self._found[place]


class DrivenTips:
    """All tips and the part, in one time."""

    def __init__(self, part: Part, tips: Sequence[DrivenTip]) -> None:
        self.part, self.tips = part, tuple(tips)
        self._at_rest = True

    @property
    def displacement(self) -> Displacement:
        """How far the part has been moved."""
        return self.part.displacement

    @property
    def is_at_rest(self) -> bool:
        """Whether nothing has moved the part in the last step."""
        return self._at_rest

    def step(self, centres_mm: Sequence[Floats], dt_s: float) -> None:
        """Bring the tips to where they are then, (2,) each, and let the part give way."""
        before = self.part.displacement
        for tip, centre in zip(self.tips, centres_mm, strict=True):
            tip.move_to(centre)
            tip.meet(before)
        touched = any(tip.press is not None for tip in self.tips)
        self.part.step(self._forces, touched, dt_s)
        self._at_rest = self.part.displacement is before
        if not self._at_rest:
            for tip in self.tips:
                tip.meet(self.part.displacement)

    def _forces(self, displacement: Displacement) -> list[PointForce]:
        return [force for tip in self.tips for force in tip.forces_on(displacement)]
