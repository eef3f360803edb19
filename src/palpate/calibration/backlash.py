"""Backlash of a slide, from presses that go in slowly and come back slowly.

Going back, the tip stands still until the drive has taken up the backlash, so that one force is met at two
servo angles; they are twice the half backlash apart. Nothing has to be known of the force but that it grows
with the dent.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from palpate.base.errors import InputError
from palpate.base.geometry import Bools, Floats, Ints
from palpate.calibration.measurements import FREE, IN, OUT, PressMeasurement

__all__ = ["Backlash", "combine_backlash", "estimate_backlash"]


_SLICES = 8  # of the force, each of which weighs the same
_FEWEST_SLICES = 4  # that both legs must have met
_LOWEST, _HIGHEST = 0.15, 0.9  # of the largest force: near it, servo and skin are turning back
_NOISES = 4.0  # standard deviations that keep the turning point's samples out
_DEGREE = 3  # of the curve from force to place


@dataclass(frozen=True)
class Backlash:
    """Half backlash of a slide (half of what lies between its flanks), ± a standard deviation; mm."""

    half_mm: float
    sigma_mm: float


def estimate_backlash(press: PressMeasurement, force: Floats, lag_samples: float = 0.0) -> Backlash:
    """Half backlash by one press; `force` (n,): any measure of the load that grows with it.

    `lag_samples`: by how many samples the force is older than the angle beside it, 0.5 where it is the mean
    of all frames since the sample before. It would count as backlash, by speed × time.

    Place is fitted as one curve of the force for both legs, plus the half backlash going in, less it going
    back. Every slice of the force weighs the same in each leg, so that neither an uneven pace nor noise of
    the force, which flattens the curve, moves one leg against the other. Encoder steps average out. What else
    is lost between servo and tip, a drive that winds up under its friction, cannot be distinguished and is
    counted: it is lost motion all the same. A skin that pushes back less than it was pushed hides backlash
    instead, by half the difference of its dents at one force; the deviation, which is that of single slices,
    shows such a thing in part. Raises InputError if the two legs have too little in common.
    """
    number = np.arange(len(press.travel_mm))
    place = np.interp(number - lag_samples, number, press.travel_mm)
    chosen, leg, slice_of = _usable(press, force)
    place, load = place[chosen], force[chosen]
    weight = 1 / np.bincount(leg * _SLICES + slice_of, minlength=2 * _SLICES)[leg * _SLICES + slice_of]
    side = np.where(leg == 0, 1.0, -1.0)
    curve = np.polynomial.chebyshev.chebvander(_unit(load), _DEGREE)
    columns = np.column_stack([side, curve])
    root = np.sqrt(weight)
    found = np.linalg.lstsq(columns * root[:, None], place * root, rcond=None)[0]
    off = (place - columns @ found) * side * weight
    by_slice = np.bincount(slice_of, off, minlength=_SLICES)[np.unique(slice_of)] / 2
    steps = len(np.unique(np.round(press.travel_mm[chosen] / press.step_mm)))
    step_mm = press.step_mm / math.sqrt(12 * steps)
    scatter = math.sqrt(float((by_slice**2).sum()) / (len(by_slice) - 1))
    return Backlash(max(0.0, float(found[0])), math.hypot(scatter, step_mm))


def combine_backlash(plays: Sequence[Backlash]) -> Backlash:
    """Backlash of a slide from several presses: their median, and how far one more may be off it.

    The deviation is that of the presses among one another, because backlash differs from place to place, and
    what a single one is uncertain by. ValueError for none.
    """
    if not plays:
        raise ValueError("backlash is combined from at least one press")
    half = np.array([play.half_mm for play in plays])
    middle = float(np.median(half))
    spread = 1.4826 * float(np.median(np.abs(half - middle)))
    own = float(np.median([play.sigma_mm for play in plays]))
    return Backlash(middle, math.hypot(spread, own / math.sqrt(len(plays))))


def _usable(press: PressMeasurement, force: Floats) -> tuple[Bools, Ints, Ints]:
    """Which samples (n,) count; of those the leg (0 in, 1 out) and the slice of force."""
    noise = float(np.std(force[press.leg == FREE])) if (press.leg == FREE).sum() > 1 else 0.0
    legs = [force[press.leg == leg] for leg in (IN, OUT)]
    if min(len(leg) for leg in legs) < _SLICES:
        raise _too_little(press)
    largest = min(float(np.quantile(leg, 0.98)) for leg in legs)
    hi = min(_HIGHEST * largest, largest - _NOISES * noise)
    lo = max(_LOWEST * largest, _NOISES * noise)
    if not lo < hi:
        raise _too_little(press)
    slice_of = np.floor((force - lo) / (hi - lo) * _SLICES).astype(np.int64)
    both = np.intersect1d(slice_of[press.leg == IN], slice_of[press.leg == OUT])
    both = both[(both >= 0) & (both < _SLICES)]
    if len(both) < _FEWEST_SLICES:
        raise _too_little(press)
    chosen: Bools = np.isin(press.leg, [IN, OUT]) & np.isin(slice_of, both)
    return chosen, (press.leg[chosen] == OUT).astype(np.int64), slice_of[chosen]


def _unit(values: Floats) -> Floats:
    """Values moved to -1 … 1."""
    middle = (values.min() + values.max()) / 2
    result: Floats = (values - middle) / max(float(np.ptp(values)) / 2, 1e-12)
    return result


def _too_little(press: PressMeasurement) -> InputError:
    return InputError(
        f"finger {press.finger}, placing {press.placing}: going in and going back, its press measured "
        "too few of the same forces to show the slide's backlash; press harder or more slowly"
    )
