"""Evidence beside bounds: false-match probability, and the smallest detectable shift of the part.

Bounds prove which of the catalogue's objects lies there, but not that it is one of these, nor that it stayed
where it was. Evidence for that are touches that agreed with their predictions though they need not have.
"""

import math
from collections.abc import Sequence

import numpy as np

from palpate.geometry import Floats
from palpate.recognizer.contact import Contact
from palpate.recognizer.prediction import Predictions

__all__ = ["detectable_shift_mm", "false_match_probability"]

_ACROSS_MM = 40.0  # a stop might have come anywhere within this, as far as an unknown part's size is known
_FACING_RAD = math.pi  # and normals within this
_SHIFTS = 90


def false_match_probability(
    predictions: Predictions, contacts: Sequence[Contact], normal_half_rad: float
) -> float:
    """False-match probability: share of a grip's possible outcomes that agree with some hypothesis, 0 to 1.

    `predictions` (a, h) for the a contacts, in order. Stops and normals count as independent and equally
    likely everywhere; misses say nothing, because a smaller thing would have been missed as well. So it is a
    measure, and no proof.
    """
    touched = np.array([contact.touched for contact in contacts], dtype=bool)
    possible = np.isfinite(predictions.earliest[touched])
    stop = np.where(possible, predictions.furthest[touched] - predictions.earliest[touched], 0.0)
    normal = (predictions.normal_hi - predictions.normal_lo)[touched] + 2 * normal_half_rad
    share = np.clip(stop / _ACROSS_MM, 0.0, 1.0) * np.clip(normal / _FACING_RAD, 0.0, 1.0)
    return float(min(1.0, share.prod(axis=0).sum()))


def detectable_shift_mm(predictions: Predictions, normal_rad: Floats, direction_rad: Floats) -> float:
    """Smallest shift (mm) of the part before a grip that its touches are guaranteed to detect.

    `predictions` (a, h), `normal_rad` and `direction_rad` (a,): the surfaces that were met, and the travels.
    On a straight surface a shift moves the stop by its component along the normal; it is detected if that
    leaves the predicted interval. Infinite if no predicted contact is certain.
    """
    wide = predictions.latest.max(axis=1) - predictions.earliest.min(axis=1)
    facing = np.abs(np.cos(normal_rad - direction_rad))
    sure = np.isfinite(wide) & (facing > 0)
    bearing = np.arange(_SHIFTS) * (math.pi / _SHIFTS)
    along = np.abs(np.cos(bearing[:, None] - normal_rad[sure]))
    with np.errstate(divide="ignore"):
        hidden = (wide * facing)[sure] / along
    return float(hidden.min(axis=1, initial=np.inf).max())
