"""Judges of configurations and the scenes they are asked about."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import pairwise

import numpy as np
import shapely

from palpate.base.geometry import Bools, Floats, ObjectModel, State
from palpate.config.objects_file import objects_from_text
from palpate.config.objects_tables import ObjectsFileText
from palpate.recognizer import Catalogue, Configuration, Contact, Finger, Recognition, recognise
from palpate.recognizer.contact import NormalRange
from palpate.recognizer.interpretations import Query
from palpate.recognizer.verification import Poses
from support.campaign.objects import FAMILIES, displaced, drawn_objects, drawn_source, objects_of
from support.commands.repository import SHARED_OUTLINES
from support.oracles.shapely_touches import (
    SHIPPED_OBJECTS,
    Placed,
    grip,
    outlines,
    place,
    true_normal,
    turned,
    until_touched,
)

# ----------------------------------------------------------------------------------------------------
# Is a configuration what `verified` says? By shapely alone, on outlines and true arcs.
#
# It shares no code with the recogniser. In the frame of the object. Rounded outward: distances and radii by
# 2e-6 mm, normals by 1e-6 rad. Where a path as stated is not free, or much of a contact's surroundings is
# covered, discs are replaced by polygons that are up to 4e-5 mm smaller; of an object with a tolerance, by as
# much for all of its contacts.

_ROUND_MM, _ROUND_RAD = 2e-6, 1e-6
_POLYGONAL_MM = 5e-5
_SEGMENTS = 256  # of a quarter circle
_STEP_RAD = 1e-3
_SAMPLES = 200  # of a bound


def objections(
    state: State, tolerance_mm: float, at: Configuration, contacts: Sequence[Contact]
) -> list[str]:
    """What speaks against an object lying so: contacts and paths that it does not satisfy."""
    found = []
    for contact in contacts:
        shape = _shape(state, contact.finger.height_mm)
        start, end = (_seen(at, point) for point in (contact.start_mm, contact.end_mm))
        if contact.touched and not _is_contact(shape, tolerance_mm, at, contact, end):
            found.append(f"contact of {contact.name}")
        radius = contact.finger.tip_radius_mm - tolerance_mm - _ROUND_MM
        if not _is_free(shape, radius, start, end, contact.free_path_bound_mm):
            found.append(f"path of {contact.name}")
    return found


@cache
def _shape(state: State, height_mm: float) -> shapely.Geometry:
    parts = [
        shapely.Polygon(polygon.outer, polygon.holes)
        for section in state.sections_at(height_mm)
        for polygon in section.polygons
    ]
    return shapely.union_all(parts)


def _seen(at: Configuration, point: tuple[float, float]) -> Floats:
    x, y = point[0] - at.x_mm, point[1] - at.y_mm
    cos, sin = math.cos(at.theta_rad), math.sin(at.theta_rad)
    return np.array([cos * x + sin * y, cos * y - sin * x])


def _is_contact(
    shape: shapely.Geometry, tolerance: float, at: Configuration, contact: Contact, point: Floats
) -> bool:
    radius, bound = contact.finger.tip_radius_mm, contact.position_bound_mm
    assert contact.normal is not None
    lo = contact.normal.lo_rad - at.theta_rad - _ROUND_RAD
    allowed = (lo, contact.normal.hi_rad - contact.normal.lo_rad + 2 * _ROUND_RAD)
    near = radius + bound + tolerance + 1e-3
    for begin, end, normal, turn in _features(shape, tolerance, radius):
        if shapely.distance(shapely.LineString([begin, end]), shapely.Point(point)) > near:
            continue
        for first, width in _common((normal, turn), allowed):
            swept, place = _swept(begin, end, first, width, radius), shapely.Point(point)
            if shapely.distance(swept, place) > bound + tolerance + _ROUND_MM:
                continue
            if tolerance > 0:
                fits = _loosely_near(shape, swept, place, radius, bound, tolerance)
            else:
                fits = _near(shape, swept, place, radius, bound)
            if fits:
                return True
    return False


@cache
def _feature_list(
    shape: shapely.Geometry, tolerance: float, *, arcs: bool
) -> list[tuple[Floats, Floats, float, float]]:
    found = []
    for part in shapely.get_parts(shape):
        oriented = shapely.geometry.polygon.orient(part)
        for ring in (oriented.exterior, *oriented.interiors):
            points = shapely.get_coordinates(ring)[:-1]
            legs = np.roll(points, -1, axis=0) - points
            sines = [min(1.0, 4 * tolerance / math.hypot(*leg)) for leg in legs]
            tilts = [math.pi if sine >= 1 else math.asin(sine) for sine in sines]
            normals = [math.atan2(-x, y) for x, y in legs]
            for k in range(len(points)):
                tilt, before = tilts[k], tilts[k - 1]
                found.append((points[k], points[k] + legs[k], normals[k] - tilt, 2 * tilt))
                bend = math.remainder(normals[k] - normals[k - 1], 2 * math.pi) + tilt + before
                if arcs and bend > 0:
                    width = min(bend, 2 * math.pi)
                    found.append((points[k], points[k], normals[k - 1] - before, width))
    return found


def _features(
    shape: shapely.Geometry, tolerance: float, radius: float
) -> Iterator[tuple[Floats, Floats, float, float]]:
    """Edges, and vertices if the finger has a radius: ends, and first normal and turn of the normals."""
    yield from _feature_list(shape, tolerance, arcs=radius > 0)


def _common(one: tuple[float, float], two: tuple[float, float]) -> Iterator[tuple[float, float]]:
    """Where two ranges of directions (begin, width) meet."""
    for (begin, width), (other, room) in ((one, two), (two, one)):
        into = (begin - other) % (2 * math.pi)
        if into <= room:
            yield begin, min(width, room - into)


def _swept(begin: Floats, end: Floats, first: float, width: float, radius: float) -> shapely.Geometry:
    """Where the tip's centre is on a feature with these normals."""
    angles = first + np.linspace(0.0, width, 2 + int(width / _STEP_RAD))
    rim = radius * np.column_stack([np.cos(angles), np.sin(angles)])
    if width <= 0 or radius == 0:
        return shapely.LineString([begin + rim[0], end + rim[0]])
    if np.array_equal(begin, end):
        return shapely.LineString(begin + rim)
    quads = [shapely.Polygon([begin + a, end + a, end + b, begin + b]).convex_hull for a, b in pairwise(rim)]
    return shapely.union_all(quads)


