"""Touches computed by shapely."""

import json
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ParamSpec

import numpy as np
import shapely
from shapely import affinity, ops

from palpate.base.geometry import Floats, ObjectModel, Polygon, Section, State
from palpate.recognizer.contact import Contact, Finger, NormalRange
from palpate.recognizer.hypotheses import Hypothesis
from palpate.recognizer.recognition import Recognition
from support.commands.repository import ROOT

# ----------------------------------------------------------------------------------------------------
# Touches simulated with shapely alone: an oracle that shares no code with the recogniser.

SHIPPED_OBJECTS = ROOT / "src" / "palpate" / "config" / "objects" / "memo.json"

MOST_DRAWS = 50

How = ParamSpec("How")


def flat(name: str, outline: object, height_mm: float = 20.0) -> ObjectModel:
    """An object with one state and one section."""
    section = Section((0.0, height_mm), (Polygon(np.asarray(outline, dtype=float)),))
    return ObjectModel(name, (State("flat", (section,)),))


def outlines(path: Path) -> list[ObjectModel]:
    """All objects of an objects file in the short form."""
    return [flat(item["name"], item["outline"]) for item in json.loads(path.read_text())["objects"]]


@dataclass(frozen=True)
class Placed:
    """An object on the table: x ↦ R(theta) x + (x, y)."""

    model: ObjectModel
    x: float
    y: float
    theta: float

    @property
    def shape(self) -> shapely.Geometry:
        return self.shape_at(10.0)

    def shape_at(self, height: float) -> shapely.Geometry:
        """Where the object is at a height: all of its sections there."""
        parts = [
            shapely.Polygon(polygon.outer, polygon.holes)
            for section in self.model.states[0].sections_at(height)
            for polygon in section.polygons
        ]
        rotated = affinity.rotate(shapely.union_all(parts), self.theta, origin=(0, 0), use_radians=True)
        return affinity.translate(rotated, self.x, self.y)

    def on_table(self, point: np.ndarray) -> np.ndarray:
        """Where a point (2,) of the object is on the table."""
        return turned(point, self.theta) + np.array([self.x, self.y])


def stop(shape: shapely.Polygon, start: np.ndarray, direction: float, radius: float, reach: float) -> float:
    """Travel after which a disc on a straight path first touches the shape; infinite if it passes by."""
    heading = unit(direction)
    travel = 0.0
    while travel < reach:
        gap = shapely.distance(shape, shapely.Point(start + travel * heading)) - radius
        if gap < 1e-9:
            return travel
        travel += gap
    return math.inf


def outward_normal(shape: shapely.Geometry, centre: np.ndarray) -> float:
    """Direction from the nearest point of the shape to the centre of a tip that touches it from outside."""
    nearest = ops.nearest_points(shape, shapely.Point(centre))[0]
    return math.atan2(centre[1] - nearest.y, centre[0] - nearest.x)


def touch(
    shape: shapely.Polygon,
    rng: np.random.Generator,
    *,
    radius: float,
    bound: float,
    half_range: float | None,
    direction: float,
    start: np.ndarray,
    reach: float,
    at_bound: bool = False,
    name: str = "f",
    height: float = 10.0,
) -> Contact:
    """One approach with its position and normal mismeasured by no more than their bounds."""
    heading = unit(direction)
    travel = stop(shape, start, direction, radius, reach)
    angle = rng.uniform(0, 2 * math.pi)
    error = unit(angle) * (bound if at_bound else bound * math.sqrt(rng.uniform()))
    finger = Finger(radius, height)
    given = tuple(float(v) for v in start + error)
    if not math.isfinite(travel):
        end = tuple(float(v) for v in start + error + reach * heading)
        return Contact(name, finger, False, given, end, bound)
    centre = start + travel * heading
    normal = None
    if half_range is not None and radius > 0:
        true = outward_normal(shape, centre)
        shift = rng.choice([-1, 1]) * half_range if at_bound else rng.uniform(-half_range, half_range)
        normal = NormalRange(true + shift - half_range, true + shift + half_range)
    end = tuple(float(v) for v in centre + error)
    return Contact(name, finger, True, given, end, bound, normal)


