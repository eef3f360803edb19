"""Plans without a rig: a ring of approaches from everywhere, and what there is along them by shapely."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import shapely
from shapely import ops
from shapely_bench import SHIPPED_OBJECTS, Placed, grip, outlines, place, stop

from palpate.base.geometry import Bools, Floats, Ints, ObjectModel
from palpate.recognizer import (
    Approach,
    Catalogue,
    Contact,
    Finger,
    FingerApproach,
    Goals,
    Hypothesis,
    Recognition,
    Resolution,
    recognise,
)

RESOLUTION = Resolution(1.0, math.radians(12))
GOALS = Goals(1.0, math.radians(1.0))
FINGER = Finger(5.0, 10.0)


@dataclass(frozen=True)
class Ring:
    """Three fingers that reach the table from everywhere, and never meet one another."""

    approaches: Sequence[FingerApproach]

    def together(self, one: int, travel_mm: float, others: Ints, travels_mm: Floats) -> Bools:
        del travel_mm, travels_mm
        finger = np.array([item.finger_index for item in self.approaches], dtype=np.int64)
        return finger[others] != finger[one]

    def seconds(self, travels_mm: Floats) -> Floats:
        return 2.0 + travels_mm / 20.0


def ring(count: int = 24, bound: float = 0.3) -> Ring:
    return Ring(
        [
            FingerApproach(
                FINGER,
                (140 * math.cos(at), 140 * math.sin(at)),
                at + math.pi + aim,
                280.0,
                bound,
                finger_index=k % 3,
            )
            for k, at in enumerate(2 * math.pi * np.arange(count) / count)
            for aim in (-0.12, 0.0, 0.12)
        ]
    )


def model_of(models: list[ObjectModel], item: Hypothesis) -> ObjectModel:
    return next(model for model in models if model.name == item.state.object_name)


def travel_of(placed: Placed, approach: Approach) -> float:
    start = np.asarray(approach.start_mm)
    radius = approach.finger.tip_radius_mm
    return stop(placed.shape, start, approach.direction_rad, radius, approach.travel_mm)


def normal_at(placed: Placed, approach: Approach, travel: float) -> float:
    centre = np.asarray(approach.start_mm) + travel * np.array(
        [math.cos(approach.direction_rad), math.sin(approach.direction_rad)]
    )
    nearest = ops.nearest_points(placed.shape, shapely.Point(centre))[0]
    return math.atan2(centre[1] - nearest.y, centre[0] - nearest.x)


def some_recognition(seed: int, *, half_deg: float = 10.0) -> tuple[list[ObjectModel], Recognition]:
    rng = np.random.default_rng(seed)
    models = outlines(SHIPPED_OBJECTS)
    contacts = grip(place(models[seed % 6], rng), rng, half_range=math.radians(half_deg))
    return models, recognise(Catalogue(models), contacts)


def contact_along(candidate: FingerApproach, travel: float) -> Contact:
    approach = candidate
    end = np.asarray(approach.start_mm) + travel * np.array(
        [math.cos(approach.direction_rad), math.sin(approach.direction_rad)]
    )
    return Contact("f", FINGER, True, approach.start_mm, (float(end[0]), float(end[1])), 0.3)
