"""Questions to palpate and its peers, and a judge of their answers that is shapely's.

Grips are simulated by shapely, with errors inside their bounds; see
`tests/support/oracles/shapely_touches.py`.
"""

import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import shapely
from shapely import affinity

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
sys.path.insert(0, str(Path(__file__).parent / "peers"))
from question import Answer, Model, Problem, Touch, angle_between

from palpate.base.geometry import ObjectModel
from support.oracles.shapely_touches import SHIPPED_OBJECTS, flat, grip, outlines, outward_normal, place

__all__ = ["ALIKE_MM", "ALIKE_RAD", "Asked", "Case", "Judge", "ask", "drawn_models"]

TIP_RADIUS_MM = 5.0
BOUND_MM = 0.3
ALIKE_MM, ALIKE_RAD = 10.0, math.radians(10.0)  # twice what peers take for one answer
SLACK_MM, SLACK_RAD = 1e-3, 3e-3
SYMMETRIC_SHARE = 1e-3


@dataclass(frozen=True)
class Case:
    """A kind of question. `half_range`: of the normals; None: nothing is measured of them."""

    name: str
    fingers: int
    half_range: float | None
    questions: int
    drawn: int = 0  # outlines drawn at random; 0: the six shipped objects

    @property
    def models(self) -> list[ObjectModel]:
        return drawn_models(self.drawn) if self.drawn else outlines(SHIPPED_OBJECTS)


@dataclass(frozen=True)
class Asked:
    """A problem, and what the truth of each of its questions is."""

    problem: Problem
    truths: tuple[Answer, ...]


def drawn_models(count: int, edges: int = 20, seed: int = 1) -> list[ObjectModel]:
    """Wavy outlines with a rough edge, no two alike."""
    rng = np.random.default_rng(seed)
    found = []
    for number in range(count):
        angle = 2 * np.pi * (np.arange(edges) + rng.uniform(-0.35, 0.35, edges)) / edges
        wave = sum(rng.normal(0, 0.12 / k) * np.cos(k * angle + rng.uniform(0, 6.28)) for k in range(1, 6))
        radius = 40 * np.clip(1 + wave, 0.4, 1.6) * (1 + rng.uniform(-0.06, 0.06, edges))
        points = np.column_stack([radius * np.cos(angle), radius * np.sin(angle)])
        found.append(flat(f"outline {number}", points))
    return found


def ask(case: Case) -> Asked:
    """Grips on random objects in random poses, all of whose fingers touch."""
    rng = np.random.default_rng(case.fingers)
    models = case.models
    questions: list[tuple[Touch, ...]] = []
    truths = []
    while len(questions) < case.questions:
        placed = place(models[int(rng.integers(len(models)))], rng)
        contacts = grip(
            placed,
            rng,
            fingers=case.fingers,
            radius=TIP_RADIUS_MM,
            bound=BOUND_MM,
            half_range=case.half_range,
        )
        if not all(contact.touched for contact in contacts):
            continue
        questions.append(
            tuple(
                Touch(
                    contact.start_mm,
                    contact.end_mm,
                    TIP_RADIUS_MM,
                    contact.position_bound_mm,
                    normals(contact.normal, contact.direction_rad),
                )
                for contact in contacts
            )
        )
        truths.append(Answer(placed.model.name, (placed.x, placed.y, placed.theta)))
    rings = [model.states[0].sections[0].polygons[0].outer for model in models]
    shown = tuple(
        Model(model.name, tuple((float(x), float(y)) for x, y in counter_clockwise(ring)))
        for model, ring in zip(models, rings, strict=True)
    )
    return Asked(Problem(shown, tuple(questions)), tuple(truths))


def normals(measured: object, direction_rad: float) -> tuple[float, float]:
    """The measured range; else what the approach says: a quarter turn to either side of its way back."""
    if measured is None:
        against = direction_rad + math.pi
        return against - math.pi / 2, against + math.pi / 2
    return measured.lo_rad, measured.hi_rad