def equivalent_configurations(
    placed: Placed, order: int, centre: np.ndarray
) -> Iterator[tuple[float, float, float]]:
    """(x, y, θ) of the object turned about `centre` (its frame) by every multiple of 2π/order, 0: 2π."""
    at = turned(centre, placed.theta) + np.array([placed.x, placed.y])
    order = order or 1
    for step in range(-2 * order, 2 * order + 1):
        theta = placed.theta + 2 * math.pi * step / order
        x, y = at - turned(centre, theta)
        yield float(x), float(y), theta


def holding_truth(recognition: Recognition, placed: Placed) -> Hypothesis | None:
    """The hypothesis whose bounds contain the true configuration or a symmetric one; None if lost."""
    for item in recognition.hypotheses:
        if item.state.object_name != placed.model.name:
            continue
        bounds = item.bounds
        for x, y, theta in equivalent_configurations(placed, item.state.symmetry_order, item.state.origin_mm):
            values = ((x, bounds.x_mm), (y, bounds.y_mm), (theta, bounds.theta_rad))
            if all(lo <= value <= hi for value, (lo, hi) in values):
                return item
    return None


def unit(angle: float) -> np.ndarray:
    """The direction (2,) at an angle."""
    return np.array([math.cos(angle), math.sin(angle)])


def turned(vector: np.ndarray, angle: float) -> np.ndarray:
    """A vector (2,) turned counter-clockwise."""
    cos, sin = math.cos(angle), math.sin(angle)
    return np.array([cos * vector[0] - sin * vector[1], sin * vector[0] + cos * vector[1]])


def place(model: ObjectModel, rng: np.random.Generator, spread: float = 15.0) -> Placed:
    """The object with its origin within a square about the centre, turned anyhow."""
    x, y = rng.uniform(-spread, spread, 2)
    return Placed(model, float(x), float(y), float(rng.uniform(-math.pi, math.pi)))


def place_within(model: ObjectModel, rng: np.random.Generator) -> Placed:
    """The object turned anyhow, with its centre of area anywhere in 20 mm about the table's."""
    theta = float(rng.uniform(-math.pi, math.pi))
    away, bearing = 20.0 * math.sqrt(rng.uniform()), rng.uniform(0, 2 * math.pi)
    x, y = away * unit(bearing) - shapely.get_coordinates(Placed(model, 0.0, 0.0, theta).shape.centroid)[0]
    return Placed(model, float(x), float(y), theta)


def placed_as(item: Hypothesis) -> Placed:
    """The object in the state and the configuration of a hypothesis."""
    at = item.configuration
    model = ObjectModel(item.state.object_name, (item.state.state,))
    return Placed(model, at.x_mm, at.y_mm, at.theta_rad)


def grip(
    placed: Placed,
    rng: np.random.Generator,
    *,
    fingers: int = 3,
    radius: float = 5.0,
    bound: float = 0.3,
    half_range: float | None = math.radians(10),
    at_bound: bool = False,
    ring: float = 140.0,
    aim: float = 0.15,
) -> list[Contact]:
    """Fingers evenly round the table, each going roughly through the middle."""
    shape = placed.shape
    first = rng.uniform(0, 2 * math.pi)
    contacts = []
    for k in range(fingers):
        at = first + 2 * math.pi * k / fingers
        contacts.append(
            touch(
                shape,
                rng,
                radius=radius,
                bound=bound,
                half_range=half_range,
                direction=at + math.pi + rng.uniform(-aim, aim),
                start=ring * unit(at),
                reach=2 * ring,
                at_bound=at_bound,
                name=f"f{k + 1}",
            )
        )
    return contacts


def until_touched(draw: Callable[How, list[Contact]], *args: How.args, **kwargs: How.kwargs) -> list[Contact]:
    """The first of a few drawn grips in which a finger touched; a grip that only misses asks nothing."""
    for _ in range(MOST_DRAWS):
        contacts = draw(*args, **kwargs)
        if any(contact.touched for contact in contacts):
            return contacts
    raise AssertionError(f"{MOST_DRAWS} grips in a row touched nothing")


