"""Calibration overlay: a rig with measured values, and the check that the calibration belongs to it.

The result is a `RigFile` like any other, with values that were measured and bounds that hold for them. A
calibration is given in the frame in which bases and headings are nearest to the rig file's (ADR 0018); the
uncertainty of that frame is added to values taken from the drawing. Hand and recogniser use the calibrated
rig; emulated devices are built from the one in the rig file, around which their hidden truth is drawn.
"""

import hashlib
import json
import math
import os
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Any

from palpate.base.errors import InputError
from palpate.config.calibration_file import CalibrationFile, calibration_path, load_calibration
from palpate.config.calibration_finger import FingerCalibration
from palpate.config.fields import FileModel
from palpate.config.loading import shipped_rig
from palpate.config.rig_file import RigFile, change_tables, load_rig
from palpate.config.rig_fingers import BOUND_SIGMAS, FingerConfig
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


_NOT_GEOMETRY = frozenset(
    {
        "port", "baudrate_bps", "bounds", "bound_mm", "bound_deg", "centre_bound_mm", "zero_bound_mm",
        "zero_bound_deg", "mm_per_turn_spread",
        "radius_bound_mm", "heading_bound_deg", "stiffness_spread", "gain_spread", "drift_counts_per_s",
        "backlash_mm", "backlash_deg", "friction_a", "taxels",
    }
)  # fmt: skip
"""Keys that say where a device is plugged in, or how well something is known: they may change freely."""


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
        if not all(isinstance(part, finger.calibrated_by) for part in parts):
            raise InputError(f'{name}: finger "{finger.name}" {finger.no_calibration}: {remedy}')
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
            "backlash_deg": found.backlash_deg + BOUND_SIGMAS * found.backlash_sigma_deg,
        }
        return stage.model_copy(update=measured)
    if all(finger.place is None for finger in file.fingers):
        return stage
    # It is not measured, and the calibration's frame may be another than the drawing's.
    wide = stage.centre_bound_mm + frame_offset_bound_mm(rig, stage.centre_mm)
    return stage.model_copy(update={"centre_bound_mm": wide})


def _calibrate_finger(finger: FingerConfig, found: FingerCalibration) -> FingerConfig:
    if found.tactile is not None:
        finger = finger.with_tactile(found.tactile)
    if found.actuators is not None:
        finger = finger.with_actuators(found.actuators)
    if found.place is not None:
        finger = finger.with_place(found.place)
    if found.bounds is None:
        return finger
    finger = finger.with_bounds(found.bounds)
    if found.place is None or found.place.encoder_harmonics_deg is None:
        return finger  # made before encoders were measured: the rig file's bound is added
    return finger.replace_in_tables(bounds={"encoder_deg": 0.0})


def _table_geometry(model: FileModel | None) -> object:
    """Return what a table says of how something is built, as plain values."""
    return None if model is None else _geometry(model.model_dump(mode="json", exclude_defaults=True))


def _geometry(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _geometry(item) for key, item in value.items() if key not in _NOT_GEOMETRY}
    return value


@dataclass(frozen=True, eq=False)
class RigOnBench:
    """A rig: with its calibration laid over it, and as its file `path` describes it.

    Both are the same if `calibration` is None. `is_changed`: the file says otherwise, by `change`.
    """

    rig: RigFile
    described: RigFile
    calibration: CalibrationFile | None
    path: Path | Traversable
    is_changed: bool = False

    def change(self, tables: Mapping[str, object]) -> "RigOnBench":
        """The rig with other values in its file, as `change_tables` puts them there, and its calibration.

        Raises InputError if such a file would be wrong, or the calibration is not of that rig.
        """
        name = os.fspath(self.path) if isinstance(self.path, Path) else self.path.name
        shown = "the shipped rig" if self.path == shipped_rig() else name
        rig = described = change_tables(self.described, tables, f"change of {shown}")
        if self.calibration is not None:
            check_calibration(self.calibration, described, str(self.calibration_path), name)
            rig = apply_calibration(described, self.calibration)
        return RigOnBench(rig, described, self.calibration, self.path, is_changed=True)

    @property
    def calibration_path(self) -> Path | None:
        """Path that the calibration was read from; None without one."""
        if self.calibration is None or not isinstance(self.path, Path):
            return None
        return calibration_path(self.path)


def load_calibrated(path: Path | None, *, calibration: bool = True) -> RigOnBench:
    """Read a rig file, or the shipped one, and the calibration beside it, if there is one.

    `calibration`: False to leave it alone. The shipped rig has none. Raises InputError if a file is wrong, or
    the calibration is not of this rig as it is now.
    """
    if path is None:
        rig = load_rig(shipped_rig())
        return RigOnBench(rig, rig, None, shipped_rig())
    described = load_rig(path)
    beside = calibration_path(path)
    if not calibration or not beside.exists():
        return RigOnBench(described, described, None, path)
    found = load_calibration(beside)
    check_calibration(found, described, str(beside), str(path))
    return RigOnBench(apply_calibration(described, found), described, found, path)
