"""Round outlines: flat parts and states of solids whose outlines are all circles about one axis.

However a file draws a circle (an entity, two half arcs, four Béziers, a polyline), its points are compared:
the centre that fits the outer outline's points best, and how far each outline, chords included, is from its
circle about that. A mesh has polygons for circles, too. Where the walls between two heights are within what
the tolerance allows of as many circles about one axis as the section has outlines, the circles are written
instead, and by what angle the surface's normals, seen from above, differ from theirs. Judged is the surface
itself, at all heights.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
import shapely

from palpate.base.geometry import Floats
from palpate.base.geometry.plane import segment_distance, signed_area
from palpate.cad.parts import CrossSection, Drawing, Solid, StableState
from palpate.config.fields import DECIMALS
from palpate.config.objects_tables import CircleText, PolygonText, SectionText

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
        """True if the other one's outer circle is this one's to within a distance."""
        apart = math.dist(self.centre_mm, other.centre_mm)
        return apart + abs(self.radii_mm[0] - other.radii_mm[0]) <= within_mm

    @property
    def bounds_mm(self) -> tuple[float, float, float, float]:
        """Least x and y, most x and y in the drawing's frame."""
        (x, y), radius = self.centre_mm, self.radii_mm[0]
        return x - radius, y - radius, x + radius, y + radius

    def polygon(self) -> PolygonText:
        """The circles as text of the file, about the origin."""
        outer, *holes = (_centred_circle(radius) for radius in self.radii_mm)
        return PolygonText(outer=outer, holes=holes) if holes else PolygonText(outer=outer)


def round_drawing(drawing: Drawing, allowed_mm: float) -> RoundDrawing | None:
    """The drawing as circles about one centre; None if an outline is further than `allowed_mm` from one."""
    x, y = (round(float(value), DECIMALS) + 0.0 for value in _centre(drawing.outline.outer))
    rings = [ring - [x, y] for ring in drawing.outline.rings]
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
    nearest = segment_distance(np.zeros(2), ring, np.roll(ring, -1, axis=0))
    return float(nearest.min()), float(np.hypot(*ring.T).max())


def _turns_much(ring: Floats) -> bool:
    """True if some edge has a normal far from radial at an end, or the origin is not inside."""
    leg = np.roll(ring, -1, axis=0) - ring
    turned = np.sign(signed_area(ring))
    for end in (ring, ring + leg):
        across = turned * (end[:, 0] * leg[:, 1] - end[:, 1] * leg[:, 0])
        along = np.abs(np.sum(end * leg, axis=1))
        if (np.arctan2(along, across) > _LARGEST_TURN_RAD).any():
            return True
    return False


def _centred_circle(radius_mm: float) -> CircleText:
    return CircleText.model_validate({"circle": {"centre": (0.0, 0.0), "radius": radius_mm}})


_AXIS_TOLERANCE = 1e-6  # of the solid's size: corners so near to the axis have no radial direction
_LEVEL_TOLERANCE = 1e-9  # facets of normals so nearly vertical have no section
_MAX_DIVISIONS = 4  # a section is halved so often where a wall leans too much for one circle


@dataclass(frozen=True)
class RoundSections:
    """Sections of circles only, of `least_radius_mm` and more.

    The solid's outlines are within `off_mm` of them, and normals of its facets within `turn_rad`.
    """

    sections: tuple[SectionText, ...]
    off_mm: float
    turn_rad: float
    least_radius_mm: float


def round_sections(
    solid: Solid, state: StableState, sections: Sequence[CrossSection], allowed_mm: float
) -> RoundSections | None:
    """The sections as circles about one axis; None if some outline is none to within `allowed_mm` in all."""
    known = sorted((section for section in sections if section.polygons), key=lambda item: item.z_mm)
    corners = (solid.vertices_mm @ state.rotation.T + state.offset_mm)[:, :2]
    # The centre of mass, above the origin, is on the axis, unless something of the part is not.
    middle = np.round((corners.min(axis=0) + corners.max(axis=0)) / 2, DECIMALS) + 0.0
    for centre in (np.zeros(2), middle):
        found = _about(centre, solid, state, known, allowed_mm)
        if found is not None:
            return found
    return None


def _about(
    centre: Floats, solid: Solid, state: StableState, sections: Sequence[CrossSection], allowed_mm: float
) -> RoundSections | None:
    """The sections as circles about an axis through `centre` (2,)."""
    axis = shapely.Point(centre)
    regions = (region for section in sections for region in section.polygons)
    if not all(shapely.Polygon(ring).contains(axis) for region in regions for ring in region.rings):
        return None
    walls = _Walls.of(solid, state, centre, sections)
    if walls.turn_rad > _LARGEST_TURN_RAD:
        return None
    texts, off = [], 0.0
    for section in sections:
        found = _circles(walls, section, *section.z_mm, centre, allowed_mm - solid.off_mm, _MAX_DIVISIONS)
        if found is None:
            return None
        texts += found[0]
        off = max(off, found[1])
    outlines = [ring for text in texts for p in text.polygons for ring in (p.outer, *p.holes)]
    least = min(ring.circle.radius for ring in outlines if isinstance(ring, CircleText))
    return RoundSections(tuple(texts), solid.off_mm + off, walls.turn_rad, least)