def _near(
    shape: shapely.Geometry, swept: shapely.Geometry, at: shapely.Point, radius: float, bound: float
) -> bool:
    """Whether the tip may be on this feature within the bound: there, the object is just a radius away."""
    nearest = shapely.shortest_line(swept, at).coords[0]
    reach = at.buffer(bound + _ROUND_MM + _POLYGONAL_MM, quad_segs=_SEGMENTS)
    around = swept.intersection(reach)
    fine = shapely.get_coordinates(shapely.segmentize(around, max(bound, 1e-3) / _SAMPLES))
    places = shapely.points(np.vstack([[nearest], fine]))
    clear = shapely.distance(places, shape) >= radius - _ROUND_MM
    if np.any(clear & (shapely.distance(places, at) <= bound + _ROUND_MM)):
        return True
    # The part that is not covered may be shorter than what lies between two samples.
    open_part = around.difference(_grown(shape, radius - _ROUND_MM, reach))
    return not open_part.is_empty and shapely.distance(open_part, at) <= bound + _ROUND_MM


def _loosely_near(
    shape: shapely.Geometry,
    swept: shapely.Geometry,
    at: shapely.Point,
    radius: float,
    bound: float,
    tolerance: float,
) -> bool:
    """The same of a feature that is off by up to the tolerance: the object is a radius less that away."""
    if radius <= tolerance:
        return True
    reach = at.buffer(bound + _POLYGONAL_MM, quad_segs=_SEGMENTS)
    around = swept.buffer(tolerance + _POLYGONAL_MM, quad_segs=_SEGMENTS).intersection(reach)
    return not around.difference(_grown(shape, radius - tolerance - _ROUND_MM, reach)).is_empty


