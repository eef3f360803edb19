"""Calibration overlay: a rig with its measured values, and whether the calibration belongs to it.

The result is a `RigFile` like any other, with values that were measured and bounds that hold for them. A
calibration speaks of the frame in which bases and headings are nearest to the rig file's (ADR 0018); what
that frame leaves open is added where a value is the drawing's.
"""

import hashlib
import json
import math
from collections.abc import Mapping
from typing import Any, TypeVar

from palpate.base.errors import InputError
from palpate.config.calibration_file import CalibrationFile
from palpate.config.calibration_finger import (
    ActuatorsCalibration,
    ArmActuatorsCalibration,
    ArmPlaceCalibration,
    ContactBounds,
    FingerCalibration,
    PlaceCalibration,
    TactileCalibration,
)
from palpate.config.fields import FileModel
from palpate.config.rig_file import RigFile
from palpate.config.rig_fingers import ArmFingerConfig, FingerConfig, SlideFingerConfig, TaxelsConfig
from palpate.config.rig_servos import StageConfig


def frame_offset_bound_mm(rig: RigFile, point_mm: tuple[float, float]) -> float:
    """Bound on the offset of points of the drawing in a calibration's frame, by bounds of bases (mm).

    The frame is turned by no more than headings, or bases as seen from their middle, may be off: it is fitted
    to both by least squares. Its middle is off by the mean of the bases' bounds at most.
    """
    count = len(rig.fingers)
    bounds = [finger.bounds.base_mm for finger in rig.fingers]
    middle = [sum(finger.base_mm[k] for finger in rig.fingers) / count for k in (0, 1)]
    levers = [math.dist(finger.base_mm, middle) for finger in rig.fingers]
    square = math.fsum(lever**2 for lever in levers)
    aside = math.fsum(lever * bound for lever, bound in zip(levers, bounds, strict=True))
    turned = math.asin(min(aside / square, 1.0)) if square > 0 else 0.0
    turned = max(turned, *(math.radians(finger.bounds.heading_deg) for finger in rig.fingers))
    return math.fsum(bounds) / count + 2 * math.sin(turned / 2) * math.dist(point_mm, middle)


_FingerT = TypeVar("_FingerT", bound=FileModel)

_BOUND_SIGMAS = 3.3
"""Standard deviations that 99.9 % of a normal distribution lie within (3.29)."""

_NOT_GEOMETRY = frozenset(
    {
        "port", "baudrate_bps", "bounds", "bound_mm", "bound_deg", "centre_bound_mm", "zero_bound_mm",
        "zero_bound_deg", "mm_per_turn_spread",
        "radius_bound_mm", "heading_bound_deg", "stiffness_spread", "gain_spread", "drift_counts_per_s",
        "backlash_mm", "backlash_deg", "friction_a", "taxels",
    }
)  # fmt: skip
"""Keys that say where a device is plugged in, or how well something is known: they may change freely."""


_MIN_FRICTION_SHARE = 0.8
"""Of a slide's measured friction: it becomes less as grease warms and parts wear in."""


def geometry_sha256(rig: RigFile) -> str:
    """SHA-256 of what a calibration depends on: how stage and fingers are built and where they stand.

    How well that is known, ports, and how the rig is used do not count, and neither do keys that are left
    at their defaults.
    """
    parts = {
        "format": rig.format,
        "stage": _table_geometry(rig.stage),
        "fingers": [_table_geometry(finger) for finger in rig.fingers],
    }
    text = json.dumps(parts, sort_keys=True, separators=(",", ":"), ensure_ascii=True)
    return hashlib.sha256(text.encode()).hexdigest()


