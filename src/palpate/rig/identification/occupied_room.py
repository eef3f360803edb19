"""Room that a part certainly takes up: what it fills in every configuration that is left.

Parts never overlap, so what two parts fill has nothing in common.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import shapely
from shapely import affinity

from palpate.base.geometry.outlines import region_of
from palpate.recognizer import Hypothesis

_CHORDS = 16  # in a quarter
_SLIVER_MM2 = 1e-6  # rounding overlaps by less


@dataclass(frozen=True, eq=False)
class Core:
    """Region that is inside of a part in every configuration of one hypothesis."""

    hypothesis: Hypothesis

    @cached_property
    def off_mm(self) -> float:
        """Distance of any point of the part from where the hypothesis's configuration puts it, at most."""
        at, bounds = self.hypothesis.configuration, self.hypothesis.search_bounds
        state = self.hypothesis.state
        x, y, turn = (
            max(abs(lo - here), abs(hi - here))
            for (lo, hi), here in (
                (bounds.x_mm, at.x_mm),
                (bounds.y_mm, at.y_mm),
                (bounds.theta_rad, at.theta_rad),
            )
        )
        corners = np.concatenate([ring for item in state.state.sections for ring in item.rings])
        lever = float(np.hypot(*corners.T).max())
        return math.hypot(x, y) + min(turn, math.pi) * lever + state.tolerance_mm + state.rounding_mm

    @cached_property
    def _nominal(self) -> Sequence[tuple[tuple[float, float], shapely.Geometry]]:
        """Heights (from, to) mm, and shape in W, of each section at the hypothesis's configuration."""
        at, found = self.hypothesis.configuration, []
        for section in self.hypothesis.state.state.sections:
            region = region_of(section.polygons)
            turned = affinity.rotate(region, at.theta_rad, origin=(0, 0), use_radians=True)
            found.append((section.z_mm, affinity.translate(turned, at.x_mm, at.y_mm)))
        return found

    @cached_property
    def sections(self) -> Sequence[tuple[tuple[float, float], shapely.Geometry]]:
        """Heights (from, to) mm and core in W of each section."""
        # Chords of a buffer's arcs must not leave more than the arcs would.
        off = self.off_mm / math.cos(math.pi / (4 * _CHORDS))
        return [(z_mm, shape.buffer(-off, _CHORDS)) for z_mm, shape in self._nominal]

    def within(self, span_mm: tuple[float, float]) -> shapely.Geometry:
        """All of it between two heights (mm)."""
        lo, hi = span_mm
        return shapely.union_all([core for (low, high), core in self.sections if low <= hi and high >= lo])

    def gap_mm(self, other: "Core") -> float:
        """Distance of the two parts at least, at heights at which both have sections; infinite: none."""
        apart = [
            float(shapely.distance(shape, there))
            for (low, high), shape in self._nominal
            for (bottom, top), there in other._nominal
            if min(high, top) >= max(low, bottom)
        ]
        return min(apart, default=math.inf) - self.off_mm - other.off_mm

    def overlaps(self, other: "Core") -> bool:
        """Return whether the two parts would certainly be in one place, at some height."""
        return any(
            min(high, top) > max(low, bottom) and shapely.intersection(core, there).area > _SLIVER_MM2
            for (low, high), core in self.sections
            for (bottom, top), there in other.sections
        )
