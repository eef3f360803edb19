"""Guarded closing: fingers move along straight lines and stop at what they touch.

From planned approaches to contacts. Each finger touches twice: quickly to find the object, then, after
backing off a little, slowly to measure it. All chosen fingers move at once; the loop runs once per tactile
sample, and every finger stops by itself. A finger that comes too close to another one stops where it is: its
free way so far is still evidence.
"""

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from enum import Enum

from palpate.drivers.dynamixel.failures import WatchdogTripped
from palpate.drivers.dynamixel.servo import Servo, stop_at, write_goals
from palpate.drivers.finger import Line, Turn
from palpate.drivers.tactile.contact import ContactPatch
from palpate.errors import DeviceError, SafetyStop
from palpate.rig.concluding import Touch, concluded
from palpate.rig.drives import AIM_TOLERANCE_RAD, Drive, Goals
from palpate.rig.hand import SPEAK_S, Hand, HostFinger
from palpate.rig.reach import Close
from palpate.rig.room import gap_mm, pieces_of
from palpate.rig.run import Run
from palpate.rig.stage import planned_turn

__all__ = ["Close", "Measure", "Stage", "Touch", "aim", "begin", "close_fingers", "go_to", "look"]
__all__ += ["measure_at_rest", "retract_all"]

_STATE_EVERY = 5  # samples between looks at the servos while nothing is touched, if that is soon enough
_ARRIVED_MM = 0.8
_STALLED_S = 0.6
_SILENT_S = 0.15
_SILENT_FRAMES = 3  # that long at least, for slow arrays
_OFF_WAY_MM = 3.0
_SETTLE_S = 0.08
_MEASURE_FRAMES = 8
_MOST_BACKS = 3
_FREE_SHARE = 0.25  # of the way back: a slow touch that comes sooner was no new touch


Measure = Callable[[Hand, Sequence[Run]], list[tuple[Run, ContactPatch | None]]]
"""How fingers that rest in contact, or have met nothing, are measured: their patches, in their order."""


class Stage(Enum):
    """What a finger is doing, for whoever shows progress."""

    AIMING = "aiming"
    CLOSING = "closing"
    TOUCHING = "touching"
    RETRACTING = "retracting"


def close_fingers(
    hand: Hand,
    grip: Sequence[Close],
    tell: Callable[[Stage], None],
    measure: Measure | None = None,
) -> list[Touch]:
    """Carry out a grip: aim, close, touch, measure, retract. Fingers must be retracted and stay so between.

    `measure`: how contacts are measured after the slow touch, None for where fingers rest. A grip in which a
    servo's Bus Watchdog trips is begun once more. Raises DeviceError for a device that fails and SafetyStop
    for a finger that is held by something it does not feel; the hand's `close` then ends all motion.
    """
    under_way: list[Run] = []
    try:
        return _carry_out(hand, grip, tell, measure or measure_at_rest, under_way)
    except WatchdogTripped as tripped:
        hand.notice(f"{tripped}; the grip is begun again")
    hand.arm()
    if under_way:
        look(hand, under_way)
        go_to(hand, dict.fromkeys(under_way, 0.0))
    return _carry_out(hand, grip, tell, measure or measure_at_rest, [])


def _carry_out(
    hand: Hand,
    grip: Sequence[Close],
    tell: Callable[[Stage], None],
    measure: Measure,
    under_way: list[Run],
) -> list[Touch]:
    """Carry out a grip; `under_way` is filled with the fingers that have left where they wait."""
    tell(Stage.AIMING)
    hand.arm()
    retract_all(hand)
    turn = _turn(hand, {item.stage_rad for item in grip})
    runs = [Run.of(hand.fingers[item.finger_index], item, turn) for item in grip]
    aim(hand, runs)
    under_way += runs
    hand.tare()
    tell(Stage.CLOSING)
    for run in runs:
        run.limit_mm = run.close.travel_mm
    _move_until_touched(hand, runs, hand.rig.closing.approach_speed_mm_s)
    _settle(hand, runs)
    found = [run for run in runs if run.touched]
    patches: dict[str, ContactPatch | None] = {}
    if found:
        tell(Stage.TOUCHING)
        patches = {run.finger.name: patch for run, patch in _measured(hand, found, measure)}
    turned = hand.turn
    touches = [concluded(run, patches.get(run.finger.name), hand.rig.closing, turned) for run in runs]
    tell(Stage.RETRACTING)
    hand.stop_arrays()
    go_to(hand, dict.fromkeys(runs, 0.0))
    hand.disarm()
    return touches


def retract_all(hand: Hand) -> None:
    """Let every finger go back to where it waits, also those that take no part."""
    goals = {servo: goal for finger in hand.fingers for servo, goal in finger.drive.retract().items()}
    if goals:
        write_goals(hand.bus, goals, confirm=True)
        _wait(hand, goals, {servo: finger.drive for finger in hand.fingers for servo in finger.drive.servos})


