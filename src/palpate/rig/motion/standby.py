"""Moves to standby: fingers go from wherever they stand to their standby poses before anything else moves.

Slides are homed and retracted by then, and turn outside of the workspace. An arm's tip may stand beside the
part, of which nothing is known yet. It goes slowly, and stops and backs off at a contact: one that its array
feels, or, where the tip has no taxels, one that its servos need current for. Then it tries another way.
"""

import math
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Protocol, TypeVar

import numpy as np

from palpate.base.errors import DeviceError
from palpate.base.geometry import Floats
from palpate.config import RigFile
from palpate.drivers.dynamixel import MoveEnd, Mover, Servo, ServoGoals, ServoState
from palpate.drivers.kinematics import Servos, Turn
from palpate.rig.fingers import HostFinger
from palpate.rig.mechanisms.mechanism import AIM_TOLERANCE_RAD, CIRCLE_SPEED_MM_S
from palpate.rig.motion.array_guard import ArrayReading
from palpate.rig.motion.finger_movers import ARRIVED_MM, FreeMover
from palpate.rig.motion.free_force import CURRENT_CONTACT_N, torques_nm
from palpate.rig.reach.approaches import WaitingFingers
from palpate.rig.reach.standby_ways import Standby, StandbyWay

_MAX_WAYS_TRIED = 10  # ways of a finger, after which it is a person's turn
_FRICTION_WINDOW_S = (0.15, 2.0)  # friction is the most that a servo has needed in this time
_OBSTACLE_MARGIN_MM = 4.0  # a way must lead so far past what was met, once it is further off
_MAX_BLIND_SHARE = 0.02  # share of the tip's leading half without taxels, below which its array is relied on
_WAY_TIMEOUT_S = 120.0

_M = TypeVar("_M", bound=Mover)


class _Hand(Protocol):
    """Part of a hand that coming to standby needs."""

    @property
    def rig(self) -> RigFile: ...

    @property
    def fingers(self) -> Sequence[HostFinger]: ...

    @property
    def turn(self) -> Turn: ...

    @property
    def notice(self) -> Callable[[str], None]: ...

    def servos_of(self, fingers: Sequence[HostFinger], /) -> Mapping[HostFinger, Servos]: ...

    def guarded(self, movers: Sequence[_M], /, *, period_s: float = ...) -> Mapping[_M, MoveEnd]: ...

    def move_servos(self, goals_rad: ServoGoals, tolerance_rad: Callable[[Servo], float], /) -> None: ...

    def reading(self, finger: HostFinger, /) -> ArrayReading: ...

    def arm(self) -> None: ...

    def disarm(self) -> None: ...

    def tare(self) -> None: ...

    def stop_arrays(self) -> None: ...


def stage_problem(rig: RigFile, turn: Turn) -> str | None:
    """Reason why the stage must not turn from where it stands; None if it may.

    It must be in its range, and no obstacle between there and angle 0.
    """
    spec = rig.stage
    if spec is None:
        return None
    angle = math.degrees(turn.angle_rad)
    stands = f"the stage (servo {spec.dxl_id}) stands at {angle:.1f}°"
    remedy = "with torque off, turn it by hand to about 0, then start again"
    lo, hi = spec.range_deg
    play = spec.backlash_deg + spec.bound_deg
    if not lo - play <= angle <= hi + play:
        return f"{stands}, outside {lo:g} … {hi:g}°; {remedy}"
    if not rig.obstacles:
        return None
    slack = turn.angle_bound_rad + AIM_TOLERANCE_RAD
    free = WaitingFingers.of(rig).stage_range_rad
    if free[0] - slack <= turn.angle_rad <= free[1] + slack:
        return None
    return f"{stands}, and between there and 0 a finger would meet an obstacle; {remedy}"


def come_to_standby(hand: _Hand) -> None:
    """Bring every finger that is not where fingers wait there, one after the other. Torque is on.

    Raises DeviceError for a finger that has no way there, or meets something on each that is tried, and what
    the guards of every motion raise.
    """
    standby = Standby.of(hand.rig, hand.turn)
    if not _away(hand, standby):
        return
    hand.arm()
    _retract(hand)
    hand.tare()
    while away := _away(hand, standby):
        if not any(_bring_to_standby(hand, standby, index) for index in away):
            raise _no_way(hand, away[0])
    hand.stop_arrays()
    hand.disarm()


