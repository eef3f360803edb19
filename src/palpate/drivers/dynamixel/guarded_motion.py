"""Guarded motion: drives servos until each mover ends by arrival, contact, stall or deadline.

`guarded_loop` is the only loop that moves anything: it writes goals, lets time pass, and stops each mover by
itself. Every guard is in it or in what it is given: `pause` lets time pass and raises where arrays, outputs
or an interrupt end all motion; `read` raises for a servo that has failed, restarted, tripped its Bus Watchdog
or was switched off. `guarded_move` drives servos by themselves; the rig's fingers are movers, too.
"""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Protocol, TypeVar

from palpate.drivers.dynamixel.bus import Bus
from palpate.drivers.dynamixel.servo import Servo, stop_at, write_goals
from palpate.drivers.dynamixel.servo_state import ServoState, StateReader
from palpate.drivers.transport.clock import Clock

ServoGoals = Mapping[Servo, float]
"""Servo angles (rad) to be written, or to be reached."""

ReadStates = Callable[[Sequence[Servo]], Mapping[int, ServoState]]
"""Reads servos' states by id; raises what is wrong with one."""


class MoveEnd(Enum):
    """End of a mover's part of a guarded move; after TURN it is stopped, and goes on with a new goal."""

    REACHED = "reached"
    CONTACT = "contact"
    STALL = "stall"
    DEADLINE = "deadline"
    CLEARANCE = "clearance"
    ENOUGH = "enough"
    TURN = "turn"


class Mover(Protocol):
    """Unit that moves and stops as one: a servo, or a finger. Hashed by identity."""

    @property
    def servos(self) -> Sequence[Servo]:
        """Servos that are read, whether they move or hold."""
        ...

    @property
    def driven(self) -> Sequence[Servo]:
        """Servos that move, and are stopped at any end but REACHED."""
        ...

    @property
    def streams(self) -> bool:
        """True if goals follow one another each period, so that a lost one need not be written again."""
        ...

    def start(self, now: float, /) -> ServoGoals:
        """Set profiles; the first goals."""
        ...

    def stream(self, now: float, /) -> ServoGoals:
        """Goals of this period, at its end; empty where the servos know enough."""
        ...

    def sense(self, now: float, /) -> MoveEnd | None:
        """Each period, before anything else: an end that arrays report, such as a contact.

        After TURN the mover is stopped, and goes on with what it streams next.
        """
        ...

    def look(self, states: Mapping[int, ServoState], now: float, /) -> None:
        """Note the states of `servos`."""
        ...

    def stopped(self, now: float, /) -> None:
        """Note that the servos have been told to stop, and have confirmed it."""
        ...

    def judge(self, now: float, /) -> MoveEnd | None:
        """After all states are noted: an end that servos report. Raises what must end all motion."""
        ...


_M = TypeVar("_M", bound=Mover)


def guarded_loop(
    bus: Bus,
    read: ReadStates,
    now: Callable[[], float],
    pause: Callable[[float], None],
    movers: Sequence[_M],
    *,
    period_s: float,
    read_every: int = 1,
) -> dict[_M, MoveEnd]:
    """Drive all movers at once until each has ended; returns how.

    Servos are read in every `read_every`-th period, streaming movers' in each. Raises SafetyStop for a goal
    out of range, with nothing sent, and what `pause`, `read` and the movers raise. The loop leaves torque
    as it is, also when it raises: the caller switches it off, on a rig `Hand.__exit__` at the end of its
    `with` block, in a script of its own a `finally` with `disable_torque`.
    """
    _write(bus, {mover: mover.start(now()) for mover in movers})
    _read_states(read, movers, now)
    streaming = [mover for mover in movers if mover.streams]
    ends: dict[_M, MoveEnd] = {}
    left, periods = list(movers), 0
    while left:
        pause(period_s)
        periods += 1
        if ended := {mover: end for mover in left if (end := mover.sense(now())) is not None}:
            _stop(bus, read, now, list(ended))
            ends |= {mover: end for mover, end in ended.items() if end is not MoveEnd.TURN}
            left = [mover for mover in left if mover not in ends]
        if periods % read_every == 0:
            _read_states(read, movers, now)
            if ended := {mover: end for mover in left if (end := mover.judge(now())) is not None}:
                _stop(bus, read, now, [mover for mover, end in ended.items() if end is not MoveEnd.REACHED])
                ends |= ended
                left = [mover for mover in left if mover not in ended]
        elif streaming:
            _read_states(read, streaming, now)
        _write(bus, _next_goals(left, now, period_s))
    return ends


def hold(bus: Bus, read: ReadStates, servos: Sequence[Servo]) -> None:
    """Stop servos where they are now, whatever they were on their way to."""
    states = read(servos)
    stop_at(bus, {servo: servo.nearest_rad(states[servo.dxl_id].position_rad) for servo in servos})


def _next_goals(movers: Sequence[_M], now: Callable[[], float], period_s: float) -> dict[_M, ServoGoals]:
    """Goals of this period. A mover that sets its speed over a slow adapter takes longer than that.

    Then those after it wait for the next period: others may be moving, and their arrays are looked at first.
    """
    begun_s, goals = now(), dict[_M, ServoGoals]()
    for mover in movers:
        goals[mover] = mover.stream(now())
        if now() - begun_s >= period_s:
            break
    return goals


