"""Homing: finds the turn in which a slide stands by driving it against its back stop.

A servo that was without power reports its angle within one turn, and a slide takes several. A slide whose
rig file names its stops is therefore homed unless its servo bears a mark in its RAM (`turn_mark`), which is
lost together with its turns. Whole turns are all that homing finds: zero and travel stay what the rig file
or a calibration says.

Going back is free whatever the turn and wherever other fingers stand: a finger's body reaches straight from
its base to its tip, so a tip that goes back with its aim held goes where its own body has been. Aims must
not turn before all slides are back. Where the rig file is wrong, it may be another finger that goes, and
forwards: a slide that needs more force than on its way so far is stopped.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from enum import Enum
from typing import Protocol

import numpy as np

from palpate.base.errors import DeviceError
from palpate.drivers.dynamixel import (
    MAX_TURNS,
    NO_MARK,
    Bus,
    Guard,
    MoveEnd,
    OperatingMode,
    Servo,
    ServoGoals,
    ServoMover,
    ServoState,
    mark_item,
    mark_value,
    turns_of_mark,
)
from palpate.drivers.kinematics import Servos
from palpate.drivers.slide_kinematics import SlideKinematics
from palpate.drivers.transport import Clock
from palpate.rig.fingers import HostFinger
from palpate.rig.mechanisms.mechanism import ACCELERATION_RAD_S2, HardStops
from palpate.rig.motion.free_force import START_S, FreeForce

_PERIOD_S = 0.01
_ARRIVED_MM = 0.8
_SLOW_MM_S = 5.0
_STOP_YIELD_MM = 0.7  # what a stop and a drive yield under max_force_n
_SLOW_ZONE_MM = 1.5  # so far before the nearest place of a stop the slide goes slowly
_PASSED_TOLERANCE_MM = 1.0
_MOTION_THRESHOLD_MM = 0.03
_STALL_S = 0.4
_FREE_STALL_S = 1.0
_AIM_SLACK_DEG = 2.0
_REVERSED = 0x01  # bit of Drive Mode: set or cleared, turns are forgotten
_RAM_RESTORE = 0x02  # bit of Startup Configuration: RAM, and with it the mark, would outlive the turns


class HomingPolicy(Enum):
    """Choice of slides that are homed before a run: of unknown turn, all that have stops, or none."""

    UNKNOWN = "unknown"
    ALL = "all"
    NONE = "none"


class _Hand(Protocol):
    """Part of a hand that homing needs."""

    @property
    def bus(self) -> Bus: ...

    @property
    def clock(self) -> Clock: ...

    def states(self, servos: Sequence[Servo], /) -> Mapping[int, ServoState]: ...

    def guarded(
        self, movers: Sequence[ServoMover], /, *, period_s: float = ...
    ) -> Mapping[ServoMover, MoveEnd]: ...

    def move_servos(self, goals_rad: ServoGoals, tolerance_rad: Callable[[Servo], float], /) -> None: ...

    def arm(self) -> None: ...

    def disarm(self) -> None: ...


class _BackWatch:
    """Watch over the current of a slide that goes back: what exceeds its way so far, it has met.

    What it needs to speed up is compared with what it needed to speed up before.
    """

    def __init__(self, clock: Clock, finger: HostFinger) -> None:
        (self._slide,) = finger.drive.closing_servos
        self._clock, self._kinematics = clock, _stops(finger).kinematics
        self._any, self._under_way = FreeForce(), FreeForce()
        self._begun_s = -math.inf
        self.excess_n = 0.0

    def begin(self) -> None:
        """Begin a leg."""
        self._begun_s = self._clock.now()

    def has_met(self, state: ServoState) -> bool:
        """True if the slide needs more force than friction and cogging explain."""
        now, kinematics = self._clock.now(), self._kinematics
        torque_nm = state.current_a * self._slide.model.known_torque.nm_per_a
        needed_n = -1000 * torque_nm / kinematics.mm_per_rad
        at_mm = kinematics.distance_mm(state.position_rad)
        met = self._exceeds(self._any, needed_n, at_mm, now)
        if now - self._begun_s >= START_S:
            met = self._exceeds(self._under_way, needed_n, at_mm, now) or met
        return met

    def _exceeds(self, free: FreeForce, needed_n: float, at_mm: float, now: float) -> bool:
        excess_n = free.excess_n(needed_n, at_mm, now)
        if excess_n <= free.contact_n:
            return False
        self.excess_n = excess_n
        return True


def recall_turn(bus: Bus, finger: HostFinger) -> bool:
    """Take over the turn that a slide's servo is marked with; False if it is not marked, and must be homed.

    Call it before the servo's mode is written: position mode forgets turns, too.
    """
    slide = finger.drive.closing_servos[0]
    slide.turns, turns = 0, _marked_turns(bus, slide)
    if turns is None:
        return False
    slide.turns = turns
    return True


def forget_turn(bus: Bus, finger: HostFinger) -> None:
    """Take the mark off a slide's servo: from now on its turn is unknown, whatever interrupts homing."""
    slide = finger.drive.closing_servos[0]
    slide.turns, item = 0, mark_item(slide.model)
    if item is not None and turns_of_mark(bus.read(slide.dxl_id, item)) is not None:
        bus.write(slide.dxl_id, item, NO_MARK)


