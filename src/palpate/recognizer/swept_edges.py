"""Swept edges (capsules): where straight paths run within ρ of edges of an object known to within ρ.

They give the earliest and the latest stop of a finger and the edges it may be on. `sweep` uses them as
evidence, `prediction` to look ahead, so that recogniser and planner cannot disagree.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from palpate.base.geometry import Bools, Floats, Ints
from palpate.base.geometry.segments import capsule_interval
from palpate.recognizer.edges import EdgeSet
from palpate.recognizer.rays import Rays, near_edges, offset_from_rays
from palpate.recognizer.strip_trees import StripForest

__all__ = ["Capsules", "capsules_of"]


@dataclass(frozen=True, eq=False)
class Capsules:
    """For r rays, up to n edges that each passes within ρ, padded: all (r, n).

    The ray is in the edge's capsule for a travel in [`enter`, `leave`] mm; `crossing`: its line crosses the
    edge. Where there is no edge, `edge` is −1, `enter` ∞ and `leave` −∞.
    """

    edge: Ints
    enter: Floats
    leave: Floats
    crossing: Bools

    @cached_property
    def touchable(self) -> Bools:
        """Edges whose capsule the ray is in at some travel ≥ 0, (r, n)."""
        return (self.leave >= 0) & (self.enter <= self.leave)

    @cached_property
    def earliest(self) -> Floats:
        """No stop comes before this travel (r,) mm; infinite if nothing can be met."""
        enter = np.where(self.touchable, np.maximum(self.enter, 0.0), np.inf)
        result: Floats = enter.min(axis=1, initial=np.inf)
        return result

    @cached_property
    def latest(self) -> Floats:
        """First travel ≥ 0 (r,) at which a ray is inside the outline and in no capsule; infinite if never."""
        order = np.argsort(self.enter, axis=1)
        enter = np.take_along_axis(self.enter, order, axis=1)
        covered = np.maximum.accumulate(np.take_along_axis(self.leave, order, axis=1), axis=1)
        # Every crossing lies in its own edge's capsule, so after the first i capsules the ray is inside iff
        # an odd number of them held one.
        inside = np.logical_xor.accumulate(np.take_along_axis(self.crossing, order, axis=1), axis=1)
        following = np.column_stack([enter[:, 1:], np.full(len(enter), np.inf)])
        gap = inside & (following > covered) & (following > 0)
        depth: Floats = np.where(gap, np.maximum(covered, 0.0), np.inf).min(axis=1, initial=np.inf)
        return depth


def capsules_of(edges: EdgeSet, strips: StripForest, rays: Rays) -> Capsules:
    """The capsules that rays run through."""
    ray, edge = near_edges(edges, strips, rays)
    begin, end = offset_from_rays(rays, ray, edges.start[edge]), offset_from_rays(rays, ray, edges.end[edge])
    enter, leave = capsule_interval(
        rays.start[ray],
        rays.heading[ray],
        edges.start[edge],
        edges.direction[edge],
        edges.length[edge],
        rays.rho[ray],
    )
    # Neighbours share their corner's numbers, so a ray through a corner crosses both of them or neither.
    crossing = (begin > 0) != (end > 0)
    count = np.bincount(ray, minlength=len(rays.state))
    slot = np.arange(len(ray)) - np.repeat(np.cumsum(count) - count, count)
    shape = (len(count), int(count.max(initial=0)))
    found = Capsules(
        np.full(shape, -1), np.full(shape, np.inf), np.full(shape, -np.inf), np.zeros(shape, dtype=bool)
    )
    for to, value in (
        (found.edge, edge),
        (found.enter, enter),
        (found.leave, leave),
        (found.crossing, crossing),
    ):
        to[ray, slot] = value
    return found
