"""Round drawings: flat parts whose outlines are all circles about one centre.

However a file draws a circle (an entity, two half arcs, four Béziers, a polyline), its points are compared:
the centre that fits the outer outline's points best, and how far each outline, chords included, is from its
circle about that.
"""

import math
from dataclasses import dataclass

import numpy as np

from palpate.base.geometry import Floats
from palpate.cad.values import Drawing
from palpate.config.objects_rings import CircleText
from palpate.config.objects_tables import PolygonText
from palpate.config.results import DECIMALS

__all__ = ["RoundDrawing", "round_drawing"]

_LARGEST_TURN_RAD = math.radians(20.0)
"""Half of what an outline turns at a corner, at most; coarser polygons are none that stand for circles."""

_ROUNDING_MM = 10.0**-DECIMALS


@dataclass(frozen=True)
class RoundDrawing:
    """Circles about `centre_mm` in the drawing's frame, with `radii_mm`, the outer one first.

    The part's outlines are within `off_mm` of them.
    """

    centre_mm: tuple[float, float]
    radii_mm: tuple[float, ...]
    off_mm: float

    def is_near(self, other: "RoundDrawing", within_mm: float) -> bool:
        """Whether the other one's outer circle is this one's to within a distance."""
        apart = math.dist(self.centre_mm, other.centre_mm)
        return apart + abs(self.radii_mm[0] - other.radii_mm[0]) <= within_mm

    @property
    def bounds_mm(self) -> tuple[float, float, float, float]:
        """Least x and y, most x and y in the drawing's frame."""
        (x, y), radius = self.centre_mm, self.radii_mm[0]
        return x - radius, y - radius, x + radius, y + radius

    def polygon(self) -> PolygonText:
        """The circles as text of the file, about the origin."""
        outer, *holes = (_circle(radius) for radius in self.radii_mm)
        return PolygonText(outer=outer, holes=holes) if holes else PolygonText(outer=outer)


def round_drawing(drawing: Drawing, allowed_mm: float) -> RoundDrawing | None:
    """The drawing as circles about one centre; None if an outline is further than `allowed_mm` from one."""
    x, y = (round(float(value), DECIMALS) + 0.0 for value in _centre(drawing.region.outer))
    rings = [ring - [x, y] for ring in (drawing.region.outer, *drawing.region.holes)]
    ranges = [_distances_mm(ring) for ring in rings]
    off = max((most - least) / 2 for least, most in ranges) + 2 * _ROUNDING_MM + drawing.off_mm
    if off > allowed_mm or any(_turns_much(ring) for ring in rings):
        return None
    return RoundDrawing((x, y), tuple(round(sum(ends) / 2, DECIMALS) for ends in ranges), off)


def _centre(ring: Floats) -> Floats:
    """The centre (2,) of the circle that fits points best: |p|² = 2 c·p + k in least squares."""
    middle = ring.mean(axis=0)
    near = ring - middle
    terms = np.column_stack([2 * near, np.ones(len(ring))])
    fitted: Floats = np.linalg.lstsq(terms, np.sum(near * near, axis=1), rcond=None)[0]
    centre: Floats = middle + fitted[:2]
    return centre


def _distances_mm(ring: Floats) -> tuple[float, float]:
    """Least and largest distance of a closed polygon from the origin."""
    leg = np.roll(ring, -1, axis=0) - ring
    share = np.clip(-np.sum(ring * leg, axis=1) / np.sum(leg * leg, axis=1), 0.0, 1.0)
    nearest = np.hypot(*(ring + share[:, None] * leg).T)
    return float(nearest.min()), float(np.hypot(*ring.T).max())


def _turns_much(ring: Floats) -> bool:
    """Whether some edge has a normal far from radial at an end, or the origin is not inside."""
    leg = np.roll(ring, -1, axis=0) - ring
    turned = np.sign(np.sum(ring[:, 0] * np.roll(ring[:, 1], -1) - ring[:, 1] * np.roll(ring[:, 0], -1)))
    for end in (ring, ring + leg):
        across = turned * (end[:, 0] * leg[:, 1] - end[:, 1] * leg[:, 0])
        along = np.abs(np.sum(end * leg, axis=1))
        if (np.arctan2(along, across) > _LARGEST_TURN_RAD).any():
            return True
    return False


def _circle(radius_mm: float) -> CircleText:
    return CircleText.model_validate({"circle": {"centre": (0.0, 0.0), "radius": radius_mm}})
