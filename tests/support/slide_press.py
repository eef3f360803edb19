"""A press as a slide's servo reports it: angles in encoder steps and currents, as travel and push."""

import numpy as np

from palpate.base.geometry import Floats, Ints
from palpate.calibration.measurements import PressMeasurement
from palpate.drivers.kinematics import TICK_RAD

CURRENT_STEP_A = 2.69e-3


def slide_press(
    slide_rad: Floats,
    mm_per_rad: float,
    current_a: Floats,
    leg: Ints,
    counts: Floats | None = None,
    *,
    newton_per_a: float = 1.0,
    placing: int = 0,
) -> PressMeasurement:
    """Of finger f1; `current_a` (n,): positive if it pushes the tip out."""
    return PressMeasurement(
        "f1",
        placing,
        mm_per_rad * slide_rad,
        current_a * newton_per_a,
        leg,
        np.zeros((len(leg), 1, 1)) if counts is None else counts,
        abs(mm_per_rad) * TICK_RAD,
        CURRENT_STEP_A * newton_per_a,
        np.zeros(len(leg)),
        np.zeros(len(leg)),
        (0.0, newton_per_a),
    )
