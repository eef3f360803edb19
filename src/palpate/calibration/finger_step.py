"""Calibration step for where fingers stand: references at several places, touched by all fingers.

Each placing begins with touches that find the reference, goes on with those that say most, and ends with the
first of these again: a reference that has moved meanwhile shows.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from palpate.base.geometry import Bools, Floats
from palpate.calibration.consistency_checks import check_fit, check_still
from palpate.calibration.experiment_design import choose_touches, locate_reference, touch_arrays
from palpate.calibration.finger_fit import (
    FingerFit,
    ReferencePlacement,
    TouchArrays,
    fit_fingers,
    predict_residuals,
    touch_loads,
)
from palpate.calibration.finger_model import RADIUS, FingerModel
from palpate.calibration.idle_statistics import COVERAGE_SIGMAS
from palpate.calibration.measurements import Probe, Prober, TouchMeasurement
from palpate.calibration.reference import Reference
from palpate.config import FingerConfig

_HELD_OUT_EVERY = (
    7  # one touch in so many shows whether the fit keeps its promises; not a multiple of fingers
)
_MIN_VARIANCE_SHARE = 0.04  # of the expected squares: some 0.002 mm; what gains do to forces repeats itself
_CREEP_BOUND_MM = 0.005  # a tip creeps 1 mm in a second, and its measured force is a few milliseconds old
_TYPICAL_SIGMA_MM = 0.012
_GRIPS_PER_PLACING = 6
_REFERENCE_RADIUS_SHARE = 0.4  # of the workspace's radius: where references lie


def plan_placements(disc: Reference, plate: Reference, radius_mm: float) -> list[ReferencePlacement]:
    """Plan where references lie: the disc on three sides of the middle, then the plate between these."""
    away = min(_REFERENCE_RADIUS_SHARE * radius_mm, radius_mm - max(disc.radius_mm, plate.radius_mm) - 10.0)
    found = []
    for reference, first in ((disc, math.pi / 2), (plate, -math.pi / 2)):
        for k in range(3):
            angle = first + 2 * math.pi / 3 * k
            found.append(ReferencePlacement(reference, (away * math.cos(angle), away * math.sin(angle))))
    return found


def touch_placing(
    prober: Prober,
    specs: Sequence[FingerConfig],
    models: Sequence[FingerModel],
    placings: Sequence[ReferencePlacement],
    known: Sequence[TouchMeasurement],
    *,
    tell: Callable[[str], None],
) -> list[TouchMeasurement]:
    """Have the last of `placings` put, and touch it; `known`: touches of the earlier ones.

    Raises InputError for a reference that moves, is not found or is not what it is said to be.
    """
    number = len(placings) - 1
    placing = placings[number]
    prober.put(placing.reference, placing.about_mm)
    start = None
    if known:
        start = fit_fingers(models, placings[:number], touch_arrays(known, models, placings, specs))
    found = locate_reference(prober, models, placings, known, specs, start)
    touched = list(found.touched)
    grips = choose_touches(
        found.predicted,
        prober.approaches,
        models,
        found.fit.covariance,
        _TYPICAL_SIGMA_MM,
        _GRIPS_PER_PLACING,
    )

    def carried_out(grip: Sequence[Probe]) -> list[TouchMeasurement]:
        return [item for item in prober.touch(grip, number) if item is not None]

    first: list[TouchMeasurement] = []
    repeated: Sequence[Probe] = []
    for k, grip in enumerate(grips):
        tell(f"touch {k + 1} of {len(grips)}")
        got = carried_out(grip)
        if not first:
            first, repeated = got, grip
        touched += got
    if first:
        again = carried_out(repeated)
        check_still(first, again, models, placing)
        touched += again
    every = [*known, *touched]
    touches = touch_arrays(every, models, placings, specs)
    check_fit(
        specs,
        models,
        placings,
        touches,
        fit_fingers(models, placings, touches, (found.fit.values, found.fit.poses[:number])),
    )
    return touched


def fit_touches(
    specs: Sequence[FingerConfig],
    models: Sequence[FingerModel],
    placings: Sequence[ReferencePlacement],
    touched: Sequence[TouchMeasurement],
) -> tuple[TouchArrays, FingerFit, FingerFit]:
    """Touches, their fit, and the fit without those that are held out. Raises what `check_fit` raises.

    Once it is known that touches agree, the fit is made again with what they scatter by: servos that come to
    rest in the same part of a step again and again scatter by less than steps let expect. What repeats itself
    does not show in the scatter: the fit's poses take some of it in, the radii what is alike in all dents.
    """
    touches = touch_arrays(touched, models, placings, specs)
    fit = fit_fingers(models, placings, touches, _begin_of_fit(specs, models, placings, touched))
    check_fit(specs, models, placings, touches, fit)
    share = max(_MIN_VARIANCE_SHARE, fit.chi_square / fit.freedom)
    touches = replace(touches, sigma_mm=touches.sigma_mm * math.sqrt(share))
    fit = fit_fingers(models, placings, touches, (fit.values, fit.poses))
    slopes = predict_residuals(models, placings, touches, fit.values, fit.poses)[3]
    give = touch_loads(touched, specs).give_sigma_mm
    fit = _with_dents_alike(specs, touches, _with_give_alike(slopes, give, touches, fit))
    without = fit_fingers(
        models, placings, touches.with_used(~hold_out(len(touched))), (fit.values, fit.poses)
    )
    return touches, fit, without


def _begin_of_fit(
    specs: Sequence[FingerConfig],
    models: Sequence[FingerModel],
    placings: Sequence[ReferencePlacement],
    touched: Sequence[TouchMeasurement],
) -> tuple[Floats, Floats] | None:
    """Values and poses by one placing after the other: all at once, a plate may be found turned wrongly."""
    begin = None
    for count in range(1, len(placings)):
        some = [item for item in touched if item.placing < count]
        fit = fit_fingers(models, placings[:count], touch_arrays(some, models, placings, specs), begin)
        begin = fit.values, fit.poses
    return begin


def _with_dents_alike(specs: Sequence[FingerConfig], touches: TouchArrays, fit: FingerFit) -> FingerFit:
    """A fit whose radii are as uncertain as what all dents of a finger may be off by alike.

    Touches know a radius less a dent only, and one dent is nearly as deep as the other: what is wrong with
    all of them is in the radius. It comes from the stiffness and from how old the array's frames are.
    """
    covariance = fit.covariance.copy()
    for index, spec in enumerate(specs):
        dent_mm = float(touches.dent_mm[touches.finger == index].mean())
        soft_mm = dent_mm * spec.tip.stiffness_spread / COVERAGE_SIGMAS
        at = index * fit.values.shape[1] + RADIUS
        covariance[at, at] += soft_mm**2 + _CREEP_BOUND_MM**2 / 3
    return replace(fit, covariance=covariance)


def _with_give_alike(
    slopes: Floats, give_sigma_mm: Floats, touches: TouchArrays, fit: FingerFit
) -> FingerFit:
    """A fit that is more uncertain by what all touches of a finger may have given way by alike.

    `slopes` (n, unknowns): derivatives of residuals. What a shift of a finger's residuals by their deviations
    does to the least squares is one more deviation of all unknowns (Schmidt's consider covariance).
    """
    weight = (touches.used & ~fit.outlier) / touches.sigma_mm**2
    covariance = fit.covariance.copy()
    for finger in np.unique(touches.finger):
        shift = np.where(touches.finger == finger, give_sigma_mm, 0.0)
        off = fit.covariance @ (slopes.T @ (weight * shift))
        covariance += np.outer(off, off)
    return replace(fit, covariance=covariance)


def hold_out(count: int) -> Bools:
    """Choose those of `count` touches (count,) that are predicted rather than fitted."""
    result: Bools = np.arange(count) % _HELD_OUT_EVERY == _HELD_OUT_EVERY - 1
    return result