def check_calibration(file: CalibrationFile, rig: RigFile, name: str, rig_name: str) -> None:
    """Refuse the calibration of another rig, or of this one before it was changed.

    `name`, `rig_name`: what messages call the two files. Raises InputError.
    """
    by_hand = rig.why_not("calibrate")
    again = "" if by_hand else f"calibrate again with `palpate calibrate --rig {rig_name}`, or "
    remedy = f"{again}move this file away"
    if file.rig != rig.name:
        raise InputError(
            f'{name}: was made for rig "{file.rig}"; {rig_name} describes "{rig.name}": {remedy}'
        )
    ours, theirs = [item.name for item in rig.fingers], [item.name for item in file.fingers]
    if ours != theirs:
        raise InputError(
            f"{name}: was made for fingers {', '.join(theirs)}; {rig_name} has {', '.join(ours)}: {remedy}"
        )
    for finger, found in zip(rig.fingers, file.fingers, strict=True):
        parts = [part for part in (found.actuators, found.place) if part is not None]
        of_arm = [isinstance(part, ArmActuatorsCalibration | ArmPlaceCalibration) for part in parts]
        if isinstance(finger, ArmFingerConfig) and not all(of_arm):
            raise InputError(
                f'{name}: finger "{finger.name}" is an arm, which has no aim and no slide: {remedy}'
            )
        if isinstance(finger, SlideFingerConfig) and any(of_arm):
            raise InputError(
                f'{name}: finger "{finger.name}" has an aim and a slide, and the calibration is an arm\'s: '
                f"{remedy}"
            )
    if file.geometry_sha256 != geometry_sha256(rig):
        raise InputError(
            f"{name}: fingers or stage were changed in {rig_name} since this calibration was made on "
            f"{file.made:%Y-%m-%d}: {remedy}"
        )


def apply_calibration(rig: RigFile, file: CalibrationFile) -> RigFile:
    """The rig with everything that the calibration has measured; `check_calibration` comes before.

    What was not calibrated stays as described. Where the calibration has bounds, they take the place of those
    of its parts. The result is not checked again as a rig file is: an `[emulation]` table says what may be
    off of the rig as described, and that is more than calibration leaves.
    """
    fingers = [
        _calibrate_finger(finger, found) for finger, found in zip(rig.fingers, file.fingers, strict=True)
    ]
    return rig.model_copy(update={"fingers": fingers, "stage": _calibrate_stage(rig, file)})


def _calibrate_stage(rig: RigFile, file: CalibrationFile) -> StageConfig | None:
    """The stage as it was measured; what its angle may be off by besides the play no touch can show."""
    stage, found = rig.stage, file.stage
    if stage is None:
        return None
    if found is not None:
        measured = {
            "centre_mm": found.centre_mm,
            "centre_bound_mm": found.centre_bound_mm,
            "backlash_deg": found.backlash_deg + _BOUND_SIGMAS * found.backlash_sigma_deg,
        }
        return stage.model_copy(update=measured)
    if all(finger.place is None for finger in file.fingers):
        return stage
    # It is not measured, and the calibration's frame may be another than the drawing's.
    wide = stage.centre_bound_mm + frame_offset_bound_mm(rig, stage.centre_mm)
    return stage.model_copy(update={"centre_bound_mm": wide})


def _calibrate_finger(finger: FingerConfig, found: FingerCalibration) -> FingerConfig:
    if found.tactile is not None:
        finger = _with_tactile(finger, found.tactile)
    if isinstance(finger, SlideFingerConfig):
        if isinstance(found.actuators, ActuatorsCalibration):
            finger = _with_actuators(finger, found.actuators)
        if isinstance(found.place, PlaceCalibration):
            finger = _place_slide_finger(finger, found.place)
    else:
        if isinstance(found.actuators, ArmActuatorsCalibration):
            finger = _with_joints(finger, found.actuators)
        if isinstance(found.place, ArmPlaceCalibration):
            finger = _place_arm(finger, found.place)
    if found.bounds is not None:
        finger = _with_bounds(finger, found.bounds)
    return finger


def _with_tactile(finger: FingerConfig, found: TactileCalibration) -> FingerConfig:
    taxels = TaxelsConfig(
        gain=found.gain,
        gain_bound=found.gain_bound,
        unusable=[(taxel.row, taxel.col) for taxel in found.unusable],
        noise_counts=found.noise_counts,
        crosstalk=found.crosstalk,
        crosstalk_bound=found.crosstalk_bound,
        force_drift_n_per_s=found.force_drift_n_per_s,
    )
    array = {"taxels": taxels, "drift_counts_per_s": found.drift_counts_per_s}
    tip = {"stiffness_n_per_mm": found.stiffness_n_per_mm, "stiffness_spread": found.stiffness_bound}
    return _replace_in_tables(finger, array=array, tip=tip)


