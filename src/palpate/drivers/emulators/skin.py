"""Skin of a tip against a part that may have been moved: worked out in the part's frame, and turned back."""

from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

from palpate.base.geometry import Floats
from palpate.drivers.emulators.part import Displacement, PointForce
from palpate.drivers.emulators.tip import PartSection, TipLoad, tip_load
from palpate.drivers.emulators.tip_friction import Shear, sheared

__all__ = ["Load", "Press", "Skin"]


class Load(Protocol):
    """What presses on a tip's skin, in W: on a disc's (`TipLoad`) or a pad's (`FaceLoad`)."""

    @property
    def force_n(self) -> Floats:
        """The whole force (2,) N on the tip."""
        ...

    @property
    def on_skin_n(self) -> Floats:
        """What presses on each place of the skin (m,)."""
        ...

    def point_mm(self, centre_mm: Floats, /) -> Floats:
        """Where the force acts (2,), with the tip's middle at `centre_mm` (2,)."""
        ...

    def height_mm(self, middle_mm: float, /) -> float:
        """How high it acts, with the tip's middle at `middle_mm`."""
        ...


_L_co = TypeVar("_L_co", bound=Load, covariant=True)


@dataclass(frozen=True, eq=False)
class Press(Generic[_L_co]):
    """What presses on a tip, in W; `load` has the skin's shear in it, `shear` is in the part's frame."""

    load: _L_co
    shear: Shear | None

    def on_part(self, centre_mm: Floats, displacement: Displacement, height_mm: float) -> list[PointForce]:
        """The same, as forces on the part; `centre_mm` (2,): the tip's axis in W.

        At `height_mm`, the tip's middle; or, where the part is not upright, where its sections press.
        """
        height_mm, at_mm = self.load.height_mm(height_mm), self.load.point_mm(centre_mm)
        if self.shear is None:
            return [PointForce(at_mm, height_mm, -self.load.force_n)]
        drag, point = displacement.turned(self.shear.force_n), displacement.place(self.shear.point_mm)
        return [
            PointForce(at_mm, height_mm, drag - self.load.force_n),
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
    ) -> Press[TipLoad] | None:
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