def _grown(shape: shapely.Geometry, radius: float, about: shapely.Geometry) -> shapely.Geometry:
    """The shape grown, or shrunk, as far as that matters in a region."""
    if radius <= 0:
        return shape.buffer(radius, join_style="mitre")
    x0, y0, x1, y1 = about.bounds
    margin = radius + 1.0
    part = shape.intersection(shapely.box(x0 - margin, y0 - margin, x1 + margin, y1 + margin))
    return part.buffer(radius, quad_segs=_SEGMENTS)


def _is_free(shape: shapely.Geometry, radius: float, start: Floats, end: Floats, bound: float) -> bool:
    """Whether some path, off by no more than the bound, does not come nearer to the shape than the radius."""
    path = shapely.LineString([start, end])
    if radius > 0 and shapely.distance(path, shape) >= radius:
        return True
    tube = path.buffer(bound + _POLYGONAL_MM, quad_segs=_SEGMENTS)
    ends = [shapely.Point(at).buffer(bound + _POLYGONAL_MM, quad_segs=_SEGMENTS) for at in (start, end)]
    free = tube.difference(_grown(shape, radius, tube))
    return any(all(part.intersects(disc) for disc in ends) for part in shapely.get_parts(free))


# ----------------------------------------------------------------------------------------------------
# Seeded grips whose verified configurations are judged: one row of settings after the other.
#
# Shared by tests/recognizer/test_verification.py and benchmarks/bench_verified.py. A scene depends on its
# seed
# and index.

RADII_MM = (0.0, 1.0, 3.0, 5.0, 8.0)
BOUNDS_MM = (0.05, 0.1, 0.2, 0.3, 0.5)
NORMALS_DEG = (5.0, 10.0, 15.0, 20.0)
TOLERANCE_MM = 0.05


@dataclass(frozen=True)
class Scene:
    """One grip. `family`: "memo" or "parts"; `normals_deg`: half of the range of normals."""

    family: str
    tolerance_mm: float
    radius_mm: float
    bound_mm: float
    normals_deg: float
    placed: Placed
    contacts: tuple[Contact, ...]

    @property
    def touches(self) -> int:
        """How many fingers touched."""
        return sum(contact.touched for contact in self.contacts)


@cache
def models_of(family: str, tolerance_mm: float) -> tuple[ObjectModel, ...]:
    """The shipped parts, or the shared outlines."""
    file = SHIPPED_OBJECTS if family == "memo" else SHARED_OUTLINES
    return tuple(replace(model, tolerance_mm=tolerance_mm) for model in outlines(file))


@cache
def catalogue_of(family: str, tolerance_mm: float) -> Catalogue:
    """Built once in each process."""
    return Catalogue(models_of(family, tolerance_mm))


def drawn(seed: int, index: int, families: tuple[str, ...]) -> Scene:
    """Scene `index`: a grip of two to five fingers, some of which miss."""
    rng = np.random.default_rng((seed, index))
    family = families[int(rng.integers(len(families)))]
    tolerance = TOLERANCE_MM if rng.random() < 0.25 else 0.0
    radius, bound = float(rng.choice(RADII_MM)), float(rng.choice(BOUNDS_MM))
    half = float(rng.choice(NORMALS_DEG))
    models = models_of(family, tolerance)
    at_bound = bool(rng.random() < 0.5)
    placed = place(displaced(models[int(rng.integers(len(models)))], rng, at_bound=at_bound), rng)
    contacts = until_touched(
        grip,
        placed,
        rng,
        fingers=int(rng.choice([2, 3, 4, 5], p=[0.2, 0.4, 0.3, 0.1])),
        radius=radius,
        bound=bound,
        half_range=math.radians(half),
        at_bound=at_bound,
        aim=float(rng.choice([0.15, 0.4])),
    )
    felt = [_with_normal(contact, placed.shape, math.radians(half), rng) for contact in contacts]
    return Scene(family, tolerance, radius, bound, half, placed, tuple(felt))