def _with_actuators(finger: SlideFingerConfig, found: ActuatorsCalibration) -> SlideFingerConfig:
    slide, aim = found.slide, found.aim
    changes: dict[str, float] = {
        "backlash_mm": slide.backlash_mm + _BOUND_SIGMAS * slide.backlash_sigma_mm,
        "friction_a": _MIN_FRICTION_SHARE * slide.friction_a,
    }
    if slide.homed:
        changes |= {
            "zero_mm": slide.zero_mm,
            "zero_bound_mm": _BOUND_SIGMAS * slide.zero_sigma_mm,
            "mm_per_turn": slide.mm_per_turn,
            "mm_per_turn_spread": _BOUND_SIGMAS * slide.mm_per_turn_sigma / abs(slide.mm_per_turn),
        }
    play = {"backlash_deg": aim.backlash_deg + _BOUND_SIGMAS * aim.backlash_sigma_deg}
    return _replace_in_tables(finger, slide=changes, aim=play)


def _with_joints(finger: ArmFingerConfig, found: ArmActuatorsCalibration) -> ArmFingerConfig:
    shoulder, elbow = (
        {"backlash_deg": joint.backlash_deg + _BOUND_SIGMAS * joint.backlash_sigma_deg}
        for joint in (found.shoulder, found.elbow)
    )
    return _replace_in_tables(finger, shoulder=shoulder, elbow=elbow)


def _place_slide_finger(finger: SlideFingerConfig, found: PlaceCalibration) -> SlideFingerConfig:
    zero_sigma_mm = max(found.covariance[4][4], 0.0) ** 0.5
    placed = finger.model_copy(update={"base_mm": found.base_mm, "heading_deg": found.heading_deg})
    return _replace_in_tables(
        placed,
        slide={
            "zero_mm": found.zero_mm,
            "zero_bound_mm": _BOUND_SIGMAS * zero_sigma_mm,
            "mm_per_turn": found.mm_per_turn,
        },
        **_tip_and_array(found),
    )


def _place_arm(finger: ArmFingerConfig, found: ArmPlaceCalibration) -> ArmFingerConfig:
    """An arm where it is; its shoulder's zero is in its heading."""
    placed = finger.model_copy(update={"base_mm": found.base_mm, "heading_deg": found.heading_deg})
    lengths = {"upper_mm": found.upper_mm, "fore_mm": found.fore_mm}
    zero_deg = finger.elbow.zero_deg - finger.elbow.gear_ratio * found.elbow_zero_deg
    return _replace_in_tables(
        placed,
        links=lengths | {"bound_mm": _BOUND_SIGMAS * max(found.upper_sigma_mm, found.fore_sigma_mm)},
        shoulder={"zero_bound_deg": 0.0},
        elbow={"zero_deg": zero_deg, "zero_bound_deg": _BOUND_SIGMAS * found.elbow_zero_sigma_deg},
        **_tip_and_array(found),
    )


def _tip_and_array(found: PlaceCalibration | ArmPlaceCalibration) -> dict[str, Mapping[str, object]]:
    return {
        "tip": {
            "radius_mm": found.tip_radius_mm,
            "radius_bound_mm": _BOUND_SIGMAS * found.tip_radius_sigma_mm,
        },
        "array": {
            "heading_deg": found.array_heading_deg,
            "heading_bound_deg": _BOUND_SIGMAS * found.array_heading_sigma_deg,
        },
    }


def _with_bounds(finger: FingerConfig, found: ContactBounds) -> FingerConfig:
    """Return the finger with contact bounds, which contain those of radius, zero, travel and heading."""
    if isinstance(finger, SlideFingerConfig):
        finger = _replace_in_tables(finger, slide={"zero_bound_mm": 0.0, "mm_per_turn_spread": 0.0})
    return _replace_in_tables(
        finger,
        bounds={"position_mm": found.position_mm, "direction_deg": found.direction_deg},
        tip={"radius_bound_mm": 0.0},
        array={"heading_bound_deg": 0.0},
    )


def _replace_in_tables(finger: _FingerT, **tables: Mapping[str, object]) -> _FingerT:
    """The finger with other values in some of its tables."""
    new = {key: getattr(finger, key).model_copy(update=values) for key, values in tables.items()}
    return finger.model_copy(update=new)


def _table_geometry(model: FileModel | None) -> object:
    """Return what a table says of how something is built, as plain values."""
    return None if model is None else _geometry(model.model_dump(mode="json", exclude_defaults=True))


def _geometry(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _geometry(item) for key, item in value.items() if key not in _NOT_GEOMETRY}
    return value
