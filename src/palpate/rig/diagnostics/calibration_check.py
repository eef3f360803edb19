"""Check of a calibration: its age and bounds, whether its devices are these, and whether it is still valid.

For that a disc is touched a few times by every finger. Fingers stand where the calibration says; only the
disc's place is fitted. A press shows the current that slides need to move freely now: a slide's current
limit is what max_force_n takes and `slide.friction_a`, which its friction is to use up. A carriage that
runs more easily leaves the rest to the tip; one that runs harder takes it from the touch.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace

import numpy as np

from palpate.base.errors import InputError
from palpate.calibration.actuator_estimators import estimate_friction
from palpate.calibration.consistency_checks import (
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
from palpate.calibration.finger_model import FingerModel
from palpate.calibration.measurements import Prober, Reference, TouchMeasurement
from palpate.calibration.rig_models import certain_models
from palpate.config import CalibrationFile, FingerConfig, RigFile
from palpate.config.diagnosis_results import (
    CalibrationCheckOut,
    Cause,
    FindingOut,
    FingerTouchOut,
    TouchCheckOut,
)
from palpate.config.rig_servos import SlideConfig
from palpate.rig.conversion import deflection_mm, slide_force_n
from palpate.rig.diagnostics.readings import Readings
from palpate.rig.diagnostics.servo_bus import list_servos
from palpate.rig.diagnostics.steps import (
    NOTHING_TO_DO,
    DiagnosisCase,
    Judgement,
    NamedDevice,
    join_words,
    warning,
    wrong,
)
from palpate.rig.diagnostics.touch_explanation import CheckedTouches, JointChange
from palpate.rig.mechanisms import mechanism_of
from palpate.rig.motion.touch import dent_range_mm
from palpate.rig.session.calibration_drift import device_mismatch

_MIN_FORCE_RATIO = 2.0
"""Times contact_force_n that a slide should be able to press with."""


def _measure_friction(
    prober: Prober, models: Sequence[FingerModel], found: LocatedReference
) -> dict[str, float]:
    """Current (A) that each finger's slide needs to move out freely, from the begin of a press head-on.

    Left out are arms, slides that moved too little, and fingers that meet what was located too obliquely.
    """
    slides = {k for k, model in enumerate(models) if model.slide is not None}
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


def judge_friction(rig: RigFile, friction_a: Mapping[str, float]) -> list[FindingOut]:
    """Judge the force with which tips may press by measured friction, and warn where it matters."""
    found = (
        _judge_slide(rig, spec.name, slide, friction_a[spec.name])
        for spec in rig.fingers
        if spec.name in friction_a and (slide := mechanism_of(spec).push) is not None
    )
    return [item for item in found if item is not None]


def _judge_slide(rig: RigFile, name: str, slide: SlideConfig, measured_a: float) -> FindingOut | None:
    allowed_a, dxl_id = slide.friction_a, slide.dxl_id
    more_n = slide_force_n(slide, allowed_a - measured_a)
    left_n = rig.closing.max_force_n + more_n
    device = NamedDevice(f"finger {name}", (dxl_id,))
    if more_n > 0:
        return warning(
            Cause.FRICTION,
            device,
            f"its slide (servo {dxl_id}) moves freely with {measured_a:.3f} A, and {allowed_a:.3f} A are "
            f"allowed for its friction: its tip may press with {math.ceil(10 * more_n) / 10:g} N more than "
            "max_force_n",
            "what friction does not use up of the slide's current is left to the tip",
            f"calibrate again, or make slide.friction_a at most {math.floor(1e3 * measured_a) / 1e3:g}",
        )
    if left_n < _MIN_FORCE_RATIO * rig.closing.contact_force_n:
        return warning(
            Cause.FRICTION,
            device,
            f"its slide (servo {dxl_id}) needs {measured_a:.3f} A to move freely, and {allowed_a:.3f} A are "
            f"allowed for it: {max(left_n, 0.0):.1f} N of max_force_n are left to touch with",
            "friction takes the rest of the slide's current",
            "clean and grease it, then calibrate again",
        )
    return None


_BEARINGS_RAD = (math.radians(40.0), math.radians(-40.0))  # beside those of the touches that look for it


@dataclass(frozen=True, eq=False)
class Retouch:
    """Result of a re-touch: how all touches agree with the calibration, and every finger's mean.

    `friction_a`: current that slides need to move freely, by fingers' names, as far as it was measured.
    `changes`: each alone explains touches that do not agree.
    """

    agreement: DriftTest
    fingers: tuple[FingerTouchOut, ...]
    friction_a: Mapping[str, float] = field(default_factory=dict)
    changes: tuple[JointChange, ...] = ()


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
    friction_a = _measure_friction(prober, models, found)
    prober.clear()
    missing = [model.name for model in models if all(item.finger != model.name for item in touched)]
    if missing:
        raise InputError(
            f"finger {missing[0]} never met the {disc.name}: put it nearer to the middle, or calibrate again"
        )
    return replace(_compare_retouch(rig, disc, uncertainties, touched), friction_a=friction_a)


def _compare_retouch(
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
    checked = CheckedTouches(models, placings, touches, covariance, fit)
    changes = checked.explain() if agreement.drifted else []
    offsets = tuple(_finger_offset(model, k, touches, fit) for k, model in enumerate(models))
    return Retouch(agreement, offsets, changes=tuple(changes))


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
    """Places where all touches, outliers of the fit among them, met the disc."""
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


_MAX_AGE_DAYS = 90
"""From this age on a calibration should be made anew: skins wear, screws loosen."""


def touch_out(found: Retouch) -> TouchCheckOut:
    """A re-touch as a part of a check's result."""
    agreement = found.agreement
    fingers = (
        item.model_copy(update={"friction_a": found.friction_a.get(item.finger)}) for item in found.fingers
    )
    return TouchCheckOut(
        agrees=not agreement.drifted,
        touches=len(agreement.residual_mm),
        residual_rms_mm=agreement.rms_mm,
        expected_rms_mm=agreement.expected_rms_mm,
        fingers=tuple(fingers),
    )


