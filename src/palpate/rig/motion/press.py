"""Motions for calibration: slow presses, stops at speed, slides against hard stops, swings of aims.

The ways to contacts must be known to be free: the fingers have touched there before. What servos and arrays
say on the way in and out is kept sample by sample; what it means is calibration's business.

*End stops.* Calibration measures slides and aims so. A run checks by its stops that no slide's horn has
slipped on its shaft: a slide that has slipped looks like a part that lies elsewhere, which contacts alone do
not show. Only slides of which the rig file knows the stops are looked at.
"""

import math
from collections.abc import Mapping, Sequence
from typing import TypeVar

import numpy as np

from palpate.base.errors import DeviceError, InputError, SafetyStop
from palpate.base.geometry import Floats, Ints
from palpate.base.geometry.plane import wrap_angle
from palpate.calibration.measurements import LEG_FREE, LEG_IN, LEG_OUT, PressMeasurement, StopMeasurement
from palpate.drivers.dynamixel import MoveEnd, Servo, ServoGoals, ServoMover, ServoState
from palpate.drivers.kinematics import TICK_RAD, FingerKinematics, Servos
from palpate.recognizer import FingerApproach
from palpate.rig.fingers import HostFinger, Stage
from palpate.rig.mechanisms.mechanism import (
    ACCELERATION_RAD_S2,
    AIM_SPEED_RAD_S,
    AIM_TOLERANCE_RAD,
    HardStops,
)
from palpate.rig.motion.finger_movers import ARRIVED_MM, TipMover
from palpate.rig.motion.guarded_approach import (
    aim_fingers,
    move_along_lines,
    move_tips,
    read_positions,
    retract_all,
)
from palpate.rig.motion.hand import Hand
from palpate.rig.motion.homing import creep_to_stall
from palpate.rig.motion.touch import ApproachState

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
        goal_rad = kinematics.slide_servo_rad(near)
        mover = ServoMover(slide, goal_rad, finger.drive.tolerance_rad(slide, ARRIVED_MM))
        if hand.guarded([mover])[mover] is not MoveEnd.REACHED:
            raise _early_stop(hand, finger, stop_mm)
    slide.set_goal_current_a(_STALL_CURRENT_SHARE * full_a)
    # Soft limits end before the stop: this move alone may go past them.
    ends = sorted((kinematics.slide_servo_rad(near), kinematics.slide_servo_rad(past)))
    end, at = creep_to_stall(hand, slide.with_range((ends[0], ends[1])), kinematics, past)
    slide.set_goal_current_a(full_a)  # nothing presses on: it was stopped where it stalled
    if end is not MoveEnd.STALL:
        raise DeviceError(
            f"finger {finger.name}: its slide (servo {slide.dxl_id}) passed {stop_mm:g} mm and met no hard "
            "stop; check where it stands: if at its other end, slide.mm_per_turn has the wrong sign, else "
            "slide.zero_mm or slide.stops_mm is wrong"
        )
    retract_all(hand)
    hand.disarm()
    return at


def _early_stop(hand: Hand, finger: HostFinger, stop_mm: float) -> DeviceError:
    """Error of a slide that stands before it is near its stop, with where it stands."""
    (slide,) = finger.drive.closing_servos
    at_mm = _stops(finger).kinematics.distance_mm(hand.states([slide])[slide.dxl_id].position_rad)
    return DeviceError(
        f"finger {finger.name}: its slide (servo {slide.dxl_id}) stands at {at_mm:.1f} mm by the rig file, "
        f"on its way to its stop at {stop_mm:g} mm, and does not go on; clear its way; if it is clear and "
        "this is its stop, correct slide.mm_per_turn or slide.stops_mm, else loosen the slide"
    )


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
                "from where it did before this run, and no answer is given; see that the horn's screw and "
                f"the stop are tight, then {again}"
            )


_SPEED_MM_S = 4.0
_PRESS_FORCE_N = 3.0
_LEAD_MM = 2.0  # before a contact: gathering speed, then friction alone
_MAX_DEPTH_MM = 4.0  # no press goes deeper
_MOTION_THRESHOLD_MM = 0.03
_STALL_S = 0.25
_SETTLE_S = 0.15
_DIFFERENCE_RAD = 1e-4  # of differences in place of derivatives
_MIN_SERVO_RATE_RAD_MM = (
    1e-4  # a servo that turns less along the way does not move: an aim is a little off its line
)
_LEAD_ACCELERATION_MM_S2 = 20.0  # to reach a speed before a contact

_K = TypeVar("_K")

Contacts = Sequence[tuple[FingerApproach, float]]
"""Ways, and after how many mm of each the finger touches."""


def press_contacts(hand: Hand, contacts: Contacts, placing: int) -> list[PressMeasurement]:
    """Press where fingers touch, all at once, and go back. Ends retracted.

    Raises SafetyStop above the rig file's max_force_n or off the line, and DeviceError for a device that
    fails; the end of the hand's `with` block then switches torque off.
    """
    runs = _approach_contacts(hand, [(item, max(contact - _LEAD_MM, 0.0)) for item, contact in contacts])
    pressing = [
        _PressMover(hand, run, contact, runs) for run, (_, contact) in zip(runs, contacts, strict=True)
    ]
    _check_none_crowded(hand.guarded(pressing, period_s=_PERIOD_S))
    _end_press(hand, runs)
    return [mover.press(placing) for mover in pressing]


