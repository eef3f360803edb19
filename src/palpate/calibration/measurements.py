"""Measurements of a rig that is being calibrated: touches of references, presses, stops, idle arrays.

A `prober.Prober` makes them; the estimators are pure functions of them. Servo angles count from Goal Position
2048, the servo next to the base first.
"""

import math
from dataclasses import dataclass

from palpate.base.geometry import Counts, Floats, Ints

__all__ = ["FREE", "IN", "OUT", "IdleMeasurement", "PressMeasurement", "StopMeasurement", "TouchMeasurement"]


FREE, IN, OUT = 0, 1, 2
"""Legs of a press: before contact, pressing on, going back."""


@dataclass(frozen=True)
class TouchMeasurement:
    """Contact of a finger at rest with a reference, after a slow touch.

    `placing`: number of the placing of a reference that was touched. `servos_rad`: aim and slide, or shoulder
    and elbow. `aim_way`: +1 if the aim or shoulder came to its angle from below, -1 from above, 0 if unknown:
    it determines the side of its backlash; `elbow_way` likewise. `angle_rad` ± `angle_half_rad`: direction
    from the tip's axis to the contact, from the array's middle. `force_n` ± `force_bound_n`: by the array,
    with its gains as known then. `facing_rad`: where the finger faces, from its direction of travel: 0 for a
    slide. `stage_rad`: angle of the turning stage, by its servo; `stage_way`: from which side it came.
    """

    finger: str
    placing: int
    servos_rad: tuple[float, float]
    aim_way: int
    angle_rad: float
    angle_half_rad: float
    force_n: float
    force_bound_n: float
    elbow_way: int = 0
    facing_rad: float = 0.0
    stage_rad: float = 0.0
    stage_way: int = 0


@dataclass(frozen=True, eq=False)
class PressMeasurement:
    """Slow press along one way and back, n samples in the order of time.

    `travel_mm` (n,): how far along its way the tip's servos have brought it; `aside_mm` (n,): how far to the
    left of it. `push_n` (n,): force along the way that the servos' currents stand for, positive if they push
    the tip on, friction in it. `facing_rad` (n,): where the finger faces, from the direction of travel.
    `leg` (n,): FREE, IN or OUT. `counts` (n, rows, cols): the array's counts less the mean of what it read
    untouched just before. `step_mm`, `push_step_n`: by what an encoder step moves the tip along, and what a
    step of the currents is worth. `newton_per_a` (2,): what each servo's current pushes along the way.
    `free_a` (2,): current of each servo on the free way, positive if it turns the servo the way that it
    moves; nan of one that does not move. `friction_sigma_n`: by what friction along the way may be another
    under load, besides what it differs by from place to place; joints that move step by step rest on it.
    """

    finger: str
    placing: int
    travel_mm: Floats
    push_n: Floats
    leg: Ints
    counts: Floats
    step_mm: float
    push_step_n: float
    aside_mm: Floats
    facing_rad: Floats
    newton_per_a: tuple[float, float]
    free_a: tuple[float, float] = (math.nan, math.nan)
    friction_sigma_n: float = 0.0


@dataclass(frozen=True, eq=False)
class IdleMeasurement:
    """An untouched array: counts (n, rows, cols) as read, at `time_s` (n,)."""

    finger: str
    counts: Counts
    time_s: Floats


@dataclass(frozen=True)
class StopMeasurement:
    """Stop of a finger that met a contact at a speed, in mm along its way.

    `felt_mm`: where it was when the contact had been detected and the stop was sent; `stood_mm`: where it
    came to stand; `contact_mm`: where a slow touch of the same way stood. `samples_s`: time between two looks
    at the array.
    """

    finger: str
    speed_mm_s: float
    felt_mm: float
    stood_mm: float
    contact_mm: float
    samples_s: float