def judge_touch(rig: RigFile, found: Retouch) -> Judgement:
    """Judge whether touches agree with the calibration that is laid over `rig`, and slides' friction."""
    touch, findings = touch_out(found), judge_friction(rig, found.friction_a)
    saw = f"{touch.residual_rms_mm:.3f} mm, and the calibration lets expect {touch.expected_rms_mm:.3f} mm"
    if not touch.agrees:
        # Of three fingers round a disc one that is off shows in all: the disc's place gives way to it.
        offsets = ", ".join(f"{item.finger} {item.offset_mm:+.3f}" for item in touch.fingers)
        means, do = _explain_touches(found.changes)
        differ = f"touches of the disc differ by {saw} (in the mean {offsets})"
        problem = wrong(Cause.TOUCH_DISAGREES, CALIBRATION, differ, means, do)
        findings = [problem, *findings]
    return f"{touch.touches} touches differ by {saw}", findings


def _explain_touches(changes: Sequence[JointChange]) -> tuple[str, str]:
    """What touches that disagree mean, and what to do."""
    if not changes:
        means = "no change of one joint's zero, play or encoder explains it"
        return means, "calibrate again, unless the disc moved or is not as given"
    words = " or ".join(item.words for item in changes[:_MOST_CHANGES])
    return f"{words} would explain it", f"{changes[0].remedy}, then calibrate again"


_MOST_CHANGES = 3

CALIBRATION = NamedDevice("calibration")


def need_calibrated_device(case: DiagnosisCase, readings: Readings) -> str | None:
    """The need of a device that answers, if there is a calibration to compare it with."""
    known = case.on_bench.calibration is None or _answering(readings) != ({}, {})
    return None if known else "no device answers"


def _answering(readings: Readings) -> tuple[dict[int, str], dict[str, str]]:
    """Servos' models by id, and arrays' unique ids by finger, of those that answer."""
    bus = readings.bus
    servos = () if bus is None else (item for item in bus.owned if item.dxl_id in bus.sound)
    arrays = ((item.spec.name, item.description) for item in readings.arrays)
    return (
        {item.dxl_id: item.model for item in servos},
        {name: described.unique_id.hex() for name, described in arrays if described is not None},
    )