def _away(hand: _Hand, standby: Standby) -> list[int]:
    """Fingers that are not where they wait, by index."""
    at = hand.servos_of(hand.fingers)
    return [k for k, finger in enumerate(hand.fingers) if not standby.is_there(k, at[finger])]


def _retract(hand: _Hand) -> None:
    goals: dict[Servo, float] = {}
    for finger in hand.fingers:
        goals |= finger.drive.retract()
    by_servo = {servo: finger for finger in hand.fingers for servo in finger.drive.servos}
    if goals:
        hand.move_servos(goals, lambda servo: by_servo[servo].drive.tolerance_rad(servo, ARRIVED_MM))


def _bring_to_standby(hand: _Hand, standby: Standby, index: int) -> bool:
    """Bring a finger to standby; False if it has no free way now. Raises as `come_to_standby` does."""
    finger, met = hand.fingers[index], _MetObstacles()
    for _ in range(_MAX_WAYS_TRIED):
        at = hand.servos_of(hand.fingers)
        way = next(met.past(standby.ways(index, [at[other] for other in hand.fingers]), finger), None)
        if way is None:
            break
        if not finger.drive.streams:
            goals = finger.drive.follow(way.servos_rad, way.travel_mm, CIRCLE_SPEED_MM_S, 0.0)
            hand.move_servos(goals, lambda _: AIM_TOLERANCE_RAD)
            return True
        if not met.places:
            hand.notice(f"finger {finger.name} goes to where it waits")
        contact = _follow_way(hand, finger, way)
        if contact is None:
            return True
        met.places.append(contact)
    if met.places:
        raise DeviceError(
            f"finger {finger.name} has met something on {len(met.places)} of its ways out of the workspace; "
            f"{_by_hand(finger)}"
        )
    return False


def _no_way(hand: _Hand, index: int) -> DeviceError:
    finger = hand.fingers[index]
    return DeviceError(
        f"finger {finger.name} has no way to where it waits that keeps clearance_mm from obstacles and from "
        f"where the other fingers stand; {_by_hand(finger)}"
    )


def _by_hand(finger: HostFinger) -> str:
    x, y = finger.home.start_mm
    return f"with torque off, push its tip by hand to about ({x:.0f}, {y:.0f}) mm, then start again"


@dataclass
class _MetObstacles:
    """Obstacles that a finger has met so far: where its tip stood, and in which direction from there."""

    places: list[tuple[Floats, float]] = field(default_factory=list)

    def past(self, ways: Iterator[StandbyWay], finger: HostFinger) -> Iterator[StandbyWay]:
        """Ways on which the tip passes what it has met."""
        tip, past_mm = finger.spec.tip, finger.spec.tip.half_width_mm + _OBSTACLE_MARGIN_MM
        for way in ways:
            points = [at + tip.radius_mm * np.array([math.cos(a), math.sin(a)]) for at, a in self.places]
            if all(way.keeps_off(point, past_mm) for point in points):
                yield way


def _follow_way(hand: _Hand, finger: HostFinger, way: StandbyWay) -> tuple[Floats, float] | None:
    """Go a way; where the tip stood and in which direction it has met something, None if it has arrived."""
    for first, last, speed in _legs(hand.rig, way):
        mover = _WayMover(hand, finger, way, (first, last), speed)
        if hand.guarded([mover], period_s=1 / hand.rig.closing.sample_rate_hz)[mover] is MoveEnd.REACHED:
            continue
        found = mover.met()
        gone = way.up_to(mover.travel_mm).reversed().up_to(hand.rig.closing.back_off_mm)
        if gone.travel_mm[-1] > 0:
            back = _WayMover(hand, finger, gone, (0, len(gone.travel_mm) - 1), speed, feels=False)
            hand.guarded([back], period_s=1 / hand.rig.closing.sample_rate_hz)
        return found
    return None


def _legs(rig: RigFile, way: StandbyWay) -> Iterator[tuple[int, int, float]]:
    """Pieces of a way, by the numbers of their first and last postures, each with its speed (mm/s)."""
    closing = rig.closing
    seeing = np.where(way.blind <= _MAX_BLIND_SHARE, closing.search_mm_s, closing.touch_speed_mm_s)
    speeds = np.where(way.is_inside, seeing, min(CIRCLE_SPEED_MM_S, closing.approach_speed_mm_s))
    ends = [0, *(np.flatnonzero(np.diff(speeds)) + 1).tolist(), len(speeds)]
    for first, last in pairwise(ends):
        if last > first:
            yield first, last, float(speeds[first])


