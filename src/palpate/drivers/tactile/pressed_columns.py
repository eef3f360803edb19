"""Pressed columns of a flat array: columns of taxels on which something certainly presses.

The centroid of a patch may be where nothing touches, as between two corners. So of each column it is asked
whether what it shows could be crosstalk from its neighbours, with gains as far off as they may be, and noise.
If not, something presses on it.
"""

import numpy as np

from palpate.base.geometry import Bools, Floats
from palpate.drivers.tactile.baseline import SIGMAS
from palpate.drivers.tactile.patches import TipCalibration
from palpate.drivers.tactile.taxel_forces import TaxelForces

__all__ = ["loaded_places_mm", "pressed_columns", "pressed_places_mm"]


def pressed_columns(taxels: TaxelForces, calibration: TipCalibration) -> Bools:
    """Which columns (n, c) something certainly presses on, in n frames.

    None beside a taxel that cannot be read: what it bears its neighbours may show.
    """
    force, doubt = _sums(taxels)
    spread = float(calibration.spreads.max())
    share = calibration.crosstalk + calibration.crosstalk_bound
    # A column keeps what its two neighbours do not take of its force.
    most = np.maximum(force + doubt, 0.0) / (1 - spread) / max(1 - 2 * share, 1e-9)
    most = np.where(taxels.usable.all(axis=1), most, np.inf)
    beside = np.zeros_like(most)
    beside[:, 1:] += most[:, :-1]
    beside[:, :-1] += most[:, 1:]
    result: Bools = (force - doubt) / (1 + spread) > share * beside
    return result


def pressed_places_mm(pressed: Bools, column_mm: Floats, half_mm: float) -> Floats:
    """Ranges (n, 2, 2) of places across the array, [first, last] and [from, to]: in each something presses.

    `pressed` (n, c): as `pressed_columns`; `column_mm` (c,) ascending: their middles, each `half_mm` wide to
    either side. The ranges are equal if a single column is certainly pressed, and nan where none is.
    """
    first, last = np.argmax(pressed, axis=1), len(column_mm) - 1 - np.argmax(pressed[:, ::-1], axis=1)
    middle = column_mm[np.column_stack([first, last])]
    found: Floats = middle[..., None] + np.array([-half_mm, half_mm])
    some: Bools = np.any(pressed, axis=1)
    return np.where(some[:, None, None], found, np.nan)


def loaded_places_mm(taxels: TaxelForces, column_mm: Floats, half_mm: float) -> Floats:
    """The range (n, 2) across the array outside of which columns show nothing; nan where none does."""
    force, doubt = _sums(taxels)
    loaded: Bools = np.logical_or(force > doubt, ~taxels.usable.all(axis=1))
    result: Floats = pressed_places_mm(loaded, column_mm, half_mm)[:, [0, 1], [0, 1]]
    return result


def _sums(taxels: TaxelForces) -> tuple[Floats, Floats]:
    """Force and doubt of each column, both (n, c) N."""
    doubt = SIGMAS * np.sqrt((taxels.noise_n**2).sum(axis=1)) + taxels.drift_n.sum(axis=1)
    return taxels.force_n.sum(axis=1), doubt