def is_within_stops(finger: HostFinger, angle_rad: float) -> bool:
    """True if a slide's tip can stand at the distance that its servo's angle says."""
    stops = _stops(finger)
    slack = _stop_tolerance_mm(stops)
    distance = stops.kinematics.distance_mm(angle_rad)
    return stops.back_mm - slack <= distance <= stops.front_mm + slack + stops.slide.off_mm(stops.front_mm)


def homing_problem(finger: HostFinger, angles_rad: Servos) -> str | None:
    """Why a finger must not be homed from where it stands; None if it may. `angles_rad`: aim, and slide."""
    stops = _stops(finger)
    aim, slide = finger.drive.servos
    kinematics = stops.kinematics
    aimed = math.degrees((angles_rad[0] - kinematics.aim_zero_rad) / kinematics.gear_ratio)
    lo, hi = stops.aim.range_deg
    if not lo - _AIM_SLACK_DEG <= aimed <= hi + _AIM_SLACK_DEG:
        return (
            f"its aim (servo {aim.dxl_id}) stands at {aimed:.1f}°, outside its range {lo:g} … {hi:g}°; "
            "with torque off, turn it back by hand, then start again"
        )
    needed_mm = 2 * _stop_tolerance_mm(stops) + _SLOW_ZONE_MM + 2 * _PASSED_TOLERANCE_MM
    if needed_mm >= abs(stops.slide.mm_per_turn):
        return (
            f"its slide (servo {slide.dxl_id}) cannot be homed: zero_bound_mm and mm_per_turn_spread leave "
            "open which turn its back stop is in; measure better"
        )
    if not back_stop_distances_mm(stops, kinematics.distance_mm(angles_rad[1])):
        return (
            f"its slide (servo {slide.dxl_id}) stands where it cannot be in any turn between its stops at "
            f"{stops.back_mm:g} and {stops.front_mm:g} mm; {_see_wiring(slide)} slide.stops_mm, "
            "slide.zero_mm and slide.mm_per_turn"
        )
    return None


def home_slides(hand: _Hand, fingers: Sequence[HostFinger]) -> None:
    """Drive slides back, one after the other, until each stalls at its back stop; mark their turns.

    Torque is on, aims hold, turns are forgotten (`forget_turn`). Each goes to
    where it waits. Raises DeviceError for a slide that is held elsewhere, or meets no stop, and what the
    guards of every motion raise.
    """
    if not fingers:
        return
    hand.arm()
    for finger in fingers:
        slide = finger.drive.closing_servos[0]
        turns = _turns_at_stop(hand, finger)
        slide.turns = turns
        item = mark_item(slide.model)
        if item is not None and abs(turns) <= MAX_TURNS:
            hand.bus.write(slide.dxl_id, item, mark_value(turns))
        _go_back(hand, finger)
    hand.disarm()