def _turn(hand: Hand, wanted_rad: Collection[float]) -> Turn:
    """Turn the stage to a grip's angle, which all its approaches share; every finger goes home first.

    Returns the turn that was asked for: the lines of a grip are computed for it.
    """
    if len(set(wanted_rad)) > 1:
        raise ValueError("approaches of one grip are for different stage angles")
    angle = next(iter(wanted_rad), 0.0)
    stage = hand.stage
    if stage is None:
        return Turn()
    goal = {stage.servo: stage.goal_rad(angle)}
    now_at = hand.states([stage.servo])[stage.servo.dxl_id].position_rad
    if abs(now_at - goal[stage.servo]) > AIM_TOLERANCE_RAD:
        _to_lines(hand, {finger: finger.home for finger in hand.fingers})
        write_goals(hand.bus, goal, confirm=True)
        hand.wait_still(goal, lambda _: AIM_TOLERANCE_RAD)
    return planned_turn(stage.spec, angle)


def _to_lines(hand: Hand, lines: Mapping[HostFinger, Line]) -> None:
    """Let fingers go to where lines start, outside of the workspace."""
    fingers = list(lines)
    present = hand.servos_of(fingers)
    now = hand.clock.now()
    goals = _every(finger.drive.aim(lines[finger], present[finger], now) for finger in fingers)
    begin(hand, goals, fingers)
    _stream(hand, fingers)
    hand.wait_still(_every(finger.drive.targets() for finger in fingers), lambda _: AIM_TOLERANCE_RAD)


def aim(hand: Hand, runs: Sequence[Run]) -> None:
    """Turn fingers to where their lines start, outside of the workspace."""
    _to_lines(hand, {run.finger: run.line for run in runs})
    found = hand.servos_of([run.finger for run in runs])
    for run in runs:
        run.begin(found[run.finger])


def go_to(hand: Hand, travels_mm: Mapping[Run, float]) -> None:
    """Move along lines through space that is known to be free, and wait until fingers are there."""
    now = hand.clock.now()
    speed = hand.rig.closing.approach_speed_mm_s
    goals = [run.finger.drive.go(run.line, run.travel_mm, to, speed, now) for run, to in travels_mm.items()]
    fingers = [run.finger for run in travels_mm]
    begin(hand, _every(goals), fingers)
    _stream(hand, fingers)
    _wait(
        hand,
        _every(run.finger.drive.targets() for run in travels_mm),
        {servo: run.finger.drive for run in travels_mm for servo in run.finger.drive.servos},
    )
    look(hand, list(travels_mm))


def _wait(hand: Hand, goals: Goals, drive_of: Mapping[Servo, Drive]) -> None:
    hand.wait_still(goals, lambda servo: drive_of[servo].reached_rad(servo, _ARRIVED_MM))


def begin(hand: Hand, goals: Goals, fingers: Sequence[HostFinger]) -> None:
    """Write the first goals of a move. One that is followed by others need not be confirmed."""
    streamed = {servo for finger in fingers if finger.drive.streams for servo in finger.drive.servos}
    write_goals(hand.bus, {s: goal for s, goal in goals.items() if s in streamed})
    write_goals(hand.bus, {s: goal for s, goal in goals.items() if s not in streamed}, confirm=True)


def _stream(hand: Hand, fingers: Sequence[HostFinger]) -> None:
    """Write goals every sample until the last ones are written, and see to it that those arrived."""
    period = 1 / hand.rig.closing.sample_rate_hz
    streaming = [finger for finger in fingers if finger.drive.under_way(hand.clock.now())]
    while any(finger.drive.under_way(hand.clock.now()) for finger in streaming):
        hand.pause(period)
        _write(hand, streaming)
    write_goals(hand.bus, _every(finger.drive.targets() for finger in streaming), confirm=True)


def _write(hand: Hand, fingers: Sequence[HostFinger]) -> None:
    goals = _every(finger.drive.goals(hand.clock.now()) for finger in fingers)
    if goals:
        write_goals(hand.bus, goals)


def _every(parts: Iterable[Goals]) -> dict[Servo, float]:
    return {servo: goal for part in parts for servo, goal in part.items()}


def _move_until_touched(hand: Hand, runs: Sequence[Run], speed_mm_s: float) -> None:
    """Send every finger towards its limit and stop each at its own contact, limit or neighbour."""
    now = hand.clock.now()
    for run in runs:
        run.touched = run.done = False
        run.moved_s = run.heard_s = now
    goals = [run.finger.drive.go(run.line, run.travel_mm, run.limit_mm, speed_mm_s, now) for run in runs]
    begin(hand, _every(goals), [run.finger for run in runs])
    look(hand, runs)
    count = 0
    period = 1 / hand.rig.closing.sample_rate_hz
    look_every = max(1, min(_STATE_EVERY, int(SPEAK_S / period)))
    while active := [run for run in runs if not run.done]:
        hand.clock.sleep(period)
        touched = [run for run in active if _feels(hand, run)]
        if touched:
            _stop(hand, touched)
            for run in touched:
                run.touched = run.done = True
        _write(hand, [run.finger for run in runs if not run.done])
        count += 1
        streaming = [run for run in runs if run.finger.drive.streams]
        if count % look_every == 0:
            look(hand, runs)
            _watch(hand, runs)
        elif streaming:
            look(hand, streaming)


