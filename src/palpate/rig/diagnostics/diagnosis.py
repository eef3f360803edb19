"""Diagnosis of a set-up step by step, in the order in which things go wrong.

What depends on something that failed is skipped, for single devices as well as for whole steps: a servo
that answers at another baud rate is asked nothing else, and a cause is not reported again by its
consequences. In the last step, if it is allowed, each joint moves a little. A servo knows its own angle
only: which way a tip goes is seen by a person, or by what emulates the bench.
"""

import math
from collections.abc import Callable, Sequence
from datetime import datetime
from typing import Protocol

from palpate.base.errors import DeviceError, InputError, quantity
from palpate.config.diagnosis_results import (
    DEVICE_CAUSES,
    Cause,
    DoctorOut,
    DoctorStepOut,
    FindingOut,
    Outcome,
    Severity,
)
from palpate.drivers.arm_kinematics import ArmKinematics
from palpate.drivers.dynamixel import Servo, ServoMover
from palpate.drivers.slide_kinematics import SlideKinematics
from palpate.rig.bench import BenchRig
from palpate.rig.diagnostics.array_examination import examine_arrays
from palpate.rig.diagnostics.array_steps import judge_arrays
from palpate.rig.diagnostics.bus_steps import examine_bus
from palpate.rig.diagnostics.calibration_check import judge_calibration
from palpate.rig.diagnostics.port_steps import examine_ports
from palpate.rig.diagnostics.servo_bus import list_servos
from palpate.rig.diagnostics.servo_examination import examine_servos
from palpate.rig.diagnostics.servo_steps import judge_servos
from palpate.rig.diagnostics.steps import (
    NOTHING_TO_DO,
    DiagnosisCase,
    error_finding,
    finish_step,
    join_words,
    skip_step,
)
from palpate.rig.drives import ACCELERATION_RAD_S2, AIM_TOLERANCE_RAD
from palpate.rig.fingers import HostFinger
from palpate.rig.motion.guarded_approach import retract_all
from palpate.rig.motion.hand import Hand
from palpate.rig.motion.homing import HomingPolicy

DIRECTIONS = ("directions", "moved each joint a little, and asked which way the tip went")

_AIM_MOVE_RAD = 0.35  # of the aim's servo, as calibration swings it
_JOINT_MOVE_RAD = 0.1
_SLIDE_MOVE_MM = 8.0
_SPEED_RAD_S = 0.8
_PERIOD_S = 0.01

LEFT, OUT = "to its left, seen from its base", "away from its base"


class Onlooker(Protocol):
    """Sees which way tips go."""

    def ready(self, finger: str) -> None:
        """A finger is about to move a joint; it may take a moment."""
        ...

    def went(self, finger: str, where: str) -> bool:
        """Whether the tip went there: in words, for a person."""
        ...


class EmulatedOnlooker:
    """Sees where the tips of an emulated bench really are."""

    def __init__(self, bench: BenchRig) -> None:
        """Raises ValueError for a real rig."""
        if bench.emulated is None:
            raise ValueError("only an emulated bench knows where its tips are")
        self._fingers = dict(
            zip((spec.name for spec in bench.rig.fingers), bench.emulated.bench.fingers, strict=True)
        )
        self._bases = {spec.name: spec.base_mm for spec in bench.rig.fingers}
        self._before = (0.0, 0.0)

    def ready(self, finger: str) -> None:
        """Remember where the tip is."""
        x, y = self._fingers[finger].centre_mm
        self._before = (float(x), float(y))

    def went(self, finger: str, where: str) -> bool:
        """Compare with where it is now."""
        (x, y), (bx, by), (x0, y0) = self._fingers[finger].centre_mm, self._bases[finger], self._before
        along, across = (x0 - bx, y0 - by), (-(y0 - by), x0 - bx)
        axis = across if where == LEFT else along
        return bool((x - x0) * axis[0] + (y - y0) * axis[1] > 0)


def examine_directions(hand: Hand, onlooker: Onlooker) -> DoctorStepOut:
    """Move each joint of each finger from where it waits, and back. Raises what motion raises."""
    hand.prepare(home=HomingPolicy.NONE)  # which way slides go is not known yet
    hand.arm()
    retract_all(hand)
    findings, joints = [], 0
    for finger in hand.fingers:
        for servo, key, goal, where in _joint_moves(hand, finger):
            joints += 1
            found = _move_joint(hand, finger, servo, goal, onlooker, where, key)
            findings += [] if found is None else [found]
    hand.disarm()
    fine = joints - len(findings)
    return finish_step(
        *DIRECTIONS, f"{fine} of {quantity(joints, 'joint goes', 'joints go')} the right way", findings
    )


