"""Guarded closing: fingers move along straight lines and stop at what they touch.

From planned approaches to contacts. Each finger touches twice: quickly to find the object, then, after
backing off a little, slowly to measure it. All chosen fingers move at once; the loop runs once per tactile
sample, and every finger stops by itself. A finger that comes too close to another one stops where it is: its
free way so far is still evidence.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum

import numpy as np

from palpate.drivers.dynamixel.servo import Servo, stop_at, write_goals
from palpate.drivers.tactile.contact import ContactPatch, PatchFlag
from palpate.errors import DeviceError, SafetyStop
from palpate.recognizer import Contact, NormalRange
from palpate.recognizer.arrays import Floats
from palpate.recognizer.segments import distance_range
from palpate.rig.convert import finger_of
from palpate.rig.hand import Hand, HostFinger
from palpate.rig.wait import Close, wait_distance_mm

__all__ = ["Close", "Stage", "Touch", "close_fingers"]

_STATE_EVERY = 5  # samples between looks at the servos while nothing is touched
_ARRIVED_MM = 0.8
_STALLED_S = 0.6
_SILENT_S = 0.15
_SETTLE_S = 0.08
_MEASURE_FRAMES = 8
_AIM_TOLERANCE_RAD = math.radians(1.5)
_TWO_EDGES = frozenset({PatchFlag.WIDE, PatchFlag.SEVERAL_PATCHES})


class Stage(Enum):
    """What a finger is doing, for whoever shows progress."""

    AIMING = "aiming"
    CLOSING = "closing"
    TOUCHING = "touching"
    RETRACTING = "retracting"


@dataclass(frozen=True)
class Touch:
    """What came of it: the contact for the recogniser, and the patch that it rests on (None for a miss)."""

    finger_index: int
    contact: Contact
    patch: ContactPatch | None


@dataclass
class _Run:
    """One finger during a closing."""

    finger: HostFinger
    close: Close
    wait_mm: float
    aim_rad: float = 0.0
    limit_mm: float = 0.0
    distance_mm: float = 0.0
    touched: bool = False
    done: bool = False
    moved_s: float = 0.0
    heard_s: float = 0.0
    last_mm: float = 0.0

    @property
    def end_mm(self) -> float:
        """Distance at which the approach is over."""
        return self.wait_mm + self.close.travel_mm


def close_fingers(hand: Hand, grip: Sequence[Close], tell: Callable[[Stage], None]) -> list[Touch]:
    """Carry out a grip: aim, close, touch, measure, retract. Fingers must be retracted and stay so between.

    Raises DeviceError for a device that fails and SafetyStop for a finger that is held by something it does
    not feel; the hand's `close` then ends all motion.
    """
    radius = hand.rig.workspace.radius_mm
    runs = [
        _Run(
            hand.fingers[item.finger_index],
            item,
            wait_distance_mm(hand.fingers[item.finger_index].spec, radius),
        )
        for item in grip
    ]
    tell(Stage.AIMING)
    hand.arm()
    _go_to(hand, {run.finger: run.wait_mm for run in runs})
    _aim(hand, runs)
    hand.tare()
    tell(Stage.CLOSING)
    for run in runs:
        run.limit_mm = run.end_mm
    _move_until_touched(hand, runs, hand.rig.closing.approach_speed_mm_s)
    _settle(hand, runs)
    found = [run for run in runs if run.touched]
    patches: dict[str, ContactPatch | None] = {}
    if found:
        tell(Stage.TOUCHING)
        patches = {run.finger.name: patch for run, patch in _measure(hand, found)}
    touches = [_concluded(hand, run, patches.get(run.finger.name)) for run in runs]
    tell(Stage.RETRACTING)
    hand.stop_arrays()
    _go_to(hand, {run.finger: run.wait_mm for run in runs})
    hand.disarm()
    return touches


def _aim(hand: Hand, runs: Sequence[_Run]) -> None:
    goals = {run.finger.aim: run.finger.kinematics.aim_servo_rad(run.close.aim_rad) for run in runs}
    write_goals(hand.bus, goals)
    servos = list(goals)
    hand.wait_still(servos, {servo.dxl_id: goal for servo, goal in goals.items()}, _AIM_TOLERANCE_RAD)
    states = hand.states(servos)
    for run in runs:
        run.aim_rad = run.finger.kinematics.aim_rad(states[run.finger.aim.dxl_id].position_rad)


def _go_to(hand: Hand, distances_mm: Mapping[HostFinger, float]) -> None:
    """Move slides through space that is known to be free, and wait until they are there."""
    for finger in distances_mm:
        hand.set_speed(finger, hand.rig.closing.approach_speed_mm_s)
    goals = {f.slide: f.kinematics.slide_servo_rad(distance) for f, distance in distances_mm.items()}
    write_goals(hand.bus, goals)
    tolerance = min(_ARRIVED_MM / abs(f.kinematics.mm_per_rad) for f in distances_mm)
    hand.wait_still(list(goals), {servo.dxl_id: goal for servo, goal in goals.items()}, tolerance)


def _move_until_touched(hand: Hand, runs: Sequence[_Run], speed_mm_s: float) -> None:
    """Send every finger towards its limit and stop each at its own contact, limit or neighbour."""
    now = hand.clock.now()
    for run in runs:
        hand.set_speed(run.finger, speed_mm_s)
        run.touched = run.done = False
        run.moved_s = run.heard_s = now
    goals = {run.finger.slide: run.finger.kinematics.slide_servo_rad(run.limit_mm) for run in runs}
    write_goals(hand.bus, goals)
    _look(hand, runs)
    count = 0
    period = 1 / hand.rig.closing.sample_rate_hz
    while active := [run for run in runs if not run.done]:
        hand.clock.sleep(period)
        touched = [run for run in active if _feels(hand, run)]
        if touched:
            _stop(hand, touched)
            for run in touched:
                run.touched = run.done = True
        count += 1
        if count % _STATE_EVERY == 0:
            _look(hand, runs)
            _watch(hand, runs)


def _feels(hand: Hand, run: _Run) -> bool:
    """Whether the newest frames show a contact; raises DeviceError if frames have stopped coming."""
    frames = run.finger.array.frames()
    now = hand.clock.now()
    if not frames:
        if now - run.heard_s > _SILENT_S:
            raise DeviceError(
                f"tactile array {run.finger.name} on {run.finger.spec.array.port} has sent nothing for "
                f"{_SILENT_S:g} s while its finger moved; fingers were stopped; check its cable"
            )
        return False
    run.heard_s = now
    threshold = hand.rig.closing.contact_force_n
    hard = hand.rig.closing.max_force_n
    force = run.finger.extractor.force_n(frames[-1])
    if force > hard:
        raise SafetyStop(
            f"finger {run.finger.name} felt {force:.1f} N, above max_force_n = {hard:g} N; "
            "fingers were stopped; lower approach_speed_mm_s"
        )
    return force > threshold


def _stop(hand: Hand, runs: Sequence[_Run]) -> None:
    """Hold fingers where they are now."""
    states = hand.states([run.finger.slide for run in runs])
    goals: dict[Servo, float] = {}
    for run in runs:
        lo, hi = run.finger.slide.range_rad
        goals[run.finger.slide] = min(max(states[run.finger.slide.dxl_id].position_rad, lo), hi)
    stop_at(hand.bus, goals)


def _look(hand: Hand, runs: Sequence[_Run]) -> None:
    # The aim servos only hold, but one that has died or is pushed aside would spoil what is measured.
    states = hand.states([servo for run in runs for servo in (run.finger.slide, run.finger.aim)])
    now = hand.clock.now()
    for run in runs:
        run.aim_rad = run.finger.kinematics.aim_rad(states[run.finger.aim.dxl_id].position_rad)
        run.distance_mm = run.finger.kinematics.distance_mm(states[run.finger.slide.dxl_id].position_rad)
        if abs(run.distance_mm - run.last_mm) > 0.05:
            run.last_mm, run.moved_s = run.distance_mm, now


def _watch(hand: Hand, runs: Sequence[_Run]) -> None:
    """Fingers at their limits are done; those too near to another one stop; a held one stops everything."""
    for run in runs:
        if run.done:
            continue
        if abs(run.limit_mm - run.distance_mm) < _ARRIVED_MM:
            run.done = True
        elif hand.clock.now() - run.moved_s > _STALLED_S:
            raise SafetyStop(
                f"finger {run.finger.name} is held at {run.distance_mm:.1f} mm from its base by something "
                "that its array does not feel; fingers were stopped; clear its way"
            )
    crowded = [run for run in runs if not run.done and _is_crowded(hand, run, runs)]
    if crowded:
        _stop(hand, crowded)
        for run in crowded:
            run.done = True


def _is_crowded(hand: Hand, run: _Run, runs: Sequence[_Run]) -> bool:
    base, tip = _segment(run)
    for other in runs:
        if other is run:
            continue
        gap = run.finger.spec.tip.radius_mm + other.finger.spec.tip.radius_mm
        apart, _ = distance_range(base, tip, *_segment(other))
        if float(apart[0]) < gap + hand.rig.closing.clearance_mm:
            return True
    return False


def _segment(run: _Run) -> tuple[Floats, Floats]:
    tip = run.finger.kinematics.centre_mm(run.aim_rad, run.distance_mm)
    return np.array([run.finger.kinematics.base_mm]), np.array([tip])


def _measure(hand: Hand, runs: Sequence[_Run]) -> list[tuple[_Run, ContactPatch | None]]:
    """Back off, touch again slowly, let everything settle, and look."""
    _settle(hand, runs)
    back = hand.rig.closing.back_off_mm
    _go_to(hand, {run.finger: max(run.wait_mm, run.distance_mm - back) for run in runs})
    _move_until_touched(hand, runs, hand.rig.closing.touch_speed_mm_s)
    _settle(hand, runs)
    measured = hand.collect([run.finger for run in runs], _MEASURE_FRAMES)
    return [
        (run, run.finger.extractor.extract(frames) if run.touched else None)
        for run, frames in zip(runs, measured, strict=True)
    ]


def _settle(hand: Hand, runs: Sequence[_Run]) -> None:
    hand.pause(_SETTLE_S)
    _look(hand, runs)


def _concluded(hand: Hand, run: _Run, patch: ContactPatch | None) -> Touch:
    if patch is None:
        return Touch(run.close.finger_index, _miss(hand, run), None)
    return Touch(run.close.finger_index, _contact(hand, run, patch), patch)


def _unfelt_mm(hand: Hand, run: _Run) -> float:
    """How deep something may have dented a moving tip without being felt.

    Twice the contact threshold: the quick guard leaves out what is below each taxel's noise, and gains vary.
    """
    tip = run.finger.spec.tip
    return 2 * hand.rig.closing.contact_force_n / (tip.stiffness_n_per_mm * (1 - tip.stiffness_spread))


def _miss(hand: Hand, run: _Run) -> Contact:
    """The way was free as far as the finger went; less a little where a touch could not be measured."""
    kinematics = run.finger.kinematics
    far = run.distance_mm - (2 * hand.rig.closing.back_off_mm if run.touched else 0.0)
    bound = kinematics.position_bound_mm(run.distance_mm)
    return Contact(
        name=run.finger.name,
        finger=finger_of(run.finger.spec),
        touched=False,
        start_mm=kinematics.centre_mm(run.aim_rad, run.wait_mm),
        end_mm=kinematics.centre_mm(run.aim_rad, max(far, run.wait_mm)),
        position_bound_mm=bound,
        path_bound_mm=bound + _unfelt_mm(hand, run),
    )


def _contact(hand: Hand, run: _Run, patch: ContactPatch) -> Contact:
    """Where the tip's centre would be if it just touched: the dent is taken back along the normal."""
    finger, tip = run.finger, run.finger.spec.tip
    kinematics = finger.kinematics
    direction = kinematics.direction_rad(run.aim_rad)
    normal = direction + math.radians(finger.spec.array.heading_deg) + patch.angle_rad + math.pi
    half = patch.angle_half_range_rad + kinematics.direction_bound_rad
    hardest = min(patch.force_n + patch.force_bound_n, hand.rig.closing.max_force_n)
    softest = max(patch.force_n - patch.force_bound_n, 0.0)
    deepest = hardest / (tip.stiffness_n_per_mm * (1 - tip.stiffness_spread))
    shallowest = softest / (tip.stiffness_n_per_mm * (1 + tip.stiffness_spread))
    dent = (deepest + shallowest) / 2
    # In a notch the dent is along two normals and only one of them is known.
    sideways = deepest if patch.flags & _TWO_EDGES or half > math.pi / 2 else deepest * math.sin(half)
    x, y = kinematics.centre_mm(run.aim_rad, run.distance_mm)
    bound = kinematics.position_bound_mm(run.distance_mm) + (deepest - shallowest) / 2 + sideways
    return Contact(
        name=finger.name,
        finger=finger_of(finger.spec),
        touched=True,
        start_mm=kinematics.centre_mm(run.aim_rad, run.wait_mm),
        end_mm=(x + dent * math.cos(normal), y + dent * math.sin(normal)),
        position_bound_mm=bound,
        path_bound_mm=bound + _unfelt_mm(hand, run),
        normal=NormalRange(normal - half, normal + half) if half < math.pi else None,
    )
