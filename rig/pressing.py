"""Slow presses and stops of fingers, for calibration. Between the hand and `rig_prober`.

The ways to contacts must be known to be free: the fingers have touched there before. What servos and arrays
say on the way in and out is kept sample by sample; what it means is calibration's business.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from palpate.calibration.measured import FREE, IN, OUT, Press, Stop
from palpate.drivers.dynamixel.servo import stop_at
from palpate.errors import DeviceError, SafetyStop
from palpate.rig.closing import aim, begin, go_to, look, retract_all
from palpate.rig.hand import SPEAK_S, Hand, HostFinger
from palpate.rig.reach import Close
from palpate.rig.run import Run
from palpate.rig.stage import planned_turn

__all__ = ["counts_as_contact", "press", "run_into"]

_SPEED_MM_S = 4.0
_FORCE_N = 3.0
_LEAD_MM = 2.0  # before a contact: gathering speed, then friction alone
_DEPTH_MM = 4.0  # no press goes deeper
_PERIOD_S = 0.01
_STILL_MM = 0.03
_STILL_S = 0.25
_SETTLE_S = 0.15
_SILENT_S = 0.15
_GENTLE_MM_S2 = 20.0  # to reach a speed before a contact

Contacts = Sequence[tuple[Close, float]]
"""Ways, and after how many mm of each the finger touches."""


def press(hand: Hand, contacts: Contacts, placing: int) -> list[Press]:
    """Press where fingers touch, all at once, and go back. Ends retracted.

    Raises SafetyStop above the rig file's max_force_n, and DeviceError for a device that fails.
    """
    runs = _made_ready(hand, [(close, max(contact - _LEAD_MM, 0.0)) for close, contact in contacts])
    pressed = [_Pressed(run, contact) for run, (_, contact) in zip(runs, contacts, strict=True)]
    _start(hand, {item.run: item.contact_mm + _DEPTH_MM for item in pressed}, _SPEED_MM_S)
    now = hand.clock.now()
    for item in pressed:
        item.rest(now)
    while any(item.leg != _DONE for item in pressed):
        hand.clock.sleep(_PERIOD_S)
        _sample(hand, pressed)
        turning = [item for item in pressed if item.turns(hand.clock.now())]
        if turning:
            _start(hand, {item.run: max(item.contact_mm - _LEAD_MM, 0.0) for item in turning}, _SPEED_MM_S)
    _end(hand, runs)
    return [item.press(placing) for item in pressed]


def run_into(hand: Hand, contacts: Contacts, speed_mm_s: float) -> list[Stop]:
    """Run into contacts at a speed, stop each finger when it feels something, see where it stood."""
    lead = max(_LEAD_MM, speed_mm_s**2 / _GENTLE_MM_S2 / 2)
    runs = _made_ready(hand, [(close, max(contact - lead, 0.0)) for close, contact in contacts])
    _start(
        hand,
        {run: contact + _DEPTH_MM for run, (_, contact) in zip(runs, contacts, strict=True)},
        speed_mm_s,
    )
    felt = _felt(hand, runs, hand.clock.now() + (lead + 2 * _DEPTH_MM) / speed_mm_s + 1.0)
    hand.pause(_SETTLE_S)
    look(hand, runs)
    stops = []
    for run, (_, contact) in zip(runs, contacts, strict=True):
        contact_rad = run.finger.kinematics.servos_rad(run.line, contact)[1]
        period = 1 / hand.rig.closing.sample_rate_hz
        stops.append(Stop(run.finger.name, speed_mm_s, felt[run], run.servos[1], contact_rad, period))
    _end(hand, runs)
    return stops


def _felt(hand: Hand, runs: Sequence[Run], deadline_s: float) -> dict[Run, float]:
    """Stop each finger when it feels something; the angles (rad) of slides' servos then."""
    felt: dict[Run, float] = {}
    spoken_s = hand.clock.now()
    heard_s = dict.fromkeys(runs, spoken_s)
    while len(felt) < len(runs):
        hand.clock.sleep(1 / hand.rig.closing.sample_rate_hz)
        if hand.clock.now() - spoken_s > SPEAK_S:
            look(hand, runs)
            spoken_s = hand.clock.now()
        for run in [run for run in runs if run not in felt]:
            frames = run.finger.array.frames()
            heard_s[run] = _heard_s(
                run.finger, heard=bool(frames), since_s=heard_s[run], now=hand.clock.now()
            )
            run.finger.extractor.follow(frames)
            if frames and counts_as_contact(hand, run.finger, run.finger.extractor.force_n(frames[-1])):
                slide = run.finger.drive.closing_servos[0]
                felt[run] = hand.states([slide])[slide.dxl_id].position_rad
                stop_at(hand.bus, {slide: slide.nearest_rad(felt[run])})
        if hand.clock.now() > deadline_s:
            missing = next(run for run in runs if run not in felt)
            raise DeviceError(
                f"finger {missing.finger.name} felt nothing where it had touched the reference before; "
                "if that was moved, begin again and see that it stands firmly"
            )
    return felt


