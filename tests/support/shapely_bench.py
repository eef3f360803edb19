"""Touches simulated with shapely alone: an oracle that shares no code with the recogniser."""

import json
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import shapely
from shapely import affinity, ops

from palpate.recognizer.contact import Contact, Finger, NormalRange
from palpate.recognizer.model import ObjectModel, Polygon, Section, State

SHARED_OUTLINES = Path(__file__).parents[3] / "shared" / "data" / "outlines" / "classic.json"


def flat(name: str, outline: object, height_mm: float = 20.0) -> ObjectModel:
    """An object with one state and one section."""
    section = Section(0.0, height_mm, (Polygon(np.asarray(outline, dtype=float)),))
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
    def shape(self) -> shapely.Polygon:
        outline = shapely.Polygon(self.model.states[0].sections[0].polygons[0].outer)
        turned = affinity.rotate(outline, self.theta, origin=(0, 0), use_radians=True)
        return affinity.translate(turned, self.x, self.y)


def stop(shape: shapely.Polygon, start: np.ndarray, direction: float, radius: float, reach: float) -> float:
    """Travel after which a disc on a straight path first touches the shape; infinite if it passes by."""
    heading = np.array([math.cos(direction), math.sin(direction)])
    travel = 0.0
    while travel < reach:
        gap = shapely.distance(shape, shapely.Point(start + travel * heading)) - radius
        if gap < 1e-9:
            return travel
        travel += gap
    return math.inf


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
) -> Contact:
    """One approach with its position and normal mismeasured by no more than their bounds."""
    heading = np.array([math.cos(direction), math.sin(direction)])
    travel = stop(shape, start, direction, radius, reach)
    angle = rng.uniform(0, 2 * math.pi)
    size = bound if at_bound else bound * math.sqrt(rng.uniform())
    error = size * np.array([math.cos(angle), math.sin(angle)])
    finger = Finger(radius, 10.0)
    given = tuple(float(v) for v in start + error)
    if not math.isfinite(travel):
        end = tuple(float(v) for v in start + error + reach * heading)
        return Contact(name, finger, False, given, end, bound)
    centre = start + travel * heading
    normal = None
    if half_range is not None and radius > 0:
        nearest = ops.nearest_points(shape, shapely.Point(centre))[0]
        true = math.atan2(centre[1] - nearest.y, centre[0] - nearest.x)
        shift = rng.choice([-1, 1]) * half_range if at_bound else rng.uniform(-half_range, half_range)
        normal = NormalRange(true + shift - half_range, true + shift + half_range)
    end = tuple(float(v) for v in centre + error)
    return Contact(name, finger, True, given, end, bound, normal)


def place(model: ObjectModel, rng: np.random.Generator, spread: float = 15.0) -> Placed:
    """The object with its origin within a square about the centre, turned anyhow."""
    x, y = rng.uniform(-spread, spread, 2)
    return Placed(model, float(x), float(y), float(rng.uniform(-math.pi, math.pi)))


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
                start=ring * np.array([math.cos(at), math.sin(at)]),
                reach=2 * ring,
                at_bound=at_bound,
                name=f"f{k + 1}",
            )
        )
    return contacts
