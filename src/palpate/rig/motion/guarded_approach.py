"""Guarded approach: fingers move along straight lines until contact, limit, stall or deadline.

Each finger touches twice: quickly to find the object, when it backs off at once, then slowly to measure it.
Where the search is that slow already, the last finger to touch stays where it is. All chosen fingers move at
once; the loop runs once per tactile sample, and every finger stops by itself. A finger that comes too close
to another one stops where it is: its free way so far is still evidence.
"""

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from enum import Enum
from functools import partial

from palpate.drivers.dynamixel import MoveEnd, Servo, ServoGoals, WatchdogTripped
from palpate.drivers.kinematics import TICK_RAD, Line, Turn
from palpate.drivers.tactile import ArrayLost, ContactPatch
from palpate.recognizer import FREE_MARGIN_MM, FingerApproach
from palpate.rig.fingers import HostFinger, Stage
from palpate.rig.mechanisms.mechanism import AIM_TOLERANCE_RAD
from palpate.rig.motion.array_proof import SearchWatch
from palpate.rig.motion.finger_movers import ARRIVED_MM, FreeMover, SearchMover, TipMover
from palpate.rig.motion.free_force import START_S
from palpate.rig.motion.hand import BUS_KEEPALIVE_S, Hand
from palpate.rig.motion.load_meter import LIGHT_FORCE_FACTOR, TouchStage
from palpate.rig.motion.touch import ApproachState, Touch, conclude
from palpate.rig.motion.touch_timing import (
    MEASURE_FRAMES,
    RETOUCH_MARGIN_MM,
    SAMPLES_PER_STATE_READ,
    SETTLE_S,
    load_meter_of,
    search_stage,
    touch_speed_mm_s,
)

_FREE_PERIOD_S = 0.02
_MAX_SETTLE_STEPS = 8  # of that time, until fingers stand
_STILL_RAD = 1.5 * TICK_RAD  # a servo that stands may be read a step off
_MAX_BACK_OFFS = 3
_MAX_STEADY_STEPS = 25  # of that time, until arrays are steady, too
_MAX_STEADY_S = 0.15  # that arrays may take for it and are as declared
_MIN_FREE_SHARE = 0.25  # of the way back: a slow touch that comes sooner was no new touch

Measure = Callable[[Hand, Sequence[ApproachState]], list[tuple[ApproachState, ContactPatch | None]]]
"""How fingers that rest in contact, or have met nothing, are measured: their patches, in their order."""


class GripPhase(Enum):
    """Phase of a grip, as progress is reported."""

    AIMING = "aiming"
    CLOSING = "closing"
    TOUCHING = "touching"
    RETRACTING = "retracting"


def carry_out_grip(
    hand: Hand,
    grip: Sequence[FingerApproach],
    tell: Callable[[GripPhase], None],
    measure: Measure | None = None,
) -> list[Touch]:
    """Carry out a grip: aim, close, touch, measure, retract. Fingers must be retracted and stay so between.

    `measure`: how contacts are measured after the slow touch, None for where fingers rest. A grip in which
    a servo's Bus Watchdog trips, or an array is lost and comes back, is begun once more; its touches then
    have no trace. Raises DeviceError for a
    device that fails and SafetyStop for a finger that is held by something its array does not feel. Torque
    stays on at every way out; the end of the hand's `with` block switches it off.
    """
    under_way: list[ApproachState] = []
    try:
        return _carry_out(hand, grip, tell, measure or measure_at_rest, under_way)
    except WatchdogTripped as tripped:
        hand.notice(f"{tripped}; the grip is begun again")
    except ArrayLost as lost:
        hand.take_up_again(lost)
    while True:
        try:
            again = _carry_out_again(hand, grip, tell, measure or measure_at_rest, under_way)
        except ArrayLost as lost:
            hand.take_up_again(lost)  # as often as that lets it
        else:  # what the first tries did to the part is not in it
            return [replace(touch, trace=None) for touch in again]


def _carry_out_again(
    hand: Hand,
    grip: Sequence[FingerApproach],
    tell: Callable[[GripPhase], None],
    measure: Measure,
    under_way: list[ApproachState],
) -> list[Touch]:
    """Take fingers back that were under way, as `under_way` is told, and carry out the grip."""
    hand.arm()
    if under_way:
        read_positions(hand, under_way)
        move_along_lines(hand, dict.fromkeys(under_way, 0.0))
        under_way.clear()
    return _carry_out(hand, grip, tell, measure, under_way)


