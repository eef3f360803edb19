"""Known symmetries of a solid: their products need no search and no proof of their own.

Two motions in a row are apart by no more than both together, because neither changes distances: from a few
that are proven on the surface follow hundreds. So each is first made as exact as the solid is, by bringing
the vertices onto each other in the mean (Kabsch, A solution for the best rotation to relate two sets of
vectors, Acta Crystallographica A32, 1976).
"""

from dataclasses import dataclass

import numpy as np

from palpate.base.geometry import Floats
from palpate.cad.congruence import surface_apart_between_mm
from palpate.cad.surface_distance import SurfaceDistance

__all__ = ["KnownSymmetries", "SolidSymmetry"]

_MOST = 128
"""So many are kept as they come, later on only those that two others in a row do not make."""
_EXACT = 1e-8
"""Share of the size: a symmetry that is nearer need not be made more exact."""
_LEAST_PAIRS = 4


@dataclass(frozen=True, eq=False)
class SolidSymmetry:
    """A motion in the file's frame that brings the solid onto itself within `apart_mm`.

    A vertex v goes to `rotation` (3, 3) @ v + `shift_mm` (3,).
    """

    rotation: Floats
    shift_mm: Floats
    apart_mm: float

    def then(self, after: "SolidSymmetry") -> "SolidSymmetry":
        """Both in a row, this one first."""
        return SolidSymmetry(
            after.rotation @ self.rotation,
            after.rotation @ self.shift_mm + after.shift_mm,
            after.apart_mm + self.apart_mm,
        )

    def back(self) -> "SolidSymmetry":
        """The inverse."""
        turned = self.rotation.T
        return SolidSymmetry(turned, -turned @ self.shift_mm, self.apart_mm)


class KnownSymmetries:
    """Those of one `surface` that are known so far, each with its inverse."""

    def __init__(self, surface: SurfaceDistance) -> None:
        self.surface = surface
        self._known = [SolidSymmetry(np.eye(3), np.zeros(3), 0.0)]

    def proven(self, rotation: Floats, shift_mm: Floats, apart_mm: float) -> None:
        """Remember a motion that the surface was found to allow."""
        found = SolidSymmetry(rotation, shift_mm, apart_mm)
        self._keep(found if apart_mm <= _EXACT * self.surface.size_mm else self._exact(found))

    def remember(self, found: SolidSymmetry) -> None:
        """One that others made, unless many are known."""
        if len(self._known) < _MOST:
            self._keep(found)

    def _keep(self, found: SolidSymmetry) -> None:
        self._known += [found, found.back()]

    def taking(self, one: Floats, other: Floats, within_rad: float) -> SolidSymmetry | None:
        """The one, or two in a row, that takes a direction (3,) most nearly to another; None if beyond.

        Of such as do so equally well one that is as little apart as can be.
        """
        if len(self._known) == 1:
            return None
        turns = np.array([item.rotation for item in self._known])
        apart = np.array([item.apart_mm for item in self._known])
        # The first takes the one to where the second takes the other back to.
        first, second = turns @ one, other @ turns
        tilt = np.linalg.norm(first - second[:, None], axis=2)
        off = tilt * self.surface.size_mm + apart + apart[:, None]
        after, before = np.unravel_index(int(off.argmin()), off.shape)
        if tilt[after, before] > within_rad:
            return None
        return self._known[before].then(self._known[after])

    def _exact(self, found: SolidSymmetry) -> SolidSymmetry:
        """The motion that brings vertices best onto those that they come near to, if that is proven."""
        surface = self.surface
        points = surface.vertices_mm @ found.rotation.T + found.shift_mm
        off, vertex = surface.vertex_tree.query(points, distance_upper_bound=2 * found.apart_mm)
        near = np.isfinite(off)
        if near.sum() < _LEAST_PAIRS:
            return found
        here, there = surface.vertices_mm[near], surface.vertices_mm[np.asarray(vertex)[near]]
        middle, its = here.mean(axis=0), there.mean(axis=0)
        u, _, v = np.linalg.svd((here - middle).T @ (there - its))
        proper = np.diag([1.0, 1.0, np.linalg.det(u) * np.linalg.det(v)])
        rotation = v.T @ proper @ u.T
        shift = its - rotation @ middle
        apart = surface_apart_between_mm(surface, rotation, shift, found.apart_mm)
        return found if apart is None else SolidSymmetry(rotation, shift, apart)
