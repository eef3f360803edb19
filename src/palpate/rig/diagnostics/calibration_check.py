"""Check of a calibration: its age and bounds, whether it is of these devices, and whether it still holds.

For that a disc is touched a few times by every finger. Fingers stand where the calibration says; only the
disc's place is fitted. A press shows the current that slides need to move freely now: a slide's current
limit is what max_force_n takes and `slide.friction_a`, which its friction is to use up. A carriage that
runs more easily leaves the rest to the tip; one that runs harder takes it from the touch.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from datetime import datetime

import numpy as np

from palpate.base.errors import InputError
from palpate.calibration.actuator_estimators import estimate_friction
from palpate.calibration.drift_test import (
    ContactUncertainty,
    DriftTest,
    SurfaceContacts,
    compare_touches,
    touch_covariance,
)
from palpate.calibration.experiment_design import (
    LocatedReference,
    locate_reference,
    probes_at_bearing,
    touch_arrays,
)
from palpate.calibration.finger_fit import (
    FingerFit,
    ReferencePlacement,
    TouchArrays,
    fit_fingers,
    predict_residuals,
)
from palpate.calibration.finger_model import FingerModel, SlideModel, certain_models
from palpate.calibration.measurements import Prober, TouchMeasurement
from palpate.calibration.reference import Reference
from palpate.config import CalibrationFile, FingerConfig, RigFile, SlideFingerConfig
from palpate.config.diagnosis_results import (
    CalibrationCheckOut,
    Cause,
    CheckOut,
    DoctorStepOut,
    FingerTouchOut,
    TouchCheckOut,
)
from palpate.rig.calibrated_rig import RigOnBench
from palpate.rig.conversion import deflection_mm, slide_force_n
from palpate.rig.diagnostics.steps import (
    DiagnosisCase,
    error_finding,
    finish_step,
    join_words,
    skip_step,
    warning_finding,
)
from palpate.rig.motion.touch import dent_range_mm
from palpate.rig.session.calibration_drift import device_mismatch

_MIN_FORCE_RATIO = 2.0
"""Times contact_force_n that a slide should be able to press with."""


def measure_friction(
    prober: Prober, models: Sequence[FingerModel], found: LocatedReference
) -> dict[str, float]:
    """Current (A) that each finger's slide needs to move out freely, from the begin of a press head-on.

    Left out are arms, slides that moved too little, and fingers that meet what was located too obliquely.
    """
    slides = {k for k, model in enumerate(models) if isinstance(model, SlideModel)}
    contacts = [
        probe
        for probe, _ in probes_at_bearing(found, prober, models, 0.0)
        if prober.approaches[probe.approach].finger in slides
    ]
    presses = {press.finger: press for press in prober.press(contacts, 0)} if contacts else {}
    found_a = {}
    for name, press in presses.items():
        with suppress(InputError):  # too few samples: what touches have shown must not be lost with it
            found_a[name] = abs(estimate_friction([press]).push_n / press.newton_per_a[1])
    return found_a


def friction_warnings(rig: RigFile, friction_a: Mapping[str, float]) -> list[str]:
    """What measured friction means for the force with which tips may press, where it matters."""
    slides = (item for item in rig.fingers if isinstance(item, SlideFingerConfig) and item.name in friction_a)
    found = (_friction_warning(rig, spec, friction_a[spec.name]) for spec in slides)
    return [warning for warning in found if warning is not None]


def _friction_warning(rig: RigFile, spec: SlideFingerConfig, measured_a: float) -> str | None:
    allowed_a = spec.slide.friction_a
    more_n = slide_force_n(spec.slide, allowed_a - measured_a)
    left_n = rig.closing.max_force_n + more_n
    servo = f"finger {spec.name}: its slide (servo {spec.slide.dxl_id})"
    if more_n > 0:
        return (
            f"{servo} moves freely with {measured_a:.3f} A, and {allowed_a:.3f} A are allowed for its "
            f"friction: its tip may press with {math.ceil(10 * more_n) / 10:g} N more than max_force_n; "
            f"calibrate again, or make slide.friction_a at most {math.floor(1e3 * measured_a) / 1e3:g}"
        )
    if left_n < _MIN_FORCE_RATIO * rig.closing.contact_force_n:
        return (
            f"{servo} needs {measured_a:.3f} A to move freely, and {allowed_a:.3f} A are allowed for it: "
            f"{max(left_n, 0.0):.1f} N of max_force_n are left to touch with; clean and grease it, then "
            "calibrate again"
        )
    return None


_BEARINGS_RAD = (math.radians(40.0), math.radians(-40.0))  # beside those of the touches that look for it


@dataclass(frozen=True, eq=False)
class Retouch:
    """What came of a re-touch: how all touches agree with the calibration, and every finger's mean.

    `friction_a`: current that slides need to move freely, by fingers' names, as far as it was measured.
    """

    agreement: DriftTest
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
    touched = [*found.touched, *_touch_around(found, prober, models, tell)]
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
    covariance = touch_covariance(_surface_contacts(rig, specs, models, touched, touches, fit), uncertainties)
    covariance += disc.tolerance_mm**2 / 3
    slopes = predict_residuals(models, placings, touches, fit.values, fit.poses)[3]
    first = fit.values.size
    agreement = compare_touches(fit.residual_mm, slopes[:, first : first + 2], covariance)
    if agreement is None:
        raise InputError(
            f"the {disc.name} was touched {len(touched)} times only: put it nearer to the middle"
        )
    return Retouch(agreement, tuple(_finger_offset(model, k, touches, fit) for k, model in enumerate(models)))


def _touch_around(
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


def _surface_contacts(
    rig: RigFile,
    specs: Sequence[FingerConfig],
    models: Sequence[FingerModel],
    touched: Sequence[TouchMeasurement],
    touches: TouchArrays,
    fit: FingerFit,
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


def _finger_offset(model: FingerModel, index: int, touches: TouchArrays, fit: FingerFit) -> FingerTouchOut:
    own = fit.residual_mm[touches.finger == index]
    return FingerTouchOut(finger=model.name, touches=len(own), offset_mm=float(own.mean()))


MAX_AGE_DAYS = 90
"""From this age on a calibration should be made anew: skins wear, screws loosen."""


def with_calibration(out: CheckOut, on_bench: RigOnBench, now: datetime) -> CheckOut:
    """A check's result with findings on the rig's calibration; unchanged without one."""
    file = on_bench.calibration
    if file is None:
        return out
    other = _other_device(file, out)
    problems = [] if other is None else [f"calibration {other}; calibrate again, or move the file away"]
    bounds = [item.bounds for item in file.fingers if item.bounds is not None]
    loose = [item.name for item in file.fingers if item.bounds is None]
    found = CalibrationCheckOut(
        file=str(on_bench.calibration_path),
        made=file.made.isoformat().replace("+00:00", "Z"),
        age_days=max((now - file.made).days, 0),
        coverage=file.coverage,
        position_mm=None if loose else max(item.position_mm for item in bounds),
        direction_deg=None if loose else max(item.direction_deg for item in bounds),
        devices_match=_devices_match(out, other),
    )
    return out.model_copy(
        update={
            "calibration": found,
            "well": out.well and not problems,
            "problems": (*out.problems, *problems),
            "warnings": (*out.warnings, *_warnings(found.age_days, loose)),
        }
    )


def with_touch(out: CheckOut, found: Retouch, rig: RigFile) -> CheckOut:
    """A check's result, which tells of a calibration, with that of a re-touch of the `rig` it was put on."""
    assert out.calibration is not None, "there is nothing to compare touches with"
    agreement = found.agreement
    touch = TouchCheckOut(
        agrees=not agreement.drifted,
        touches=len(agreement.residual_mm),
        residual_rms_mm=agreement.rms_mm,
        expected_rms_mm=agreement.expected_rms_mm,
        fingers=tuple(_with_friction(item, found) for item in found.fingers),
    )
    problems = [] if touch.agrees else [_touch_problem(touch)]
    return out.model_copy(
        update={
            "calibration": out.calibration.model_copy(update={"touch": touch}),
            "well": out.well and not problems,
            "problems": (*out.problems, *problems),
            "warnings": (*out.warnings, *friction_warnings(rig, found.friction_a)),
        }
    )


