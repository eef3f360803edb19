"""Re-touch of a reference: does a disc, touched a few times by every finger, agree with the calibration?

Fingers stand where the calibration
says; only the disc's place is fitted.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from palpate.base.errors import InputError
from palpate.calibration.agreement import (
    Agreement,
    ContactUncertainty,
    SurfaceContacts,
    compare_touches,
    touch_covariance,
)
from palpate.calibration.finger_fit import (
    Fit,
    ReferencePlacement,
    Touches,
    fit_fingers,
    predict_residuals,
)
from palpate.calibration.finger_model import certain_models
from palpate.calibration.fitted_kinematics import FingerModel
from palpate.calibration.measurements import TouchMeasurement
from palpate.calibration.prober import Prober
from palpate.calibration.reference import Reference
from palpate.calibration.reference_search import (
    LocatedReference,
    locate_reference,
    probes_at_bearing,
    touch_arrays,
)
from palpate.config import FingerConfig, RigFile
from palpate.config.check_result import FingerTouchOut
from palpate.rig.conversion import deflection_mm
from palpate.rig.diagnostics.friction_check import measure_friction
from palpate.rig.motion.contact_from_touch import dent_range_mm

__all__ = ["Retouch", "compare_retouch", "retouch"]

_BEARINGS_RAD = (math.radians(40.0), math.radians(-40.0))  # beside those of the touches that look for it


@dataclass(frozen=True, eq=False)
class Retouch:
    """What came of a re-touch: how all touches agree with the calibration, and every finger's mean.

    `friction_a`: current that slides need to move freely, by fingers' names, as far as it was measured.
    """

    agreement: Agreement
    fingers: tuple[FingerTouchOut, ...]
    friction_a: Mapping[str, float] = field(default_factory=dict)


def retouch(
    rig: RigFile,
    prober: Prober,
    disc: Reference,
    uncertainties: Sequence[ContactUncertainty],
    tell: Callable[[str], None] = lambda _: None,
) -> Retouch:
    """Have a disc put in the middle, touch it with every finger from several sides, and compare.

    In the end every finger presses on it once; a way that begins so shows a slide's friction.

    `rig`: with its calibration; `uncertainties`: of every finger. Raises InputError
    if the disc is not found, or a finger never meets it.
    """
    specs = rig.fingers
    models = certain_models(specs)
    placings = [ReferencePlacement(disc, (0.0, 0.0))]
    tell(f"putting the {disc.name}")
    prober.put(disc, placings[0].about_mm)
    tell("looking for it")
    found = locate_reference(prober, models, placings, [], specs)
    touched = [*found.touched, *_touched_round(found, prober, models, tell)]
    tell("friction")
    friction_a = measure_friction(prober, models, found)
    prober.clear()
    missing = [model.name for model in models if all(item.finger != model.name for item in touched)]
    if missing:
        raise InputError(
            f"finger {missing[0]} never met the {disc.name}: put it nearer to the middle, or calibrate again"
        )
    return replace(compare_retouch(rig, disc, uncertainties, touched), friction_a=friction_a)


def compare_retouch(
    rig: RigFile,
    disc: Reference,
    uncertainties: Sequence[ContactUncertainty],
    touched: Sequence[TouchMeasurement],
) -> Retouch:
    """Compare touches of a disc in the middle with the uncertainties of `rig`'s calibration.

    Every finger must have touched it. Raises InputError if touches are too few to tell anything.
    """
    specs = rig.fingers
    models = certain_models(specs)
    placings = [ReferencePlacement(disc, (0.0, 0.0))]
    touches = touch_arrays(touched, models, placings, specs)
    fit = fit_fingers(models, placings, touches)
    # Another size of the disc shifts all touches alike.
    covariance = touch_covariance(_surface(rig, specs, models, touched, touches, fit), uncertainties)
    covariance += disc.tolerance_mm**2 / 3
    slopes = predict_residuals(models, placings, touches, fit.values, fit.poses)[3]
    first = fit.values.size
    agreement = compare_touches(fit.residual_mm, slopes[:, first : first + 2], covariance)
    if agreement is None:
        raise InputError(
            f"the {disc.name} was touched {len(touched)} times only: put it nearer to the middle"
        )
    return Retouch(agreement, tuple(_off(model, k, touches, fit) for k, model in enumerate(models)))


def _touched_round(
    found: LocatedReference, prober: Prober, models: Sequence[FingerModel], tell: Callable[[str], None]
) -> list[TouchMeasurement]:
    """Touches at several sides of what was found, each by all fingers."""
    touched: list[TouchMeasurement] = []
    for number, bearing in enumerate(_BEARINGS_RAD, start=1):
        tell(f"touch {number} of {len(_BEARINGS_RAD)}")
        grip = []
        for probe, _ in probes_at_bearing(found, prober, models, bearing):
            approach = prober.approaches[probe.approach]
            grip.append(replace(probe, end_mm=approach.length_mm))
        touched += [item for item in prober.touch(grip, 0) if item is not None]
    return touched


def _surface(
    rig: RigFile,
    specs: Sequence[FingerConfig],
    models: Sequence[FingerModel],
    touched: Sequence[TouchMeasurement],
    touches: Touches,
    fit: Fit,
) -> SurfaceContacts:
    """Where all touches, outliers of the fit among them, met the disc."""
    fingers = touches.finger.tolist()
    travel = np.empty(len(fingers))
    for k, model in enumerate(models):
        own = touches.finger == k
        rows = np.tile(fit.values[k], (int(own.sum()), 1))
        still = np.zeros((len(rows), 2))
        travel[own] = model.facing_rad(rows, touches.servos_rad[own], still)
    travel -= [item.facing_rad for item in touched]
    dents = [
        dent_range_mm(item.force_n, item.force_bound_n, specs[k].tip, rig.closing.max_force_n)
        for k, item in zip(fingers, touched, strict=True)
    ]
    bent = [deflection_mm(specs[k], item.force_n) for k, item in zip(fingers, touched, strict=True)]
    return SurfaceContacts(
        finger=touches.finger,
        normal=fit.normal,
        travel=np.column_stack([np.cos(travel), np.sin(travel)]),
        dent_mm=np.array([(most - least) / 2 for least, most in dents]) + bent,
        tolerance_mm=0.0,
    )


def _off(model: FingerModel, index: int, touches: Touches, fit: Fit) -> FingerTouchOut:
    own = fit.residual_mm[touches.finger == index]
    return FingerTouchOut(finger=model.name, touches=len(own), offset_mm=float(own.mean()))
