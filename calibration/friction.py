"""Friction of a slide, as the current that it takes to move without touching anything.

Measured in the free legs of presses. The sign of the current also shows whether the servo turns the way that
the rig file says.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from palpate.calibration.measurements import FREE, PressMeasurement
from palpate.drivers.finger import TICK_RAD
from palpate.errors import InputError
from palpate.geometry import Bools

__all__ = ["Friction", "estimate_friction"]


_WINDOW = 5  # samples over which a slide must have moved on by an encoder step
_FEWEST = 8  # moving samples
_SIGNIFICANT = 3.0  # standard errors from which on a current has a direction


@dataclass(frozen=True)
class Friction:
    """Current of a slide that moves out freely, A: the median of samples.

    `direction`: +1 if the current pushes the tip out, as it must; -1 if it pulls, so that the slide was
    pushed or its direction is not what the rig file says; 0 if the current cannot be told from none.
    """

    current_a: float
    direction: int


def estimate_friction(presses: Sequence[PressMeasurement], mm_per_rad: float) -> Friction:
    """Friction from the free legs of a finger's presses, by samples in which the slide moves out.

    Median, and the deviation that a normal distribution with their quartiles would have: stiction at
    the start, and places where a carriage catches, are rare. Raises InputError if too few samples move.
    """
    moving = [press.current_a[_moves_out(press, mm_per_rad)] for press in presses]
    current = np.concatenate(moving) if moving else np.empty(0)
    if len(current) < _FEWEST:
        name = presses[0].finger if presses else "?"
        raise InputError(
            f"finger {name}: before it touched, its slide moved in {len(current)} samples only; {_FEWEST} "
            "are needed to tell its friction; begin presses further away from the reference"
        )
    middle = float(np.median(current))
    lower, upper = np.quantile(current, [0.25, 0.75])
    sigma = float(upper - lower) / 1.349
    significant = abs(middle) > _SIGNIFICANT * sigma / np.sqrt(len(current))
    return Friction(middle, int(np.sign(middle)) if significant else 0)


def _moves_out(press: PressMeasurement, mm_per_rad: float) -> Bools:
    """Samples (n,) of the free leg before and after which the slide moves outwards."""
    free = np.flatnonzero(press.leg == FREE)
    result = np.zeros(len(press.leg), dtype=bool)
    if len(free) < 2 * _WINDOW:
        return result
    place = press.slide_rad[free] * np.sign(mm_per_rad)
    before = place[_WINDOW:-_WINDOW] - place[: -2 * _WINDOW]
    after = place[2 * _WINDOW :] - place[_WINDOW:-_WINDOW]
    steady = (before > TICK_RAD / 2) & (after > TICK_RAD / 2)
    result[free[_WINDOW:-_WINDOW][steady]] = True
    return result
