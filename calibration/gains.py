"""Gains of taxels, where an array's middle looks, stiffness and crosstalk, from presses on references.

The last of the fits of an array: presses and what `idle` found come in, what the rig file and the
contact extractor need goes out. Columns come first (`press_model`); within a column the taxels share the
load, as references stand higher than the array and touch it along all of its rows. A reference that
leans would be taken for a slope of gains along the tip.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from palpate.calibration.idle import COVERAGE_SIGMAS, IdleFit
from palpate.calibration.measurements import IN
from palpate.calibration.pattern import approach
from palpate.calibration.press_model import FixedParameters, PressFit, solve
from palpate.calibration.ramps import PressAtBearing, Ramps, ramps_of, telling
from palpate.drivers.tactile.messages import Description, Shape
from palpate.errors import InputError
from palpate.geometry import Bools, Floats

__all__ = ["GainFit", "GainPriors", "PressAtBearing", "gains_of"]

_ROW_SHARE = 0.003  # rows do not share a load more evenly
_SILENT = 0.15  # of what its column's taxels read
_LOUD_SIGMAS = 40.0  # what a column must read to tell a silent taxel
_LIT = 0.02  # of the strongest column: residuals of weaker ones say nothing


@dataclass(frozen=True)
class GainPriors:
    """What is known of a finger before its presses are looked at.

    `heading_rad` ± `heading_bound_rad`: where the array's middle looks, from the direction of travel.
    `gain_spread`: bound on the error of a gain, as a share; `force_bound`: the same of the newtons that
    currents tell, which all gains and the stiffness inherit. `current_step_a`: unit of Present Current.
    """

    tip_radius_mm: float
    mm_per_rad: float
    heading_rad: float = 0.0
    heading_bound_rad: float = math.radians(5.0)
    gain_spread: float = 0.4
    force_bound: float = 0.0
    current_step_a: float = 2.69e-3


@dataclass(frozen=True, eq=False)
class GainFit:
    """What presses told of an array. Bounds hold in 99.9 % of cases, as shares of what they bound.

    `gain` ± `gain_bound` (rows, cols): counts per N over what the array says; 1 ± the expected spread
    where it was not `pressed`. `phase_rad` ± one `phase_sigma_rad`: where the array's middle looks, from
    the direction of travel. `crosstalk` ± `crosstalk_bound`: share that each of four neighbours takes of
    a taxel's force. `friction_a` (presses,). `residual_share`: root mean square of what columns read
    besides what they should, as a share of the strongest. `unresponsive`: (row, col) of live taxels that
    do not answer to load. `saturates_n`: least force on the tip with a taxel at its largest count, if
    any was.
    """

    gain: Floats
    gain_bound: Floats
    pressed: Bools
    phase_rad: float
    phase_sigma_rad: float
    stiffness_n_per_mm: float
    stiffness_bound: float
    crosstalk: float
    crosstalk_bound: float
    friction_a: Floats
    residual_share: float
    unresponsive: tuple[tuple[int, int], ...]
    saturates_n: float | None


def gains_of(
    presses: Sequence[PressAtBearing], description: Description, idle: IdleFit, expected: GainPriors
) -> GainFit:
    """What the presses of one finger, at several bearings, say of its array.

    Only the way in is looked at: there play is used up and friction always has the same sign. Presses that
    met nothing where they should have are left out, as long as they are fewer than half. Raises InputError
    without presses, for an array that is not bent round a cylinder, and for presses that move or feel too
    little.
    """
    if not presses:
        raise InputError("gains of an array: there are no presses; press a reference at several bearings")
    if description.shape is not Shape.CYLINDER or description.cols < 2:
        raise InputError(
            f"array {description.unique_id.hex()}: only arrays bent round a cylindrical tip are calibrated "
            "by presses; give the gains of this one in the rig file"
        )
    full = description.max_count - 0.5 - idle.zero_counts
    presses = telling(presses, idle.live, full, idle.noise_counts, expected.mm_per_rad)
    ramps = ramps_of(presses, idle.live, full, idle.noise_counts, expected.mm_per_rad)
    silent = _silent(ramps, idle)
    usable = idle.live & ~silent
    rows_used = usable.sum(axis=0)
    column_counts = (ramps.counts * usable).sum(axis=1) / np.maximum(rows_used, 1)
    found = solve(presses, ramps, column_counts, _known(description, idle, expected, rows_used))
    ratio, ratio_sigma = _rows(ramps, usable, column_counts, found.counts, idle.noise_counts)
    sigma = np.hypot(found.gain_log_sigma, ratio_sigma)
    bound = np.expm1(COVERAGE_SIGMAS * sigma) * (1 + expected.force_bound) + expected.force_bound
    pressed = usable & (bound < expected.gain_spread)
    lit = np.abs(found.counts) > _LIT * found.counts.max(axis=1, keepdims=True)
    stiffness = math.expm1(COVERAGE_SIGMAS * found.stiffness_log_sigma)
    return GainFit(
        gain=np.where(pressed, found.gain * ratio, 1.0),
        gain_bound=np.where(pressed, bound, expected.gain_spread),
        pressed=pressed,
        phase_rad=found.phase_rad,
        phase_sigma_rad=found.phase_sigma_rad,
        stiffness_n_per_mm=found.stiffness_n_per_mm,
        stiffness_bound=stiffness * (1 + expected.force_bound) + expected.force_bound,
        crosstalk=found.crosstalk,
        crosstalk_bound=COVERAGE_SIGMAS * found.crosstalk_sigma,
        friction_a=found.friction_a,
        residual_share=float(np.sqrt((found.off[lit] ** 2).mean())),
        unresponsive=tuple((int(row), int(col)) for row, col in np.argwhere(silent)),
        saturates_n=_saturates_n(presses, ramps, found, idle.live, full, expected),
    )


def _known(
    description: Description, idle: IdleFit, expected: GainPriors, rows_used: Floats
) -> FixedParameters:
    columns = np.asarray(description.columns, dtype=np.float64)
    return FixedParameters(
        columns_rad=columns,
        pitch_rad=float(columns[1] - columns[0]),
        rows=description.rows,
        counts_per_n=description.counts_per_n,
        radius_mm=expected.tip_radius_mm,
        rows_used=rows_used.astype(np.float64),
        noise_counts=idle.noise_counts,
        phase_rad=expected.heading_rad,
        phase_sigma_rad=expected.heading_bound_rad / math.sqrt(3),
        gain_sigma=expected.gain_spread / math.sqrt(3),
        current_step_a=expected.current_step_a,
    )


def _silent(ramps: Ramps, idle: IdleFit) -> Bools:
    """Live taxels (rows, cols) that read next to nothing where their column reads much."""
    live = idle.live
    total = (ramps.counts * ramps.samples[:, None, None]).sum(axis=0)
    noise = idle.noise_counts * math.sqrt(float(ramps.samples.sum()))
    middle = np.zeros(live.shape[1])
    for col in np.flatnonzero(live.any(axis=0)):
        middle[col] = np.median(total[live[:, col], col])
    result: Bools = live & (middle > _LOUD_SIGMAS * noise) & (total < _SILENT * middle)
    return result


def _rows(
    ramps: Ramps, usable: Bools, column_counts: Floats, modelled: Floats, noise: float
) -> tuple[Floats, Floats]:
    """Gain of taxels over the mean of their column's usable ones, ± a share of it; (rows, cols).

    Counts are weighed by what the model says of the column, which has no noise of its own in it.
    """
    weight = np.maximum(modelled, 0.0)
    along = np.einsum("mc,mrc->rc", weight, ramps.counts)
    mean = np.einsum("mc,mc->c", weight, column_counts)
    noise_of_sum = noise * np.sqrt(np.einsum("mc,m->c", weight**2, 1 / ramps.samples))
    safe = np.maximum(mean, 1e-9)
    ratio = np.where(usable, along / safe, 1.0)
    sigma = np.hypot(_ROW_SHARE, noise_of_sum / safe / np.maximum(ratio, 0.1))
    return ratio, np.minimum(sigma, 10.0)


def _saturates_n(
    presses: Sequence[PressAtBearing],
    ramps: Ramps,
    found: PressFit,
    live: Bools,
    full: Floats,
    expected: GainPriors,
) -> float | None:
    """Least force on the tip with a live taxel at its largest count, by the dent on the way in."""
    least = math.inf
    for at, start, touch, bearing in zip(
        presses, ramps.start_mm, found.touch_mm, found.bearing_rad, strict=True
    ):
        saturated = ((at.press.counts >= full) & live).any(axis=(1, 2)) & (at.press.leg == IN)
        travel = expected.mm_per_rad * at.press.slide_rad[saturated] - start - touch
        curvature = np.full(len(travel), at.curvature_per_mm)
        dent, _ = approach(travel, np.full(len(travel), bearing), expected.tip_radius_mm, curvature)
        least = min(least, float(dent.min(initial=math.inf)) * found.stiffness_n_per_mm)
    return None if math.isinf(least) else least
