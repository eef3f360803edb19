"""Moves of single joints for calibration: slides against their hard stops, aims to and fro.

Between the hand and `rig_prober`. Nothing lies on the table.
"""

import math

import numpy as np

from palpate.drivers.dynamixel.servo import Servo, stop_at, write_goals
from palpate.drivers.slide_finger import SlideKinematics
from palpate.errors import DeviceError, InputError
from palpate.rig.closing import retract_all
from palpate.rig.drives import ACCELERATION_RAD_S2, AIM_SPEED_RAD_S
from palpate.rig.hand import Hand, HostFinger

__all__ = ["slide_of", "stall", "swing"]

_PERIOD_S = 0.01
_STILL_MM = 0.03
_STILL_S = 0.4
_NEAR_MM = 6.0
_PAST_MM = 4.0
_SLOW_MM_S = 5.0
_GENTLE = 0.6  # of the largest current
_ARRIVED_MM = 0.8
_SWING_RAD = 0.4  # of the aim's servo
_SWING_RAD_S = 0.8
_SWING_S = 1.2
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
    if (near - now_at) * way > 0:
        _drive(hand, slide, kinematics, near, hand.rig.closing.approach_speed_mm_s)
        goals = {slide: kinematics.slide_servo_rad(near)}
        hand.wait_still(goals, lambda servo: finger.drive.reached_rad(servo, _ARRIVED_MM))
    slide.set_goal_current_a(_GENTLE * full_a)
    # Soft limits end before the stop: this move alone may go past them.
    ends = sorted((kinematics.slide_servo_rad(near), kinematics.slide_servo_rad(past)))
    beyond = slide.with_range((ends[0], ends[1]))
    _drive(hand, beyond, kinematics, past, _SLOW_MM_S)
    at = _stalled(hand, finger)
    stop_at(hand.bus, {beyond: beyond.nearest_rad(at)})  # nothing presses on when the full current comes back
    slide.set_goal_current_a(full_a)
    if abs(kinematics.distance_mm(at) - past) < 1.0:
        raise DeviceError(
            f"finger {finger.name}: its slide (servo {slide.dxl_id}) passed {stop_mm:g} mm and met no hard "
            "stop; check slide.stops_mm, slide.zero_mm and the sign of slide.mm_per_turn"
        )
    retract_all(hand)
    hand.disarm()
    return at


def swing(hand: Hand) -> list[float]:
    """Turn every aim to and fro where fingers wait; the current (A) that each needs, in the median."""
    hand.arm()
    retract_all(hand)
    aims = [finger.drive.servos[0] for finger in hand.fingers]
    start = {aim: hand.states([aim])[aim.dxl_id].position_rad for aim in aims}
    seen: dict[Servo, list[float]] = {aim: [] for aim in aims}
    for aim in aims:
        aim.set_profile(_SWING_RAD_S, ACCELERATION_RAD_S2)
    for side in (_SWING_RAD, -_SWING_RAD, 0.0):
        goals = {aim: aim.nearest_rad(start[aim] + side) for aim in aims}
        write_goals(hand.bus, goals, confirm=True)
        deadline = hand.clock.now() + _SWING_S
        while hand.clock.now() < deadline:
            hand.pause(_PERIOD_S)
            states = hand.states(aims)
            for aim in aims:
                state = states[aim.dxl_id]
                if abs(state.velocity_rad_s) > _TURNING_RAD_S:
                    seen[aim].append(math.copysign(state.current_a, state.current_a * state.velocity_rad_s))
    for finger in hand.fingers:
        finger.drive.servos[0].set_profile(AIM_SPEED_RAD_S, ACCELERATION_RAD_S2)
    hand.disarm()
    return [float(np.median(seen[aim])) if seen[aim] else 0.0 for aim in aims]


def slide_of(finger: HostFinger) -> SlideKinematics:
    """Kinematics of a slide; InputError for a finger of another type."""
    if not isinstance(finger.kinematics, SlideKinematics):
        raise InputError(
            f'finger {finger.name} is of type "two-link"; only fingers of type "slide" can be calibrated'
        )
    return finger.kinematics


def _drive(hand: Hand, slide: Servo, kinematics: SlideKinematics, to_mm: float, speed_mm_s: float) -> None:
    slide.set_profile(speed_mm_s / abs(kinematics.mm_per_rad), ACCELERATION_RAD_S2)
    write_goals(hand.bus, {slide: kinematics.slide_servo_rad(to_mm)}, confirm=True)


def _stalled(hand: Hand, finger: HostFinger) -> float:
    """Servo angle (rad) at which a slide has come to stand: the mean of what is read while it stands."""
    slide, kinematics = finger.drive.closing_servos[0], slide_of(finger)
    moved = abs(_STILL_MM / kinematics.mm_per_rad)
    read: list[tuple[float, float]] = []
    at, since = math.inf, hand.clock.now()
    while hand.clock.now() - since < _STILL_S:
        hand.pause(_PERIOD_S)
        now_at = hand.states([slide])[slide.dxl_id].position_rad
        read.append((hand.clock.now(), now_at))
        if abs(now_at - at) > moved:
            at, since = now_at, hand.clock.now()
    # It may have crept on by less than what counts as motion.
    return float(np.mean([angle for when, angle in read if when > since + _STILL_S / 2]))
