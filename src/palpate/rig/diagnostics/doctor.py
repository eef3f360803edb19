"""Doctor: a set-up examined step by step, in the order in which things go wrong.

What depends on something that failed is skipped, for single devices as well as for whole steps: a servo that
answers at another baud rate is asked nothing else, and a cause is not reported again by its consequences.
"""

from collections.abc import Callable, Sequence
from datetime import datetime

from palpate.base.errors import DeviceError, InputError
from palpate.config.doctor_result import (
    DEVICE_CAUSES,
    Cause,
    DoctorOut,
    DoctorStepOut,
    FindingOut,
    Outcome,
    Severity,
)
from palpate.rig.diagnostics.bus_selection import list_servos
from palpate.rig.diagnostics.doctor_array_steps import judge_arrays
from palpate.rig.diagnostics.doctor_arrays import look_at_arrays
from palpate.rig.diagnostics.doctor_bus import examine_bus
from palpate.rig.diagnostics.doctor_calibration import judge_calibration
from palpate.rig.diagnostics.doctor_directions import DIRECTIONS
from palpate.rig.diagnostics.doctor_ports import examine_ports
from palpate.rig.diagnostics.doctor_servo_steps import judge_servos
from palpate.rig.diagnostics.doctor_servos import look_at_servos
from palpate.rig.diagnostics.doctor_steps import NOTHING, Case, listed, skipped, step, wrong

__all__ = ["diagnose"]

_NOT_ALLOWED = "fingers move for it only if asked to: palpate doctor --move"


def diagnose(case: Case, now: datetime, directions: Callable[[], DoctorStepOut] | None = None) -> DoctorOut:
    """Examine a set-up. `directions` moves fingers and judges which way they go; only if nothing is wrong.

    If it raises InputError it is skipped for that reason. Failures of devices are findings. Raises
    SafetyStop as motion does.
    """
    ports = examine_ports(case)
    bus = examine_bus(case, ports.usable)
    silent = "no servo answers as the rig file says"
    servos = look_at_servos(case, bus.sound) if bus.sound else None
    arrays = look_at_arrays(case, ports.usable)
    steps = [
        *ports.steps,
        *bus.steps,
        *judge_servos(case, servos, silent),
        *judge_arrays(case, arrays, "no array's port can be used"),
    ]
    models = {item.dxl_id: item.model for item in list_servos(case.rig) if item.dxl_id in bus.sound}
    uids = {item.spec.name: item.description.unique_id.hex() for item in arrays if item.description}
    steps.append(judge_calibration(case, models, uids, now))
    blocked = _has_wrong(steps)
    steps.append(_directions(case, directions, blocked=blocked))
    moved = directions is not None and steps[-1].outcome is not Outcome.SKIPPED
    return _result(case, steps, moved=moved)


def _directions(
    case: Case, directions: Callable[[], DoctorStepOut] | None, *, blocked: bool
) -> DoctorStepOut:
    if directions is None:
        return skipped(*DIRECTIONS, _NOT_ALLOWED)
    if blocked:
        return skipped(*DIRECTIONS, "fingers move only once nothing else is wrong")
    case.tell("directions")
    try:
        return directions()
    except InputError as error:
        return skipped(*DIRECTIONS, str(error))
    except DeviceError as error:
        failed = wrong(
            Cause.MOTION_FAILED,
            "fingers",
            str(error),
            "a motion did not end where it should; torque is off",
            "see what holds the finger, with the supply off",
        )
        return step(*DIRECTIONS, "a motion failed", [failed])


def _has_wrong(steps: Sequence[DoctorStepOut]) -> bool:
    return any(item.outcome is Outcome.WRONG for item in steps)


def _result(case: Case, steps: Sequence[DoctorStepOut], *, moved: bool) -> DoctorOut:
    findings = [found for item in steps for found in item.findings]
    return DoctorOut(
        rig=case.rig.name,
        emulated=case.rig.emulated,
        well=not _has_wrong(steps),
        device_missing=any(item.cause in DEVICE_CAUSES for item in findings),
        moved=moved,
        steps=tuple(steps),
        next=_first(findings),
    )


def _first(findings: Sequence[FindingOut]) -> str | None:
    """What to do first: about the first thing that is wrong, else the first warning, and all like it."""
    open_ones = [item for item in findings if not item.next.startswith(NOTHING)]
    if not open_ones:
        return None
    first = min(open_ones, key=lambda item: item.severity is not Severity.WRONG)
    alike = [item.device for item in open_ones if (item.cause, item.next) == (first.cause, first.next)]
    return f"{listed(alike)}: {first.next}"
