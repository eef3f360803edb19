"""Reference search: touches that locate a reference that was put down, and approaches at given bearings."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from palpate.base.errors import InputError
from palpate.base.geometry import Floats
from palpate.calibration.experiment_design import PredictedTouches, predict_touches, probes_towards
from palpate.calibration.finger_fit import Fit, ReferencePlacement, Touches, fit_fingers
from palpate.calibration.fitted_kinematics import FingerModel
from palpate.calibration.measurements import TouchMeasurement
from palpate.calibration.prober import Probe, Prober
from palpate.calibration.touch_load import touch_loads
from palpate.config import ArmFingerConfig, FingerConfig

__all__ = ["LocatedReference", "locate_reference", "probes_at_bearing", "touch_arrays"]

_ASIDE_MM = (0.0, 11.0, -11.0)  # of the first reference; where fingers stand is known, fewer do
_ROOM_OF_PRESS_MM = 12.0  # half of what is touched, and what the face may be elsewhere
_OTHER_MM = 0.006  # what is left: force, tares


@dataclass(frozen=True, eq=False)
class LocatedReference:
    """A reference that was found: the touches that did it, a fit, and what approaches would meet."""

    touched: tuple[TouchMeasurement, ...]
    fit: Fit
    predicted: PredictedTouches


def locate_reference(
    prober: Prober,
    models: Sequence[FingerModel],
    placings: Sequence[ReferencePlacement],
    known: Sequence[TouchMeasurement],
    specs: Sequence[FingerConfig],
    start: Fit | None = None,
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
    looks = len(_ASIDE_MM) if start is None else 1 + placings[number].reference.turns
    for aside in _ASIDE_MM[:looks]:
        grip = probes_towards(about, aside, prober.approaches, models, values)
        touched += [item for item in prober.touch(grip, number) if item is not None]
        if not touched:
            continue
        touches = touch_arrays([*known, *touched], models, placings, specs)
        begin = None if start is None else (start.values, start.poses)
        fit = fit_fingers(models, placings, touches, begin)
        values, about = fit.values, (float(fit.poses[number, 0]), float(fit.poses[number, 1]))
    if fit is None or len({item.finger for item in touched}) < min(2, len(models)):
        reference, (x, y) = placings[number].reference, placings[number].about_mm
        raise InputError(
            f"the {reference.name} was not found near ({x:.0f}, {y:.0f}) mm: {len(touched)} of the touches "
            "that looked for it met something; put it there and begin this step again"
        )
    return LocatedReference(
        tuple(touched), fit, predict_touches(models, placings, fit, number, prober.approaches)
    )


def probes_at_bearing(
    found: LocatedReference, prober: Prober, models: Sequence[FingerModel], bearing_rad: float
) -> list[tuple[Probe, float]]:
    """For each finger the approach that meets the reference nearest to a bearing, and its bearing.

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
            own = own[room >= min(_ROOM_OF_PRESS_MM, float(room.max()))]
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
) -> Touches:
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
    for k, (model, spec) in enumerate(zip(models, specs, strict=True)):
        own = finger == k
        values = np.tile(model.prior, (int(own.sum()), 1))
        angle = model.facing_rad(values, servos[own], ways[own]) + loads.towards_rad[own]
        towards = np.column_stack([np.cos(angle), np.sin(angle)])
        rounding[own] = model.rounding_mm(values, servos[own], towards)
        # Towards the contact a joint's turn brings the tip nearer; the force turns it back, to that flank.
        nearer = np.einsum("nkx,nx->nk", model.moved_by(values, servos[own]), towards)
        pushed = np.where(loads.pushes[own], np.sign(nearer), ways[own])
        unsure = np.abs(pushed - ways[own]) / 2
        unsure = np.where(ways[own] == 0, 1.0, unsure) if isinstance(spec, ArmFingerConfig) else unsure
        flank[own] = np.sqrt(((unsure * _plays_rad(spec) * nearer) ** 2).sum(axis=1) / 3)
        ways[own] = (ways[own] + pushed) / 2
    stiffness = np.array([spec.tip.stiffness_n_per_mm for spec in specs])[finger]
    placing = np.array([item.placing for item in touched], dtype=np.int64)
    shape = np.array([item.reference.tolerance_mm for item in placings])[placing] / math.sqrt(3)
    return Touches(
        finger,
        placing,
        servos,
        ways,
        force / stiffness + loads.give_mm,
        np.sqrt(rounding**2 + flank**2 + shape**2 + _OTHER_MM**2),
        np.ones(len(touched), dtype=bool),
    )


def _plays_rad(spec: FingerConfig) -> Floats:
    """Declared plays (2,) of both joints; that of a slide is in its zero: a touch keeps it on one flank."""
    if isinstance(spec, ArmFingerConfig):
        return np.radians([spec.shoulder.backlash_deg, spec.elbow.backlash_deg])
    return np.radians([spec.aim.backlash_deg, 0.0])