_DONE = -1


@dataclass(eq=False)
class _Pressed:
    """A press under way: the leg it is on, and what is kept of it, in the order of time."""

    run: Run
    contact_mm: float
    leg: int = IN
    rows: list[tuple[float, float, int]] = field(default_factory=list)
    counts: list[np.ndarray[tuple[int, ...], np.dtype[np.float64]]] = field(default_factory=list)
    force_n: float = 0.0
    heard_s: float = 0.0
    since_s: float = 0.0
    at_mm: float = math.nan

    def rest(self, now: float) -> None:
        """Count from now how long the slide stands still, and the array is silent."""
        self.since_s = self.heard_s = now
        self.at_mm = self.run.travel_mm

    def turns(self, now: float) -> bool:
        """Go on to the next leg if this one is over; whether the way back begins."""
        if abs(self.run.travel_mm - self.at_mm) > _STILL_MM:
            self.at_mm, self.since_s = self.run.travel_mm, now
        stands = now - self.since_s > _STILL_S
        if self.leg == IN and (stands or self.force_n > _FORCE_N):
            self.leg = OUT
            self.rest(now)
            return True
        if self.leg == OUT and stands:
            self.leg = _DONE
        return False

    def press(self, placing: int) -> Press:
        """What was kept."""
        rows = np.array(self.rows)
        return Press(
            self.run.finger.name,
            placing,
            self.run.servos[0],
            rows[:, 0],
            rows[:, 1],
            rows[:, 2].astype(np.int64),
            np.array(self.counts),
        )


def _sample(hand: Hand, pressed: Sequence[_Pressed]) -> None:
    """Look at servos and arrays of all fingers that press, at one instant."""
    active = [item for item in pressed if item.leg != _DONE]
    states = hand.states([servo for item in active for servo in item.run.finger.drive.servos])
    now = hand.clock.now()
    for item in active:
        finger = item.run.finger
        near, far = (states[servo.dxl_id] for servo in finger.drive.servos)
        item.run.seen((near.position_rad, far.position_rad), now)
        frames = finger.array.frames()
        item.heard_s = _heard_s(finger, heard=bool(frames), since_s=item.heard_s, now=now)
        if not frames:
            continue
        finger.extractor.follow(frames)
        item.force_n = finger.extractor.force_n(frames[-1])
        felt = counts_as_contact(hand, finger, item.force_n)
        out = _outward(item.run)
        item.rows.append(
            (far.position_rad, out * far.current_a, item.leg if felt or item.leg == OUT else FREE)
        )
        item.counts.append(np.mean([f.counts for f in frames], axis=0) - finger.extractor.baseline.mean)


def _heard_s(finger: HostFinger, *, heard: bool, since_s: float, now: float) -> float:
    """When an array was heard last; DeviceError if that is too long ago."""
    if heard:
        return now
    if now - since_s > _SILENT_S:
        raise DeviceError(
            f"tactile array {finger.name} on {finger.spec.array.port} has sent nothing for "
            f"{_SILENT_S:g} s while its finger moved; fingers were stopped; check its cable"
        )
    return since_s


def _outward(run: Run) -> float:
    """+1 if growing angles of the slide's servo push the tip out, else -1."""
    first, last = (run.finger.kinematics.servos_rad(run.line, travel)[1] for travel in (0.0, 1.0))
    return math.copysign(1.0, last - first)


def _made_ready(hand: Hand, ways: Contacts) -> list[Run]:
    """Fingers that have aimed and tared and gone so far along their ways."""
    hand.arm()
    retract_all(hand)
    turn = planned_turn(hand.rig.stage, 0.0)
    runs = [Run.of(hand.fingers[close.finger_index], close, turn) for close, _ in ways]
    aim(hand, runs)
    hand.tare()
    go_to(hand, {run: before for run, (_, before) in zip(runs, ways, strict=True)})
    return runs


def _start(hand: Hand, to_mm: dict[Run, float], speed_mm_s: float) -> None:
    now = hand.clock.now()
    for run, goal in to_mm.items():
        goals = run.finger.drive.go(run.line, run.travel_mm, goal, speed_mm_s, now)
        begin(hand, goals, [run.finger])


def _end(hand: Hand, runs: Sequence[Run]) -> None:
    hand.stop_arrays()
    go_to(hand, dict.fromkeys(runs, 0.0))
    hand.disarm()


def counts_as_contact(hand: Hand, finger: HostFinger, force_n: float) -> bool:
    """Whether a force counts as contact; SafetyStop if it is more than is allowed."""
    hard = hand.rig.closing.max_force_n
    if force_n > hard:
        raise SafetyStop(
            f"finger {finger.name} felt {force_n:.1f} N, above max_force_n = {hard:g} N; fingers were "
            "stopped; lower approach_speed_mm_s or press elsewhere"
        )
    return force_n > hand.rig.closing.contact_force_n