def counter_clockwise(ring: np.ndarray) -> np.ndarray:
    x, y = np.asarray(ring).T
    area = float(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y))
    return ring if area > 0 else ring[::-1]


class Judge:
    """Says with shapely which answers satisfy the contacts, and whether one answer is covered by others."""

    def __init__(self, problem: Problem) -> None:
        self.shapes = {model.name: shapely.Polygon(model.outline) for model in problem.models}
        self.turns = {name: symmetric_turns(shape) for name, shape in self.shapes.items()}

    def satisfied(self, answer: Answer, touches: Sequence[Touch], slack: float) -> bool:
        """Whether a pose satisfies all contacts, give or take `slack` times 1 µm and 0.17°.

        Of a contact: some place within its bound is one where a tip touches, with a normal in the range;
        and on its way there the tip was nowhere inside the object by more than the bound.
        """
        shape = placed(self.shapes[answer.name], answer.pose)
        return all(touched(shape, touch, slack) and free(shape, touch, slack) for touch in touches)

    def covers(self, answer: Answer, other: Answer) -> bool:
        """Whether `answer` holds another one's pose, or one that is the same by the object's symmetry.

        In its box, if it has one; else within 10 mm and 10°.
        """
        if answer.name != other.name:
            return False
        centre = np.array(self.shapes[other.name].centroid.coords[0])
        x, y, theta = other.pose
        at = rotation(theta) @ centre + (x, y)
        for turn in self.turns[other.name]:
            moved = at - rotation(theta + turn) @ centre
            if holds(answer, (float(moved[0]), float(moved[1]), theta + turn)):
                return True
        return False


def holds(answer: Answer, pose: tuple[float, float, float]) -> bool:
    if answer.box is None:
        away = math.dist(answer.pose[:2], pose[:2])
        return away <= ALIKE_MM and abs(angle_between(answer.pose[2] - pose[2])) <= ALIKE_RAD
    inside = all(lo <= value <= hi for (lo, hi), value in zip(answer.box[:2], pose[:2], strict=True))
    low, high = answer.box[2]
    return inside and (pose[2] - low) % (2 * math.pi) <= high - low


def symmetric_turns(shape: shapely.Polygon) -> list[float]:
    """Turns about its centroid that leave a shape as it is."""
    found = [0.0]
    for order in range(2, 9):
        turned = affinity.rotate(shape, 360 / order, origin=shape.centroid)
        if shape.symmetric_difference(turned).area < SYMMETRIC_SHARE * shape.area:
            found += [2 * math.pi * k / order for k in range(1, order)]
    return found


def rotation(theta: float) -> np.ndarray:
    return np.array([[math.cos(theta), -math.sin(theta)], [math.sin(theta), math.cos(theta)]])


def placed(shape: shapely.Polygon, pose: tuple[float, float, float]) -> shapely.Polygon:
    turned = affinity.rotate(shape, pose[2], origin=(0, 0), use_radians=True)
    return affinity.translate(turned, *pose[:2])


def touched(shape: shapely.Polygon, touch: Touch, slack: float) -> bool:
    bound = touch.bound_mm + slack * SLACK_MM
    line = shape.buffer(touch.radius_mm, quad_segs=64).boundary
    where = shapely.intersection(line, shapely.Point(touch.centre_mm).buffer(bound, quad_segs=64))
    half = touch.half_rad + slack * SLACK_RAD
    for point in shapely.get_coordinates(shapely.segmentize(where, bound / 50)):
        if abs(angle_between(outward_normal(shape, point) - touch.middle_rad)) <= half:
            return True
    return False


def free(shape: shapely.Polygon, touch: Touch, slack: float) -> bool:
    way = shapely.LineString([touch.start_mm, touch.centre_mm])
    return shapely.distance(shape, way) >= touch.radius_mm - touch.bound_mm - slack * SLACK_MM
