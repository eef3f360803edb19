"""Evidence beside bounds: the smallest detectable shift of the part, by predictions or by recognising anew.

Bounds prove which of the catalogue's objects lies there, but not that it stayed where it was. Evidence for
that are touches that agreed with their predictions though they need not have. That it is one of the catalogue
at all: see `strangers`.
"""

import math
from collections.abc import Sequence

import numpy as np

from palpate.base.geometry import Floats
from palpate.recognizer.catalogue import Catalogue
from palpate.recognizer.contact import Contact
from palpate.recognizer.motion import Motion
from palpate.recognizer.prediction import Predictions
from palpate.recognizer.recognition import Recognition
from palpate.recognizer.region import Cells

__all__ = ["detectable_shift_mm", "recognised_shift_mm"]

_SHIFTS = 90
_FURTHEST_MM = 50.0  # a part that is further off has been put elsewhere
_ROUNDING_RAD = 1e-9


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


def recognised_shift_mm(before: Recognition, contacts: Sequence[Contact]) -> float:
    """Smallest shift (mm) of the part, 50 mm at most, before `contacts` that they certainly show.

    They are recognised as those of a part that was shifted, by 50 mm at most, and not turned, after what was
    known `before`. No configuration that is left is further from the earlier ones. Infinite if some shift of
    nearly 50 mm explains them.
    """
    catalogue = before.catalogue
    shift = np.full(len(catalogue.states), _FURTHEST_MM)
    after = before.extend(contacts, Motion(shift, np.zeros_like(shift)))
    furthest = _furthest_mm(catalogue, before.cells, after.cells)
    return furthest if furthest < _FURTHEST_MM else math.inf


def _furthest_mm(catalogue: Catalogue, before: Cells, after: Cells) -> float:
    """How far apart centroids of equally turned configurations of the same state are at most; 0: none is."""
    furthest = 0.0
    for number in np.unique(after.state).tolist():
        state = catalogue.states[number]
        turn = 2 * math.pi / state.symmetry.order
        old, new = (cells.select(cells.state == number) for cells in (before, after))
        (old_mm, old_off), (new_mm, new_off) = map(_centroids_mm, (old, new))
        for k in range(len(new)):
            apart = np.abs((old.middle - new.middle[k] + turn / 2) % turn - turn / 2)
            alike = (apart <= old.half_width + new.half_width[k] + _ROUNDING_RAD) | state.state.is_round
            away = np.hypot(*(old_mm - new_mm[k]).T) + old_off + new_off[k]
            furthest = max(furthest, float(away[alike].max(initial=0.0)))
    return furthest


def _centroids_mm(cells: Cells) -> tuple[Floats, Floats]:
    """Centroids (k, 2) in W, from the anchor, at the middles of cells, and how far off they are at most."""
    cos, sin = np.cos(cells.middle), np.sin(cells.middle)
    x, y = cells.centre.T
    return np.column_stack([cos * x - sin * y, sin * x + cos * y]), cells.displacement(np.zeros(len(cells)))