def _carry_out(
    hand: Hand,
    grip: Sequence[FingerApproach],
    tell: Callable[[GripPhase], None],
    measure: Measure,
    under_way: list[ApproachState],
) -> list[Touch]:
    """Carry out a grip; `under_way` is filled with the fingers that have left where they wait."""
    tell(GripPhase.AIMING)
    hand.arm()
    retract_all(hand)
    turn = turn_stage(hand, {item.stage_rad for item in grip})
    runs = [ApproachState.of(hand.fingers[item.finger_index], item, turn) for item in grip]
    aim_fingers(hand, runs)
    under_way += runs
    hand.tare()
    tell(GripPhase.CLOSING)
    stage = search_stage(hand.rig.closing, [run.approach for run in runs])
    _start_metering(hand, runs, stage)
    backed = _search_contacts(hand, runs, stay=stage is TouchStage.SLOW)
    touched = [run for run in runs if run.touched]
    _settle(hand, runs)
    patches: dict[str, ContactPatch | None] = {}
    if touched:
        tell(GripPhase.TOUCHING)
        _touch_again(hand, backed)
        patches = {
            run.finger.name: run.widen_unsteady(patch, hand.rig) for run, patch in measure(hand, touched)
        }
        for run in runs:
            run.note_measured(hand.clock.now())
    turned = hand.turn
    touches = [conclude(run, patches.get(run.finger.name), hand.rig.closing, turned) for run in runs]
    tell(GripPhase.RETRACTING)
    # Arrays are guarded until every finger has left the part.
    move_along_lines(hand, dict.fromkeys(runs, 0.0), hand.rig.closing.retract_mm_s)
    hand.finish_grip()
    hand.disarm()
    return [
        replace(touch, loads=run.loads, trace=run.trace) for touch, run in zip(touches, runs, strict=True)
    ]


def _start_metering(hand: Hand, runs: Sequence[ApproachState], stage: TouchStage) -> None:
    """Measure from now on what loads the part."""
    closing = hand.rig.closing
    for run in runs:
        extractor = run.finger.extractor
        drags = run.drags(LIGHT_FORCE_FACTOR * closing.contact_force_n)
        run.meter = load_meter_of(
            closing,
            run.finger.spec,
            run.approach,
            extractor.least_force_n,
            extractor.noise_share,
            drags,
        )
        run.meter.begin(stage, hand.clock.now(), run.approach.fast_mm, FREE_MARGIN_MM)
    hand.meter({run.finger: run.meter for run in runs if run.meter is not None})


def retract_all(hand: Hand) -> None:
    """Let every finger go back to where it waits, also those that take no part."""

    def begin(goals: ServoGoals) -> Callable[[float], ServoGoals]:
        return lambda _: goals

    ways = {finger: finger.drive.retract() for finger in hand.fingers}
    _move_free(hand, [_free_mover(finger, begin(goals)) for finger, goals in ways.items() if goals])


def turn_stage(hand: Hand, wanted_rad: Collection[float]) -> Turn:
    """Turn the stage to a grip's angle, which all its approaches share; every finger goes home first.

    Returns the turn that was asked for: the lines of a grip are computed for it.
    """
    if len(set(wanted_rad)) > 1:
        raise ValueError("approaches of one grip are for different stage angles")
    angle = next(iter(wanted_rad), 0.0)
    goals = hand.stage.goals(angle)
    at = hand.states(hand.stage.servos)
    if any(abs(at[servo.dxl_id].position_rad - goal) > AIM_TOLERANCE_RAD for servo, goal in goals.items()):
        _move_to_starts(hand, {finger: finger.home for finger in hand.fingers})
        hand.move_servos(goals, lambda _: AIM_TOLERANCE_RAD)
    return Stage.of(hand.rig).planned_turn(angle)


def _move_to_starts(hand: Hand, lines: Mapping[HostFinger, Line]) -> None:
    """Let fingers go to where lines start, outside of the workspace."""
    present = hand.servos_of(list(lines))

    def begin(finger: HostFinger) -> Callable[[float], ServoGoals]:
        return lambda now: finger.drive.aim(lines[finger], present[finger], now)

    movers = [FreeMover(finger, begin(finger), lambda _: AIM_TOLERANCE_RAD) for finger in lines]
    _move_free(hand, movers)


