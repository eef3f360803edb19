"""Touches and reach that plans are judged by."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import shapely
from shapely import ops

from palpate.base.geometry import Bools, Floats, Ints, ObjectModel
from palpate.recognizer import (
    Approach,
    Catalogue,
    Contact,
    Finger,
    FingerApproach,
    Goals,
    Hypothesis,
    NormalRange,
    Recognition,
    Resolution,
    recognise,
)
from palpate.recognizer.prediction import Prediction
from palpate.rig.motion.guarded_approach import GripPhase
from palpate.rig.motion.touch import Touch
from palpate.rig.reach.approaches import Reach
from support.oracles.shapely_touches import (
    SHIPPED_OBJECTS,
    Placed,
    grip,
    outlines,
    outward_normal,
    place,
    stop,
    unit,
)

# ----------------------------------------------------------------------------------------------------
# Plans without a rig: a ring of approaches from everywhere, and what there is along them by shapely.

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


# ----------------------------------------------------------------------------------------------------
# A rig without devices: grips carried out with shapely, mismeasured within their declared bounds.
#
# Thousands of searches in the time of one on emulated devices. Shares with the rig only what a rig file says:
# which approaches there are, and how well they are carried out.

# Of an approach's bound: what touches on the emulated bench declare.
ORDINARY_SHARE, ORDINARY_PATH = 0.33, 0.55


@dataclass
class SimulatedTouches:
    """What lies on the table, and how it is felt. Called as the loop's `carry`.

    A touch declares `share` of its approach's bound, and is off by as much if `at_bound`, otherwise by any
    part of it. `normal_half_rad`: half of every normal range; the true normal is anywhere in it, or at its
    end.
    """

    reach: Reach
    placed: Placed
    rng: np.random.Generator
    normal_half_rad: float = math.radians(10.0)
    share: float = ORDINARY_SHARE
    at_bound: bool = False

    def __call__(
        self, grip: Sequence[FingerApproach], tell: Callable[[GripPhase], None] | None = None
    ) -> list[Touch]:
        del tell
        return [self._touch(item) for item in grip]

    def _touch(self, approach: FingerApproach) -> Touch:
        bound = approach.position_bound_mm
        contact = felt_along(
            approach,
            f"f{approach.finger_index + 1}",
            self.placed,
            self.rng,
            bound=self.share * bound,
            path_bound=max(self.share, ORDINARY_PATH) * bound,
            half_range=self.normal_half_rad,
            at_bound=self.at_bound,
        )
        return Touch(approach.finger_index, contact, None, (math.nan, math.nan))


def felt_along(
    approach: Approach,
    name: str,
    placed: Placed,
    rng: np.random.Generator,
    *,
    bound: float,
    path_bound: float,
    half_range: float,
    at_bound: bool = False,
) -> Contact:
    """What a finger feels that really travels up to `bound` mm beside the approach, or just as much."""
    finger, direction = approach.finger, approach.direction_rad
    shape = placed.shape_at(finger.height_mm)
    angle = rng.uniform(0, 2 * math.pi)
    error = unit(angle) * bound * (1.0 if at_bound else math.sqrt(rng.uniform()))
    start = np.array(approach.start_mm)
    travel = stop(shape, start + error, direction, finger.tip_radius_mm, approach.travel_mm)
    touched, normal = math.isfinite(travel), None
    end = start + (travel if touched else approach.travel_mm) * unit(direction)
    if touched:
        off = rng.choice([-1.0, 1.0]) if at_bound else rng.uniform(-1, 1)
        middle = outward_normal(shape, end + error) + off * half_range
        normal = NormalRange(middle - half_range, middle + half_range)
    at = (float(end[0]), float(end[1]))
    return Contact(name, finger, touched, approach.start_mm, at, bound, normal, path_bound_mm=path_bound)


def as_predicted(contact: Contact, predicted: Prediction, slack_mm: float = 0.0) -> bool:
    """Whether the finger stopped where it was to, or missed where it might."""
    travel = contact.travel_mm if contact.touched else math.inf
    return predicted.earliest_mm - slack_mm <= travel <= predicted.latest_mm + slack_mm
