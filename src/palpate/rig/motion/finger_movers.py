"""Fingers as movers of a guarded move: through free space, and along a line on which they may touch.

A `FreeMover` must arrive; a `TipMover` ends at a contact, at its limit, or where another finger comes too
near. A violation of a finger's limits ends all motion: `judge` raises it, and so does the hand's `pause`.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Protocol, final

import numpy as np

from palpate.base.errors import SafetyStop
from palpate.config import RigFile
from palpate.drivers.dynamixel import MoveEnd, Servo, ServoGoals, ServoState
from palpate.rig.fingers import HostFinger
from palpate.rig.mechanisms.swept_volume import is_apart
from palpate.rig.motion.array_guard import ArrayReading
from palpate.rig.motion.array_proof import SearchWatch
from palpate.rig.motion.free_force import START_S, torques_nm
from palpate.rig.motion.touch import ApproachState
from palpate.rig.motion.touch_timing import touch_speed_mm_s

ARRIVED_MM = 0.8
"""How near to where it was sent a tip has arrived."""

_STILL_RAD_S = 0.03
_MOTION_THRESHOLD_RAD = 0.003
_FREE_STALL_S = 1.0
_MOVE_TIMEOUT_S = 60.0  # no move takes so long, but a slow one over a long way: one that creeps on is ended
_DEADLINE_FACTOR = 2.0  # than way over speed says
_STALL_S = 0.6
_MAX_CROSS_TRACK_MM = 3.0
_SLOWING_LAG_S = 0.045  # until a finger begins to slow down: the order's way, the servo's lag behind it


class SensingHand(Protocol):
    """Part of a hand that movers need: its rig, and what arrays feel; `proven`: whose have answered."""

    proven: set[HostFinger]

    @property
    def rig(self) -> RigFile:
        """The rig file."""
        ...

    def reading(self, finger: HostFinger, /) -> ArrayReading:
        """Reading of an array in the last pause."""
        ...

    def sampled_s(self, finger: HostFinger, /) -> float:
        """Instant up to which all has been read that an array has sampled."""
        ...

    def take_reading(self, finger: HostFinger, /) -> ArrayReading:
        """Frames of an array that were not taken before, up to now."""
        ...


class _FingerMover:
    """Mover of one finger by its drive."""

    def __init__(self, finger: HostFinger, begin: Callable[[float], ServoGoals]) -> None:
        self.finger = finger
        self.started_s = -math.inf
        self._begin = begin

    @property
    def servos(self) -> Sequence[Servo]:
        """Both servos."""
        return self.finger.drive.servos

    @property
    def streams(self) -> bool:
        """True if the drive does."""
        return self.finger.drive.streams

    def start(self, now: float) -> ServoGoals:
        """Begin; the first goals."""
        self.started_s = now
        return self._begin(now)

    def stream(self, now: float) -> ServoGoals:
        """Goals that the drive writes now."""
        return self.finger.drive.goals(now)

    def is_late(self, now: float) -> bool:
        """True if the move has gone on for longer than it should."""
        return now - self.started_s > self.longest_s()

    def stopped(self, now: float) -> None:
        """Do nothing: it is read again."""

    def longest_s(self) -> float:
        """Time that it may take."""
        return _MOVE_TIMEOUT_S


def _note_position(run: ApproachState, states: Mapping[int, ServoState], now: float) -> None:
    """Note where a finger is."""
    near, far = (states[servo.dxl_id].position_rad for servo in run.finger.drive.servos)
    run.seen((near, far), now)


def _check_cross_track(run: ApproachState) -> None:
    """Raise SafetyStop for a tip that is far beside its line."""
    off_mm = run.cross_track_error_mm
    if off_mm > _MAX_CROSS_TRACK_MM:
        raise SafetyStop(
            f"finger {run.finger.name} is {off_mm:.1f} mm off its way; fingers were stopped; "
            "check what pushes it aside, and if nothing does, raise max_force_n"
        )


class FreeMover(_FingerMover):
    """A finger on its way through free space: it arrives when all its servos stand at their targets.

    `tolerance_rad` of a servo; `begin` tells the drive where to go.
    """

    def __init__(
        self,
        finger: HostFinger,
        begin: Callable[[float], ServoGoals],
        tolerance_rad: Callable[[Servo], float],
        run: ApproachState | None = None,
    ) -> None:
        super().__init__(finger, begin)
        self.tolerance_rad = tolerance_rad
        self._run = run
        self.states: dict[Servo, ServoState] = {}
        self._moved: dict[Servo, float] = {}
        self._moved_s = -math.inf

    @property
    def driven(self) -> Sequence[Servo]:
        """Servos that have a target."""
        return tuple(self.finger.drive.targets())

    def sense(self, _now: float) -> MoveEnd | None:
        """Go on: nothing ends it but arrival."""
        return None

    def look(self, states: Mapping[int, ServoState], now: float) -> None:
        """Note where the servos are, and whether one has moved."""
        self.states = {servo: states[servo.dxl_id] for servo in self.servos}
        if self._run is not None:
            _note_position(self._run, states, now)
        at = {servo: state.position_rad for servo, state in self.states.items()}
        if any(abs(at[servo] - self._moved.get(servo, math.inf)) > _MOTION_THRESHOLD_RAD for servo in at):
            self._moved, self._moved_s = at, now

    def judge(self, now: float) -> MoveEnd | None:
        """Arrival; a stall once no servo of it has moved for a second."""
        if self._run is not None:
            _check_cross_track(self._run)
        if self.finger.drive.under_way(now):
            return None
        targets = self.finger.drive.targets()
        if all(self.is_at(servo, self.states[servo], goal) for servo, goal in targets.items()):
            return MoveEnd.REACHED
        if now - self._moved_s > _FREE_STALL_S:
            return MoveEnd.STALL
        return MoveEnd.DEADLINE if self.is_late(now) else None

    def is_at(self, servo: Servo, state: ServoState, goal_rad: float) -> bool:
        """Arrival of one servo: near its target, and standing still."""
        off = abs(state.position_rad - goal_rad)
        return off <= self.tolerance_rad(servo) and abs(state.velocity_rad_s) <= _STILL_RAD_S


class TipMover(_FingerMover):
    """A finger on its way along its line to `limit_mm`, at `speed_mm_s`, until it feels `contact_n`.

    `others`: fingers that it must not come near; it stops where it would. A finger that stands still short of
    its limit, is pushed off its line or never arrives is a SafetyStop.
    """

    def __init__(
        self,
        hand: SensingHand,
        run: ApproachState,
        limit_mm: float,
        speed_mm_s: float,
        contact_n: float,
        others: Sequence[ApproachState] = (),
    ) -> None:
        self.limit_mm, self._speed_mm_s = limit_mm, speed_mm_s
        super().__init__(run.finger, self._go)
        self.hand, self.run = hand, run
        self._contact_n = contact_n
        self._others = [other for other in others if other is not run]

    def longest_s(self) -> float:
        """Time by its way and speed."""
        return max(super().longest_s(), _DEADLINE_FACTOR * self.limit_mm / self._speed_mm_s)

    @property
    def driven(self) -> Sequence[Servo]:
        """Servos that move along the line."""
        return self.finger.drive.closing_servos

    def start(self, now: float) -> ServoGoals:
        """Begin; from now on standing still counts."""
        self.run.moved_s = now
        return super().start(now)

    def look(self, states: Mapping[int, ServoState], now: float) -> None:
        """Note where the tip is."""
        _note_position(self.run, states, now)

    def sense(self, _now: float) -> MoveEnd | None:
        """A contact, if the newest frame shows one."""
        reading = self.hand.reading(self.finger)
        if reading.force_n <= self._contact_n:
            return None
        self.run.touched, self.run.searching = True, False
        return MoveEnd.CONTACT

    def stopped(self, now: float) -> None:
        """Note that the tip stands or goes back from now on; until that was confirmed it may have gone on."""
        self.run.note_stopped(now)

    @final
    def judge(self, now: float) -> MoveEnd | None:
        """Guards of every motion along a line: cross-track error, deadline, clearance; between them `until`.

        Not overridden, so that no kind of motion leaves one out.
        """
        _check_cross_track(self.run)
        end = self.until(now)
        if end is None and self.is_late(now):
            end = self.held(now)
        if end is None and self.is_crowded():
            end = MoveEnd.CLEARANCE
        if end is not None:
            self.run.searching = False
        if end is MoveEnd.REACHED:
            self.run.note_stopped(now)
        return end

    def until(self, now: float) -> MoveEnd | None:
        """End of this kind of motion: here arrival at the limit, or standing still."""
        at_limit = abs(self.limit_mm - self.run.travel_mm) < ARRIVED_MM
        if at_limit and not self.finger.drive.under_way(now):
            return MoveEnd.REACHED
        return self.held(now) if now - self.run.moved_s > _STALL_S else None

    def held(self, _now: float) -> MoveEnd:
        """End of the motion of a finger that stands still on its way: here of all motion."""
        # one that has not begun to move at all may be held by its own friction
        remedy = "" if self.run.travel_mm > _MAX_CROSS_TRACK_MM else "; if nothing is, raise max_force_n"
        raise self.stop_where_held("stands", remedy)

    def stop_where_held(self, seen: str, remedy: str = "") -> SafetyStop:
        """End of all motion at something that the array does not feel; `seen`: what the finger does."""
        force_n, name = self.hand.reading(self.finger).force_n, self.finger.name
        if not self.finger.spec.array.has_device:
            return SafetyStop(
                f"finger {name} is held: it {seen} after {self.run.travel_mm:.1f} mm of its way, by no more "
                "than friction may take; fingers were stopped; clear what holds it, or raise max_force_n"
            )
        felt = f"feels {force_n:.2g} N" if force_n else "feels nothing"
        return SafetyStop(
            f"finger {name} is held: it {seen} after {self.run.travel_mm:.1f} mm of its way, and its array "
            f"{felt}; fingers were stopped; look at it: if its tip has met something, see with palpate check "
            f"--press whether array {name} answers; if something else is in its way, clear it{remedy}"
        )

    def _go(self, now: float) -> ServoGoals:
        run = self.run
        return self.finger.drive.go(run.line, run.travel_mm, self.limit_mm, self._speed_mm_s, now)

    def is_crowded(self) -> bool:
        """True if another finger is nearer than the rig file's clearance_mm, or may be at the next look.

        Until then both go on about as far as they have come since the last one.
        """
        own, clearance_mm = self.run.body(), self.hand.rig.closing.clearance_mm + self.run.advance_mm
        return not all(is_apart(own, other.body(), clearance_mm + other.advance_mm) for other in self._others)


class SearchMover(TipMover):
    """Search: fast through proven free space, slower from there on, and off the part again at once.

    After a contact the finger stops, and goes back by back_off_mm by itself: it does not press while others
    are still under way. The last one `may_stay`: where its touch is a slow one already. `is_back`: it has
    gone back.
    """

    def __init__(
        self,
        hand: SensingHand,
        run: ApproachState,
        others: Sequence[ApproachState],
        watch: SearchWatch,
        *,
        may_stay: bool = False,
    ) -> None:
        """`watch`: over all arrays while any of `others` searches."""
        self._may_stay, self._watch = may_stay, watch
        closing, approach = hand.rig.closing, run.approach
        self._fast_mm_s = closing.approach_speed_mm_s
        self._search_mm_s = touch_speed_mm_s(approach, closing.search_mm_s)
        self._slow_from_mm = approach.fast_mm - _SLOWING_LAG_S * self._fast_mm_s
        self._slow_from_mm -= run.finger.drive.slowing_mm(self._fast_mm_s, self._search_mm_s)
        self._is_fast = run.travel_mm < self._slow_from_mm
        self._turns = self.is_back = False
        self._needs_n, self._needs_s = 0.0, math.inf
        self._looked_s = math.inf
        speed = self._fast_mm_s if self._is_fast else self._search_mm_s
        super().__init__(hand, run, approach.travel_mm, speed, closing.contact_force_n, others)

    def longest_s(self) -> float:
        """Time as if it were slow all the way."""
        return max(super().longest_s(), _DEADLINE_FACTOR * self.limit_mm / self._search_mm_s)

    def sense(self, now: float) -> MoveEnd | None:
        """A contact turns it, or ends its way; on its way back it still feels the part.

        It ends, too, where the contact of another finger, or its own, is to be proven.
        """
        if self.is_back:
            return None
        suspect = self._watch.look()
        if suspect is not None and suspect is not self.finger:
            return MoveEnd.ENOUGH
        if super().sense(now) is None:
            self._check_currents()
            return None
        if suspect is not None:
            return MoveEnd.CONTACT
        if self._may_stay and not any(other.searching for other in self._others):
            return MoveEnd.CONTACT
        self.is_back = self._turns = True
        return MoveEnd.TURN

    def look(self, states: Mapping[int, ServoState], now: float) -> None:
        """Note where the tip is; of an array not yet proven, since when currents show a contact."""
        super().look(states, now)
        self._looked_s = now
        if self.is_back or self.finger in self.hand.proven or now - self.started_s < START_S:
            self._needs_n, self._needs_s = 0.0, math.inf
            return
        line, at_mm, angles = self.run.line, self.run.travel_mm, self.finger.kinematics.servos_rad
        from_mm = max(0.0, min(at_mm, self.limit_mm) - 1.0)
        ahead = np.subtract(angles(line, from_mm + 1.0), angles(line, from_mm))
        torques = torques_nm({servo: states[servo.dxl_id] for servo in self.servos})
        free = self.run.free_force
        excess_n = free.excess_n(float(1000 * torques @ ahead), at_mm, now)  # of less than 0 while it brakes
        contact_n = self._contact_n + free.contact_n
        self._needs_n = excess_n if excess_n > contact_n else 0.0
        self._needs_s = min(self._needs_s, now) if excess_n > contact_n / 3 else math.inf

    def _check_currents(self) -> None:
        """Raise SafetyStop for a contact that currents show and the array has not felt since."""
        felt_s = self.hand.sampled_s(self.finger) - self.finger.spec.array.lag_s
        if self._needs_n and self._needs_s < felt_s:
            raise self.stop_where_held(f"needs {self._needs_n:.1f} N more than before")

    def until(self, now: float) -> MoveEnd | None:
        """The end is that of either way."""
        if self._turns:
            return None
        self._check_currents()
        return super().until(now)

    def stream(self, now: float) -> ServoGoals:
        """The way back, or the slower speed, once."""
        if self._turns:
            self._turns = False
            self.limit_mm = max(0.0, self.run.travel_mm - self.hand.rig.closing.back_off_mm)
            self._speed_mm_s = self._fast_mm_s
            return self.start(now)
        came_mm = self._fast_mm_s * max(now - self._looked_s, 0.0)  # at most, since the last look
        if self._is_fast and not self.is_back and self.run.travel_mm + came_mm >= self._slow_from_mm:
            self._is_fast = False
            return self.finger.drive.slow_down(self._search_mm_s, now)
        return super().stream(now)

    def is_crowded(self) -> bool:
        """Not on the way back: it was free just now."""
        return not self.is_back and super().is_crowded()