def _circles(
    walls: "_Walls",
    section: CrossSection,
    low: float,
    high: float,
    centre: Floats,
    allowed_mm: float,
    divisions: int,
) -> tuple[list[SectionText], float] | None:
    """The section between two heights as circles, in several parts if need be, and how far walls are off."""
    count = sum(len(region.rings) for region in section.polygons)
    groups = walls.radii_mm(low, high)
    off = max(((most - least) / 2 for least, most in groups), default=0.0) + 2 * _ROUNDING_MM
    if len(groups) == count and off <= allowed_mm:
        return [_section_text(section, low, high, centre, groups)], off
    if not divisions:
        return None
    middle = round((low + high) / 2, DECIMALS)
    parts = [
        _circles(walls, section, begin, end, centre, allowed_mm, divisions - 1)
        for begin, end in ((low, middle), (middle, high))
    ]
    if parts[0] is None or parts[1] is None:
        return None
    return parts[0][0] + parts[1][0], max(parts[0][1], parts[1][1])


def _section_text(
    section: CrossSection, low: float, high: float, centre: Floats, groups: Sequence[tuple[float, float]]
) -> SectionText:
    """The section with the circles of the groups, ascending, in the place of its outlines."""
    size = sorted(float(np.ptp(ring[:, 0])) for region in section.polygons for ring in region.rings)
    polygons = []
    for region in section.polygons:
        outer, *holes = (
            _circle_text(centre, groups[size.index(float(np.ptp(ring[:, 0])))]) for ring in region.rings
        )
        polygons.append(PolygonText(outer=outer, holes=holes) if holes else PolygonText(outer=outer))
    z = (round(low, DECIMALS) + 0.0, round(high, DECIMALS) + 0.0)
    return SectionText(z=z, polygons=polygons)


def _circle_text(centre: Floats, radii_mm: tuple[float, float]) -> CircleText:
    radius = round(sum(radii_mm) / 2, DECIMALS)
    return CircleText.model_validate({"circle": {"centre": tuple(centre.tolist()), "radius": radius}})


@dataclass(frozen=True, eq=False)
class _Walls:
    """Facets (m, 3, 3) mm of a state, seen from an axis; `turn_rad`: how far normals are from radial.

    Those at heights of sections that are not level: the head of a bolt says nothing of its shank.
    """

    corner: Floats
    turn_rad: float

    @classmethod
    def of(
        cls, solid: Solid, state: StableState, centre: Floats, sections: Sequence[CrossSection]
    ) -> "_Walls":
        """The walls of a state at the heights of its sections."""
        vertices = solid.vertices_mm @ state.rotation.T + state.offset_mm - [*centre, 0.0]
        corner = vertices[solid.faces]
        normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
        level = np.hypot(normal[:, 0], normal[:, 1]) <= _LEVEL_TOLERANCE * np.linalg.norm(normal, axis=1)
        z = corner[..., 2]
        met = [(z.min(axis=1) < item.z_mm[1]) & (z.max(axis=1) > item.z_mm[0]) for item in sections]
        some = np.any(met, axis=0) & ~level
        corner, outward = corner[some], normal[some][:, None, :2]
        radial = corner[..., :2]
        across = radial[..., 0] * outward[..., 1] - radial[..., 1] * outward[..., 0]
        along = np.abs(np.sum(radial * outward, axis=2))  # inward on the wall of a hole
        far = np.hypot(radial[..., 0], radial[..., 1]) > _AXIS_TOLERANCE * float(
            np.ptp(vertices, axis=0).max()
        )
        return cls(corner, float(np.arctan2(np.abs(across), along)[far].max(initial=0.0)))

    def radii_mm(self, low: float, high: float) -> list[tuple[float, float]]:
        """Least and largest distance from the axis of walls between two heights, wall by wall, ascending."""
        z = self.corner[..., 2]
        some = self.corner[(z.min(axis=1) < high) & (z.max(axis=1) > low)]
        points = np.concatenate([_within(some, low, high), _cut(some, low), _cut(some, high)], axis=1)
        known = np.isfinite(points[..., 0])
        some_known = known.any(axis=1)
        points, known = points[some_known], known[some_known]
        most = np.where(known, np.hypot(points[..., 0], points[..., 1]), -np.inf).max(axis=1)
        least = most.copy()
        for one, other in combinations(range(points.shape[1]), 2):
            least = np.fmin(least, segment_distance(np.zeros(2), points[:, one], points[:, other]))
        return _join_intervals(np.column_stack([least, most]))


def _within(corner: Floats, low: float, high: float) -> Floats:
    """Corners (m, 3, 2) between two heights, NaN for others."""
    z = corner[..., 2:]
    result: Floats = np.where((z >= low) & (z <= high), corner[..., :2], np.nan)
    return result


def _cut(corner: Floats, height: float) -> Floats:
    """Points of the sides of facets at a height, (m, 3, 2); NaN for sides that are not there."""
    other = np.roll(corner, -1, axis=1)
    rise = other[..., 2] - corner[..., 2]
    with np.errstate(divide="ignore", invalid="ignore"):
        share = (height - corner[..., 2]) / rise
        at = corner[..., :2] + share[..., None] * (other - corner)[..., :2]
    result: Floats = np.where(((share >= 0) & (share <= 1))[..., None], at, np.nan)
    return result


def _join_intervals(intervals: Floats) -> list[tuple[float, float]]:
    """Intervals (m, 2) that overlap as one, ascending."""
    result: list[tuple[float, float]] = []
    for least, most in sorted(map(tuple, intervals.tolist())):
        if result and least <= result[-1][1] + _ROUNDING_MM:
            result[-1] = result[-1][0], max(most, result[-1][1])
        else:
            result.append((least, most))
    return result
