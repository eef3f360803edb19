"""Scene: a part on an emulated table, drawn from the catalogue by a seed or placed, and its outlines.

Only emulators are told. The object's outlines in the support plane are worked out here, with shapely, so
that the emulated bench shares no geometry with the recogniser: beside a ball, each section is met by a
circle of its own, and all sections are grown by what their circles have more than the least of those that
stand out, so that one disc meets them all where the ball would. References of a calibration are put near
where asked, never exactly, as by a person with a disc in the hand who tells nobody where.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import shapely
from shapely import affinity

from palpate.base.geometry import Floats, ObjectModel, Section, State
from palpate.base.geometry.outlines import EdgeRings, region_of, rings_of
from palpate.base.tips import TipShape, implementation_for
from palpate.calibration.measurements import Reference, ReferenceDisc, ReferencePlate
from palpate.config import ObjectsFile
from palpate.drivers.emulators import Bench, Displacement, PartSection
from palpate.recognizer import Configuration

_QUARTER_CHORDS = 48
_MIN_RADIUS_MM = 1e-9
_COVERED_MM = 1e-7
_OWNER_TOLERANCE_MM = 2e-3  # more than an arc is off its chords
_PATCH_MM = 1.0  # the skin is touched so far above and below


@dataclass(frozen=True, eq=False)
class _Beside:
    """A section beside a ball: the circle that meets it, and at which height; what of it the skin touches."""

    shape: shapely.Geometry
    circle_mm: float
    z_mm: tuple[float, float]


def _outline_beside_ball(
    sections: Sequence[tuple[tuple[float, float], shapely.Geometry]],
    height_mm: float,
    radius_mm: float,
    top_mm: float,
) -> PartSection | None:
    """Edges for a disc, its radius with them, that stops where a ball at a height does; None for nothing.

    `sections`: from which height to which, and in W.
    """
    beside = _standing_out(
        [found for item in sections if (found := _section_beside(*item, height_mm, radius_mm))]
    )
    if not beside:
        return None
    least = min(item.circle_mm for item in beside)
    grown = [_dilate(item.shape, item.circle_mm - least) for item in beside]
    rings = rings_of(shapely.union_all(grown))
    rings = [ring[np.hypot(*(ring - np.roll(ring, 1, axis=0)).T) > _MIN_RADIUS_MM] for ring in rings]
    edges = EdgeRings.of(rings)
    start, end = edges.start, edges.end
    owner = _owners(grown, (start + end) / 2)
    upright = np.array([item.circle_mm / radius_mm for item in beside])[owner]
    return PartSection(
        start, end, top_mm, np.array([item.z_mm for item in beside])[owner], least, np.minimum(upright, 1.0)
    )


def _section_beside(
    z_mm: tuple[float, float], shape: shapely.Geometry, height_mm: float, radius_mm: float
) -> _Beside | None:
    """A section as the ball meets it, at the height nearest to its equator; None above it and below."""
    at = min(max(height_mm, z_mm[0]), z_mm[1])
    if abs(at - height_mm) >= radius_mm:
        return None
    circle = math.sqrt(radius_mm**2 - (at - height_mm) ** 2)
    return _Beside(shape, circle, (max(at - _PATCH_MM, z_mm[0]), min(at + _PATCH_MM, z_mm[1])))


def _standing_out(beside: list[_Beside]) -> list[_Beside]:
    """Without those that the ball never comes to: others, grown by their circles, cover all of them."""
    kept = sorted(beside, key=lambda item: item.circle_mm)
    whole = {id(item): _dilate(item.shape, item.circle_mm) for item in kept}
    for item in list(kept):
        others = [whole[id(other)] for other in kept if other is not item]
        if others and shapely.union_all(others).buffer(_COVERED_MM).covers(whole[id(item)]):
            kept.remove(item)
    return kept


def _dilate(shape: shapely.Geometry, by_mm: float) -> shapely.Geometry:
    """A shape and all within a distance: of triangles, as a buffer may smooth what is not convex."""
    if by_mm <= _MIN_RADIUS_MM:
        return shape
    triangles = shapely.get_parts(shapely.constrained_delaunay_triangles(shape))
    return shapely.union_all(shapely.buffer(triangles, by_mm, quad_segs=_QUARTER_CHORDS))


def _owners(grown: Sequence[shapely.Geometry], middle: Floats) -> np.ndarray[tuple[int], np.dtype[np.int64]]:
    """Shape that each place (n, 2) is on the outline of: the nearest, of equal ones the last."""
    points = shapely.points(middle)
    away = np.array([shapely.distance(shapely.boundary(shape), points) for shape in grown])
    away = np.where(away < _OWNER_TOLERANCE_MM, 0.0, away)
    found: np.ndarray[tuple[int], np.dtype[np.int64]] = len(grown) - 1 - np.argmin(away[::-1], axis=0)
    return found


_MAX_PLACING_TRIES = 50  # times, until a part lies inside the workspace
_SAME_PLACE_MM = 1e-9
_ON_EDGE_MM = 1e-6


@dataclass(frozen=True)
class Placement:
    """An object on the table: x ↦ R(θ) x + (x, y), mm and rad, W.

    `mass_kg` and `friction` (part on table): None as the rig file has them.
    """

    model: ObjectModel
    state: State
    x_mm: float
    y_mm: float
    theta_rad: float
    mass_kg: float | None = None
    friction: float | None = None

    @property
    def configuration(self) -> Configuration:
        """Configuration of the object frame."""
        return Configuration(self.x_mm, self.y_mm, self.theta_rad)

    @cached_property
    def _regions(self) -> dict[tuple[float, float], shapely.Geometry]:
        return {}

    def region_within(self, span_mm: tuple[float, float]) -> shapely.Geometry:
        """Return all of it between two heights (mm) in W, prepared for distances."""
        if span_mm not in self._regions:
            region = shapely.union_all([shape_of(self, item) for item in self.state.sections_within(span_mm)])
            shapely.prepare(region)
            self._regions[span_mm] = region
        return self._regions[span_mm]


def draw_placement(
    objects: ObjectsFile, radius_mm: float, rng: np.random.Generator, workspace_mm: float = math.inf
) -> Placement:
    """Any object in any state, put down as `put_down` does it."""
    model = objects.objects[int(rng.integers(len(objects.objects)))]
    state = model.states[int(rng.integers(len(model.states)))]
    return put_down(model, state, radius_mm, rng, workspace_mm)


def put_down(
    model: ObjectModel,
    state: State,
    radius_mm: float,
    rng: np.random.Generator,
    workspace_mm: float = math.inf,
) -> Placement:
    """A state with its centre of area anywhere within `radius_mm` of the middle.

    One that would stick out of a circle of `workspace_mm` is put down again; if it never fits, it lies as
    it was put first.
    """
    first = None
    for _ in range(_MAX_PLACING_TRIES):
        lies = draw_pose(model, state, radius_mm, rng)
        first = first or lies
        if is_inside(lies, workspace_mm):
            return lies
    assert first is not None
    return first


def draw_pose(model: ObjectModel, state: State, radius_mm: float, rng: np.random.Generator) -> Placement:
    """A state with its centre of area anywhere within `radius_mm` of the middle."""
    theta = float(rng.uniform(-math.pi, math.pi))
    away, bearing = radius_mm * math.sqrt(rng.uniform()), rng.uniform(0, 2 * math.pi)
    centre = affinity.rotate(
        region_of(state.sections[0].polygons), theta, origin=(0, 0), use_radians=True
    ).centroid
    x, y = away * math.cos(bearing) - centre.x, away * math.sin(bearing) - centre.y
    return Placement(model, state, float(x), float(y), theta)


def is_inside(lies: Placement, radius_mm: float) -> bool:
    """Return whether all of a part is within a circle round W's origin."""
    coordinates = [shapely.get_coordinates(shape_of(lies, section)) for section in lies.state.sections]
    return all(float(np.hypot(*item.T).max()) <= radius_mm for item in coordinates)