def stop_at_speed(hand: Hand, contacts: Contacts, speed_mm_s: float) -> list[StopMeasurement]:
    """Run into contacts at a speed, stop each finger when it feels something, see where it stood."""
    lead = max(_LEAD_MM, speed_mm_s**2 / _LEAD_ACCELERATION_MM_S2 / 2)
    runs = _approach_contacts(hand, [(item, max(contact - lead, 0.0)) for item, contact in contacts])
    contact_n = hand.rig.closing.contact_force_n
    movers = [
        TipMover(hand, run, contact + _MAX_DEPTH_MM, speed_mm_s, contact_n, runs)
        for run, (_, contact) in zip(runs, contacts, strict=True)
    ]
    ends = move_tips(hand, movers)
    _check_none_crowded(ends)
    missing = [run for run, end in ends.items() if end is not MoveEnd.CONTACT]
    if missing:
        raise DeviceError(
            f"finger {missing[0].finger.name} detected no contact where it had touched the reference before; "
            "if that was moved, begin again and see that it stands firmly"
        )
    felt_mm = {run: run.travel_mm for run in runs}
    hand.pause(_SETTLE_S)
    read_positions(hand, runs)
    stops = []
    period = 1 / hand.rig.closing.sample_rate_hz
    for run, (_, contact) in zip(runs, contacts, strict=True):
        stops.append(
            StopMeasurement(run.finger.name, speed_mm_s, felt_mm[run], run.travel_mm, contact, period)
        )
    _end_press(hand, runs)
    return stops


def _check_none_crowded(ends: Mapping[_K, MoveEnd]) -> None:
    """Raise SafetyStop if a finger was stopped because another one was too near."""
    if MoveEnd.CLEARANCE in ends.values():
        raise SafetyStop(
            "two fingers that press came nearer to each other than clearance_mm; fingers were stopped: "
            "use a larger reference, or calibrate with fewer fingers at once"
        )


class _PressMover(TipMover):
    """A press: in until the finger has pressed hard enough or stands still, and out again.

    What servos and array say is kept at every look, in the order of time.
    """

    def __init__(
        self, hand: Hand, run: ApproachState, contact_mm: float, others: Sequence[ApproachState]
    ) -> None:
        super().__init__(hand, run, contact_mm + _MAX_DEPTH_MM, _SPEED_MM_S, math.inf, others)
        self._back_mm = max(contact_mm - _LEAD_MM, 0.0)
        self._leg, self._turns = LEG_IN, False
        self._servos: list[Servos] = []
        self._currents: list[tuple[float, float]] = []
        self._legs: list[int] = []
        self._counts: list[np.ndarray[tuple[int, ...], np.dtype[np.float64]]] = []
        self._force_n = 0.0
        self._still_s, self._still_mm = math.inf, math.inf

    def look(self, states: Mapping[int, ServoState], now: float) -> None:
        """Sample servos and array at one instant."""
        super().look(states, now)
        if abs(self.run.travel_mm - self._still_mm) > _MOTION_THRESHOLD_MM:
            self._still_mm, self._still_s = self.run.travel_mm, now
        reading = self.hand.take_reading(self.finger)
        if not reading.frames:
            return
        self._force_n = reading.force_n
        touching = reading.force_n > self.hand.rig.closing.contact_force_n
        near, far = (states[servo.dxl_id] for servo in self.servos)
        self._servos.append((near.position_rad, far.position_rad))
        self._currents.append((near.current_a, far.current_a))
        self._legs.append(self._leg if touching or self._leg == LEG_OUT else LEG_FREE)
        baseline = self.finger.extractor.baseline.mean
        self._counts.append(np.mean([frame.counts for frame in reading.frames], axis=0) - baseline)

    def until(self, now: float) -> MoveEnd | None:
        """Turn where the way in ends; enough where the way out does."""
        stands = now - self._still_s > _STALL_S
        if self._leg == LEG_IN and (stands or self._force_n > _PRESS_FORCE_N):
            self._leg, self.limit_mm, self._turns = LEG_OUT, self._back_mm, True
            self._still_s = now
            return None
        return MoveEnd.ENOUGH if self._leg == LEG_OUT and stands else None

    def stream(self, now: float) -> ServoGoals:
        """The way out, once; else what the drive has to write."""
        if not self._turns:
            return super().stream(now)
        self._turns = False
        return self.start(now)

    def press(self, placing: int) -> PressMeasurement:
        """Press that was kept."""
        leg = np.array(self._legs, dtype=np.int64)
        drive = _PressMechanics(self.run, np.array(self._servos), np.array(self._currents), leg)
        return PressMeasurement(
            self.finger.name,
            placing,
            drive.travel_mm,
            drive.push_n,
            leg,
            np.array(self._counts),
            drive.step_mm,
            drive.push_step_n,
            drive.aside_mm if self.streams else np.zeros(len(leg)),
            drive.facing_rad,
            (float(drive.newton_per_a[0]), float(drive.newton_per_a[1])),
            (float(drive.free_a[0]), float(drive.free_a[1])),
            drive.friction_sigma_n if self.streams else 0.0,
        )


