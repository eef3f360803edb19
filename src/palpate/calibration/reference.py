"""Reference artefacts: things of known shape that fingers touch to be calibrated, a disc and a convex plate.

Each has a `name`, the `radius_mm` of the smallest circle round its origin that holds it, `tolerance_mm` by
which its surface may be elsewhere, `turns`, whether its orientation can be measured, and `repeats`, how many
orientations look the same. Its frame has its origin at the centre; mm.
"""

import math
from dataclasses import dataclass

import numpy as np
import shapely

from palpate.base.geometry import Floats
from palpate.base.geometry.plane import rotation_matrix


@dataclass(frozen=True)
class ReferenceDisc:
    """A round reference."""

    name: str
    radius_mm: float
    tolerance_mm: float = 0.0
    turns: bool = False
    repeats: int = 1

    def curvature_per_mm(self) -> float:
        """Curvature of its rim."""
        return 1 / self.radius_mm

    def distance_mm(self, points_mm: Floats) -> tuple[Floats, Floats, Floats]:
        """Signed distance (n,) from the rim, outward normal (n, 2), and room (n,), inf: it has no corner.

        `points_mm` (n, 2); inside counts negative.
        """
        away = np.hypot(points_mm[:, 0], points_mm[:, 1])
        normal = points_mm / np.maximum(away, 1e-9)[:, None]
        return away - self.radius_mm, normal, np.full(len(points_mm), np.inf)


class ReferencePlate:
    """A convex polygon, its corners counter-clockwise; `repeats`: its rotational symmetry.

    ValueError if it is not convex.
    """

    def __init__(self, name: str, outline_mm: Floats, tolerance_mm: float = 0.0) -> None:
        corners = np.asarray(outline_mm, dtype=np.float64)
        along = np.roll(corners, -1, axis=0) - corners
        turn = along[:, 0] * np.roll(along, -1, axis=0)[:, 1] - along[:, 1] * np.roll(along, -1, axis=0)[:, 0]
        if (turn < 0).all():
            corners, turn = corners[::-1], -turn[::-1]
        headings = np.arctan2(along[:, 1], along[:, 0])
        round_it = np.angle(np.exp(1j * (np.roll(headings, -1) - headings))).sum()
        if not (turn > 0).all() or abs(abs(round_it) - 2 * math.pi) > 1e-6:
            raise ValueError("is not convex; a plate's corners go round it, all turning the same way")
        self.name = name
        self.tolerance_mm = tolerance_mm
        self.turns = True
        self._start: Floats = corners - shapely.get_coordinates(shapely.centroid(shapely.Polygon(corners)))
        along = np.roll(self._start, -1, axis=0) - self._start
        self._length = np.hypot(along[:, 0], along[:, 1])
        self._along = along / self._length[:, None]
        self._normal = np.column_stack([self._along[:, 1], -self._along[:, 0]])
        self.radius_mm = float(np.hypot(self._start[:, 0], self._start[:, 1]).max())
        self.repeats = _symmetry(self._start)

    @property
    def corners_mm(self) -> Floats:
        """Corners (k, 2), counter-clockwise, round the centre of area."""
        return self._start

    def curvature_per_mm(self) -> float:
        """Curvature of its faces, which are flat."""
        return 0.0

    def distance_mm(self, points_mm: Floats) -> tuple[Floats, Floats, Floats]:
        """Signed distance (n,) from the surface, outward normal (n, 2), and room to the next corner (n,).

        `points_mm` (n, 2); inside counts negative. The room is how far the nearest point of the surface is
        from where its face ends, 0 at a corner.
        """
        rel = points_mm[:, None, :] - self._start
        out = np.einsum("nkj,kj->nk", rel, self._normal)
        at = np.einsum("nkj,kj->nk", rel, self._along)
        beyond = at - np.clip(at, 0.0, self._length)
        gap = np.where(out > 0, np.hypot(out, beyond), np.inf)
        inside = (out <= 0).all(axis=1)
        face = np.where(inside, out.argmax(axis=1), gap.argmin(axis=1))
        rows = np.arange(len(points_mm))
        distance = np.where(inside, out[rows, face], gap[rows, face])
        away = out[rows, face, None] * self._normal[face] + beyond[rows, face, None] * self._along[face]
        normal = np.where(inside[:, None], self._normal[face], away / np.maximum(distance, 1e-9)[:, None])
        room = np.minimum(at[rows, face], self._length[face] - at[rows, face])
        return distance, normal, np.maximum(room, 0.0)


Reference = ReferenceDisc | ReferencePlate


def _symmetry(corners: Floats) -> int:
    """Rotational symmetry of corners round the origin."""
    count = len(corners)
    for order in range(count, 1, -1):
        if count % order:
            continue
        turned = corners @ rotation_matrix(2 * math.pi / order).T
        if np.allclose(turned, np.roll(corners, -count // order, axis=0), atol=1e-6):
            return order
    return 1