def _with_normal(contact: Contact, shape: shapely.Geometry, half: float, rng: np.random.Generator) -> Contact:
    """Point fingers are given a normal as well."""
    if not contact.touched or contact.normal is not None:
        return contact
    normal = true_normal(shape, np.array(contact.end_mm), 0.0, rng) + rng.uniform(-half, half)
    return replace(contact, normal=NormalRange(normal - half, normal + half))


def asked(scene: Scene) -> Recognition:
    """The recogniser's answer."""
    return recognise(catalogue_of(scene.family, scene.tolerance_mm), scene.contacts)


def refused(scene: Scene, answer: Recognition) -> list[str]:
    """What the judge says against verified configurations."""
    found = []
    for item in answer.hypotheses:
        if item.verified:
            against = objections(item.state.state, scene.tolerance_mm, item.configuration, scene.contacts)
            found += [f"{item.state.object_name} at {item.configuration}: {what}" for what in against]
    return found


# ----------------------------------------------------------------------------------------------------
# Random questions to verification: parts and contacts of every kind, poses near the truth and far.

_RADII_MM = (0.0, 0.2, 1.0, 5.0, 8.0)
_BOUNDS_MM = (0.0, 0.01, 0.3, 1.0, 5.0)
_HALF_RAD = (0.0, 0.02, 0.2, 1.0, math.pi)
_SPREAD = (1e-7, 1e-2, 0.3, 2.0, 20.0)  # of poses about the truth: mm, and half of that in degrees
_POSES = 60


@dataclass(frozen=True, eq=False)
class Case:
    """Poses (n,) and m contacts; `skipped` (n, m) or None: those that are no evidence."""

    models: tuple[ObjectModel, ...]
    poses: Poses
    contacts: tuple[Contact, ...]
    anchor_mm: Floats
    skipped: Bools | None

    def catalogue(self) -> Catalogue:
        """A new one."""
        return Catalogue(self.models)

    def evidence(self) -> Query:
        """All contacts, and a new catalogue."""
        return Query(self.catalogue(), self.contacts, self.anchor_mm)


@cache
def _discs() -> tuple[ObjectModel, ...]:
    """A round state with a bound of its normals, one with a tolerance besides, and a polygon with both."""
    parts = []
    for name, more in (("disc", {}), ("loose disc", {"tolerance": 0.2})):
        circles = [{"circle": {"centre": [3.0, 1.0], "radius": radius}} for radius in (21.0, 8.0)]
        section = {"z": [0, 20], "polygons": [{"outer": circles[0], "holes": [circles[1]]}]}
        parts.append({"name": name, "states": [{"name": "flat", "sections": [section]}], **more})
    text = {"format": "palpate/objects@1", "units": "mm", "objects": parts}
    models = objects_from_text(ObjectsFileText.model_validate(text), "here").objects
    bounded = replace(objects_of("memo")[0], name="bounded", tolerance_mm=0.4, normal_bound_rad=0.15)
    return (*models, bounded)


def _drawn_models(rng: np.random.Generator) -> tuple[ObjectModel, ...]:
    family = str(rng.choice([family for family in (*FAMILIES, "discs") if family != "parts"]))
    if family == "discs":
        return _discs()
    if family == "drawn":
        return drawn_objects(rng, float(rng.choice(_RADII_MM)))
    models = objects_of(drawn_source(family, rng))
    some = rng.choice(len(models), min(3, len(models)), replace=False)
    # A tolerance beyond the tip's radius lets paths go through the outline.
    wide = float(rng.choice([0.0, 0.0, 0.0, 0.05, 1.5]))
    return tuple(replace(models[k], tolerance_mm=max(models[k].tolerance_mm, wide)) for k in some)


