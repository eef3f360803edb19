"""Guarded moves: servos go to their goals, and each stops by itself at contact or where it is held.

Above `servo` and `state`; the rig's hand waits through it. Nothing here is as quick as a loop over tactile
frames (that is the rig's closing): it is for moves through space that is known to be free, or towards a
stop.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum

from palpate.drivers.dynamixel.bus import Bus
from palpate.drivers.dynamixel.servo import Servo, stop_at, write_goals
from palpate.drivers.dynamixel.state import ServoState
from palpate.drivers.transport.clock import Clock

__all__ = ["End", "Guard", "guarded_move", "wait_still"]

ReadStates = Callable[[Sequence[Servo]], Mapping[int, ServoState]]
"""Reads servos' states by id; raises what is wrong with one."""


class End(Enum):
    """How a servo's move ended."""

    REACHED = "reached"
    CONTACT = "contact"
    STALL = "stall"


@dataclass(frozen=True, slots=True)
class Guard:
    """When a servo counts as still, and when as held.

    Still: slower than `still_rad_s` and within its tolerance of the goal. Held: for `stall_s` it has not
    moved by `moved_rad`. `poll_s`: time between two looks.
    """

    still_rad_s: float = 0.03
    moved_rad: float = 0.003
    stall_s: float = 1.0
    poll_s: float = 0.02


def guarded_move(
    bus: Bus,
    read: ReadStates,
    clock: Clock,
    goals_rad: Mapping[Servo, float],
    tolerance_rad: Callable[[Servo], float],
    felt: Callable[[Servo, ServoState], bool] = lambda _servo, _state: False,
    guard: Guard = Guard(),
) -> dict[Servo, End]:
    """Send servos to their goals; each stops where `felt` says that it touches, or where it is held.

    `felt` is asked with every servo's state at every look; a current above what free motion needs will do.
    Raises SafetyStop for a goal out of range, with nothing sent, and what `read` raises.
    """
    write_goals(bus, goals_rad, confirm=True)

    def look(states: Mapping[int, ServoState], left: Sequence[Servo]) -> list[Servo]:
        return [servo for servo in left if felt(servo, states[servo.dxl_id])]

    return _watch(bus, read, clock.now, clock.sleep, goals_rad, tolerance_rad, look, guard)


def wait_still(
    bus: Bus,
    read: ReadStates,
    now: Callable[[], float],
    pause: Callable[[float], None],
    goals_rad: Mapping[Servo, float],
    tolerance_rad: Callable[[Servo], float],
    guard: Guard = Guard(),
) -> dict[Servo, End]:
    """Wait until servos that are on their way stand still at their goals; one that is held is stopped."""
    return _watch(bus, read, now, pause, goals_rad, tolerance_rad, lambda _states, _left: [], guard)


def _watch(
    bus: Bus,
    read: ReadStates,
    now: Callable[[], float],
    pause: Callable[[float], None],
    goals_rad: Mapping[Servo, float],
    tolerance_rad: Callable[[Servo], float],
    touching: Callable[[Mapping[int, ServoState], Sequence[Servo]], list[Servo]],
    guard: Guard,
) -> dict[Servo, End]:
    ends: dict[Servo, End] = {}
    moved: dict[Servo, tuple[float, float]] = {}
    while left := [servo for servo in goals_rad if servo not in ends]:
        pause(guard.poll_s)
        states = read(left)
        ended = dict.fromkeys(touching(states, left), End.CONTACT)
        for servo in left:
            state = states[servo.dxl_id]
            off = abs(state.position_rad - goals_rad[servo])
            if servo not in moved or abs(state.position_rad - moved[servo][0]) > guard.moved_rad:
                moved[servo] = (state.position_rad, now())
            if servo in ended:
                continue
            if off <= tolerance_rad(servo) and abs(state.velocity_rad_s) <= guard.still_rad_s:
                ends[servo] = End.REACHED
            elif now() - moved[servo][1] > guard.stall_s:
                ended[servo] = End.STALL
        if ended:
            stop_at(bus, {servo: servo.nearest_rad(states[servo.dxl_id].position_rad) for servo in ended})
        ends.update(ended)
    return ends