def _write(bus: Bus, goals: Mapping[_M, ServoGoals]) -> None:
    """Write goals, if there are any; confirmed, but for those that others follow."""
    if not any(goals.values()):
        return
    write_goals(bus, _merge_goals(part for mover, part in goals.items() if mover.streams))
    write_goals(bus, _merge_goals(part for mover, part in goals.items() if not mover.streams), confirm=True)


def _stop(bus: Bus, read: ReadStates, now: Callable[[], float], movers: Sequence[Mover]) -> None:
    """Hold movers where they are now; they look once more."""
    if movers:
        states = _read_states(read, movers, now)
        driven = [servo for mover in movers for servo in mover.driven]
        stop_at(bus, {servo: servo.nearest_rad(states[servo.dxl_id].position_rad) for servo in driven})
        for mover in movers:
            mover.stopped(now())


def _read_states(
    read: ReadStates, movers: Sequence[Mover], now: Callable[[], float]
) -> Mapping[int, ServoState]:
    # Servos that only hold are read, too: one that has died or is pushed aside spoils what is measured.
    states = read([servo for mover in movers for servo in mover.servos])
    for mover in movers:
        mover.look(states, now())
    return states


def _merge_goals(parts: Iterable[ServoGoals]) -> dict[Servo, float]:
    return {servo: goal for part in parts for servo, goal in part.items()}


@dataclass(frozen=True, slots=True)
class Guard:
    """Criteria for a servo that is still, held, or too late.

    Still: slower than `still_rad_s` and within its tolerance of the goal. Held: for `stall_s` it has not
    moved by `moved_rad`. Too late: `deadline_s` after the start it has not arrived. `poll_s`: time between
    two looks.
    """

    still_rad_s: float = 0.03
    moved_rad: float = 0.003
    stall_s: float = 1.0
    deadline_s: float = 60.0
    poll_s: float = 0.02


class ServoMover:
    """One servo on its way to a goal."""

    streams = False

    def __init__(
        self,
        servo: Servo,
        goal_rad: float,
        tolerance_rad: float,
        guard: Guard = Guard(),
        contact: Callable[[ServoState], bool] = lambda _: False,
    ) -> None:
        """`contact` judges each state that is read."""
        self.servo = servo
        self.seen: list[tuple[float, ServoState]] = []
        self._goal_rad, self._tolerance_rad = goal_rad, tolerance_rad
        self._guard, self._contact = guard, contact
        self._started_s = self.moved_s = -math.inf
        self._moved_rad = math.inf

    @property
    def servos(self) -> Sequence[Servo]:
        """The servo."""
        return (self.servo,)

    @property
    def driven(self) -> Sequence[Servo]:
        """The servo."""
        return (self.servo,)

    def start(self, now: float) -> ServoGoals:
        """The goal."""
        self._started_s = self.moved_s = now
        return {self.servo: self._goal_rad}

    def stream(self, _now: float) -> ServoGoals:
        """Do nothing: the servo knows its goal."""
        return {}

    def sense(self, _now: float) -> MoveEnd | None:
        """Do nothing: a servo has no array."""
        return None

    def look(self, states: Mapping[int, ServoState], now: float) -> None:
        """Keep time and state."""
        state = states[self.servo.dxl_id]
        self.seen.append((now, state))
        if abs(state.position_rad - self._moved_rad) > self._guard.moved_rad:
            self._moved_rad, self.moved_s = state.position_rad, now

    def stopped(self, now: float) -> None:
        """Do nothing: the goal that was written is enough."""

    def judge(self, now: float) -> MoveEnd | None:
        """Contact, arrival, stall or deadline, in this order."""
        state = self.seen[-1][1]
        if self._contact(state):
            return MoveEnd.CONTACT
        off = abs(state.position_rad - self._goal_rad)
        if off <= self._tolerance_rad and abs(state.velocity_rad_s) <= self._guard.still_rad_s:
            return MoveEnd.REACHED
        if now - self.moved_s > self._guard.stall_s:
            return MoveEnd.STALL
        return MoveEnd.DEADLINE if now - self._started_s > self._guard.deadline_s else None


def guarded_move(
    reader: StateReader,
    clock: Clock,
    goals_rad: ServoGoals,
    *,
    tolerance_rad: float = 0.02,
    contact: Callable[[Servo, ServoState], bool] = lambda _servo, _state: False,
    guard: Guard = Guard(),
) -> dict[Servo, MoveEnd]:
    """Guarded move of servos without a rig: each drives to its goal, or until contact, stall or deadline.

    `contact` judges each state that is read; a current above what free motion needs will do. Raises
    SafetyStop for a goal out of range, with nothing sent, and the errors of states. Torque stays on in any
    case: the caller switches it off.
    """

    def mover(servo: Servo, goal_rad: float) -> ServoMover:
        return ServoMover(servo, goal_rad, tolerance_rad, guard, lambda state: contact(servo, state))

    movers = [mover(servo, goal) for servo, goal in goals_rad.items()]
    ends = guarded_loop(
        reader.bus,
        lambda servos: reader.read(servos).all(),
        clock.now,
        clock.sleep,
        movers,
        period_s=guard.poll_s,
    )
    return {mover.servo: end for mover, end in ends.items()}
