"""Evidence beside bounds: the smallest detectable shift of the part.

Bounds prove which of the catalogue's objects lies there, but not that it stayed where it was. Evidence for
that are touches that agreed with their predictions though they need not have. That it is one of the catalogue
at all: see `strangers`.
"""

import math

import numpy as np

from palpate.geometry import Floats
from palpate.recognizer.prediction import Predictions

__all__ = ["detectable_shift_mm"]

_SHIFTS = 90


def detectable_shift_mm(predictions: Predictions, normal_rad: Floats, direction_rad: Floats) -> float:
    """Smallest shift (mm) of the part before a grip that its touches are guaranteed to detect.

    `predictions` (a, h), `normal_rad` and `direction_rad` (a,): the surfaces that were met, and the travels.
    On a straight surface a shift moves the stop by its component along the normal; it is detected if that
    leaves the predicted interval. Infinite if no predicted contact is certain.
    """
    latest, earliest = predictions.latest.max(axis=1), predictions.earliest.min(axis=1)
    facing = np.abs(np.cos(normal_rad - direction_rad))
    # A way of less than its bounds has no direction to speak of: along it nothing may be predicted at all.
    sure = np.isfinite(latest) & np.isfinite(earliest) & (facing > 0)
    bearing = np.arange(_SHIFTS) * (math.pi / _SHIFTS)
    along = np.abs(np.cos(bearing[:, None] - normal_rad[sure]))
    with np.errstate(divide="ignore"):
        hidden = (latest[sure] - earliest[sure]) * facing[sure] / along
    return float(hidden.min(axis=1, initial=np.inf).max())