def _feels(hand: Hand, run: Run) -> bool:
    """Whether the newest frames show a contact; raises DeviceError if frames have stopped coming."""
    frames = run.finger.array.frames()
    now = hand.clock.now()
    if not frames:
        allowed = max(_SILENT_S, _SILENT_FRAMES / hand.rig.closing.sample_rate_hz)
        if now - run.heard_s > allowed:
            raise DeviceError(
                f"tactile array {run.finger.name} on {run.finger.spec.array.port} has sent nothing for "
                f"{allowed:g} s while its finger moved; fingers were stopped; check its cable"
            )
        return False
    run.heard_s = now
    run.finger.extractor.follow(frames)
    threshold = hand.rig.closing.contact_force_n
    hard = hand.rig.closing.max_force_n
    force = run.finger.extractor.force_n(frames[-1])
    if force > hard:
        raise SafetyStop(
            f"finger {run.finger.name} felt {force:.1f} N, above max_force_n = {hard:g} N; "
            "fingers were stopped; lower approach_speed_mm_s"
        )
    return force > threshold


def _stop(hand: Hand, runs: Sequence[Run]) -> None:
    """Hold fingers where they are now."""
    servos = [servo for run in runs for servo in run.finger.drive.closing_servos]
    states = hand.states(servos)
    stop_at(hand.bus, {servo: servo.nearest_rad(states[servo.dxl_id].position_rad) for servo in servos})


def look(hand: Hand, runs: Sequence[Run]) -> None:
    """Note where fingers are; raises if one of their servos has died or is off."""
    # Servos that only hold are looked at too: one that has died or is pushed aside spoils what is measured.
    found = hand.servos_of([run.finger for run in runs])
    now = hand.clock.now()
    for run in runs:
        run.seen(found[run.finger], now)


def _watch(hand: Hand, runs: Sequence[Run]) -> None:
    """Fingers at their limits are done; those too near to another one stop; a held one stops everything."""
    now = hand.clock.now()
    for run in runs:
        if run.done:
            continue
        if abs(run.limit_mm - run.travel_mm) < _ARRIVED_MM and not run.finger.drive.under_way(now):
            run.done = True
        elif now - run.moved_s > _STALLED_S:
            raise SafetyStop(
                f"finger {run.finger.name} is held after {run.travel_mm:.1f} mm of its way by something "
                "that its array does not feel; fingers were stopped; clear its way"
            )
        if run.off_mm > _OFF_WAY_MM:
            raise SafetyStop(
                f"finger {run.finger.name} is {run.off_mm:.1f} mm off its way; fingers were stopped; "
                "check what pushes it aside, and if nothing does, raise max_force_n"
            )
    crowded = [run for run in runs if not run.done and _is_crowded(hand, run, runs)]
    if crowded:
        _stop(hand, crowded)
        for run in crowded:
            run.done = True


def _is_crowded(hand: Hand, run: Run, runs: Sequence[Run]) -> bool:
    own = pieces_of([run.body()])
    others = (pieces_of([other.body()]) for other in runs if other is not run)
    return any(float(gap_mm(own, other).min()) < hand.rig.closing.clearance_mm for other in others)


def _measured(hand: Hand, runs: Sequence[Run], measure: Measure) -> list[tuple[Run, ContactPatch | None]]:
    """Back off, touch again slowly, let everything settle, and measure."""
    _settle(hand, runs)
    again, back = list(runs), hand.rig.closing.back_off_mm
    for _ in range(_MOST_BACKS):
        again = _touched_at_once(hand, again, back)
        if not again:
            break
        back *= 2  # they had run further into it than they backed off
    return measure(hand, runs)


def measure_at_rest(hand: Hand, runs: Sequence[Run]) -> list[tuple[Run, ContactPatch | None]]:
    """What the arrays feel while fingers rest; None for those that do not touch."""
    measured = hand.collect([run.finger for run in runs], _MEASURE_FRAMES)
    return [
        (run, run.finger.extractor.extract(frames) if run.touched else None)
        for run, frames in zip(runs, measured, strict=True)
    ]


def _touched_at_once(hand: Hand, runs: Sequence[Run], back_mm: float) -> list[Run]:
    """Back off and touch again slowly; the fingers that felt something before they had really moved.

    They had not come free, so their play is not where a touch has it.
    """
    go_to(hand, {run: max(0.0, run.travel_mm - back_mm) for run in runs})
    begun = {run: run.travel_mm for run in runs}
    _move_until_touched(hand, runs, hand.rig.closing.touch_speed_mm_s)
    _settle(hand, runs)
    return [run for run in runs if run.touched and run.travel_mm - begun[run] < _FREE_SHARE * back_mm]


def _settle(hand: Hand, runs: Sequence[Run]) -> None:
    hand.pause(_SETTLE_S)
    look(hand, runs)
