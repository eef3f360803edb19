"""Doctor, calibration: whether it was made with the devices that answer, and how old it is."""

from collections.abc import Mapping
from datetime import datetime

from palpate.config import CalibrationFile
from palpate.config.doctor_result import Cause, DoctorStepOut
from palpate.rig.diagnostics.calibration_check import OLD_DAYS
from palpate.rig.diagnostics.doctor_steps import Case, listed, skipped, step, warning, wrong
from palpate.rig.motion.calibrated_devices import other_device

__all__ = ["judge_calibration"]

_NAME = "calibration"
_LOOKED = "compared the devices that were calibrated with those that answer"


def judge_calibration(
    case: Case, servos: Mapping[int, str], arrays: Mapping[str, str], now: datetime
) -> DoctorStepOut:
    """`servos`: models by id; `arrays`: unique ids by finger, of those that answer."""
    file = case.on_bench.calibration
    if file is None:
        return step(_NAME, _LOOKED, "there is none: the rig file's own numbers and bounds hold")
    if not servos and not arrays:
        return skipped(_NAME, _LOOKED, "no device answers")
    age = max((now - file.made).days, 0)
    saw = f"{age} days old, of {len(servos)} servos and {len(arrays)} arrays that answer"
    swapped = _swapped(file, arrays)
    other = other_device(file, servos, arrays)
    findings = []
    if swapped:
        findings.append(
            wrong(
                Cause.ARRAYS_SWAPPED,
                listed([f"array {name}" for name in swapped]),
                "each answers on a port on which another finger's array was calibrated: "
                + listed([f"finger {name} has that of {owner}" for name, owner in swapped.items()]),
                "cables were plugged in crosswise, or ports have other names since; a contact would count as "
                "another finger's",
                "plug the arrays' cables as they were, or exchange their ports in the rig file",
            )
        )
    elif other is not None:
        findings.append(
            wrong(
                Cause.OTHER_DEVICES,
                "calibration",
                f"it {other}",
                "gains, zeros and play of another device are used",
                case.calibrate_or("move the calibration away: pads are measured by hand"),
            )
        )
    if age > OLD_DAYS and not findings:
        findings.append(
            warning(
                Cause.CALIBRATION_OLD,
                "calibration",
                f"it is {age} days old",
                f"skins wear and screws loosen; it should not be older than {OLD_DAYS} days",
                case.calibrate_or("move the calibration away: pads are measured by hand"),
            )
        )
    return step(_NAME, _LOOKED, saw, findings)


def _swapped(file: CalibrationFile, arrays: Mapping[str, str]) -> dict[str, str]:
    """Fingers whose array was calibrated on another finger, and on which."""
    ids = [device.id for device in file.devices if device.kind == "array"]
    if len(ids) != len(file.fingers):
        return {}
    owner = {uid: finger.name for finger, uid in zip(file.fingers, ids, strict=True)}
    return {name: owner[uid] for name, uid in arrays.items() if uid in owner and owner[uid] != name}