def _with_friction(item: FingerTouchOut, found: Retouch) -> FingerTouchOut:
    return item.model_copy(update={"friction_a": found.friction_a.get(item.finger)})


def _touch_problem(touch: TouchCheckOut) -> str:
    # Of three fingers round a disc one that is off shows in all: the disc's place gives way to it.
    offsets = ", ".join(f"{item.finger} {item.offset_mm:+.3f}" for item in touch.fingers)
    return (
        f"touches of the disc differ by {touch.residual_rms_mm:.3f} mm and the calibration lets expect "
        f"{touch.expected_rms_mm:.3f} mm (in the mean {offsets}): calibrate again, unless the disc moved or "
        "is not as given"
    )


def _other_device(file: CalibrationFile, out: CheckOut) -> str | None:
    servos = {item.id: item.model for item in out.servos if item.answers}
    arrays = {item.finger: item.unique_id for item in out.arrays if item.unique_id is not None}
    return device_mismatch(file, servos, arrays)


def _devices_match(out: CheckOut, other: str | None) -> bool | None:
    """Whether all are those that were calibrated; None if some could not be asked, and the others are."""
    if other is not None:
        return False
    asked = all(item.answers for item in out.servos) and all(item.answers for item in out.arrays)
    return True if asked else None


def _warnings(age_days: int, loose: Sequence[str]) -> list[str]:
    """About a calibration's age, and about fingers whose contacts it does not bound."""
    warnings = []
    if age_days > MAX_AGE_DAYS:
        warnings.append(
            f"the calibration is {age_days} days old; calibrate again every {MAX_AGE_DAYS} days, and after "
            "any repair"
        )
    if loose:
        warnings.append(
            f"the calibration does not bound contacts of {', '.join(loose)}, where the rig file's bounds "
            "hold; `palpate calibrate` does all of it"
        )
    return warnings