def back_stop_distances_mm(stops: HardStops, reading_mm: float) -> list[tuple[float, int]]:
    """Distances at which a slide may meet its back stop, as it reads them now, with turns; nearest first.

    `reading_mm`: distance from the base as it reads, off by a number of whole turns, the second of each pair.
    """
    slide, back, front = stops.slide, stops.back_mm, stops.front_mm
    half = _stop_tolerance_mm(stops)
    travel_mm = front - back + slide.off_mm(front) + half
    step = slide.mm_per_turn
    around = (reading_mm - back) / step
    reach = math.ceil((travel_mm + half) / abs(step)) + 1
    found = [
        (back + turns * step, turns)
        for turns in range(math.floor(around) - reach, math.ceil(around) + reach + 1)
    ]
    within = [(stop, turns) for stop, turns in found if -half <= reading_mm - stop <= travel_mm]
    return sorted(within, reverse=True)


def _turns_at_stop(hand: _Hand, finger: HostFinger) -> int:
    """Go back until a stop is met where one may be; how many turns the servo counts ahead."""
    slide, stops = finger.drive.closing_servos[0], _stops(finger)
    reading_mm = stops.kinematics.distance_mm(_angle_rad(hand, slide))
    watch = _BackWatch(hand.clock, finger)
    for stop_mm, turns in back_stop_distances_mm(stops, reading_mm):
        if _meets_stop(hand, finger, stop_mm, watch):
            return turns
    raise DeviceError(
        f"finger {finger.name}: its slide (servo {slide.dxl_id}) went back over all its travel and met no "
        f"hard stop; {_see_wiring(slide)} slide.stops_mm, slide.zero_mm and the sign of slide.mm_per_turn"
    )


def _meets_stop(hand: _Hand, finger: HostFinger, stop_mm: float, watch: _BackWatch) -> bool:
    """Go to where the back stop may be, then slowly on; whether the slide stalls there."""
    slide, stops = finger.drive.closing_servos[0], _stops(finger)
    kinematics, half = stops.kinematics, _stop_tolerance_mm(stops)
    near, past = stop_mm + half + _SLOW_ZONE_MM, stop_mm - half - 2 * _PASSED_TOLERANCE_MM
    at_mm = kinematics.distance_mm(_angle_rad(hand, slide))
    ends = sorted(kinematics.slide_servo_rad(mm) for mm in (past, max(at_mm, near)))
    # Soft limits hold in the right turn only: moves of homing alone go by what the servo reads.
    homing = slide.with_range((ends[0], ends[1]))
    per_mm = abs(1 / kinematics.mm_per_rad)
    if at_mm > near:
        finger.drive.retract()  # its profile: as fast as through free space
        free = Guard(stall_s=_FREE_STALL_S)
        goal_rad = kinematics.slide_servo_rad(near)
        leg = ServoMover(homing, goal_rad, _ARRIVED_MM * per_mm, free, watch.has_met)
        watch.begin()
        if _guarded_end(hand, leg) is not MoveEnd.REACHED:
            raise _held_error(hand, finger, at_mm, watch)

    def has_met(state: ServoState) -> bool:
        is_stop = abs(kinematics.distance_mm(state.position_rad) - stop_mm) <= half
        return watch.has_met(state) and not is_stop

    watch.begin()
    end, at_rad = creep_to_stall(hand, homing, kinematics, past, has_met)
    if end is MoveEnd.REACHED:
        return False
    if end is not MoveEnd.STALL or abs(kinematics.distance_mm(at_rad) - stop_mm) > half:
        raise _held_error(hand, finger, at_mm, watch)
    return True