# ----------------------------------------------------------------------------------------------------
# Exact contacts by shapely: where a disc on a straight path stops, and with which normal.
#
# Sharper than `stop` and `outward_normal` of shapely_bench: also where a path only grazes, and at vertices.

_GRAZING_MM = 3e-9  # no approach is drawn to pass at just this distance


def first_contact(
    shape: shapely.Geometry, start: Floats, heading: Floats, radius: float, reach: float
) -> float:
    """Travel at which a disc on a straight path first touches the shape; infinite if it passes by.

    The distance of the path so far to the shape only falls with the travel: halving finds where it reaches
    the radius, however flatly the path grazes the shape. Give or take: GEOS may take a path through a
    vertex for one that passes it 1e-15 mm away.
    """

    def met(travel: float) -> bool:
        path = shapely.LineString([start, start + travel * heading])
        return bool(shapely.distance(shape, path) <= radius + _GRAZING_MM)

    if not met(reach):
        return math.inf
    free, touching = 0.0, reach
    while touching - free > 1e-12 * reach:
        middle = (free + touching) / 2
        free, touching = (free, middle) if met(middle) else (middle, touching)
    return touching


def true_normal(shape: shapely.Geometry, centre: Floats, radius: float, rng: np.random.Generator) -> float:
    """Direction of an outward normal where a tip at `centre` touches.

    For a disc: of the edge that it is on, or from the vertex that it is at (shapely's nearest point is not
    exact enough near the end of an edge). For a point (r = 0): of the edge that it is on; at a vertex, of
    either of the two edges there, also of the one that faces away from where the point came.
    """
    begin, end = edges_of(shape)
    along = end - begin
    away = centre - begin
    free = np.sum(away * along, axis=1) / np.sum(along * along, axis=1)
    from_foot = away - np.clip(free, 0.0, 1.0)[:, None] * along
    gap = np.linalg.norm(from_foot, axis=1)
    outward = np.column_stack([along[:, 1], -along[:, 0]])
    if radius > 0:
        near = np.flatnonzero(gap <= gap.min() + 1e-12)
        faced = near[(free[near] >= 0.0) & (free[near] <= 1.0)]
        normal = outward[faced[0]] if len(faced) else from_foot[near[0]]
    else:
        normal = outward[rng.choice(np.flatnonzero(gap <= gap.min() + 2 * _GRAZING_MM))]
    return math.atan2(normal[1], normal[0])


def with_normal(placed: Placed, contact: Contact, half_range: float | None, shift: float = 0.0) -> Contact:
    """A point finger's exact contact, with the normal of the edge that it met to within `half_range`."""
    if half_range is None or contact.normal is not None or not contact.touched:
        return contact
    rng = np.random.default_rng(0)  # of two edges at a vertex
    normal = true_normal(placed.shape, np.asarray(contact.end_mm), 0.0, rng) + shift
    return replace(contact, normal=NormalRange(normal - half_range, normal + half_range))


def edges_of(shape: shapely.Geometry) -> tuple[Floats, Floats]:
    """Begins and ends (n, 2) of all edges of a shape, the solid on their left."""
    begins, ends = [], []
    for part in shapely.get_parts(shape):
        oriented = shapely.geometry.polygon.orient(part)
        for ring in (oriented.exterior, *oriented.interiors):
            points = shapely.get_coordinates(ring)
            begins.append(points[:-1])
            ends.append(points[1:])
    return np.concatenate(begins), np.concatenate(ends)


# ----------------------------------------------------------------------------------------------------
# Contacts without errors of position, as tests state them.


def exact_contact(
    name: str, radius_mm: float, start_mm: Floats, end_mm: Floats, normal_rad: float, half_rad: float
) -> Contact:
    """A touch at the end (2,) of a straight way, 10 mm up, with a normal to within `half_rad`."""
    return Contact(
        name,
        Finger(radius_mm, 10.0),
        True,
        (float(start_mm[0]), float(start_mm[1])),
        (float(end_mm[0]), float(end_mm[1])),
        0.0,
        NormalRange(normal_rad - half_rad, normal_rad + half_rad),
    )