_STEP = "calibration"
_LOOKED = "compared the devices that were calibrated with those that answer"


def judge_calibration(
    case: DiagnosisCase, servos: Mapping[int, str], arrays: Mapping[str, str], now: datetime
) -> DoctorStepOut:
    """`servos`: models by id; `arrays`: unique ids by finger, of those that answer."""
    file = case.on_bench.calibration
    if file is None:
        return finish_step(_STEP, _LOOKED, "there is none: the rig file's own numbers and bounds hold")
    if not servos and not arrays:
        return skip_step(_STEP, _LOOKED, "no device answers")
    age = max((now - file.made).days, 0)
    saw = f"{age} days old, of {len(servos)} servos and {len(arrays)} arrays that answer"
    swapped = _swapped_arrays(file, arrays)
    other = device_mismatch(file, servos, arrays)
    findings = []
    if swapped:
        findings.append(
            error_finding(
                Cause.ARRAYS_SWAPPED,
                join_words([f"array {name}" for name in swapped]),
                "each answers on a port on which another finger's array was calibrated: "
                + join_words([f"finger {name} has that of {owner}" for name, owner in swapped.items()]),
                "cables were plugged in crosswise, or ports have other names since; a contact would count as "
                "another finger's",
                "plug the arrays' cables as they were, or exchange their ports in the rig file",
            )
        )
    elif other is not None:
        findings.append(
            error_finding(
                Cause.OTHER_DEVICES,
                "calibration",
                f"it {other}",
                "gains, zeros and play of another device are used",
                case.calibrate_or("move the calibration away: pads are measured by hand"),
            )
        )
    if age > MAX_AGE_DAYS and not findings:
        findings.append(
            warning_finding(
                Cause.CALIBRATION_OLD,
                "calibration",
                f"it is {age} days old",
                f"skins wear and screws loosen; it should not be older than {MAX_AGE_DAYS} days",
                case.calibrate_or("move the calibration away: pads are measured by hand"),
            )
        )
    return finish_step(_STEP, _LOOKED, saw, findings)


def _swapped_arrays(file: CalibrationFile, arrays: Mapping[str, str]) -> dict[str, str]:
    """Fingers whose array was calibrated on another finger, and on which."""
    ids = [device.id for device in file.devices if device.kind == "array"]
    if len(ids) != len(file.fingers):
        return {}
    owner = {uid: finger.name for finger, uid in zip(file.fingers, ids, strict=True)}
    return {name: owner[uid] for name, uid in arrays.items() if uid in owner and owner[uid] != name}
