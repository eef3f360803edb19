"""The region of a state that a tip reaches, with measures that are computed once for all comparisons."""

import math
from functools import cached_property

import numpy as np
import shapely
from shapely import affinity

from palpate.base.geometry import Floats
from palpate.cad.congruence_search import Motion
from palpate.rig.catalogue.region_measures import measures

__all__ = ["ReachedRegion", "certainly_within"]

_CERTAIN = 0.98  # of a buffer's distance: GEOS evens out hollows of the outline by up to a hundredth of it


class ReachedRegion:
    """A region (mm) that tips can touch all around; its numbers and its surroundings are found once."""

    def __init__(self, region: shapely.Geometry) -> None:
        self.region = region
        self._near: dict[float, shapely.Geometry] = {}

    @cached_property
    def measures(self) -> Floats:
        """Of the region, (6,), as in `objects_measures`."""
        found: Floats = measures([self.region])[0]
        return found

    @cached_property
    def outline(self) -> shapely.Geometry:
        """All rings of the region as lines."""
        return shapely.boundary(self.region)

    def near(self, within_mm: float) -> shapely.Geometry:
        """Places within a distance of the outline for certain: nearly all there are."""
        if within_mm not in self._near:
            self._near[within_mm] = self.outline.buffer(_CERTAIN * within_mm, quad_segs=8)
            shapely.prepare(self._near[within_mm])
        return self._near[within_mm]


def certainly_within(one: ReachedRegion, other: ReachedRegion, motion: Motion, within_mm: float) -> bool:
    """Whether the motion brings the outline of one within a distance of the other's, and the other way round.

    True is certain, for arcs of buffers are chords. False is not: `apart_mm` decides then.
    """
    c, s = math.cos(motion.turn_rad), math.sin(motion.turn_rad)
    x, y = motion.shift_mm.tolist()
    back_x, back_y = (-np.array([[c, s], [-s, c]]) @ motion.shift_mm).tolist()
    there = affinity.affine_transform(one.outline, (c, -s, s, c, x, y))
    back = affinity.affine_transform(other.outline, (c, s, -s, c, back_x, back_y))
    return bool(shapely.covers(other.near(within_mm), there) and shapely.covers(one.near(within_mm), back))