def aim_fingers(hand: Hand, runs: Sequence[ApproachState]) -> None:
    """Turn fingers to where their lines start, outside of the workspace."""
    _move_to_starts(hand, {run.finger: run.line for run in runs})
    found = hand.servos_of([run.finger for run in runs])
    for run in runs:
        run.begin(found[run.finger])


def move_along_lines(
    hand: Hand, travels_mm: Mapping[ApproachState, float], speed_mm_s: float | None = None
) -> None:
    """Move along lines through space that is known to be free, and wait until fingers are there.

    `speed_mm_s`: None, that of approaches.
    """
    speed = speed_mm_s or hand.rig.closing.approach_speed_mm_s

    def begin(run: ApproachState, to_mm: float) -> Callable[[float], ServoGoals]:
        return lambda now: run.finger.drive.go(run.line, run.travel_mm, to_mm, speed, now)

    movers = [_free_mover(run.finger, begin(run, to_mm), run) for run, to_mm in travels_mm.items()]
    _move_free(hand, movers)


def _free_mover(
    finger: HostFinger, begin: Callable[[float], ServoGoals], run: ApproachState | None = None
) -> FreeMover:
    def tolerance_rad(servo: Servo) -> float:
        return finger.drive.tolerance_rad(servo, ARRIVED_MM)

    return FreeMover(finger, begin, tolerance_rad, run)


def _move_free(hand: Hand, movers: Sequence[FreeMover]) -> None:
    streaming = any(mover.streams for mover in movers)
    hand.require_arrival(hand.guarded(movers, period_s=_period_s(hand) if streaming else _FREE_PERIOD_S))


def _period_s(hand: Hand) -> float:
    return 1 / hand.rig.closing.sample_rate_hz


def move_tips(hand: Hand, movers: Sequence[TipMover]) -> dict[ApproachState, MoveEnd]:
    """A guarded move of tips along their lines; how each ended."""
    period = _period_s(hand)
    look_every = max(1, min(SAMPLES_PER_STATE_READ, int(BUS_KEEPALIVE_S / period)))
    ends = hand.guarded(movers, period_s=period, read_every=look_every)
    return {mover.run: end for mover, end in ends.items() if mover.run is not None}


def _search_contacts(hand: Hand, runs: Sequence[ApproachState], *, stay: bool) -> dict[ApproachState, float]:
    """Send every finger towards its limit; those that touch something back off at once, by themselves.

    The last one may `stay`. At the first contacts of a run all are stopped, until it is proven whose they
    are. Returns where (mm of their ways) fingers go back to.
    """
    for run in runs:
        run.touched, run.searching = False, True
    backed: dict[ApproachState, float] = {}
    left = list(runs)
    while left:
        watch = SearchWatch(hand, runs)
        movers = [SearchMover(hand, run, runs, watch, may_stay=stay) for run in left]
        ends = move_tips(hand, movers)
        backed |= {mover.run: mover.limit_mm for mover in movers if mover.is_back}
        if watch.suspect is None:
            break
        moved = [run for run, end in ends.items() if end is MoveEnd.ENOUGH or run.finger is watch.suspect]
        own = watch.prove(moved, partial(move_along_lines, hand))
        if own is not None:
            backed[own] = own.travel_mm
        left = [run for run in moved if run is not own]
        # They speed up again where nothing is: currents show no contact meanwhile.
        lead_mm, proven = hand.rig.closing.search_mm_s * START_S, hand.proven
        move_along_lines(
            hand, {run: max(0.0, run.travel_mm - lead_mm) for run in left if run.finger not in proven}
        )
        for run in left:
            if run.meter is not None:
                run.meter.resume(hand.clock.now())
    return backed


def _touch_slowly(hand: Hand, runs: Sequence[ApproachState]) -> None:
    """Send every finger on slowly, and stop each at its own contact, limit or neighbour."""
    closing = hand.rig.closing
    for run in runs:
        run.touched = False
    movers = [
        TipMover(
            hand,
            run,
            run.approach.travel_mm,
            touch_speed_mm_s(run.approach, closing.touch_speed_mm_s),
            closing.contact_force_n,
            runs,
        )
        for run in runs
    ]
    move_tips(hand, movers)


