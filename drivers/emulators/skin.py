"""Skin of a tip against a part that may have been moved: worked out in the part's frame, and turned back."""

from dataclasses import dataclass

from palpate.drivers.emulators.part import Displacement, PointForce
from palpate.drivers.emulators.tip import PartSection, TipLoad, tip_load
from palpate.drivers.emulators.tip_friction import Shear, sheared
from palpate.geometry import Floats

__all__ = ["Press", "Skin"]


@dataclass(frozen=True, eq=False)
class Press:
    """What presses on a tip, in W; `load` has the skin's shear in it, `shear` is in the part's frame."""

    load: TipLoad
    shear: Shear | None

    def on_part(self, centre_mm: Floats, displacement: Displacement, height_mm: float) -> list[PointForce]:
        """The same, as forces on the part; `centre_mm` (2,): the tip's axis in W.

        At `height_mm`, the tip's middle; or, where the part is not upright, where its sections press.
        """
        height_mm = self.load.height_mm(height_mm)
        if self.shear is None:
            return [PointForce(centre_mm, height_mm, -self.load.force_n)]
        drag, point = displacement.turned(self.shear.force_n), displacement.place(self.shear.point_mm)
        return [
            PointForce(centre_mm, height_mm, drag - self.load.force_n),
            PointForce(point, height_mm, -drag),
        ]


@dataclass(frozen=True)
class Skin:
    """Compliant skin of a cylindrical tip, with dry friction on what it touches."""

    radius_mm: float
    stiffness_n_per_mm: float
    friction: float = 0.0

    def press(
        self, outline: PartSection, centre_mm: Floats, displacement: Displacement, before: Shear | None
    ) -> Press | None:
        """What the part at a displacement does to the tip; None if it does not touch it.

        `outline`: of the part as it was put; `centre_mm` (2,): the tip's axis in W; `before`: its shear then.
        """
        centre = displacement.back(centre_mm)
        load = tip_load(outline, centre, self.radius_mm, self.stiffness_n_per_mm)
        if load is None:
            return None
        shear = None
        if self.friction:
            shear = sheared(
                before,
                load,
                centre,
                displacement.turn_rad,
                radius_mm=self.radius_mm,
                stiffness_n_per_mm=self.stiffness_n_per_mm,
                friction=self.friction,
            )
            load = load.turned(load.force_n + shear.force_n, shear.angle_rad)
        if not displacement.is_none:
            load = load.turned(displacement.turned(load.force_n), displacement.turn_rad)
        return Press(load, shear)