def judge_calibration(case: DiagnosisCase, readings: Readings) -> Judgement:
    """Judge the calibration by the devices that answer, its age and its bounds."""
    file = case.on_bench.calibration
    if file is None:
        return "there is none: the rig file's own numbers and bounds hold", []
    servos, arrays = _answering(readings)
    age = _age_days(file, readings)
    findings = _exchange_findings(case, file, servos, arrays)
    again = case.calibrate_or("move the calibration away: pads are measured by hand")
    if age > _MAX_AGE_DAYS and not findings:
        saw = f"it is {age} days old"
        means = f"skins wear and screws loosen; it should not be older than {_MAX_AGE_DAYS} days"
        findings.append(warning(Cause.CALIBRATION_OLD, CALIBRATION, saw, means, again))
    loose = [item.name for item in file.fingers if item.bounds is None]
    if loose:
        saw = f"it does not bound contacts of {', '.join(loose)}"
        means = "the rig file's bounds hold there"
        do = case.calibrate_or(f"{NOTHING_TO_DO}: pads are measured by hand")
        findings.append(warning(Cause.BOUNDS_MISSING, CALIBRATION, saw, means, do))
    return f"{age} days old, of {len(servos)} servos and {len(arrays)} arrays that answer", findings


def _age_days(file: CalibrationFile, readings: Readings) -> int:
    return max((readings.now - file.made).days, 0)


def _exchange_findings(
    case: DiagnosisCase, file: CalibrationFile, servos: Mapping[int, str], arrays: Mapping[str, str]
) -> list[FindingOut]:
    """Devices that are not those that were calibrated, or hang on each other's ports."""
    swapped = _array_swaps(file, arrays)
    if swapped:
        return [
            wrong(
                Cause.ARRAYS_SWAPPED,
                NamedDevice(join_words([f"array {name}" for name in swapped]), arrays=tuple(swapped)),
                "each answers on a port on which another finger's array was calibrated: "
                + join_words([f"finger {name} has that of {owner}" for name, owner in swapped.items()]),
                "cables were plugged in crosswise, or ports have other names since; a contact would count as "
                "another finger's",
                "plug the arrays' cables as they were, or exchange their ports in the rig file",
            )
        ]
    other = device_mismatch(file, servos, arrays)
    if other is None:
        return []
    means = "gains, zeros and play of another device are used"
    do = case.calibrate_or("move the calibration away: pads are measured by hand")
    return [wrong(Cause.OTHER_DEVICES, CALIBRATION, f"it {other}", means, do)]


def calibration_out(case: DiagnosisCase, readings: Readings) -> CalibrationCheckOut | None:
    """The calibration as a part of a check's result; None if there is none."""
    file = case.on_bench.calibration
    if file is None:
        return None
    bounds = [item.bounds for item in file.fingers if item.bounds is not None]
    loose = len(bounds) < len(file.fingers)
    servos, arrays = _answering(readings)
    same = device_mismatch(file, servos, arrays) is None
    all_asked = len(servos) == len(list_servos(case.rig)) and len(arrays) == len(case.rig.fingers)
    return CalibrationCheckOut(
        file=str(case.on_bench.calibration_path),
        made=file.made.isoformat().replace("+00:00", "Z"),
        age_days=_age_days(file, readings),
        coverage=file.coverage,
        position_mm=None if loose else max(item.position_mm for item in bounds),
        direction_deg=None if loose else max(item.direction_deg for item in bounds),
        devices_match=False if not same else True if all_asked else None,
    )


def _array_swaps(file: CalibrationFile, arrays: Mapping[str, str]) -> dict[str, str]:
    """Fingers whose array was calibrated on another finger, and on which."""
    ids = [device.id for device in file.devices if device.kind == "array"]
    if len(ids) != len(file.fingers):
        return {}
    owner = {uid: finger.name for finger, uid in zip(file.fingers, ids, strict=True)}
    return {name: owner[uid] for name, uid in arrays.items() if uid in owner and owner[uid] != name}
