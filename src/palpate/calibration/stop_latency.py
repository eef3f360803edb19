"""Stop latency of fingers, and bounds on the overshoot that it costs at each speed.

A finger that meets something
runs on for as long as the contact takes to be detected, the stop to be sent and the finger to stand: its
latency. Part of that is the wait between two looks at the array, anything from nothing to all of it.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import stdtrit

from palpate.base.errors import InputError
from palpate.base.geometry import Floats
from palpate.calibration.measurements import StopMeasurement
from palpate.config import Overshoot

__all__ = ["StopLatency", "fit_latency"]


_FEWEST = 3  # stops that are faster than a touch
_FASTER = 1.5  # times as fast as a touch, to count


@dataclass(frozen=True)
class StopLatency:
    """Latency of a finger: the mean, and a bound on that of single stops.

    `overshoots` go by growing speed, mm beyond where the slowest touch stands; they hold for the speeds that
    were tried: faster, braking adds to them.
    """

    latency_s: float
    latency_bound_s: float
    overshoots: list[Overshoot]


def fit_latency(
    stops: Sequence[StopMeasurement], step_mm: float, touch_speed_mm_s: float, coverage: float
) -> StopLatency:
    """Fit one latency to the stops of a finger; `touch_speed_mm_s`: that of the touches at
    `contact_mm`; `step_mm`: by what an encoder step moves the tip.

    A slow touch runs on as well, and dents what it touches, so a stop is further than it by (speed − touch
    speed) × latency. Stops weigh as the wait for the next look and the encoder's steps let them. The bound
    covers one more stop with probability `coverage`: Student's, one-sided, with a deviation of no less than
    that wait has, and no less than the mean plus half the wait. Raises InputError for too few stops.
    """
    used = [stop for stop in stops if stop.speed_mm_s > _FASTER * touch_speed_mm_s]
    if len(used) < _FEWEST:
        name = stops[0].finger if stops else "?"
        raise InputError(
            f"finger {name}: {len(used)} stops were faster than {_FASTER:g} times a touch; {_FEWEST} are "
            "needed to tell its latency; stop it more often at closing.approach_speed_mm_s"
        )
    speed = np.array([stop.speed_mm_s for stop in used])
    wait = np.array([stop.samples_s for stop in used])
    further = np.array([stop.stood_mm - stop.contact_mm for stop in used])
    known = _known_deviation_s(speed, touch_speed_mm_s, wait, step_mm)
    each = further / (speed - touch_speed_mm_s)
    latency = max(0.0, float(np.average(each, weights=known**-2.0)))
    bound = _bound_s(each, latency, known, float(wait.max()), coverage)
    return StopLatency(latency, bound, _table(speed, further + touch_speed_mm_s * latency, bound, step_mm))


def _known_deviation_s(speed: Floats, touch_speed: float, wait: Floats, step_mm: float) -> Floats:
    """Standard deviations (n,) of single latencies: waits of both touches, steps of both angles."""
    waits = (speed**2 + touch_speed**2) * wait**2 / 12
    result: Floats = np.sqrt(waits + step_mm**2 / 6) / (speed - touch_speed)
    return result


def _bound_s(each: Floats, latency: float, known: Floats, wait: float, coverage: float) -> float:
    """Prediction bound on the latency of one more stop.

    What the readings' steps add to the scatter makes the mean uncertain, but is no part of a stop.
    """
    n = len(each)
    worse = max(1.0, math.sqrt(float((((each - latency) / known) ** 2).sum()) / (n - 1)))
    own, of_mean = wait / math.sqrt(12), 1 / math.sqrt(float((known**-2.0).sum()))
    reach = float(stdtrit(n - 1, coverage)) * worse * math.hypot(own, of_mean)
    return latency + max(reach, wait / 2)


def _table(speed: Floats, beyond: Floats, bound_s: float, step_mm: float) -> list[Overshoot]:
    """One for each speed; the bound has room for an encoder step and is never below what was measured."""
    rows = []
    for each in np.unique(speed):
        largest = float(beyond[speed == each].max())
        bound = max(float(each) * bound_s + step_mm, largest)
        rows.append(Overshoot(speed_mm_s=float(each), largest_mm=max(largest, 0.0), bound_mm=bound))
    return rows
