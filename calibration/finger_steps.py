"""Measuring where fingers stand: which references are put where, what is touched, until enough is known.

Between whoever moves the rig (`prober`) and the fit (`finger_fit`). Each placing begins with touches that find
the reference, goes on with those that say most, and ends with the first one again: a reference that has been
moved meanwhile shows.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from palpate.calibration.choice import choose, foresee, towards
from palpate.calibration.finger_fit import FingerModel, Fit, Placing, Touches, fit_fingers
from palpate.calibration.measured import Touched
from palpate.calibration.prober import Probe, Prober
from palpate.calibration.reference import Reference

__all__ = ["TouchNoise", "placings_for", "touch_placing", "touches_of"]

_FINDING_MM = (0.0, 11.0, -11.0)
_TICK_RAD = 2 * math.pi / 4096
_OTHER_MM = 0.006  # what is left: stopping, force, tares


@dataclass(frozen=True)
class TouchNoise:
    """What is known of tips: stiffness (N/mm) by finger, for the dents."""

    stiffness_n_per_mm: Sequence[float]


def placings_for(disc: Reference, plate: Reference, radius_mm: float) -> list[Placing]:
    """Where references are to lie: each in the middle and on three sides, the plate's between the disc's."""
    away = 0.4 * radius_mm
    found = []
    for reference, first in ((disc, math.pi / 2), (plate, -math.pi / 2)):
        found.append(Placing(reference, (0.0, 0.0)))
        for k in range(3):
            angle = first + 2 * math.pi / 3 * k
            found.append(Placing(reference, (away * math.cos(angle), away * math.sin(angle))))
    return found


def touch_placing(
    prober: Prober,
    models: Sequence[FingerModel],
    placings: Sequence[Placing],
    known: list[Touched],
    number: int,
    noise: TouchNoise,
    start: Fit | None,
    *,
    count: int,
    tell: Callable[[str], None],
) -> tuple[list[Touched], Fit]:
    """Touch the reference of placing `number`, which has been put, `count` times a finger besides finding it."""
    done = list(placings[: number + 1])
    touched: list[Touched] = []

    def carry_out(grip: Sequence[Probe]) -> None:
        touched.extend(item for item in prober.touch(grip, number) if item is not None)

    def fitted(poses: int) -> Fit:
        touches = touches_of([*known, *touched], models, noise)
        begin = None if start is None else (start.values, start.poses[:poses])
        return fit_fingers(models, done, touches, begin)

    values = np.array([model.prior for model in models]) if start is None else start.values
    about = placings[number].about_mm
    for aside in _FINDING_MM:
        carry_out(towards(about, aside, prober.approaches, models, values))
        fit = fitted(number)
        values, about = fit.values, (float(fit.poses[number, 0]), float(fit.poses[number, 1]))
    foreseen = foresee(models, done, fit, number, prober.approaches)
    sigma = 0.015
    grips = choose(foreseen, prober.approaches, models, fit.covariance, sigma, count)
    for grip in [*grips, *grips[:1]]:
        carry_out(grip)
    return touched, fitted(number + 1 if start is not None and len(start.poses) > number else number)


def touches_of(touched: Sequence[Touched], models: Sequence[FingerModel], noise: TouchNoise) -> Touches:
    """Touches as arrays for the fit."""
    number = {model.name: k for k, model in enumerate(models)}
    finger = np.array([number[item.finger] for item in touched], dtype=np.int64)
    force = np.array([item.force_n for item in touched])
    stiffness = np.asarray(noise.stiffness_n_per_mm)[finger]
    slide = np.array([item.servos_rad[1] for item in touched])
    per_rad = np.array([model.mm_per_rad for model in models])[finger]
    gear = np.array([model.gear_ratio for model in models])[finger]
    zero = np.array([model.prior[4] for model in models])[finger]
    along = np.abs(per_rad) * _TICK_RAD / math.sqrt(12)
    # Contacts are oblique by less than 48°: half of what the aim is off counts, or so.
    across = 0.5 * np.abs(zero + per_rad * slide) * _TICK_RAD / np.abs(gear) / math.sqrt(12)
    return Touches(
        finger,
        np.array([item.placing for item in touched], dtype=np.int64),
        np.array([item.servos_rad[0] for item in touched]),
        slide,
        np.array([float(item.aim_way) for item in touched]),
        force / stiffness,
        np.sqrt(along**2 + across**2 + _OTHER_MM**2),
        np.ones(len(touched), dtype=bool),
    )
