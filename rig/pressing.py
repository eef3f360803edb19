"""Slow presses and stops of single fingers, for calibration. Between the hand and `rig_prober`.

The way to a contact must be known to be free: the finger has touched there before. What servo and array say
on the way in and out is kept sample by sample; what it means is calibration's business.
"""

import math
from dataclasses import dataclass

import numpy as np

from palpate.calibration.measured import FREE, IN, OUT, Press, Stop
from palpate.drivers.dynamixel.servo import stop_at, write_goals
from palpate.drivers.slide_finger import SlideKinematics
from palpate.errors import DeviceError, InputError, SafetyStop
from palpate.rig.closing import Close, aim, go_to, look, retract_all
from palpate.rig.hand import Hand, HostFinger
from palpate.rig.run import Run
from palpate.rig.stage import planned_turn

__all__ = ["PressLimits", "press", "run_into", "slide_of", "stall"]

_LEAD_MM = 3.0  # before a contact: gathering speed, then friction alone
_DEPTH_MM = 4.0  # no press goes deeper
_PERIOD_S = 0.01
_STILL_MM = 0.03
_STILL_S = 0.25
_SETTLE_S = 0.15
_SILENT_S = 0.3


@dataclass(frozen=True)
class PressLimits:
    """How slowly (mm/s) and how hard (N, as the array says) to press."""

    speed_mm_s: float = 3.0
    force_n: float = 3.0


def press(hand: Hand, close: Close, contact_mm: float, placing: int, limits: PressLimits) -> Press:
    """Press where a finger touches after `contact_mm` of its way, and go back. Ends retracted.

    Raises SafetyStop above the rig file's max_force_n, and DeviceError for a device that fails.
    """
    run = _made_ready(hand, close, max(contact_mm - _LEAD_MM, 0.0))
    samples = _Samples(hand, run)
    force = min(limits.force_n, hand.rig.closing.max_force_n)
    contact = contact_mm
    ways = ((contact + _DEPTH_MM, IN), (max(contact - _LEAD_MM, 0.0), OUT))
    for to_mm, leg in ways:
        _start(hand, run, to_mm, limits.speed_mm_s)
        since, at = hand.clock.now(), run.travel_mm
        while True:
            felt = samples.take(leg)
            if abs(run.travel_mm - at) > _STILL_MM:
                at, since = run.travel_mm, hand.clock.now()
            if (leg == IN and felt > force) or hand.clock.now() - since > _STILL_S:
                break
    _end(hand, run)
    return samples.press(close, placing)


def run_into(hand: Hand, close: Close, contact_mm: float, speed_mm_s: float) -> Stop:
    """Run into a contact that comes after `contact_mm` of the way, stop when it is felt, see where it stood."""
    lead = max(_LEAD_MM, speed_mm_s * speed_mm_s / 40.0)
    run = _made_ready(hand, close, max(contact_mm - lead, 0.0))
    slide = run.finger.drive.closing_servos[0]
    contact_rad = run.finger.kinematics.servos_rad(run.line, contact_mm)[1]
    _start(hand, run, contact_mm + _DEPTH_MM, speed_mm_s)
    period = 1 / hand.rig.closing.sample_rate_hz
    deadline = hand.clock.now() + (lead + 2 * _DEPTH_MM) / speed_mm_s + 1.0
    while True:
        hand.clock.sleep(period)
        frames = run.finger.array.frames()
        run.finger.extractor.follow(frames)
        if frames and _checked(hand, run, run.finger.extractor.force_n(frames[-1])):
            break
        if hand.clock.now() > deadline:
            raise DeviceError(
                f"finger {run.finger.name} felt nothing where it had touched the reference before; "
                "was it moved? Begin again with it"
            )
    felt_rad = hand.states([slide])[slide.dxl_id].position_rad
    stop_at(hand.bus, {slide: slide.nearest_rad(felt_rad)})
    hand.pause(_SETTLE_S)
    look(hand, [run])
    stood_rad = run.servos[1]
    _end(hand, run)
    return Stop(run.finger.name, speed_mm_s, felt_rad, stood_rad, contact_rad, period)