def _drawn_contacts(placed: Placed, rng: np.random.Generator) -> list[Contact]:
    contacts = grip(
        placed,
        rng,
        fingers=int(rng.integers(1, 6)),
        radius=float(rng.choice(_RADII_MM)),
        bound=float(rng.choice(_BOUNDS_MM)),
        half_range=float(rng.choice(_HALF_RAD)),
        at_bound=bool(rng.random() < 0.5),
        ring=float(rng.choice([60.0, 140.0])),
        aim=float(rng.choice([0.15, 0.4])),
    )
    if rng.random() < 0.5:
        contacts.append(_grazing(contacts[0], rng))
    return [_varied(contact, rng) for contact in contacts]


def _grazing(contact: Contact, rng: np.random.Generator) -> Contact:
    """A miss whose path runs across the end of another's."""
    across = contact.direction_rad + math.pi / 2 + float(rng.normal(0, 0.5))
    way = 30.0 * np.array([math.cos(across), math.sin(across)])
    (x0, y0), (x1, y1) = (np.array(contact.end_mm) + side * way for side in (-1, 1))
    ends = {"start_mm": (float(x0), float(y0)), "end_mm": (float(x1), float(y1))}
    return replace(contact, name="miss", touched=False, normal=None, **ends)


def _varied(contact: Contact, rng: np.random.Generator) -> Contact:
    """The same with another range of normals, path bound or height, or without travel; or touched or not."""
    change, half = int(rng.integers(8)), float(rng.choice(_HALF_RAD))
    middle = contact.direction_rad + math.pi + float(rng.normal(0, 0.3))
    changes: dict[int, dict[str, object]] = {
        0: {"normal": None},
        1: {"normal": NormalRange(middle - half, middle + half), "touched": True},
        2: {"path_bound_mm": contact.position_bound_mm + float(rng.choice([0.0, 0.1, 2.0]))},
        3: {"finger": Finger(contact.finger.tip_radius_mm, float(rng.choice([3.0, 17.0, 1000.0])))},
        4: {"touched": not contact.touched, "normal": None},
        5: {"start_mm": contact.end_mm, "normal": NormalRange(middle - half, middle + half)},
    }
    return replace(contact, **changes.get(change, {}))


def drawn_case(seed: int) -> Case:
    """Case `seed`: about half of its poses are of the true state, at any distance from the truth."""
    rng = np.random.default_rng([24, seed])
    models = _drawn_models(rng)
    catalogue = Catalogue(models)
    number = int(rng.integers(len(models)))
    placed = place(models[number], rng)
    contacts, anchor = _drawn_contacts(placed, rng), rng.normal(0, 5, 2)
    true = [state.object_name for state in catalogue.states].index(models[number].name)
    state = np.where(rng.random(_POSES) < 0.6, true, rng.integers(len(catalogue.states), size=_POSES))
    spread = rng.choice(_SPREAD, _POSES)
    theta = placed.theta + rng.normal(0, 1, _POSES) * spread * math.radians(0.5)
    theta += 2 * math.pi * rng.integers(-1, 2, _POSES)
    position = np.empty((_POSES, 2))
    for k in range(_POSES):
        at = np.array([placed.x, placed.y]) + rng.normal(0, spread[k], 2)
        centre = at + turned(catalogue.origins_mm[state[k]], theta[k])
        position[k] = turned(centre - anchor, -theta[k])
    skipped = rng.random((_POSES, len(contacts))) < 0.2 if rng.random() < 0.3 else None
    return Case(models, Poses(state, theta, position), tuple(contacts), anchor, skipped)
