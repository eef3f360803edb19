"""Experiment design: which touches say most about where fingers stand.

Every touch that could be made has a row of derivatives; the one that shrinks the covariance most is taken,
again and again (greedy D-optimal design; Fedorov, Theory of Optimal Experiments, 1972). Touches that would
slip, or that might meet a corner, are not offered.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from palpate.calibration.finger_fit import (
    BASE,
    HEADING,
    FingerModel,
    Fit,
    ReferencePlacement,
    Touches,
    predict_residuals,
)
from palpate.calibration.prober import Probe, SlideApproach
from palpate.geometry import Bools, Floats

__all__ = ["PredictedTouches", "choose_touches", "predict_touches", "probes_towards"]


_MOST_OBLIQUE = math.radians(48.0)
"""Further from head-on a tip may slip, and load its aim sideways."""
_ROOM_MM = 4.0
"""A face must go on so far on both sides of a contact."""
_BEYOND_MM = 12.0
_SAMPLES = 160
_HALVINGS = 24


@dataclass(frozen=True, eq=False)
class PredictedTouches:
    """Predicted touches: where each approach meets a reference.

    `slide_rad` (m,): servo angle of its slide there, nan where it meets nothing.
    `oblique_rad` (m,): from head-on, positive counter-clockwise; `room_mm` (m,): to the end of the face;
    `rows` (m, unknowns): derivatives of the residual by all values and poses.
    """

    slide_rad: Floats
    oblique_rad: Floats
    room_mm: Floats
    rows: Floats

    @property
    def good(self) -> Bools:
        """Approaches that meet a face well inside of it, not too obliquely."""
        result: Bools = (
            np.isfinite(self.slide_rad)
            & (np.abs(self.oblique_rad) <= _MOST_OBLIQUE)
            & (self.room_mm >= _ROOM_MM)
        )
        return result


def predict_touches(
    models: Sequence[FingerModel],
    placings: Sequence[ReferencePlacement],
    fit: Fit,
    number: int,
    approaches: Sequence[SlideApproach],
) -> PredictedTouches:
    """Where approaches meet the reference of placing `number`, as far as a fit can tell."""
    finger = np.array([item.finger for item in approaches])
    lo = np.array([item.start_rad for item in approaches])
    hi = np.array([item.end_rad for item in approaches])

    def at(slide: Floats) -> tuple[Floats, Floats, Floats, Floats]:
        touches = Touches(
            finger,
            np.full(len(finger), number),
            np.array([item.aim_rad for item in approaches]),
            slide,
            np.zeros(len(finger)),
            np.zeros(len(finger)),
            np.ones(len(finger)),
            np.ones(len(finger), dtype=bool),
        )
        return predict_residuals(models, placings, touches, fit.values, fit.poses)

    shares = np.linspace(0.0, 1.0, _SAMPLES)
    gaps = np.array([at(lo + share * (hi - lo))[0] for share in shares])
    inside = gaps < 0
    first = inside.argmax(axis=0)
    meets = inside.any(axis=0) & (first > 0)
    step = (hi - lo) / (_SAMPLES - 1)
    near, far = lo + (first - 1) * step, lo + first * step
    for _ in range(_HALVINGS):
        middle = (near + far) / 2
        through = at(middle)[0] < 0
        near, far = np.where(through, near, middle), np.where(through, middle, far)
    _, normal, room, rows = at(near)
    values = fit.values[finger]
    angle = values[:, HEADING] + np.array(
        [
            (item.aim_rad - models[item.finger].aim_zero_rad) / models[item.finger].gear_ratio
            for item in approaches
        ]
    )
    # The outward normal of what is met head-on points back along the way.
    oblique = np.angle(-(normal[:, 0] + 1j * normal[:, 1]) * np.exp(-1j * angle))
    return PredictedTouches(np.where(meets, near, np.nan), oblique, room, rows)


def choose_touches(
    predicted: PredictedTouches,
    approaches: Sequence[SlideApproach],
    models: Sequence[FingerModel],
    covariance: Floats,
    sigma_mm: float,
    count: int,
) -> list[list[Probe]]:
    """`count` grips, the most informative first, each with a touch of every finger that has a good one."""
    left = predicted.good.copy()
    spread = covariance.copy()
    finger = np.array([item.finger for item in approaches])
    grips: list[list[Probe]] = []
    for _ in range(count):
        grip = []
        for index in range(len(models)):
            own = np.flatnonzero(left & (finger == index))
            if not len(own):
                continue
            rows = predicted.rows[own]
            information = np.einsum("ij,jk,ik->i", rows, spread, rows)
            best = int(own[information.argmax()])
            row = predicted.rows[best]
            carried = spread @ row
            spread -= np.outer(carried, carried) / (sigma_mm**2 + row @ carried)
            left[best] = False
            probe = _probe(best, approaches[best], predicted.slide_rad[best], models[index])
            grip.append(replace(probe, side=int(np.sign(predicted.oblique_rad[best]))))
        if grip:
            grips.append(grip)
    return grips


def probes_towards(
    point_mm: tuple[float, float],
    aside_mm: float,
    approaches: Sequence[SlideApproach],
    models: Sequence[FingerModel],
    values: Floats,
) -> list[Probe]:
    """For each finger the approach that has a point nearest to `aside_mm` on its left, as far as it goes."""
    found = []
    for index, model in enumerate(models):
        own = [k for k, item in enumerate(approaches) if item.finger == index]
        x, y = np.asarray(point_mm) - values[index, BASE]
        away = []
        for k in own:
            angle = values[index, HEADING] + (approaches[k].aim_rad - model.aim_zero_rad) / model.gear_ratio
            away.append(abs(x * math.sin(angle) - y * math.cos(angle) + aside_mm))
        if own:
            best = own[int(np.argmin(away))]
            found.append(Probe(best, approaches[best].end_rad))
    return found


def _probe(number: int, approach: SlideApproach, slide_rad: float, model: FingerModel) -> Probe:
    further = slide_rad + _BEYOND_MM / model.mm_per_rad
    way = math.copysign(1.0, approach.end_rad - approach.start_rad)
    return Probe(number, min(further * way, approach.end_rad * way) * way)