def outline_at(
    placement: Placement,
    height_mm: float,
    half_length_mm: float = 0.0,
    radius_mm: float = 0.0,
    shape: TipShape = TipShape.CYLINDER,
) -> PartSection | None:
    """Edges of the object in W beside a tip with its middle at a height; None if it is not that high.

    A tip of some length meets whatever stands out between its ends; a ball what it comes to first.
    """
    outline = implementation_for(shape, _OUTLINES, "what emulated ones meet")
    return outline(placement, height_mm, half_length_mm, radius_mm)


def _outline_of_ball(
    placement: Placement, height_mm: float, _half_length_mm: float, radius_mm: float
) -> PartSection | None:
    return _outline_beside_ball(
        [(item.z_mm, shape_of(placement, item)) for item in placement.state.sections],
        height_mm,
        radius_mm,
        placement.state.top_mm,
    )


def _outline_of_column(
    placement: Placement, height_mm: float, half_length_mm: float, _radius_mm: float
) -> PartSection | None:
    if half_length_mm > 0:
        return _outline_along(placement, height_mm - half_length_mm, height_mm + half_length_mm)
    for section in placement.state.sections:
        if section.z_mm[0] <= height_mm <= section.z_mm[1]:
            rings = rings_of(shape_of(placement, section))
            edges = EdgeRings.of(rings)
            return PartSection(edges.start, edges.end, placement.state.top_mm)
    return None


