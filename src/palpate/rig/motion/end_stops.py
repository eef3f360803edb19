"""End stops: slides driven against their hard stops, and aims turned to and fro, with nothing on the table.

Calibration measures slides and aims so. A run checks by its stops that no slide's horn has slipped on its
shaft: a slide that has slipped looks like a part that lies elsewhere, which contacts alone do not show. Only
slides of which the rig file knows the stops are looked at.
"""

import math
from collections.abc import Mapping

import numpy as np

from palpate.base.errors import DeviceError, InputError
from palpate.drivers.dynamixel import MoveEnd, Servo, ServoMover
from palpate.drivers.kinematics import TICK_RAD
from palpate.rig.fingers import HostFinger
from palpate.rig.mechanisms.mechanism import (
    ACCELERATION_RAD_S2,
    AIM_SPEED_RAD_S,
    AIM_TOLERANCE_RAD,
    HardStops,
)
from palpate.rig.motion.finger_movers import ARRIVED_MM
from palpate.rig.motion.guarded_approach import retract_all
from palpate.rig.motion.hand import Hand
from palpate.rig.motion.homing import creep_to_stall

_PERIOD_S = 0.01
_SLOW_ZONE_MM = 6.0
_OVERTRAVEL_MM = 4.0
_STALL_CURRENT_SHARE = 0.6  # of the largest current
_SWING_RAD = 0.4  # of the aim's servo
_SWING_RAD_S = 0.8
_MIN_TURNING_RAD_S = 0.7  # so fast it turns without being hurried


def stall_at_stop(hand: Hand, finger: HostFinger, stop_mm: float) -> float:
    """Drive a slide against the hard stop at `stop_mm` from its base; where its servo stalls (rad).

    Quickly until near the stop, then slowly and with little current. The slide goes back to where it waits.
    DeviceError if it goes on past the stop without stalling.
    """
    slide, kinematics = finger.drive.closing_servos[0], _stops(finger).kinematics
    full_a = finger.drive.limits()[slide].current_a
    hand.arm()
    retract_all(hand)
    now_at = kinematics.distance_mm(hand.states([slide])[slide.dxl_id].position_rad)
    way = math.copysign(1.0, stop_mm - now_at)
    near, past = stop_mm - way * _SLOW_ZONE_MM, stop_mm + way * _OVERTRAVEL_MM
    speed = hand.rig.closing.approach_speed_mm_s
    if (near - now_at) * way > 0:
        slide.set_profile(speed / abs(kinematics.mm_per_rad), ACCELERATION_RAD_S2)
        goals = {slide: kinematics.slide_servo_rad(near)}
        hand.move_servos(goals, lambda servo: finger.drive.tolerance_rad(servo, ARRIVED_MM))
    slide.set_goal_current_a(_STALL_CURRENT_SHARE * full_a)
    # Soft limits end before the stop: this move alone may go past them.
    ends = sorted((kinematics.slide_servo_rad(near), kinematics.slide_servo_rad(past)))
    end, at = creep_to_stall(hand, slide.with_range((ends[0], ends[1])), kinematics, past)
    slide.set_goal_current_a(full_a)  # nothing presses on: it was stopped where it stalled
    if end is not MoveEnd.STALL:
        raise DeviceError(
            f"finger {finger.name}: its slide (servo {slide.dxl_id}) passed {stop_mm:g} mm and met no hard "
            "stop; check slide.stops_mm, slide.zero_mm and the sign of slide.mm_per_turn"
        )
    retract_all(hand)
    hand.disarm()
    return at


def swing_aims(hand: Hand) -> list[float]:
    """Turn every aim to and fro where fingers wait; the current (A) that each needs, in the median.

    0 for a finger without an aim, which stays where it is.
    """
    hand.arm()
    retract_all(hand)
    aims = [finger.drive.servos[0] for finger in hand.fingers if finger.mechanism.aim is not None]
    start = {aim: hand.states([aim])[aim.dxl_id].position_rad for aim in aims}
    seen: dict[Servo, list[float]] = {aim: [] for aim in aims}
    for aim in aims:
        aim.set_profile(_SWING_RAD_S, ACCELERATION_RAD_S2)
    for side in (_SWING_RAD, -_SWING_RAD, 0.0):
        movers = [ServoMover(aim, aim.nearest_rad(start[aim] + side), AIM_TOLERANCE_RAD) for aim in aims]
        hand.require_arrival(hand.guarded(movers, period_s=_PERIOD_S))
        for mover in movers:
            for _, state in mover.seen:
                if abs(state.velocity_rad_s) > _MIN_TURNING_RAD_S:
                    along = math.copysign(state.current_a, state.current_a * state.velocity_rad_s)
                    seen[mover.servo].append(along)
    for aim in aims:
        aim.set_profile(AIM_SPEED_RAD_S, ACCELERATION_RAD_S2)
    hand.disarm()
    needed = {aim: float(np.median(found)) for aim, found in seen.items() if found}
    return [needed.get(finger.drive.servos[0], 0.0) for finger in hand.fingers]


def _stops(finger: HostFinger) -> HardStops:
    """Hard stops of a finger; InputError without any."""
    if finger.mechanism.homing is None:
        raise InputError(
            f"finger {finger.name} has no stops_mm in the rig file; only slides with stops are driven "
            "against them"
        )
    return finger.mechanism.homing


_STALL_REPEATABILITY_MM = 0.1  # a stall at a stiff stop comes back to within a few encoder steps


def slides_at_stops(hand: Hand) -> dict[HostFinger, float]:
    """Angles at which slides' servos stall at their back stops; slides without one are left out.

    Fingers must be retracted, and stay so. Raises what `stall` raises.
    """
    found: dict[HostFinger, float] = {}
    for finger in hand.fingers:
        if finger.mechanism.homing is not None:
            found[finger] = stall_at_stop(hand, finger, finger.mechanism.homing.back_mm)
    return found


def check_slips(hand: Hand, before: Mapping[HostFinger, float]) -> None:
    """Raise DeviceError for a slide that stalls elsewhere than `before` (rad)."""
    now = slides_at_stops(hand)
    for finger, at_rad in before.items():
        per_rad = abs(_stops(finger).kinematics.mm_per_rad)
        off_mm = abs(now[finger] - at_rad) * per_rad
        if off_mm > _STALL_REPEATABILITY_MM + 2 * TICK_RAD * per_rad:
            servo = finger.drive.closing_servos[0]
            again = "measure slide.zero_mm again" if hand.rig.why_not("calibrate") else "calibrate again"
            raise DeviceError(
                f"finger {finger.name}: its slide (servo {servo.dxl_id}) meets its back stop {off_mm:.2f} mm "
                "from where it did before this run: its horn has slipped, and no answer is given; tighten "
                f"its screw, then {again}"
            )
