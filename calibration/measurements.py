"""Measurements of a rig that is being calibrated: touches of references, presses, stops, idle arrays.

A `prober.Prober` makes them; the estimators are pure functions of them. Servo angles count from Goal Position
2048, the servo next to the base first.
"""

from dataclasses import dataclass

from palpate.geometry import Counts, Floats, Ints

__all__ = ["FREE", "IN", "OUT", "IdleMeasurement", "PressMeasurement", "StopMeasurement", "TouchMeasurement"]


FREE, IN, OUT = 0, 1, 2
"""Legs of a press: before contact, pressing on, going back."""


@dataclass(frozen=True)
class TouchMeasurement:
    """Contact of a finger at rest with a reference, after a slow touch.

    `placing`: number of the placing of a reference that was touched. `servos_rad`: aim and slide. `aim_way`:
    +1 if the aim came to its angle from below, -1 from above, 0 if unknown: it determines the side of its
    backlash. `angle_rad` ± `angle_half_rad`: direction from the tip's axis to the contact, from the array's
    middle. `force_n` ± `force_bound_n`: by the array, with its gains as known then.
    """

    finger: str
    placing: int
    servos_rad: tuple[float, float]
    aim_way: int
    angle_rad: float
    angle_half_rad: float
    force_n: float
    force_bound_n: float


@dataclass(frozen=True, eq=False)
class PressMeasurement:
    """Slow press at one aim and back, n samples in the order of time.

    `aim_rad`: servo angle of the aim. `slide_rad` (n,): servo angle of the slide; `current_a` (n,): its
    Present Current, positive if it pushes the tip out. `leg` (n,): FREE, IN or OUT. `counts` (n, rows, cols):
    the array's counts less the mean of what it read untouched just before.
    """

    finger: str
    placing: int
    aim_rad: float
    slide_rad: Floats
    current_a: Floats
    leg: Ints
    counts: Floats


@dataclass(frozen=True, eq=False)
class IdleMeasurement:
    """An untouched array: counts (n, rows, cols) as read, at `time_s` (n,)."""

    finger: str
    counts: Counts
    time_s: Floats


@dataclass(frozen=True)
class StopMeasurement:
    """Stop of a slide that met a contact at a speed.

    `felt_rad`: slide's servo angle when the contact had been detected and the stop was sent; `stood_rad`:
    where it came to stand; `contact_rad`: where a slow touch at the same aim stood. `samples_s`: time between
    two looks at the array.
    """

    finger: str
    speed_mm_s: float
    felt_rad: float
    stood_rad: float
    contact_rad: float
    samples_s: float
