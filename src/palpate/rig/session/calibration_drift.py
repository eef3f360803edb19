"""Calibration drift: whether the devices and contacts of a session agree with the calibration in use.

Before a run: an array or a servo that was replaced has other gains, another play, another zero. After an
identification: the object is a thing of known shape, and at its best pose its contacts must not be further
from its outline than the calibration explains (`calibration.agreement`).
"""

import math
from collections.abc import Mapping, Sequence
from datetime import datetime

import numpy as np

from palpate.base.errors import InputError
from palpate.base.geometry import Floats
from palpate.base.geometry.plane import rotate, rotation_matrix
from palpate.base.vocabulary import RecognitionVerdict
from palpate.calibration.consistency_checks import (
    ContactUncertainty,
    DriftTest,
    SurfaceContacts,
    compare_touches,
    contact_uncertainties,
    touch_covariance,
)
from palpate.config import CalibrationDevice, CalibrationFile, RigFile
from palpate.config.recognition_results import CalibrationUsedOut
from palpate.recognizer import Finger, Hypothesis
from palpate.rig.conversion import deflection_mm
from palpate.rig.fingers import Stage
from palpate.rig.identification.outcome import Identification
from palpate.rig.motion.hand import Hand
from palpate.rig.motion.touch import Touch, dent_range_mm, may_touch_two_edges


def devices_of(hand: Hand) -> list[CalibrationDevice]:
    """Every device of a connected hand: servos, the stage's first, then arrays, in the fingers' order."""
    port = hand.rig.bus.port
    servos = [
        CalibrationDevice(
            port=port,
            kind="servo",
            id=str(servo.dxl_id),
            model=servo.model.name,
            firmware=str(servo.check().firmware),
        )
        for servo in hand.servos
    ]
    arrays = []
    for finger in hand.fingers:
        described = finger.array.description
        size = f"{described.rows} x {described.cols}"
        arrays.append(
            CalibrationDevice(
                port=finger.spec.array.port,
                kind="array",
                id=described.unique_id.hex(),
                model=f"{finger.spec.array.protocol}, {size} {described.shape.name.lower()}",
                firmware=described.firmware or "unknown",
            )
        )
    return [*servos, *arrays]


def check_devices(file: CalibrationFile | None, hand: Hand) -> None:
    """Raise InputError if a connected device is not the one that was calibrated. Nothing is sent."""
    if file is None:
        return
    servos = {servo.dxl_id: servo.model.name for servo in hand.servos}
    _refuse_mismatch(file, _servo_mismatch(file, servos))
    check_arrays(file, arrays_of(hand))


def arrays_of(hand: Hand) -> dict[str, str]:
    """Unique ids of a connected hand's arrays, in hexadecimal, by finger."""
    return {finger.name: finger.array.description.unique_id.hex() for finger in hand.fingers}


def check_arrays(file: CalibrationFile | None, arrays: Mapping[str, str]) -> None:
    """Raise InputError if one of some fingers' arrays, by unique id, is not the one that was calibrated."""
    if file is not None:
        _refuse_mismatch(file, _array_mismatch(file, arrays))


def device_mismatch(
    file: CalibrationFile, servos: Mapping[int, str], arrays: Mapping[str, str]
) -> str | None:
    """Say which device is the first that was not calibrated; None if all that are given were.

    `servos`: model by id. `arrays`: unique id in hexadecimal by finger; fingers may be left out.
    """
    return _servo_mismatch(file, servos) or _array_mismatch(file, arrays)


def _servo_mismatch(file: CalibrationFile, servos: Mapping[int, str]) -> str | None:
    for device in file.devices:
        model = servos.get(int(device.id)) if device.kind == "servo" and device.id.isdecimal() else None
        if model is not None and model != device.model:
            return f"was made with servo {device.id} a {device.model}, which is a {model} now"
    return None


def _array_mismatch(file: CalibrationFile, arrays: Mapping[str, str]) -> str | None:
    calibrated = [device.id for device in file.devices if device.kind == "array"]
    if len(calibrated) != len(file.fingers):
        return f"names {len(calibrated)} arrays for {len(file.fingers)} fingers"
    for finger, wanted in zip(file.fingers, calibrated, strict=True):
        found = arrays.get(finger.name, wanted)
        if found != wanted:
            return f"was made with array {wanted} on finger {finger.name}, which has array {found} now"
    return None


def _refuse_mismatch(file: CalibrationFile, other: str | None) -> None:
    # A replay says the same from another folder, so no path is named.
    if other is not None:
        raise InputError(
            f'the calibration of rig "{file.rig}" {other}: calibrate again with `palpate calibrate`, or '
            "leave it out with --no-calibration (an emulated rig's devices are those of its --seed)"
        )


_DIFFERENCE = 1e-6
_MIN_STAGE_TURN_RAD = math.radians(0.2)  # less is what the stage's servo stops beside its goal
_LEVER_MM = 50.0  # a turn counts like a shift so far out: unknowns of one size


def session_agreement(
    result: Identification, rig: RigFile, calibration: CalibrationFile | None
) -> DriftTest | None:
    """Return how the contacts of an identified object agree with the calibration that is laid over `rig`.

    None if there is no calibration with bounds, more than one hypothesis is left, or contacts are too few.
    """
    recognition = result.recognition
    uncertainties = None if calibration is None else contact_uncertainties(calibration, at_rest=True)
    if uncertainties is None or recognition is None or recognition.verdict is not RecognitionVerdict.UNIQUE:
        return None
    since = result.moved_before[-1] - 1 if result.moved_before else 0
    touches = [touch for grip in result.grips[since:] for touch in grip if _is_clear(touch)]
    found = recognition.hypotheses[0]
    outlines = [_touchable_edges(found, touch.contact.finger) for touch in touches]
    if not touches or any(not len(outline) for outline in outlines):
        return None
    return _agreement(touches, outlines, found, rig, uncertainties)


