"""Skin of a tip against a part that may have moved: pressed, and sheared by friction.

The skin shears as long as it sticks, then slips: a spring along the surface at the contact, limited by
friction times the force normal to it (Mindlin's ratio of stiffnesses, 2 (1 − ν) / (2 − ν), is about 0.7 for
rubber; Johnson, Contact Mechanics, ch. 7). Where a tip touches in several places, it is one spring across the
sum of their forces.
"""

import math
from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

import numpy as np

from palpate.base.geometry import Floats
from palpate.drivers.emulators.part import Displacement, PointForce
from palpate.drivers.emulators.tip import PartSection, TipLoad, tip_load

_SHEAR_STIFFNESS_SHARE = 0.7


@dataclass(frozen=True, eq=False)
class Shear:
    """Skin that is sheared by `shear_mm` along a surface, with the tip's axis at `centre_mm` (2,) then.

    `turn_rad`: how far the part was turned. `force_n` (2,) on the tip, and where it acts: `point_mm` (2,).
    `angle_rad`: how far round the tip the skin is carried from where the contact is.
    """

    shear_mm: float
    centre_mm: Floats
    turn_rad: float
    force_n: Floats
    point_mm: Floats
    angle_rad: float


def shear_skin(
    before: Shear | None,
    load: TipLoad,
    centre_mm: Floats,
    turn_rad: float,
    *,
    radius_mm: float,
    stiffness_n_per_mm: float,
    friction: float,
) -> Shear:
    """The skin after the tip has moved from `before` to `centre_mm`, without turning itself.

    `load`: what presses on it there; `before`: None for a tip that did not touch.
    """
    normal_n = math.hypot(*load.force_n)
    normal = load.force_n / max(normal_n, 1e-12)
    along = np.array([-normal[1], normal[0]])
    from_axis_mm = radius_mm - normal_n / stiffness_n_per_mm
    shear = 0.0
    if before is not None:
        shear = before.shear_mm + float(along @ (centre_mm - before.centre_mm))
        shear += from_axis_mm * (turn_rad - before.turn_rad)
    stiffness = _SHEAR_STIFFNESS_SHARE * stiffness_n_per_mm
    most = friction * normal_n / stiffness
    shear = min(max(shear, -most), most)
    return Shear(
        shear,
        centre_mm,
        turn_rad,
        -stiffness * shear * along,
        centre_mm - from_axis_mm * normal,
        -shear / radius_mm,
    )


class SkinLoad(Protocol):
    """Load on a tip's skin, in W: on a disc's (`TipLoad`) or a pad's (`FaceLoad`)."""

    @property
    def force_n(self) -> Floats:
        """The whole force (2,) N on the tip."""
        ...

    @property
    def on_skin_n(self) -> Floats:
        """Force on each place of the skin (m,)."""
        ...

    def point_mm(self, centre_mm: Floats, /) -> Floats:
        """Point at which the force acts (2,), with the tip's middle at `centre_mm` (2,)."""
        ...

    def height_mm(self, middle_mm: float, /) -> float:
        """Height at which it acts, with the tip's middle at `middle_mm`."""
        ...


@dataclass(frozen=True, eq=False)
class SkinLoads:
    """Loads of two or more parts on one tip."""

    loads: tuple[SkinLoad, ...]

    @property
    def force_n(self) -> Floats:
        """The whole force (2,) N on the tip."""
        result: Floats = np.sum([load.force_n for load in self.loads], axis=0)
        return result

    @property
    def on_skin_n(self) -> Floats:
        """Force on each place of the skin (m,), part after part."""
        return np.concatenate([load.on_skin_n for load in self.loads])


_L_co = TypeVar("_L_co", bound=SkinLoad, covariant=True)


@dataclass(frozen=True, eq=False)
class Press(Generic[_L_co]):
    """Press on a tip, in W; `load` has the skin's shear in it, `shear` is in the part's frame."""

    load: _L_co
    shear: Shear | None

    def on_part(self, centre_mm: Floats, displacement: Displacement, height_mm: float) -> list[PointForce]:
        """The same, as forces on the part; `centre_mm` (2,): the tip's axis in W.

        At `height_mm`, the tip's middle; or, where the part is not upright, where its sections press.
        """
        height_mm, at_mm = self.load.height_mm(height_mm), self.load.point_mm(centre_mm)
        if self.shear is None:
            return [PointForce(at_mm, height_mm, -self.load.force_n)]
        drag, point = displacement.rotate(self.shear.force_n), displacement.place(self.shear.point_mm)
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
        """Press of the part at a displacement on the tip; None if it does not touch it.

        `outline`: of the part as it was put; `centre_mm` (2,): the tip's axis in W; `before`: its shear then.
        """
        centre = displacement.back(centre_mm)
        load = tip_load(outline, centre, self.radius_mm, self.stiffness_n_per_mm)
        if load is None:
            return None
        shear = None
        if self.friction:
            shear = shear_skin(
                before,
                load,
                centre,
                displacement.turn_rad,
                radius_mm=self.radius_mm,
                stiffness_n_per_mm=self.stiffness_n_per_mm,
                friction=self.friction,
            )
            load = load.rotate(load.force_n + shear.force_n, shear.angle_rad)
        if not displacement.is_none:
            load = load.rotate(displacement.rotate(load.force_n), displacement.turn_rad)
        return Press(load, shear)
