"""An elastic flat pad against outlines: from the position of its face to the normal and tangential forces.

The skin is an elastic foundation that yields along the travel only, without friction: each place of the face
is dented as far as the part reaches beyond it. What presses on a stretch of touched skin is its stiffness
times its dents' rises, summed from one end of the stretch to the other: of a single corner or a flat wall
that is the deepest dent, of two corners with a valley between them both dents less the valley's. So the force
has no jumps where stretches meet. Along a stretch it is spread in proportion to the dents.
"""

import math
from dataclasses import dataclass

import numpy as np

from palpate.base.geometry import Floats
from palpate.drivers.emulators.part import Displacement
from palpate.drivers.emulators.skin import Press
from palpate.drivers.emulators.tip import PartSection

_DENT_SPACING_MM = 0.02  # of the places at which dents are taken; corners have their own
_MAX_DENT_MM = 2.0  # deeper than any dent
_SKIN_DEPTH_MM = 10.0  # what is further behind the face is no longer in its skin


@dataclass(frozen=True, eq=False)
class FaceLoad:
    """Load on a face, in W: `by_place_n` (m,) N at `across_mm` (m,), to the left of its middle."""

    force_n: Floats
    across_mm: Floats
    by_place_n: Floats

    @property
    def on_skin_n(self) -> Floats:
        """Force on the skin at each place (m,)."""
        return self.by_place_n

    def point_mm(self, centre_mm: Floats) -> Floats:
        """Point at which the force acts: the middle of the load."""
        across = float(np.average(self.across_mm, weights=self.by_place_n))
        ahead = -self.force_n / max(math.hypot(*self.force_n), 1e-12)
        result: Floats = centre_mm + across * np.array([-ahead[1], ahead[0]])
        return result

    def height_mm(self, middle_mm: float) -> float:
        """Height of the force: that of the face's middle."""
        return middle_mm

    def by_column_n(self, column_mm: Floats) -> Floats:
        """Load of each of some evenly spaced columns of taxels (c,), which cover all of the face."""
        pitch, result = float(column_mm[1] - column_mm[0]), np.zeros(len(column_mm))
        slot = np.floor((self.across_mm - column_mm[0]) / pitch + 0.5).astype(np.int64)
        np.add.at(result, np.clip(slot, 0, len(column_mm) - 1), self.by_place_n)
        return result


@dataclass(frozen=True)
class PadFace:
    """A pad's face, `half_mm` wide to either side of its middle."""

    half_mm: float
    stiffness_n_per_mm: float

    @property
    def radius_mm(self) -> float:
        """Radius beyond which nothing touches it, however deep it may be dented."""
        return math.hypot(self.half_mm, _MAX_DENT_MM)

    def press(
        self, outline: PartSection, centre_mm: Floats, facing_rad: float, displacement: Displacement
    ) -> Press[FaceLoad] | None:
        """Press of the part at a displacement on the face with its middle at `centre_mm` (2,) in W.

        None if it does not touch it. `outline`: of the part as it was put.
        """
        facing = facing_rad - displacement.turn_rad
        ahead = np.array([math.cos(facing), math.sin(facing)])
        seen = _Seen.of(outline, displacement.back(centre_mm), ahead, self.half_mm)
        across, dent = seen.dents(self.half_mm)
        if not (dent > 0).any():
            return None
        by_place = self.stiffness_n_per_mm * _share_load(across, dent)
        return Press(FaceLoad(-by_place.sum() * displacement.rotate(ahead), across, by_place), None)


@dataclass(frozen=True, eq=False)
class _Seen:
    """Edges beside a face: how far ahead of it and to the left their starts and ends are, (n,) mm each."""

    ahead: Floats
    left: Floats
    far_ahead: Floats
    far_left: Floats

    @classmethod
    def of(cls, outline: PartSection, centre_mm: Floats, ahead: Floats, half_mm: float) -> "_Seen":
        """Edges that may be within the face's width and in its skin."""
        begin, end = outline.start - centre_mm, outline.end - centre_mm
        along, far_along = begin @ ahead, end @ ahead
        left = ahead[0] * begin[:, 1] - ahead[1] * begin[:, 0]
        far_left = ahead[0] * end[:, 1] - ahead[1] * end[:, 0]
        near = (np.minimum(along, far_along) < 0) & (np.maximum(along, far_along) > -_SKIN_DEPTH_MM)
        near &= (np.minimum(left, far_left) <= half_mm) & (np.maximum(left, far_left) >= -half_mm)
        return cls(along[near], left[near], far_along[near], far_left[near])

    def dents(self, half_mm: float) -> tuple[Floats, Floats]:
        """Places across the face (m,), ascending, corners among them, and how far each is dented (m,)."""
        corners = np.concatenate([self.left, self.far_left])
        grid = np.linspace(-half_mm, half_mm, math.ceil(2 * half_mm / _DENT_SPACING_MM) + 1)
        across = np.unique(np.concatenate([grid, corners[np.abs(corners) <= half_mm]]))
        width = self.far_left - self.left
        upright = width == 0
        share = (across[:, None] - self.left) / np.where(upright, 1.0, width)
        on = (share >= 0) & (share <= 1) & ~upright
        reach = -(self.ahead + share * (self.far_ahead - self.ahead))
        dent = np.where(on & (reach < _SKIN_DEPTH_MM), reach, 0.0).max(axis=1, initial=0.0)
        return across, dent


def _share_load(across: Floats, dent: Floats) -> Floats:
    """Load of each place (m,), in mm of a flat wall's stiffness."""
    touched = dent > 0
    stretch = np.cumsum(np.diff(touched, prepend=False) & touched) - 1
    padded = np.concatenate([[0.0], dent, [0.0]])
    rise = np.maximum(np.diff(padded), 0.0)[:-1]
    weight = dent * (np.gradient(across) if len(across) > 1 else np.ones(1))
    result = np.zeros(len(across))
    of = stretch[touched]
    count = int(of.max()) + 1
    total = np.bincount(of, rise[touched], count)
    spread = np.bincount(of, weight[touched], count)
    result[touched] = total[of] * weight[touched] / spread[of]
    return result
