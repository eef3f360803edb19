"""Experiment design: which touches say most about where fingers stand.

Every touch that could be made has a row of derivatives; the one that shrinks the covariance most is taken,
again and again (greedy D-optimal design; Fedorov, Theory of Optimal Experiments, 1972). Touches that would
slip, or that might meet a corner, are not offered.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from palpate.base.geometry import Bools, Floats
from palpate.calibration.finger_fit import Fit, ReferencePlacement, Touches, predict_residuals
from palpate.calibration.fitted_kinematics import FingerModel
from palpate.calibration.prober import ApproachTable, Probe, ServoPath

__all__ = ["PredictedTouches", "choose_touches", "predict_touches", "probes_towards"]


_MOST_OBLIQUE = math.radians(48.0)
"""Further from head-on a tip may slip, and load its aim sideways."""
_ROOM_MM = 4.0
"""A face must go on so far on both sides of a contact."""
_BEYOND_MM = 12.0
_SAMPLES = 160
_HALVINGS = 24
_TOUCHED_BEFORE_MM = 15.0  # what is at a point is met so far before it, and by as much again
_DIRECTION_MM = 2.0  # either way: far enough that rows of servo angles do not show

Complexes = np.ndarray[tuple[int, ...], np.dtype[np.complex128]]


@dataclass(frozen=True, eq=False)
class PredictedTouches:
    """Predicted touches: where each approach meets a reference.

    `travel_mm` (m,): how far along it that is, nan where it meets nothing.
    `oblique_rad` (m,): from head-on, positive counter-clockwise; `room_mm` (m,): to the end of the face;
    `rows` (m, unknowns): derivatives of the residual by all values and poses.
    """

    travel_mm: Floats
    oblique_rad: Floats
    room_mm: Floats
    rows: Floats

    @property
    def good(self) -> Bools:
        """Approaches that meet a face well inside of it, not too obliquely."""
        result: Bools = (
            np.isfinite(self.travel_mm)
            & (np.abs(self.oblique_rad) <= _MOST_OBLIQUE)
            & (self.room_mm >= _ROOM_MM)
        )
        return result


def predict_touches(
    models: Sequence[FingerModel],
    placings: Sequence[ReferencePlacement],
    fit: Fit,
    number: int,
    approaches: Sequence[ServoPath],
) -> PredictedTouches:
    """Where approaches meet the reference of placing `number`, as far as a fit can tell."""
    table = ApproachTable(approaches)
    finger, length = table.finger, table.length_mm

    def at(travel_mm: Floats) -> tuple[Floats, Floats, Floats, Floats]:
        touches = Touches(
            finger,
            np.full(len(finger), number),
            table.servos_at(travel_mm),
            np.zeros((len(finger), 2)),
            np.zeros(len(finger)),
            np.ones(len(finger)),
            np.ones(len(finger), dtype=bool),
        )
        return predict_residuals(models, placings, touches, fit.values, fit.poses)

    shares = np.linspace(0.0, 1.0, _SAMPLES)
    gaps = np.array([at(share * length)[0] for share in shares])
    inside = gaps < 0
    first = inside.argmax(axis=0)
    meets = inside.any(axis=0) & (first > 0)
    step = length / (_SAMPLES - 1)
    near, far = (first - 1) * step, first * step
    for _ in range(_HALVINGS):
        middle = (near + far) / 2
        through = at(middle)[0] < 0
        near, far = np.where(through, near, middle), np.where(through, middle, far)
    _, normal, room, rows = at(near)
    travelled = _moved(table, models, fit.values, near)
    # The outward normal of what is met head-on points back along the way.
    oblique = np.angle(-(normal[:, 0] + 1j * normal[:, 1]) * travelled.conj())
    return PredictedTouches(np.where(meets, near, np.nan), oblique, room, rows)


def choose_touches(
    predicted: PredictedTouches,
    approaches: Sequence[ServoPath],
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
            end = min(float(predicted.travel_mm[best]) + _BEYOND_MM, approaches[best].length_mm)
            probe = Probe(best, end)
            grip.append(replace(probe, side=int(np.sign(predicted.oblique_rad[best]))))
        if grip:
            grips.append(grip)
    return grips


def probes_towards(
    point_mm: tuple[float, float],
    aside_mm: float,
    approaches: Sequence[ServoPath],
    models: Sequence[FingerModel],
    values: Floats,
) -> list[Probe]:
    """For each finger the approach that has a point nearest to `aside_mm` on its left, as far as it goes.

    What an approach ends too early by counts like what it passes the point at.
    """
    table = ApproachTable(approaches)
    start = _centres(table, models, values, np.zeros(len(approaches)))
    # Over all of its length: that is its direction to a part of what its middle may be off.
    along = _moved(table, models, values, table.length_mm / 2)
    rel = (complex(*point_mm) - start) * along.conj()
    short = np.maximum(rel.real - _TOUCHED_BEFORE_MM - table.length_mm, 0.0)
    away = short + np.abs(aside_mm - rel.imag)
    found = []
    for index in range(len(models)):
        own = np.flatnonzero(table.finger == index)
        if len(own):
            best = int(own[away[own].argmin()])
            found.append(Probe(best, approaches[best].length_mm))
    return found


def _centres(
    table: ApproachTable, models: Sequence[FingerModel], values: Floats, travel_mm: Floats
) -> Complexes:
    """Tip centres (n,), x + iy, of all approaches after a travel (n,) of each."""
    servos = table.servos_at(travel_mm)
    result = np.empty(len(servos), dtype=np.complex128)
    for index, model in enumerate(models):
        own = table.finger == index
        rows = np.tile(values[index], (int(own.sum()), 1))
        x, y = model.centres(rows, servos[own], np.zeros((len(rows), 2))).T
        result[own] = x + 1j * y
    return result


def _moved(
    table: ApproachTable, models: Sequence[FingerModel], values: Floats, travel_mm: Floats
) -> Complexes:
    """Directions of travel (n,) there, as unit vectors x + iy."""
    before, after = (
        _centres(table, models, values, travel_mm + side * _DIRECTION_MM) for side in (-1.0, 1.0)
    )
    step = after - before
    result: Complexes = step / np.abs(step)
    return result
