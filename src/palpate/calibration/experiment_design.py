"""Experiment design: touches that locate a reference, and those most informative about the fingers.

Every possible touch has a row of derivatives; the one that reduces the covariance most is chosen, repeatedly
(greedy D-optimal design; Fedorov, Theory of Optimal Experiments, 1972). Touches that would slip, or that
might meet a corner, are excluded.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from palpate.base.errors import InputError
from palpate.base.geometry import Bools, Floats
from palpate.calibration.finger_fit import (
    FingerFit,
    ReferencePlacement,
    TouchArrays,
    fit_fingers,
    predict_residuals,
    touch_loads,
)
from palpate.calibration.finger_model import FingerModel
from palpate.calibration.measurements import ApproachTable, Probe, Prober, ServoPath, TouchMeasurement
from palpate.config import FingerConfig

_MAX_OBLIQUE_RAD = math.radians(48.0)
"""Further from head-on a tip may slip, and load its aim sideways."""
_MIN_ROOM_MM = 4.0
"""A face must go on so far on both sides of a contact."""
_OVERTRAVEL_MM = 12.0
_TRAVEL_SAMPLES = 160
_BISECTIONS = 24
_CONTACT_AHEAD_MM = 15.0  # what is at a point is met so far before it, and by as much again
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
            & (np.abs(self.oblique_rad) <= _MAX_OBLIQUE_RAD)
            & (self.room_mm >= _MIN_ROOM_MM)
        )
        return result


def predict_touches(
    models: Sequence[FingerModel],
    placings: Sequence[ReferencePlacement],
    fit: FingerFit,
    number: int,
    approaches: Sequence[ServoPath],
) -> PredictedTouches:
    """Predict where approaches meet the reference of placing `number`, as far as a fit can tell."""
    table = ApproachTable(approaches)
    finger, length = table.finger, table.length_mm

    def at(travel_mm: Floats) -> tuple[Floats, Floats, Floats, Floats]:
        touches = TouchArrays(
            finger,
            np.full(len(finger), number),
            table.servos_at(travel_mm),
            np.zeros((len(finger), 2)),
            np.zeros(len(finger)),
            np.ones(len(finger)),
            np.ones(len(finger), dtype=bool),
        )
        return predict_residuals(models, placings, touches, fit.values, fit.poses)

    shares = np.linspace(0.0, 1.0, _TRAVEL_SAMPLES)
    gaps = np.array([at(share * length)[0] for share in shares])
    inside = gaps < 0
    first = inside.argmax(axis=0)
    meets = inside.any(axis=0) & (first > 0)
    step = length / (_TRAVEL_SAMPLES - 1)
    near, far = (first - 1) * step, first * step
    for _ in range(_BISECTIONS):
        middle = (near + far) / 2
        through = at(middle)[0] < 0
        near, far = np.where(through, near, middle), np.where(through, middle, far)
    _, normal, room, rows = at(near)
    travelled = _travel_directions(table, models, fit.values, near)
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
            end = min(float(predicted.travel_mm[best]) + _OVERTRAVEL_MM, approaches[best].length_mm)
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
    """Approach of each finger that has a point nearest to `aside_mm` on its left, as far as it goes.

    What an approach ends too early by counts like what it passes the point at.
    """
    table = ApproachTable(approaches)
    start = _centres(table, models, values, np.zeros(len(approaches)))
    # Over all of its length: that is its direction to a part of what its middle may be off.
    along = _travel_directions(table, models, values, table.length_mm / 2)
    rel = (complex(*point_mm) - start) * along.conj()
    short = np.maximum(rel.real - _CONTACT_AHEAD_MM - table.length_mm, 0.0)
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


def _travel_directions(
    table: ApproachTable, models: Sequence[FingerModel], values: Floats, travel_mm: Floats
) -> Complexes:
    """Directions of travel (n,) there, as unit vectors x + iy."""
    before, after = (
        _centres(table, models, values, travel_mm + side * _DIRECTION_MM) for side in (-1.0, 1.0)
    )
    step = after - before
    result: Complexes = step / np.abs(step)
    return result


_SEARCH_OFFSETS_MM = (0.0, 11.0, -11.0)  # of the first reference; where fingers stand is known, fewer do
_PRESS_ROOM_MM = 12.0  # half of what is touched, and what the face may be elsewhere
_OTHER_SIGMA_MM = 0.006  # what is left: force, tares


@dataclass(frozen=True, eq=False)
class LocatedReference:
    """A reference that was found: the touches that did it, a fit, and what approaches would meet."""

    touched: tuple[TouchMeasurement, ...]
    fit: FingerFit
    predicted: PredictedTouches


def locate_reference(
    prober: Prober,
    models: Sequence[FingerModel],
    placings: Sequence[ReferencePlacement],
    known: Sequence[TouchMeasurement],
    specs: Sequence[FingerConfig],
    start: FingerFit | None = None,
) -> LocatedReference:
    """Touch the last of `placings`, which has been put, from all sides.

    `known`, `start`: touches of the earlier ones, and their fit.
    Raises InputError if fingers meet nothing where it should be.
    """
    number = len(placings) - 1
    touched: list[TouchMeasurement] = []
    values = np.array([model.prior for model in models]) if start is None else start.values
    about = placings[number].about_mm
    fit = start
    looks = len(_SEARCH_OFFSETS_MM) if start is None else 1 + placings[number].reference.turns
    for aside in _SEARCH_OFFSETS_MM[:looks]:
        grip = probes_towards(about, aside, prober.approaches, models, values)
        touched += [item for item in prober.touch(grip, number) if item is not None]
        if not touched:
            continue
        touches = touch_arrays([*known, *touched], models, placings, specs)
        begin = None if start is None else (start.values, start.poses)
        fit = fit_fingers(models, placings, touches, begin)
        values, about = fit.values, (float(fit.poses[number, 0]), float(fit.poses[number, 1]))
    met = dict.fromkeys(item.finger for item in touched)
    if fit is None or len(met) < min(2, len(models)):
        reference, (x, y) = placings[number].reference, placings[number].about_mm
        raise InputError(
            f"the {reference.name} was not found near ({x:.0f}, {y:.0f}) mm: of the fingers that looked for "
            f"it {f'only {next(iter(met))}' if met else 'none'} met something; put it there and begin this "
            "step again; if it is there, palpate check --press --move shows which finger stands where"
        )
    return LocatedReference(
        tuple(touched), fit, predict_touches(models, placings, fit, number, prober.approaches)
    )


def probes_at_bearing(
    found: LocatedReference, prober: Prober, models: Sequence[FingerModel], bearing_rad: float
) -> list[tuple[Probe, float]]:
    """Approach of each finger that meets the reference nearest to a bearing, and its bearing.

    A bearing is the direction from the tip's axis to the contact, from the direction of travel. A tip that
    is pressed touches some millimetres of a face, and where a plate stands is hardly known along its faces:
    those that may meet a corner are taken only if there are no others.
    """
    finger = np.array([item.finger for item in prober.approaches])
    result = []
    for index in range(len(models)):
        own = np.flatnonzero(found.predicted.good & (finger == index))
        if len(own):
            room = found.predicted.room_mm[own]
            own = own[room >= min(_PRESS_ROOM_MM, float(room.max()))]
            off = np.abs(found.predicted.oblique_rad[own] - bearing_rad)
            best = int(own[off.argmin()])
            oblique = float(found.predicted.oblique_rad[best])
            probe = Probe(best, float(found.predicted.travel_mm[best]), int(np.sign(oblique)))
            result.append((probe, oblique))
    return result


def touch_arrays(
    touched: Sequence[TouchMeasurement],
    models: Sequence[FingerModel],
    placings: Sequence[ReferencePlacement],
    specs: Sequence[FingerConfig],
) -> TouchArrays:
    """Touches as arrays for the fit, with what each is expected to be off by.

    Where the force may have pushed a joint through its play, it is taken to be halfway. By what the tip has
    given way sideways its dent seems deeper: half of what the rig file allows is taken for it.
    """
    number = {model.name: k for k, model in enumerate(models)}
    finger = np.array([number[item.finger] for item in touched], dtype=np.int64)
    force = np.array([item.force_n for item in touched])
    servos = np.array([item.servos_rad for item in touched]).reshape(-1, 2)
    ways = np.array([(item.aim_way, item.elbow_way) for item in touched], dtype=np.float64).reshape(-1, 2)
    loads = touch_loads(touched, specs)
    rounding, flank = np.empty(len(touched)), np.empty(len(touched))
    for k, model in enumerate(models):
        own = finger == k
        values = np.tile(model.prior, (int(own.sum()), 1))
        angle = model.facing_rad(values, servos[own], ways[own]) + loads.towards_rad[own]
        towards = np.column_stack([np.cos(angle), np.sin(angle)])
        rounding[own] = model.rounding_mm(values, servos[own], towards)
        # Towards the contact a joint's turn brings the tip nearer; the force turns it back, to that flank.
        nearer = np.einsum("nkx,nx->nk", model.travel_per_turn(values, servos[own]), towards)
        pushed = np.where(loads.pushes[own], np.sign(nearer), ways[own])
        unsure = np.abs(pushed - ways[own]) / 2
        unsure = np.where(ways[own] == 0, 1.0, unsure) if model.gives_all_round else unsure
        flank[own] = np.sqrt(((unsure * model.plays_rad * nearer) ** 2).sum(axis=1) / 3)
        ways[own] = (ways[own] + pushed) / 2
    stiffness = np.array([spec.tip.stiffness_n_per_mm for spec in specs])[finger]
    placing = np.array([item.placing for item in touched], dtype=np.int64)
    shape = np.array([item.reference.tolerance_mm for item in placings])[placing] / math.sqrt(3)
    return TouchArrays(
        finger,
        placing,
        servos,
        ways,
        force / stiffness + loads.give_mm,
        np.sqrt(rounding**2 + flank**2 + shape**2 + _OTHER_SIGMA_MM**2),
        np.ones(len(touched), dtype=bool),
    )