def _joint_moves(hand: Hand, finger: HostFinger) -> list[tuple[Servo, str, float, str]]:
    """Each joint of a finger: its servo, its key, the angle to go to, and where the tip goes then."""
    near, far = finger.drive.servos
    at = hand.servos_of([finger])[finger]
    kinematics = finger.kinematics
    if isinstance(kinematics, SlideKinematics):
        ratio = kinematics.aim_servo_rad(1.0) - kinematics.aim_servo_rad(0.0)
        aim = at[0] + (_AIM_MOVE_RAD if ratio > 0 else -_AIM_MOVE_RAD)
        slide = kinematics.slide_servo_rad(kinematics.distance_mm(at[1]) + _SLIDE_MOVE_MM)
        return [(near, "aim.gear_ratio", aim, LEFT), (far, "slide.mm_per_turn", slide, OUT)]
    assert isinstance(kinematics, ArmKinematics), "there are two kinds of fingers"
    shoulder, elbow = kinematics.shoulder, kinematics.elbow
    turned = min(shoulder.angle_rad(at[0]) + _JOINT_MOVE_RAD, shoulder.hi_rad)
    bent = elbow.angle_rad(at[1])
    straighter = min(max(bent - math.copysign(_JOINT_MOVE_RAD, bent), elbow.lo_rad), elbow.hi_rad)
    return [
        (near, "shoulder.gear_ratio", shoulder.servo_rad(turned), LEFT),
        (far, "elbow.gear_ratio", elbow.servo_rad(straighter), OUT),
    ]


def _move_joint(
    hand: Hand,
    finger: HostFinger,
    servo: Servo,
    goal: float,
    onlooker: Onlooker,
    where: str,
    key: str,
) -> FindingOut | None:
    """A joint moved to `goal` and back, torque on, and what is wrong with where the tip went."""
    start = hand.states([servo])[servo.dxl_id].position_rad
    hand.disarm()  # a person takes longer than servos wait
    onlooker.ready(finger.name)
    hand.arm()
    servo.set_profile(_SPEED_RAD_S, ACCELERATION_RAD_S2)
    hand.require_arrival(
        hand.guarded([ServoMover(servo, servo.nearest_rad(goal), AIM_TOLERANCE_RAD)], period_s=_PERIOD_S)
    )
    hand.disarm()
    right = onlooker.went(finger.name, where)
    hand.arm()
    hand.require_arrival(
        hand.guarded([ServoMover(servo, servo.nearest_rad(start), AIM_TOLERANCE_RAD)], period_s=_PERIOD_S)
    )
    if right:
        return None
    return error_finding(
        Cause.DIRECTION_WRONG,
        f"servo {servo.dxl_id} ({finger.name} {key.partition('.')[0]})",
        f"the tip of finger {finger.name} was to go {where}, and went the other way",
        "the servo is mounted the other way round than the rig file says",
        f"change the sign of {key} of finger {finger.name} in the rig file, then measure its zero anew",
    )


_NOT_ALLOWED = "fingers move for it only if asked to: palpate doctor --move"


def diagnose(
    case: DiagnosisCase, now: datetime, directions: Callable[[], DoctorStepOut] | None = None
) -> DoctorOut:
    """Examine a set-up. `directions` moves fingers and judges which way they go; only if nothing is wrong.

    If it raises InputError it is skipped for that reason. Failures of devices are findings. Raises
    SafetyStop as motion does.
    """
    ports = examine_ports(case)
    bus = examine_bus(case, ports.usable)
    silent = "no servo answers as the rig file says"
    servos = examine_servos(case, bus.sound) if bus.sound else None
    arrays = examine_arrays(case, ports.usable)
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
    case: DiagnosisCase, directions: Callable[[], DoctorStepOut] | None, *, blocked: bool
) -> DoctorStepOut:
    if directions is None:
        return skip_step(*DIRECTIONS, _NOT_ALLOWED)
    if blocked:
        return skip_step(*DIRECTIONS, "fingers move only once nothing else is wrong")
    case.tell("directions")
    try:
        return directions()
    except InputError as error:
        return skip_step(*DIRECTIONS, str(error))
    except DeviceError as error:
        failed = error_finding(
            Cause.MOTION_FAILED,
            "fingers",
            str(error),
            "a motion did not end where it should; torque is off",
            "see what holds the finger, with the supply off",
        )
        return finish_step(*DIRECTIONS, "a motion failed", [failed])


def _has_wrong(steps: Sequence[DoctorStepOut]) -> bool:
    return any(item.outcome is Outcome.WRONG for item in steps)


def _result(case: DiagnosisCase, steps: Sequence[DoctorStepOut], *, moved: bool) -> DoctorOut:
    findings = [found for item in steps for found in item.findings]
    return DoctorOut(
        rig=case.rig.name,
        emulated=case.rig.emulated,
        well=not _has_wrong(steps),
        device_missing=any(item.cause in DEVICE_CAUSES for item in findings),
        moved=moved,
        steps=tuple(steps),
        next=_next_action(findings),
    )


def _next_action(findings: Sequence[FindingOut]) -> str | None:
    """What to do first: about the first thing that is wrong, else the first warning, and all like it."""
    open_ones = [item for item in findings if not item.next.startswith(NOTHING_TO_DO)]
    if not open_ones:
        return None
    first = min(open_ones, key=lambda item: item.severity is not Severity.WRONG)
    alike = [item.device for item in open_ones if (item.cause, item.next) == (first.cause, first.next)]
    return f"{join_words(alike)}: {first.next}"
