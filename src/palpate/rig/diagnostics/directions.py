"""Directions of joints: each moves a little, and somebody sees which way the tip goes.

A servo knows its own angle only: which way a tip goes is seen by a person, or by what emulates the bench.
"""

from collections.abc import Callable
from typing import Protocol

from palpate.base.errors import DeviceError, InputError, quantity
from palpate.config.diagnosis_results import Cause, FindingOut
from palpate.drivers.dynamixel import Servo, ServoMover
from palpate.rig.bench import BenchRig
from palpate.rig.diagnostics.steps import Judgement, MotionStep, NamedDevice, name_servo, wrong
from palpate.rig.fingers import HostFinger
from palpate.rig.mechanisms.mechanism import ACCELERATION_RAD_S2, AIM_TOLERANCE_RAD
from palpate.rig.motion.guarded_approach import retract_all
from palpate.rig.motion.hand import Hand
from palpate.rig.motion.homing import HomingPolicy

_SPEED_RAD_S = 0.8
_PERIOD_S = 0.01

LEFT, OUT = "to its left, seen from its base", "away from its base"


class Onlooker(Protocol):
    """Sees which way tips go."""

    def ready(self, finger: str) -> None:
        """A finger is about to move a joint; it may take a moment."""
        ...

    def went(self, finger: str, where: str) -> bool:
        """Return whether the tip went there: in words, for a person."""
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


def examine_directions(hand: Hand, onlooker: Onlooker) -> Judgement:
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
    return f"{fine} of {quantity(joints, 'joint goes', 'joints go')} the right way", findings


def _joint_moves(hand: Hand, finger: HostFinger) -> list[tuple[Servo, str, float, str]]:
    """Each joint of a finger: its servo, its key, the angle to go to, and where the tip goes then."""
    at = hand.servos_of([finger])[finger]
    return [
        (servo, move.key, move.goal_rad, OUT if move.outward else LEFT)
        for servo, move in zip(finger.drive.servos, finger.mechanism.test_moves(at), strict=True)
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
    return wrong(
        Cause.DIRECTION_WRONG,
        name_servo(f"{finger.name} {key.partition('.')[0]}", servo.dxl_id),
        f"the tip of finger {finger.name} was to go {where}, and went the other way",
        "the servo is mounted the other way round than the rig file says",
        f"change the sign of {key} of finger {finger.name} in the rig file, then measure its zero anew",
    )


def directions_step(examine: Callable[[], Judgement] | None) -> MotionStep:
    """The step that moves joints: `examine` connects and calls `examine_directions`; None if not asked for.

    If it raises InputError the step is skipped for that reason.
    """

    def carry_out() -> Judgement | str:
        assert examine is not None, "asked for"
        try:
            return examine()
        except InputError as error:
            return str(error)
        except DeviceError as error:
            means = "a motion did not end where it should; torque is off"
            do = "see what holds the finger, with the supply off"
            found = wrong(Cause.MOTION_FAILED, NamedDevice("fingers"), str(error), means, do)
            return "a motion failed", [found]

    looked = "moved each joint a little, and asked which way the tip went"
    return MotionStep("directions", looked, _NOT_ALLOWED if examine is None else carry_out)


_NOT_ALLOWED = "fingers move for it only if asked to: palpate doctor --move"