def calibration_used(
    result: Identification, rig: RigFile, calibration: CalibrationFile, started: datetime
) -> CalibrationUsedOut:
    """The calibration's part of a run's answer; `started`: when the run began."""
    found = session_agreement(result, rig, calibration)
    return CalibrationUsedOut(
        made=calibration.made.isoformat().replace("+00:00", "Z"),
        age_days=max((started - calibration.made).days, 0),
        residual_rms_mm=found and found.rms_mm,
        expected_rms_mm=found and found.expected_rms_mm,
        drifted=found and found.drifted,
    )


def _is_clear(touch: Touch) -> bool:
    """True if it met one edge, so that it is known along which normal the tip was dented."""
    return touch.patch is not None and not may_touch_two_edges(touch.patch)


def _agreement(
    touches: Sequence[Touch],
    outlines: Sequence[Floats],
    found: Hypothesis,
    rig: RigFile,
    uncertainties: Sequence[ContactUncertainty],
) -> DriftTest | None:
    from scipy.optimize import least_squares  # noqa: PLC0415  (slow to import)

    centre = np.array([touch.contact.end_mm for touch in touches])
    radius = np.array([touch.contact.finger.tip_radius_mm for touch in touches])
    at = found.configuration
    middle = np.array([at.x_mm, at.y_mm])
    middle = middle + rotation_matrix(at.theta_rad) @ found.state.origin_mm

    def gaps(pose: Floats) -> tuple[Floats, Floats]:
        """Distances (n,) of centres from the outline less the radius, and outward normals (n, 2) in W."""
        turn = rotation_matrix(at.theta_rad + pose[2] / _LEVER_MM)
        own = (centre - middle - pose[:2]) @ turn + found.state.origin_mm
        nearest = np.array([_nearest_point(outline, p) for outline, p in zip(outlines, own, strict=True)])
        away = own - nearest
        far = np.hypot(away[:, 0], away[:, 1])
        return far - radius, away @ turn.T / np.maximum(far, 1e-9)[:, None]

    def off(pose: Floats) -> Floats:
        return gaps(pose)[0]

    pose = least_squares(off, np.zeros(3)).x
    residual, normal = gaps(pose)
    slopes = np.column_stack(
        [(off(pose + step) - off(pose - step)) / (2 * _DIFFERENCE) for step in _DIFFERENCE * np.eye(3)]
    )
    travel = np.array([touch.contact.direction_rad for touch in touches])
    surface = SurfaceContacts(
        finger=np.array([touch.finger_index for touch in touches], dtype=np.int64),
        normal=normal,
        travel=np.column_stack([np.cos(travel), np.sin(travel)]),
        dent_mm=np.array([_dent_mm(touch, rig) for touch in touches]),
        tolerance_mm=found.state.tolerance_mm,
        shared_mm=_stage_deviation_mm(touches, centre, normal, Stage.of(rig)),
    )
    return compare_touches(residual, slopes, touch_covariance(surface, uncertainties))


def _dent_mm(touch: Touch, rig: RigFile) -> float:
    """Bound on how far dent and deflection may be other than the contact takes them to be."""
    assert touch.patch is not None
    patch, finger = touch.patch, rig.fingers[touch.finger_index]
    least, most = dent_range_mm(patch.force_n, patch.force_bound_n, finger.tip, rig.closing.max_force_n)
    return (most - least) / 2 + deflection_mm(finger, patch.force_n)


def _stage_deviation_mm(touches: Sequence[Touch], centre: Floats, normal: Floats, stage: Stage) -> Floats:
    """Return what the turning stage puts contacts off by along their normals: deviations (n, m).

    Its axis is alike in all of them; its angle in those between which it did not turn, because where it
    turns its play may be taken up on the other side.
    """
    angle = np.array([touch.stage_rad for touch in touches])
    stop = np.concatenate([[0], np.cumsum(np.abs(np.diff(angle)) > _MIN_STAGE_TURN_RAD)])
    arm = centre - np.array(stage.centre_mm)
    across = normal[:, 1] * arm[:, 0] - normal[:, 0] * arm[:, 1]
    off_rad = stage.planned_turn(0.0).angle_bound_rad / math.sqrt(3)
    turned = (stop[:, None] == np.unique(stop)) * (across * off_rad)[:, None]
    shifted = (normal - rotate(normal, -angle)) * stage.centre_bound_mm / 2
    return np.hstack([turned, shifted])


def _touchable_edges(found: Hypothesis, finger: Finger) -> Floats:
    """Edges (m, 2, 2) of the object beside a tip: start and end, in its own frame; none where nothing is.

    Nor where it is not by its own circle that a ball meets them.
    """
    sections = found.state.state.sections_within(finger.span_mm)
    if any(finger.radius_beside_mm(item.z_mm) < finger.tip_radius_mm for item in sections):
        return np.empty((0, 2, 2))
    rings = [ring for section in sections for ring in section.rings]
    edges = [np.stack([ring, np.roll(ring, -1, axis=0)], axis=1) for ring in rings]
    return np.concatenate(edges) if edges else np.empty((0, 2, 2))


def _nearest_point(edges: Floats, point: Floats) -> Floats:
    """The point (2,) of the edges (m, 2, 2) that is nearest to a point (2,)."""
    start, along = edges[:, 0], edges[:, 1] - edges[:, 0]
    share = ((point - start) * along).sum(axis=1) / np.maximum((along**2).sum(axis=1), 1e-12)
    places = start + np.clip(share, 0.0, 1.0)[:, None] * along
    result: Floats = places[np.hypot(*(places - point).T).argmin()]
    return result