def read_positions(hand: Hand, runs: Sequence[ApproachState]) -> None:
    """Note where fingers are; raises if one of their servos has died or is off."""
    found = hand.servos_of([run.finger for run in runs])
    now = hand.clock.now()
    for run in runs:
        run.seen(found[run.finger], now)


def _touch_again(hand: Hand, backed: Mapping[ApproachState, float]) -> None:
    """Touch again slowly from where fingers have backed off to, and let everything settle."""
    again, back = backed, hand.rig.closing.back_off_mm
    for _ in range(_MAX_BACK_OFFS if backed else 0):
        stuck = _back_off_and_touch(hand, again, back)
        if not stuck:
            break
        back *= 2  # they had run further into it than they backed off
        again = {run: max(0.0, run.travel_mm - back) for run in stuck}


def measure_at_rest(
    hand: Hand, runs: Sequence[ApproachState]
) -> list[tuple[ApproachState, ContactPatch | None]]:
    """Measure what the arrays feel while fingers rest; None for those that do not touch."""
    measured = hand.collect([run.finger for run in runs], MEASURE_FRAMES)
    return [
        (run, run.finger.extractor.extract(frames) if run.touched else None)
        for run, frames in zip(runs, measured, strict=True)
    ]


def _back_off_and_touch(
    hand: Hand, backed: Mapping[ApproachState, float], back_mm: float
) -> list[ApproachState]:
    """Back off and touch again slowly; the fingers that felt something before they had really moved.

    They had not come free, so their play is not where a touch has it.
    """
    runs = list(backed)
    move_along_lines(hand, backed)
    begun = {run: run.travel_mm for run in runs}
    for run in runs:
        if run.meter is not None:
            met_mm = min(begun[run] + back_mm, run.unfelt_mm)
            free, now = (met_mm - RETOUCH_MARGIN_MM, RETOUCH_MARGIN_MM), hand.clock.now()
            speed = touch_speed_mm_s(run.approach, hand.rig.closing.touch_speed_mm_s)
            run.meter.begin(TouchStage.SLOW, now, *free, speed)
    _touch_slowly(hand, runs)
    _settle(hand, runs)
    return [run for run in runs if run.touched and run.travel_mm - begun[run] < _MIN_FREE_SHARE * back_mm]


def _settle(hand: Hand, runs: Sequence[ApproachState]) -> None:
    """Wait until fingers stand, and frames come that were sampled since: quick touches take longer to rest.

    A force that is measured must be that of the place which is read.
    """
    fingers = [run.finger for run in runs]
    hand.settle(fingers, SETTLE_S / 2)
    read_positions(hand, runs)
    for _ in range(_MAX_SETTLE_STEPS):
        before = {run: run.servos for run in runs}
        hand.settle(fingers, SETTLE_S / 2)
        read_positions(hand, runs)
        if all(math.dist(run.servos, before[run]) <= _STILL_RAD for run in runs):
            break
    if lag_s := max((finger.spec.array.lag_s for finger in fingers), default=0.0):
        hand.settle(fingers, lag_s)
    _wait_until_steady(hand, [run for run in runs if run.touched])


def _wait_until_steady(hand: Hand, resting: Sequence[ApproachState]) -> None:
    """Wait until arrays show contacts at rest as they are: firmware may filter for longer than declared.

    And then as long again: what is left of an exponential is too little to be seen in the noise by then.
    """
    fingers, begun_s = [run.finger for run in resting], hand.clock.now()
    changed_s: dict[HostFinger, float] = {}
    for step in range(1, _MAX_STEADY_STEPS + 1):
        window_s = min(step * SETTLE_S / 2, SETTLE_S)
        changing = [finger for finger in fingers if hand.is_changing(finger, window_s)]
        if not changing:
            break
        hand.states(hand.servos)  # they must hear something
        hand.settle(fingers, SETTLE_S / 2)
        changed_s |= dict.fromkeys(changing, hand.clock.now() - begun_s)
    if changed_s and changing:
        for run in resting:
            run.is_steady = run.finger not in changing
    elif changed_s:
        hand.settle(fingers, max(changed_s.values()))
    for finger, took_s in changed_s.items():
        if took_s > _MAX_STEADY_S:
            hand.checks.keep_lag(finger, took_s, steady=finger not in changing)
