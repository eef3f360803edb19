"""Check of a calibration: its bounds, its age, and whether it was made with these devices."""

from collections.abc import Sequence
from datetime import datetime

from palpate.config import CalibrationFile, RigFile
from palpate.config.check_result import CalibrationCheckOut, CheckOut, FingerTouchOut, TouchCheckOut
from palpate.rig.calibrated_rig import RigOnBench
from palpate.rig.diagnostics.friction_check import friction_warnings
from palpate.rig.diagnostics.retouch import Retouch
from palpate.rig.motion.calibrated_devices import other_device

__all__ = ["OLD_DAYS", "with_calibration", "with_touch"]

OLD_DAYS = 90
"""From this age on a calibration should be made anew: skins wear, screws loosen."""


def with_calibration(out: CheckOut, on_bench: RigOnBench, now: datetime) -> CheckOut:
    """A check's result with findings on the rig's calibration; unchanged without one."""
    file = on_bench.calibration
    if file is None:
        return out
    other = _other(file, out)
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
        devices_match=_match(out, other),
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
    problems = [] if touch.agrees else [_disagreement(touch)]
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


def _disagreement(touch: TouchCheckOut) -> str:
    # Of three fingers round a disc one that is off shows in all: the disc's place gives way to it.
    offsets = ", ".join(f"{item.finger} {item.offset_mm:+.3f}" for item in touch.fingers)
    return (
        f"touches of the disc differ by {touch.residual_rms_mm:.3f} mm and the calibration lets expect "
        f"{touch.expected_rms_mm:.3f} mm (in the mean {offsets}): calibrate again, unless the disc moved or "
        "is not as given"
    )


def _other(file: CalibrationFile, out: CheckOut) -> str | None:
    servos = {item.id: item.model for item in out.servos if item.answers}
    arrays = {item.finger: item.unique_id for item in out.arrays if item.unique_id is not None}
    return other_device(file, servos, arrays)


def _match(out: CheckOut, other: str | None) -> bool | None:
    """Whether all are those that were calibrated; None if some could not be asked, and the others are."""
    if other is not None:
        return False
    asked = all(item.answers for item in out.servos) and all(item.answers for item in out.arrays)
    return True if asked else None


def _warnings(age_days: int, loose: Sequence[str]) -> list[str]:
    """About a calibration's age, and about fingers whose contacts it does not bound."""
    warnings = []
    if age_days > OLD_DAYS:
        warnings.append(
            f"the calibration is {age_days} days old; calibrate again every {OLD_DAYS} days, and after any "
            "repair"
        )
    if loose:
        warnings.append(
            f"the calibration does not bound contacts of {', '.join(loose)}, where the rig file's bounds "
            "hold; `palpate calibrate` does all of it"
        )
    return warnings
