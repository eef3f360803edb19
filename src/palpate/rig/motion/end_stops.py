"""Motions of single joints for calibration: slides against their hard stops, aims to and fro.

Nothing lies on the table.
"""

import math

import numpy as np

from palpate.base.errors import DeviceError, InputError
from palpate.drivers.dynamixel.guarded import End, Guard, ServoMover
from palpate.drivers.dynamixel.servo import Servo
from palpate.drivers.slide_finger import SlideKinematics
from palpate.rig.drives import ACCELERATION_RAD_S2, AIM_SPEED_RAD_S, AIM_TOLERANCE_RAD
from palpate.rig.host_finger import HostFinger
from palpate.rig.motion.finger_movers import ARRIVED_MM
from palpate.rig.motion.guarded_approach import retract_all
from palpate.rig.motion.hand import Hand

__all__ = ["slide_of", "stall", "swing"]

_PERIOD_S = 0.01
_STILL_MM = 0.03
_STILL_S = 0.4
_NEAR_MM = 6.0
_PAST_MM = 4.0
_PASSED_MM = 1.0
_SLOW_MM_S = 5.0
_GENTLE = 0.6  # of the largest current
_SWING_RAD = 0.4  # of the aim's servo
_SWING_RAD_S = 0.8
_TURNING_RAD_S = 0.7  # so fast it turns without being hurried


def stall(hand: Hand, finger: HostFinger, stop_mm: float) -> float:
    """Drive a slide against the hard stop at `stop_mm` from its base; where its servo stalls (rad).

    Quickly until near the stop, then slowly and with little current. The slide goes back to where it waits.
    DeviceError if it goes on past the stop without stalling.
    """
    slide, kinematics = finger.drive.closing_servos[0], slide_of(finger)
    full_a = finger.drive.limits()[slide].current_a
    hand.arm()
    retract_all(hand)
    now_at = kinematics.distance_mm(hand.states([slide])[slide.dxl_id].position_rad)
    way = math.copysign(1.0, stop_mm - now_at)
    near, past = stop_mm - way * _NEAR_MM, stop_mm + way * _PAST_MM
    speed = hand.rig.closing.approach_speed_mm_s
    if (near - now_at) * way > 0:
        _set_speed(slide, kinematics, speed)
        goals = {slide: kinematics.slide_servo_rad(near)}
        hand.move_servos(goals, lambda servo: finger.drive.reached_rad(servo, ARRIVED_MM))
    slide.set_goal_current_a(_GENTLE * full_a)
    # Soft limits end before the stop: this move alone may go past them.
    ends = sorted((kinematics.slide_servo_rad(near), kinematics.slide_servo_rad(past)))
    at = _stalled(hand, slide.with_range((ends[0], ends[1])), kinematics, past)
    slide.set_goal_current_a(full_a)  # nothing presses on: it was stopped where it stalled
    if at is None:
        raise DeviceError(
            f"finger {finger.name}: its slide (servo {slide.dxl_id}) passed {stop_mm:g} mm and met no hard "
            "stop; check slide.stops_mm, slide.zero_mm and the sign of slide.mm_per_turn"
        )
    retract_all(hand)
    hand.disarm()
    return at


def swing(hand: Hand) -> list[float]:
    """Turn every aim to and fro where fingers wait; the current (A) that each needs, in the median.

    0 for an arm, which has no aim and stays where it is.
    """
    hand.arm()
    retract_all(hand)
    slides = [finger for finger in hand.fingers if isinstance(finger.kinematics, SlideKinematics)]
    aims = [finger.drive.servos[0] for finger in slides]
    start = {aim: hand.states([aim])[aim.dxl_id].position_rad for aim in aims}
    seen: dict[Servo, list[float]] = {aim: [] for aim in aims}
    for aim in aims:
        aim.set_profile(_SWING_RAD_S, ACCELERATION_RAD_S2)
    for side in (_SWING_RAD, -_SWING_RAD, 0.0):
        movers = [ServoMover(aim, aim.nearest_rad(start[aim] + side), AIM_TOLERANCE_RAD) for aim in aims]
        hand.arrived(hand.guarded(movers, period_s=_PERIOD_S))
        for mover in movers:
            for _, state in mover.seen:
                if abs(state.velocity_rad_s) > _TURNING_RAD_S:
                    along = math.copysign(state.current_a, state.current_a * state.velocity_rad_s)
                    seen[mover.servo].append(along)
    for finger in slides:
        finger.drive.servos[0].set_profile(AIM_SPEED_RAD_S, ACCELERATION_RAD_S2)
    hand.disarm()
    needed = {aim: float(np.median(found)) for aim, found in seen.items() if found}
    return [needed.get(finger.drive.servos[0], 0.0) for finger in hand.fingers]


def slide_of(finger: HostFinger) -> SlideKinematics:
    """Kinematics of a slide; InputError for a finger of another type."""
    if not isinstance(finger.kinematics, SlideKinematics):
        raise InputError(
            f'finger {finger.name} is of type "two-link"; only slides are driven against their stops'
        )
    return finger.kinematics


def _set_speed(slide: Servo, kinematics: SlideKinematics, speed_mm_s: float) -> None:
    slide.set_profile(speed_mm_s / abs(kinematics.mm_per_rad), ACCELERATION_RAD_S2)


def _stalled(hand: Hand, slide: Servo, kinematics: SlideKinematics, past_mm: float) -> float | None:
    """Servo angle (rad) at which a slide stalls before `past_mm`: the mean of what is read while it stands.

    None if it gets there.
    """
    per_mm = abs(1 / kinematics.mm_per_rad)
    guard = Guard(moved_rad=_STILL_MM * per_mm, stall_s=_STILL_S)
    _set_speed(slide, kinematics, _SLOW_MM_S)
    mover = ServoMover(slide, kinematics.slide_servo_rad(past_mm), _PASSED_MM * per_mm, guard)
    (end,) = hand.guarded([mover], period_s=_PERIOD_S).values()
    if end is not End.STALL:
        return None
    # It may have crept on by less than what counts as motion.
    since = mover.moved_s + _STILL_S / 2
    return float(np.mean([state.position_rad for when, state in mover.seen if when > since]))