_OUTLINES = {
    TipShape.CYLINDER: _outline_of_column,
    TipShape.BALL: _outline_of_ball,
    TipShape.PAD: _outline_of_column,
}


def _outline_along(placement: Placement, low_mm: float, high_mm: float) -> PartSection | None:
    """Edges of all sections between two heights together, each with the heights at which it stands."""
    met = [item for item in placement.state.sections if item.z_mm[0] <= high_mm and item.z_mm[1] >= low_mm]
    if not met:
        return None
    shapes = [shape_of(placement, item) for item in met]
    rings = (
        ring[np.hypot(*(ring - np.roll(ring, 1, axis=0)).T) > _SAME_PLACE_MM]
        for ring in rings_of(shapely.union_all(shapes))
    )
    edges = EdgeRings.of([ring for ring in rings if len(ring) >= 3])
    starts, ends = edges.start, edges.end
    middle = shapely.points((starts + ends) / 2)
    on = np.array([shapely.distance(shape.boundary, middle) < _ON_EDGE_MM for shape in shapes])
    own = np.array([[max(z[0], low_mm), min(z[1], high_mm)] for z in (item.z_mm for item in met)])
    lowest = np.where(on, own[:, :1], np.inf).min(axis=0)
    highest = np.where(on, own[:, 1:], -np.inf).max(axis=0)
    # What rounding has put beside all of the sections' edges belongs to any.
    lost = ~on.any(axis=0)
    z_mm = np.column_stack([np.where(lost, low_mm, lowest), np.where(lost, high_mm, highest)])
    return PartSection(starts, ends, placement.state.top_mm, z_mm)


def shape_of(placement: Placement, section: Section) -> shapely.Geometry:
    """A section in W."""
    turned = affinity.rotate(
        region_of(section.polygons), placement.theta_rad, origin=(0, 0), use_radians=True
    )
    return affinity.translate(turned, placement.x_mm, placement.y_mm)


def displace(placement: Placement, displacement: Displacement) -> Placement:
    """Displace the object; the same value if there was no displacement."""
    if displacement.is_none:
        return placement
    x, y = displacement.place(np.array([placement.x_mm, placement.y_mm])).tolist()
    return replace(placement, x_mm=x, y_mm=y, theta_rad=placement.theta_rad + displacement.turn_rad)


_PLACING_ERROR_MM = 8.0
_DISC_FACETS = 180  # a rim that is 0.002 mm off
_REFERENCE_HEIGHT_MM = 40.0


class ReferencePlacer:
    """Puts references within 8 mm of where they should be, turned as it happens to be."""

    def __init__(self, bench: Bench, seed: int) -> None:
        self._bench = bench
        self._rng = np.random.default_rng([seed, 5])

    def put(self, reference: Reference, about_mm: tuple[float, float]) -> None:
        """Put it there, alone."""
        x, y = np.asarray(about_mm) + self._rng.uniform(-_PLACING_ERROR_MM, _PLACING_ERROR_MM, 2) / math.sqrt(
            2
        )
        self._lay(
            reference_outline(reference, float(x), float(y), float(self._rng.uniform(-math.pi, math.pi)))
        )

    def clear(self) -> None:
        """Take it away."""
        self._lay(None)

    def _lay(self, outline: PartSection | None) -> None:
        self._bench.put(lambda *_: outline)


def reference_outline(reference: Reference, x_mm: float, y_mm: float, theta_rad: float) -> PartSection:
    """Edges of a reference in W; a disc's facets lie half within it, half outside."""
    if isinstance(reference, ReferenceDisc):
        angles = np.arange(_DISC_FACETS) * 2 * math.pi / _DISC_FACETS
        radius = reference.radius_mm * (1 + (math.pi / _DISC_FACETS) ** 2 / 3)
        corners = radius * np.column_stack([np.cos(angles), np.sin(angles)])
    elif isinstance(reference, ReferencePlate):
        corners = reference.corners_mm
    else:
        raise TypeError(f"{reference.name} cannot be emulated")
    c, s = math.cos(theta_rad), math.sin(theta_rad)
    start = corners @ np.array([[c, s], [-s, c]]) + [x_mm, y_mm]
    return PartSection(start, np.roll(start, -1, axis=0), _REFERENCE_HEIGHT_MM)
