"""Coming to standby: fingers that stand anywhere go to where they wait, before anything else moves.

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
from palpate.drivers.arm_kinematics import ArmKinematics
from palpate.drivers.dynamixel import MoveEnd, Mover, Servo, ServoGoals, ServoState
from palpate.drivers.kinematics import Servos, Turn
from palpate.rig.drives import AIM_TOLERANCE_RAD, ARM_AIM_SPEED_MM_S, ArmDrive
from palpate.rig.fingers import HostFinger, HostStage
from palpate.rig.motion.array_guard import ArrayReading
from palpate.rig.reach.approaches import stage_range_rad
from palpate.rig.reach.standby_ways import Standby, StandbyWay, standby_of

_MAX_WAYS_TRIED = 10  # ways of a finger, after which it is a person's turn
_CURRENT_CONTACT_N = (
    0.8  # what currents must show beyond friction; cogging and the steps of Present Current are less
)
_FRICTION_WINDOW_S = (0.15, 2.0)  # friction is the most that a servo has needed in this time
_OBSTACLE_MARGIN_MM = 4.0  # a way must lead so far past what was met, once it is further off
_MAX_BLIND_SHARE = 0.02  # share of the tip's leading half without taxels, below which its array is relied on
_FREE_STALL_S = 1.0
_MOTION_THRESHOLD_RAD = 0.003
_WAY_TIMEOUT_S = 120.0
_ARRIVED_MM = 0.8

_M = TypeVar("_M", bound=Mover)


class _Hand(Protocol):
    """What coming to standby needs of a hand."""

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


def stage_problem(stage: HostStage, rig: RigFile, angle_rad: float) -> str | None:
    """Why the stage must not turn from its servo's angle; None if it may.

    It must be in its range, and no obstacle between there and angle 0.
    """
    wrong = stage.start_problem(angle_rad)
    if wrong is not None or not rig.obstacles:
        return wrong
    turn = stage.turn(angle_rad)
    slack = turn.angle_bound_rad + AIM_TOLERANCE_RAD
    lo, hi = stage_range_rad(rig)
    if lo - slack <= turn.angle_rad <= hi + slack:
        return None
    return (
        f"the stage (servo {stage.servo.dxl_id}) stands at {math.degrees(turn.angle_rad):.1f}°, and between "
        "there and 0 a finger would meet an obstacle; with torque off, turn it by hand to about 0, then "
        "start again"
    )


def come_to_standby(hand: _Hand) -> None:
    """Bring every finger that is not where fingers wait there, one after the other. Torque is on.

    Raises DeviceError for a finger that has no way there, or meets something on each that is tried, and what
    the guards of every motion raise.
    """
    standby = standby_of(hand.rig, hand.turn)
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
        hand.move_servos(goals, lambda servo: by_servo[servo].drive.reached_rad(servo, _ARRIVED_MM))


def _bring_to_standby(hand: _Hand, standby: Standby, index: int) -> bool:
    """Bring a finger to standby; False if it has no free way now. Raises as `come_to_standby` does."""
    finger, met = hand.fingers[index], _MetObstacles()
    for _ in range(_MAX_WAYS_TRIED):
        at = hand.servos_of(hand.fingers)
        way = next(met.past(standby.ways(index, [at[other] for other in hand.fingers]), finger), None)
        if way is None:
            break
        if not isinstance(finger.drive, ArmDrive):
            aim = finger.drive.servos[0]
            hand.move_servos({aim: float(way.servos_rad[-1, 0])}, lambda _: AIM_TOLERANCE_RAD)
            return True
        if not met.places:
            hand.notice(f"finger {finger.name} goes to where it waits")
        contact = _follow_way(hand, finger, finger.drive, way)
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
    """What a finger has met so far: where its tip stood, and in which direction from there."""

    places: list[tuple[Floats, float]] = field(default_factory=list)

    def past(self, ways: Iterator[StandbyWay], finger: HostFinger) -> Iterator[StandbyWay]:
        """Ways on which the tip passes what it has met."""
        radius = finger.spec.tip.radius_mm
        for way in ways:
            points = [at + radius * np.array([math.cos(a), math.sin(a)]) for at, a in self.places]
            if all(way.keeps_off(point, radius + _OBSTACLE_MARGIN_MM) for point in points):
                yield way


def _follow_way(
    hand: _Hand, finger: HostFinger, drive: ArmDrive, way: StandbyWay
) -> tuple[Floats, float] | None:
    """Go a way; where the tip stood and in which direction it has met something, None if it has arrived."""
    for first, last, speed in _legs(hand.rig, way):
        mover = _WayMover(hand, finger, drive, way, (first, last), speed)
        if hand.guarded([mover], period_s=1 / hand.rig.closing.sample_rate_hz)[mover] is MoveEnd.REACHED:
            continue
        found = mover.met()
        gone = way.up_to(mover.travel_mm).reversed().up_to(hand.rig.closing.back_off_mm)
        if gone.travel_mm[-1] > 0:
            back = _WayMover(hand, finger, drive, gone, (0, len(gone.travel_mm) - 1), speed, feels=False)
            hand.guarded([back], period_s=1 / hand.rig.closing.sample_rate_hz)
        return found
    return None


def _legs(rig: RigFile, way: StandbyWay) -> Iterator[tuple[int, int, float]]:
    """Pieces of a way, by the numbers of their first and last postures, each with its speed (mm/s)."""
    closing = rig.closing
    seeing = np.where(way.blind <= _MAX_BLIND_SHARE, closing.search_mm_s, closing.touch_speed_mm_s)
    speeds = np.where(way.is_inside, seeing, min(ARM_AIM_SPEED_MM_S, closing.approach_speed_mm_s))
    ends = [0, *(np.flatnonzero(np.diff(speeds)) + 1).tolist(), len(speeds)]
    for first, last in pairwise(ends):
        if last > first:
            yield first, last, float(speeds[first])


class _WayMover:
    """An arm on a piece of its way: it must arrive, and ends where its array or its currents show a contact.

    `travel_mm`: how far it is on the way.
    """

    streams = True

    def __init__(
        self,
        hand: _Hand,
        finger: HostFinger,
        drive: ArmDrive,
        way: StandbyWay,
        piece: tuple[int, int],
        speed_mm_s: float,
        *,
        feels: bool = True,
    ) -> None:
        self.finger, self._hand, self._drive = finger, hand, drive
        self._way, self._piece, self._speed_mm_s, self._feels = way, piece, speed_mm_s, feels
        self.travel_mm = float(way.travel_mm[piece[0]])
        self._begun_s = self._moved_s = -math.inf
        self._states: dict[Servo, ServoState] = {}
        self._moved: dict[Servo, float] = {}
        self._needed: deque[tuple[float, Floats]] = deque()
        self._patch_rad: float | None = None

    @property
    def servos(self) -> Sequence[Servo]:
        """Both servos."""
        return self._drive.servos

    @property
    def driven(self) -> Sequence[Servo]:
        """Both."""
        return self._drive.servos

    def start(self, now: float) -> ServoGoals:
        """Begin the piece."""
        first, last = self._piece
        postures = self._way.servos_rad[first : last + 1]
        travel = self._way.travel_mm[first : last + 1]
        self._begun_s = now
        return self._drive.follow(postures, travel - travel[0], self._speed_mm_s, now)

    def stream(self, now: float) -> ServoGoals:
        """What the drive writes now."""
        return self._drive.goals(now)

    def sense(self, _now: float) -> MoveEnd | None:
        """A contact that the array feels."""
        reading = self._hand.reading(self.finger)
        if not self._feels or reading.force_n <= self._hand.rig.closing.contact_force_n:
            return None
        patch = self.finger.extractor.extract(reading.frames)
        self._patch_rad = None if patch is None else patch.angle_rad
        return MoveEnd.CONTACT

    def look(self, states: Mapping[int, ServoState], now: float) -> None:
        """Note where the servos are and what they need."""
        self._states = {servo: states[servo.dxl_id] for servo in self.servos}
        at = {servo: state.position_rad for servo, state in self._states.items()}
        if any(abs(at[servo] - self._moved.get(servo, math.inf)) > _MOTION_THRESHOLD_RAD for servo in at):
            self._moved, self._moved_s = at, now
        near, far = at.values()
        x, y = self._kinematics.centre_mm((near, far))
        away = np.hypot(*(self._way.places_mm - [x, y]).T)
        self.travel_mm = float(self._way.travel_mm[away.argmin()])
        self._needed.append((now, self._forces_n((near, far))))
        while self._needed[0][0] < now - _FRICTION_WINDOW_S[1]:
            self._needed.popleft()

    def stopped(self, now: float) -> None:
        """Nothing: another way begins."""

    def judge(self, now: float) -> MoveEnd | None:
        """A contact that currents show; arrival; a stall."""
        if self._feels and self._is_pressing(now):
            return MoveEnd.CONTACT
        if self._drive.under_way(now):
            return None
        near = {
            servo: abs(self._states[servo].position_rad - goal)
            for servo, goal in self._drive.targets().items()
        }
        if all(off <= self._drive.reached_rad(servo, _ARRIVED_MM) for servo, off in near.items()):
            return MoveEnd.REACHED
        if now - self._moved_s > _FREE_STALL_S:
            return MoveEnd.STALL
        return MoveEnd.DEADLINE if now - self._begun_s > _WAY_TIMEOUT_S else None

    def met(self) -> tuple[Floats, float]:
        """Where the tip stood when it met something, and in which direction that is."""
        near, far = (self._states[servo].position_rad for servo in self.servos)
        at = np.array(self._kinematics.centre_mm((near, far)))
        if self._patch_rad is not None:
            facing = self._kinematics.facing_rad((near, far))
            return at, facing + math.radians(self.finger.spec.array.heading_deg) + self._patch_rad
        number = min(int(np.searchsorted(self._way.travel_mm, self.travel_mm)), len(self._way.blind) - 1)
        x, y = np.diff(self._way.places_mm[number : number + 2], axis=0)[0]
        return at, math.atan2(y, x)

    @property
    def _kinematics(self) -> ArmKinematics:
        assert isinstance(self.finger.kinematics, ArmKinematics)
        return self.finger.kinematics

    def _forces_n(self, servos_rad: Servos) -> Floats:
        """What each servo's current would press with at the tip, (2,), friction and all."""
        k = self._kinematics
        levers = math.dist(k.base_mm, k.centre_mm(servos_rad)), k.fore_mm
        joints = k.shoulder, k.elbow
        return np.array(
            [
                abs(state.current_a * servo.model.known_torque.nm_per_a * joint.gear_ratio) / lever * 1000
                for (servo, state), joint, lever in zip(self._states.items(), joints, levers, strict=True)
            ]
        )

    def _is_pressing(self, now: float) -> bool:
        """Whether a servo needs more than its friction, as the last seconds have shown that."""
        before = [needed for when, needed in self._needed if when < now - _FRICTION_WINDOW_S[0]]
        if not before or now - self._begun_s < 2 * _FRICTION_WINDOW_S[0]:
            return False
        return bool((self._needed[-1][1] - np.max(before, axis=0) > _CURRENT_CONTACT_N).any())