def stall(hand: Hand, finger: HostFinger, goal_mm: float, current_a: float, speed_mm_s: float) -> float:
    """Drive a slide gently to a distance from its base that it cannot reach; where its servo stalls (rad).

    The slide goes back to where it waits. DeviceError if it gets there without stalling.
    """
    slide, kinematics = finger.drive.closing_servos[0], slide_of(finger)
    full_a = finger.drive.limits()[slide].current_a
    hand.arm()
    retract_all(hand)
    goal = kinematics.slide_servo_rad(goal_mm)
    slide.set_profile(speed_mm_s / abs(kinematics.mm_per_rad), 0.0)
    slide.set_goal_current_a(current_a)
    write_goals(hand.bus, {slide: goal}, confirm=True)
    moved = abs(_STILL_MM / kinematics.mm_per_rad)
    at, since = math.inf, hand.clock.now()
    while hand.clock.now() - since < 2 * _STILL_S:
        hand.pause(_PERIOD_S)
        now_at = hand.states([slide])[slide.dxl_id].position_rad
        if abs(now_at - at) > moved:
            at, since = now_at, hand.clock.now()
    stop_at(hand.bus, {slide: slide.nearest_rad(at)})  # nothing presses on when the full current comes back
    slide.set_goal_current_a(full_a)
    if abs(at - goal) < moved:
        raise DeviceError(
            f"finger {finger.name}: its slide (servo {slide.dxl_id}) went to {goal_mm:g} mm and met no hard stop; "
            "check slide.stops_mm, slide.zero_mm and the sign of slide.mm_per_turn"
        )
    retract_all(hand)
    hand.disarm()
    return at


def slide_of(finger: HostFinger) -> SlideKinematics:
    """Kinematics of a slide; InputError for a finger of another type."""
    if not isinstance(finger.kinematics, SlideKinematics):
        raise InputError(
            f'finger {finger.name} is of type "two-link"; only fingers of type "slide" can be calibrated'
        )
    return finger.kinematics


class _Samples:
    """What is kept of a press, in the order of time."""

    def __init__(self, hand: Hand, run: Run) -> None:
        self._hand, self._run = hand, run
        self._slide = run.finger.drive.closing_servos[0]
        self._sign = math.copysign(1.0, slide_of(run.finger).mm_per_rad)
        self._baseline = run.finger.extractor.baseline.mean
        self._rows: list[tuple[float, float, int]] = []
        self._counts: list[np.ndarray[tuple[int, ...], np.dtype[np.float64]]] = []
        self._heard_s = hand.clock.now()

    def take(self, leg: int) -> float:
        """Let one period pass and look at servo and array; returns the force that the array feels (N)."""
        hand, run = self._hand, self._run
        hand.clock.sleep(_PERIOD_S)
        state = hand.states(run.finger.drive.servos)[self._slide.dxl_id]
        frames = run.finger.array.frames()
        now = hand.clock.now()
        run.seen((run.servos[0], state.position_rad), now)
        if not frames:
            if now - self._heard_s > _SILENT_S:
                raise DeviceError(
                    f"tactile array {run.finger.name} on {run.finger.spec.array.port} has sent nothing for "
                    f"{_SILENT_S:g} s while its finger pressed; it was stopped; check its cable"
                )
            return 0.0
        self._heard_s = now
        force = run.finger.extractor.force_n(frames[-1])
        felt = _checked(hand, run, force)
        self._rows.append(
            (state.position_rad, self._sign * state.current_a, leg if felt or leg == OUT else FREE)
        )
        self._counts.append(np.mean([frame.counts for frame in frames], axis=0) - self._baseline)
        return force

    def press(self, close: Close, placing: int) -> Press:
        rows = np.array(self._rows)
        legs = rows[:, 2].astype(np.int64)
        return Press(
            self._run.finger.name,
            placing,
            self._run.servos[0],
            rows[:, 0],
            rows[:, 1],
            legs,
            np.array(self._counts),
        )


def _made_ready(hand: Hand, close: Close, before_mm: float) -> Run:
    """A finger that has aimed and tared and gone to just before a contact."""
    hand.arm()
    retract_all(hand)
    run = Run.of(hand.fingers[close.finger_index], close, planned_turn(hand.rig.stage, 0.0))
    aim(hand, [run])
    hand.tare()
    go_to(hand, {run: before_mm})
    return run


def _start(hand: Hand, run: Run, to_mm: float, speed_mm_s: float) -> None:
    now = hand.clock.now()
    write_goals(hand.bus, run.finger.drive.go(run.line, run.travel_mm, to_mm, speed_mm_s, now), confirm=True)


def _end(hand: Hand, run: Run) -> None:
    hand.stop_arrays()
    go_to(hand, {run: 0.0})
    hand.disarm()


def _checked(hand: Hand, run: Run, force_n: float) -> bool:
    """Whether a force counts as contact; SafetyStop if it is more than is allowed."""
    hard = hand.rig.closing.max_force_n
    if force_n > hard:
        raise SafetyStop(
            f"finger {run.finger.name} felt {force_n:.1f} N, above max_force_n = {hard:g} N; fingers were stopped"
        )
    return force_n > hand.rig.closing.contact_force_n