def creep_to_stall(
    hand: _Hand,
    slide: Servo,
    kinematics: SlideKinematics,
    past_mm: float,
    contact: Callable[[ServoState], bool] = lambda _: False,
) -> tuple[MoveEnd, float]:
    """Go slowly towards `past_mm` until the slide stalls; how it ends, and the servo's angle there (rad).

    `contact` judges each state, and ends it, too. The angle is the mean of what is read while it stands; nan
    if it did not stall.
    """
    per_mm = abs(1 / kinematics.mm_per_rad)
    slide.set_profile(_SLOW_MM_S * per_mm, ACCELERATION_RAD_S2)
    guard = Guard(moved_rad=_MOTION_THRESHOLD_MM * per_mm, stall_s=_STALL_S)
    goal_rad = kinematics.slide_servo_rad(past_mm)
    mover = ServoMover(slide, goal_rad, _PASSED_TOLERANCE_MM * per_mm, guard, contact)
    end = _guarded_end(hand, mover)
    if end is not MoveEnd.STALL:
        return end, math.nan
    # It may have crept on by less than what counts as motion.
    since = mover.moved_s + _STALL_S / 2
    return end, float(np.mean([state.position_rad for when, state in mover.seen if when > since]))


def _held_error(hand: _Hand, finger: HostFinger, from_mm: float, watch: _BackWatch) -> DeviceError:
    slide = finger.drive.closing_servos[0]
    gone = from_mm - _stops(finger).kinematics.distance_mm(_angle_rad(hand, slide))
    seen = f", and needs {watch.excess_n:.1f} N more than before" if watch.excess_n else ""
    return DeviceError(
        f"finger {finger.name}: its slide (servo {slide.dxl_id}) is held {abs(gone):.1f} mm on its way back "
        f"to its stop, where no stop can be{seen}; clear its way; if it is clear, {_see_wiring(slide)} "
        "slide.stops_mm and slide.zero_mm" + ("" if seen else ", and raise max_force_n")
    )


def _see_wiring(slide: Servo) -> str:
    """What to do first about a slide that is not where its file says: homing sees servos, not fingers."""
    return f"see with palpate check --press --move that servo {slide.dxl_id} moves this finger, then check"


def _guarded_end(hand: _Hand, mover: ServoMover) -> MoveEnd:
    return hand.guarded([mover], period_s=_PERIOD_S)[mover]


def _angle_rad(hand: _Hand, servo: Servo) -> float:
    return hand.states([servo])[servo.dxl_id].position_rad


def _go_back(hand: _Hand, finger: HostFinger) -> None:
    """Go from the stop to where the finger waits."""
    hand.move_servos(finger.drive.retract(), lambda servo: finger.drive.tolerance_rad(servo, _ARRIVED_MM))


def _marked_turns(bus: Bus, slide: Servo) -> int | None:
    """Turns that the servo is marked with; None if they may have been lost since, or never were known."""
    item = mark_item(slide.model)
    if item is None or slide.read("Operating Mode") != OperatingMode.CURRENT_BASED_POSITION:
        return None
    if slide.read("Drive Mode") & _REVERSED:
        return None
    restores = "Startup Configuration" in slide.model.items and slide.read("Startup Configuration")
    if restores and restores & _RAM_RESTORE:
        return None
    return turns_of_mark(bus.read(slide.dxl_id, item))


def _stop_tolerance_mm(stops: HardStops) -> float:
    """Tolerance of the back stop's declared place, either way, as the servo reads it."""
    slide = stops.slide
    off = slide.off_mm(stops.back_mm) + stops.kinematics.slide_encoder_mm
    return off + 2 * slide.backlash_mm + _STOP_YIELD_MM


def _stops(finger: HostFinger) -> HardStops:
    assert finger.mechanism.homing is not None, "only slides with stops are homed"
    return finger.mechanism.homing