class _WayMover(FreeMover):
    """A finger on a piece of its way: it arrives, or ends where its array or its currents show a contact.

    `travel_mm`: how far it is on the way.
    """

    def __init__(
        self,
        hand: _Hand,
        finger: HostFinger,
        way: StandbyWay,
        piece: tuple[int, int],
        speed_mm_s: float,
        *,
        feels: bool = True,
    ) -> None:
        super().__init__(finger, self._follow, lambda servo: finger.drive.tolerance_rad(servo, ARRIVED_MM))
        self._hand, self._way, self._piece, self._speed_mm_s, self._feels = (
            hand,
            way,
            piece,
            speed_mm_s,
            feels,
        )
        self.travel_mm = float(way.travel_mm[piece[0]])
        self._needed: deque[tuple[float, Floats]] = deque()
        self._patch_rad: float | None = None

    def _follow(self, now: float) -> ServoGoals:
        """Begin the piece."""
        first, last = self._piece
        postures = self._way.servos_rad[first : last + 1]
        travel = self._way.travel_mm[first : last + 1]
        return self.finger.drive.follow(postures, travel - travel[0], self._speed_mm_s, now)

    def longest_s(self) -> float:
        """Time for a slow way over all of the workspace."""
        return _WAY_TIMEOUT_S

    def sense(self, _now: float) -> MoveEnd | None:
        """A contact that the array feels, or that of another finger, against which it may push the part."""
        reading, contact_n = self._hand.reading(self.finger), self._hand.rig.closing.contact_force_n
        if not self._feels or all(self._hand.reading(f).force_n <= contact_n for f in self._hand.fingers):
            return None
        patch = self.finger.extractor.extract(reading.frames)
        is_known = patch is not None and patch.angle_half_range_rad < math.pi
        self._patch_rad = patch.angle_rad if patch is not None and is_known else None
        return MoveEnd.CONTACT

    def look(self, states: Mapping[int, ServoState], now: float) -> None:
        """Note where the servos are and what they need."""
        super().look(states, now)
        at = self.finger.kinematics.centre_mm(self._at())
        away = np.hypot(*(self._way.places_mm - np.array(at)).T)
        self.travel_mm = float(self._way.travel_mm[away.argmin()])
        self._needed.append((now, self._forces_n()))
        while self._needed[0][0] < now - _FRICTION_WINDOW_S[1]:
            self._needed.popleft()

    def judge(self, now: float) -> MoveEnd | None:
        """A contact that currents show; else arrival or a stall."""
        return MoveEnd.CONTACT if self._feels and self._is_pressing(now) else super().judge(now)

    def is_at(self, servo: Servo, state: ServoState, goal_rad: float) -> bool:
        """Arrival as soon as a servo is near its goal: another piece follows, on which it moves on."""
        return abs(state.position_rad - goal_rad) <= self.tolerance_rad(servo)

    def met(self) -> tuple[Floats, float]:
        """Place of the tip when it met something, and the direction of that."""
        kinematics, servos = self.finger.kinematics, self._at()
        at = np.array(kinematics.centre_mm(servos))
        if self._patch_rad is not None:
            facing = kinematics.facing_rad(servos)
            return at, facing + math.radians(self.finger.spec.array.heading_deg) + self._patch_rad
        number = min(int(np.searchsorted(self._way.travel_mm, self.travel_mm)), len(self._way.blind) - 1)
        x, y = np.diff(self._way.places_mm[number : number + 2], axis=0)[0]
        return at, math.atan2(y, x)

    def _at(self) -> Servos:
        near, far = (self.states[servo].position_rad for servo in self.servos)
        return near, far

    def _forces_n(self) -> Floats:
        """Force at the tip by each servo's current, (2,), friction and all."""
        return 1000 * np.abs(torques_nm(self.states)) / self.finger.kinematics.levers_mm(self._at())

    def _is_pressing(self, now: float) -> bool:
        """True if a servo needs more than its friction, as the last seconds have shown that."""
        before = [needed for when, needed in self._needed if when < now - _FRICTION_WINDOW_S[0]]
        if not before or now - self.started_s < 2 * _FRICTION_WINDOW_S[0]:
            return False
        return bool((self._needed[-1][1] - np.max(before, axis=0) > CURRENT_CONTACT_N).any())