class _PressMechanics:
    """Motion and push of a tip along its way, by servos' angles and currents (n, 2) of a press.

    A force f on the tip loads servo k with f · e, where e is what a turn of it moves the tip by: currents and
    the postures' Jacobian tell the force (virtual work). What servos need on the free way is their friction.
    """

    def __init__(self, run: ApproachState, servos_rad: Floats, current_a: Floats, leg: Ints) -> None:
        finger, line = run.finger, run.line
        kinematics = finger.kinematics
        along = np.array([math.cos(line.direction_rad), math.sin(line.direction_rad)])
        centres = np.array([kinematics.centre_mm((near, far)) for near, far in servos_rad.tolist()])
        away = centres - line.start_mm
        self.travel_mm: Floats = away @ along
        self.aside_mm: Floats = away @ [-along[1], along[0]]
        facing = np.array([kinematics.facing_rad((near, far)) for near, far in servos_rad.tolist()])
        self.facing_rad: Floats = wrap_angle(facing - line.direction_rad)
        moves = np.array([_jacobian_mm(kinematics, (near, far)) for near, far in servos_rad.tolist()])
        rates = np.linalg.solve(moves, np.tile(along[:, None], (len(moves), 1, 1)))[:, :, 0]
        torques = [servo.model.known_torque for servo in finger.drive.servos]
        # Newton along the way for each ampere, (n, 2).
        worth = 1e3 * rates * [torque.nm_per_a for torque in torques]
        worth = np.where(np.abs(rates) < _MIN_SERVO_RATE_RAD_MM, 0.0, worth)
        free = np.flatnonzero(leg == LEG_FREE)
        free = free[len(free) // 3 :]  # it has gathered speed
        resting = np.median(current_a[free], axis=0) if len(free) else np.zeros(2)
        at_contact = worth[free[-1]] if len(free) else worth[0]
        self.push_n: Floats = (worth * (current_a - resting)).sum(axis=1) + float(at_contact @ resting)
        self.newton_per_a: Floats = at_contact
        self.free_a: Floats = np.where(at_contact == 0, math.nan, resting * np.sign(at_contact))
        # What friction can take, by how currents differ while the way is free: it may point either way.
        scatter = np.std(current_a[free], axis=0) if len(free) else np.zeros(2)
        self.friction_sigma_n = float(np.hypot(*(at_contact * (np.abs(resting) + scatter))))
        units = np.array([torque.current_unit_a for torque in torques])
        self.push_step_n = float(np.hypot(*(at_contact * units)))
        steps = np.abs(np.einsum("kx,x->k", moves[0].T, along)) * TICK_RAD
        self.step_mm = float(steps[at_contact != 0].max())


def _jacobian_mm(kinematics: FingerKinematics, servos_rad: Servos) -> Floats:
    """Travel of the tip per turn of both servos, mm/rad: columns of (2, 2)."""
    near, far = servos_rad
    ends = [
        np.subtract(kinematics.centre_mm((near + a, far + b)), kinematics.centre_mm((near - a, far - b)))
        for a, b in ((_DIFFERENCE_RAD, 0.0), (0.0, _DIFFERENCE_RAD))
    ]
    return np.column_stack(ends) / (2 * _DIFFERENCE_RAD)


def _approach_contacts(hand: Hand, ways: Contacts) -> list[ApproachState]:
    """Fingers that have aimed and tared and gone so far along their ways; SafetyStop if one touches there."""
    hand.arm()
    retract_all(hand)
    turn = Stage.of(hand.rig).planned_turn(0.0)
    runs = [ApproachState.of(hand.fingers[item.finger_index], item, turn) for item, _ in ways]
    aim_fingers(hand, runs)
    hand.tare()
    speed, contact_n = hand.rig.closing.approach_speed_mm_s, hand.rig.closing.contact_force_n
    movers = [
        TipMover(hand, run, before, speed, contact_n, runs)
        for run, (_, before) in zip(runs, ways, strict=True)
    ]
    ends = move_tips(hand, movers)
    _check_none_crowded(ends)
    for mover in movers:
        if ends[mover.run] is MoveEnd.CONTACT:
            raise SafetyStop(
                f"finger {mover.finger.name} met something after {mover.run.travel_mm:.1f} mm of its way, of "
                f"which {mover.limit_mm:.1f} mm are free by touches of the reference; fingers were stopped; "
                "if that has not moved, palpate check --press --move shows whether the frame is mirrored"
            )
    hand.pause(_SETTLE_S)
    read_positions(hand, runs)
    return runs


def _end_press(hand: Hand, runs: Sequence[ApproachState]) -> None:
    hand.stop_arrays()
    move_along_lines(hand, dict.fromkeys(runs, 0.0))
    hand.disarm()
