"""Friction of a finger, as the force along its way that it takes to move without touching anything.

Measured in the free legs of presses. The sign of the current also shows whether the servo turns the way that
the rig file says.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from palpate.base.errors import InputError
from palpate.base.geometry import Bools
from palpate.calibration.measurements import FREE, PressMeasurement

__all__ = ["Friction", "estimate_friction"]


_WINDOW = 5  # samples over which a slide must have moved on by an encoder step
_FEWEST = 8  # moving samples
_SIGNIFICANT = 3.0  # standard errors from which on a current has a direction


@dataclass(frozen=True)
class Friction:
    """Force along the way of a finger that moves on freely, N: the median of samples.

    `direction`: +1 if currents push the tip on, as they must; -1 if they pull, so that the finger was
    pushed or its direction is not what the rig file says; 0 if currents cannot be told from none.
    """

    push_n: float
    direction: int


def estimate_friction(presses: Sequence[PressMeasurement]) -> Friction:
    """Friction from the free legs of a finger's presses, by samples in which it moves on.

    Median, and the deviation that a normal distribution with their quartiles would have: stiction at
    the start, and places where a carriage catches, are rare. Raises InputError if too few samples move.
    """
    moving = [press.push_n[_moves_on(press)] for press in presses]
    push = np.concatenate(moving) if moving else np.empty(0)
    if len(push) < _FEWEST:
        name = presses[0].finger if presses else "?"
        raise InputError(
            f"finger {name}: before it touched, it moved in {len(push)} samples only; {_FEWEST} "
            "are needed to tell its friction; begin presses further away from the reference"
        )
    middle = float(np.median(push))
    lower, upper = np.quantile(push, [0.25, 0.75])
    sigma = float(upper - lower) / 1.349
    significant = abs(middle) > _SIGNIFICANT * sigma / np.sqrt(len(push))
    return Friction(middle, int(np.sign(middle)) if significant else 0)


def _moves_on(press: PressMeasurement) -> Bools:
    """Samples (n,) of the free leg before and after which the finger moves on."""
    free = np.flatnonzero(press.leg == FREE)
    result = np.zeros(len(press.leg), dtype=bool)
    if len(free) < 2 * _WINDOW:
        return result
    place = press.travel_mm[free]
    before = place[_WINDOW:-_WINDOW] - place[: -2 * _WINDOW]
    after = place[2 * _WINDOW :] - place[_WINDOW:-_WINDOW]
    steady = (before > press.step_mm / 2) & (after > press.step_mm / 2)
    result[free[_WINDOW:-_WINDOW][steady]] = True
    return result
