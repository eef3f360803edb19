"""Pushing touches: simulated grips on parts that slide when fingers push them.

Fingers move as in `guarded_approach`, at the rig's speeds, with its threshold, frame rate and latency, but
without servos, bytes and frames: a finger is where its speed takes it. The emulated bench's engines say
what it presses with and where the parts go; the load meter hears what arrays would read of it.
"""

import math
from collections import deque
from collections.abc import Callable, Sequence

import numpy as np

from palpate.base.geometry import Floats
from palpate.base.geometry.plane import wrap_angle
from palpate.base.tips import TipShape
from palpate.config import RigFile
from palpate.drivers.emulators import Parts, Skin
from palpate.recognizer import FREE_MARGIN_MM, Contact, FingerApproach, Resolution
from palpate.rig.contact_peak import deceleration_mm_s2
from palpate.rig.conversion import undetected_dent_mm
from palpate.rig.emulated.driven_tips import ArrayNoise, DrivenTip, DrivenTips
from palpate.rig.emulated.scene import Placement, displace
from palpate.rig.emulated.table import outlines_beside
from palpate.rig.fingers import resolution_of
from palpate.rig.motion.guarded_approach import GripPhase
from palpate.rig.motion.load_meter import (
    STEADY_FRAMES,
    TouchStage,
    drag_shares,
    friction_factor,
    tip_friction,
)
from palpate.rig.motion.touch import Touch
from palpate.rig.motion.touch_timing import (
    MEASURE_FRAMES,
    RETOUCH_MARGIN_MM,
    SAMPLES_PER_STATE_READ,
    SETTLE_S,
    load_meter_of,
    search_stage,
    touch_speed_mm_s,
)
from palpate.rig.study.simulated_touches import FingerErrors, Mismeasurement

_STOP_S = 2e-3  # from the frame that shows a contact to the servo's braking: wire, host, bus, and its loop
_TURN_S = 0.09
"""From standing still to going back (s): new profiles, speeding up, play."""

_PITCH_RAD = 0.2  # of an array's columns
# Standard deviations of a window's noise: what is noticed; what the loudest window at the tip's back may
# hide, and what columns at its sides may, times what they would drag with, as on the shipped bench.
_NOTICED_SIGMAS, _BACK_SIGMAS, _BESIDE_SIGMAS = 6.0, 5.5, 2.3
_ROUNDING_S = 1e-9


class SimulatedFinger:
    """One finger on its way; `gain`: what its array reads of a force.

    `travel_mm` is where its servos say it is. It moves at `speed_mm_s` towards `goal_mm`, and stops by itself
    at a contact while it is `sensing`.
    """

    def __init__(
        self,
        rig: RigFile,
        approach: FingerApproach,
        tip: DrivenTip,
        error: Mismeasurement,
        gain: float,
        noise: ArrayNoise,
        rng: np.random.Generator,
    ) -> None:
        spec, closing = rig.fingers[approach.finger_index], rig.closing
        self.approach, self.tip, self.error = approach, tip, error
        self.travel_mm = self.goal_mm = self.speed_mm_s = 0.0
        self.sensing = self.searching = self.touched = self.turns = self.is_back = False
        self._stop_s = math.inf
        self._period_s, self._contact_n = 1 / closing.sample_rate_hz, closing.contact_force_n
        self._deceleration = deceleration_mm_s2(spec, closing.max_force_n)
        self._start = np.array(approach.start_mm) + error.offset_mm
        self._heading = np.array([math.cos(approach.direction_rad), math.sin(approach.direction_rad)])
        self._centre = self._start
        tip.move_to(self._start)
        self._gain, self._noise, self._rng = gain, noise, rng
        self._quiet: deque[float] = deque(maxlen=STEADY_FRAMES)
        self._lately_n, self._free_frames = 0.0, 0
        self._frames = 0
        self._friction, self._off_rad = tip_friction(spec.tip), math.pi
        self.meter = load_meter_of(closing, spec, approach, noise.least_n, noise.share)

    @property
    def centre_mm(self) -> Floats:
        """True place (2,) of the tip; the same array as long as it stands still."""
        return self._centre

    @property
    def is_moving(self) -> bool:
        """True if it has not arrived."""
        return self.travel_mm != self.goal_mm

    def _dragging_n(self, force_n: float, steady_n: float) -> float:
        """Force that may drag the part as it goes back, and what noise may hide beside that."""
        if loads := self.tip.loads:
            pushed = [math.atan2(*(-load.force_n)[::-1]) for load in loads]
            off = max(abs(wrap_angle(angle - self.approach.direction_rad)) for angle in pushed)
            self._off_rad = off + _PITCH_RAD
        sigma_n, sheared = self._noise.least_n / _NOTICED_SIGMAS, friction_factor(self._friction)
        if force_n <= 0.0:  # columns are not looked at one by one then
            is_ahead = not drag_shares(np.array(self._off_rad + _PITCH_RAD), self._friction)
            hidden_n = _BACK_SIGMAS * sigma_n * self._noise.share(max(len(self._quiet), 1))
            return sheared * (hidden_n + (0.0 if is_ahead else steady_n))
        share = float(drag_shares(np.array(self._off_rad), self._friction))
        hidden_n = _BACK_SIGMAS * sigma_n * self._noise.share(STEADY_FRAMES)
        return share * force_n + _BESIDE_SIGMAS * sigma_n + sheared * hidden_n

    def until_event_s(self, now: float) -> float:
        """Time for which it goes on as it does, if it meets nothing."""
        arrival = abs(self.goal_mm - self.travel_mm) / self.speed_mm_s if self.is_moving else math.inf
        return min(arrival, max(self._stop_s - now, 0.0) or math.inf)

    def begin(
        self,
        stage: TouchStage,
        now: float,
        free_mm: float,
        free_within_mm: float,
        touch_mm_s: float | None = None,
    ) -> None:
        """Begin a stage of the grip, as the meter has it."""
        self.meter.begin(stage, now, free_mm, free_within_mm, touch_mm_s)
        self.meter.see(self.travel_mm, now)

    def begin_search(self, stage: TouchStage, now: float) -> None:
        """Begin with the first."""
        self.begin(stage, now, self.approach.fast_mm, FREE_MARGIN_MM)
        self.searching = True

    def go(self, goal_mm: float, speed_mm_s: float, *, sensing: bool) -> None:
        """Be on the way to a place."""
        self.goal_mm, self.speed_mm_s, self.sensing = goal_mm, speed_mm_s, sensing
        self._stop_s = math.inf

    def move(self, dt_s: float) -> None:
        """Let time pass."""
        if self.is_moving:
            left = self.goal_mm - self.travel_mm
            step = self.speed_mm_s * dt_s
            # A remainder of rounding is no way.
            arrives = abs(left) <= step * (1 + 1e-9)
            self.travel_mm = self.goal_mm if arrives else self.travel_mm + math.copysign(step, left)
            self._centre = self._start + self.travel_mm * self._heading

    def sample(self, at_s: float, now: float) -> bool:
        """Read a frame of an instant that has just passed; whether a contact is noticed, once."""
        ago_s = now - at_s if self.is_moving else 0.0
        if self._frames % SAMPLES_PER_STATE_READ == 0:
            back = math.copysign(self.speed_mm_s * ago_s, self.goal_mm - self.travel_mm)
            self.meter.see(self.travel_mm - back, at_s)
        self._frames += 1
        if not self.tip.loads and not self._lately_n:
            self.meter.feel(0.0, at_s + self._period_s)  # as nearly always
            self._free_frames += 1
            return False
        force, steady = self._read_n()
        self.meter.feel(force, at_s + self._period_s, steady, dragging_n=self._dragging_n(force, steady))
        if not self.sensing or force <= self._contact_n:
            return False
        self.sensing, self.touched, self.searching = False, True, False
        seen_s = at_s + self._period_s
        self.meter.stopped(seen_s)
        self._stop_s = seen_s + _STOP_S + self.speed_mm_s / (2 * self._deceleration)
        return True

    def _read_n(self) -> tuple[float, float]:
        """Force that a frame shows, and that the mean of the newest quiet ones does."""
        self._quiet.extend([0.0] * min(self._free_frames, STEADY_FRAMES))
        self._free_frames = 0
        true_n = self._gain * self.tip.force_n
        read_n = true_n + self._noise.sigma_n * self._rng.standard_normal()
        self._lately_n = true_n or self._lately_n
        if read_n > self._noise.least_n:
            self._quiet.clear()
            return read_n, 0.0
        self._quiet.append(read_n)
        count = len(self._quiet)
        if true_n == 0.0 and count == STEADY_FRAMES:
            self._lately_n = 0.0
        mean = sum(self._quiet) / count
        return 0.0, mean if mean > self._noise.least_n * self._noise.share(count) else 0.0

    def stop_if_due(self, now: float, back_off_mm: float, back_mm_s: float) -> None:
        """Stand once the stop is in effect, or go back if it turns there."""
        if now < self._stop_s - _ROUNDING_S:
            return
        if self.turns and not self.is_back:
            self.is_back, self._stop_s, self.goal_mm = True, now + _TURN_S, self.travel_mm
            return
        self.go(self.travel_mm, self.speed_mm_s, sensing=False)
        if self.turns:
            self.turns = False
            self.go(max(0.0, self.travel_mm - back_off_mm), back_mm_s, sensing=False)


_STEP_S = 1e-3
_STEP_MM = 4e-3  # in contact, a tip goes on by so much at once, if that takes no less than _STEP_S
_MAX_STEP_S = 0.25
_TIME_TOLERANCE_S = 1e-9


class PushingTouches:
    """Carries out grips on parts that they may move, as `search` has them carried out."""

    def __init__(
        self,
        rig: RigFile,
        placements: Sequence[Placement],
        parts: Parts,
        tip_friction: float,
        noise: Sequence[ArrayNoise],
        rng: np.random.Generator,
        resolution: Resolution | None = None,
    ) -> None:
        """`parts`: as placed; `noise`: of each finger's array. Tips and gains are drawn in their bounds."""
        self.seconds = 0.0  # rig time in grips; turning to the next aims is not in it
        self._rig, self._put, self._parts = rig, tuple(placements), parts
        self._noise, self._rng = noise, rng
        self._errors = FingerErrors(resolution or resolution_of(rig), rng)
        # Of cylinders alone: others are not simulated.
        self._outlines = {
            item.span_mm: outlines_beside(
                placements,
                parts,
                item.height_mm,
                item.tip.half_length_mm,
                item.tip.radius_mm,
                TipShape.CYLINDER,
            )
            for item in rig.fingers
        }
        stiffness = [
            item.tip.stiffness_n_per_mm * (1 + item.tip.stiffness_spread * rng.uniform(-1, 1))
            for item in rig.fingers
        ]
        self._skins = [
            Skin(item.tip.radius_mm, stiff, tip_friction)
            for item, stiff in zip(rig.fingers, stiffness, strict=True)
        ]
        self._gains = [1 + item.array.gain_spread * rng.uniform(-1, 1) for item in rig.fingers]

    @property
    def placements(self) -> tuple[Placement, ...]:
        """Placements of the parts now."""
        moved = zip(self._put, self._parts.displacements, strict=True)
        return tuple(displace(lies, displacement) for lies, displacement in moved)

    def __call__(
        self, grip: Sequence[FingerApproach], tell: Callable[[GripPhase], None] | None = None
    ) -> list[Touch]:
        """Touches of a grip's fingers, with the loads that they put on the parts."""
        del tell
        fingers = [self._finger(approach) for approach in grip]
        tips = DrivenTips(self._parts, [finger.tip for finger in fingers])
        under_way = _Grip(self._rig, fingers, tips)
        under_way.touch()
        contacts = [self._contact(finger) for finger in fingers]
        under_way.retract()
        self.seconds += under_way.seconds
        return [
            Touch(
                finger.approach.finger_index,
                contact,
                None,
                (math.nan, math.nan),
                finger.meter.loads(),
                finger.meter.trace(),
            )
            for finger, contact in zip(fingers, contacts, strict=True)
        ]

    def _finger(self, approach: FingerApproach) -> SimulatedFinger:
        index = approach.finger_index
        spec = self._rig.fingers[index]
        unnoticed = undetected_dent_mm(spec, self._rig.closing)
        error = self._errors.draw(approach, unnoticed)
        tip = DrivenTip(self._skins[index], spec.height_mm, self._outlines[spec.span_mm])
        gain, noise = self._gains[index], self._noise[index]
        return SimulatedFinger(self._rig, approach, tip, error, gain, noise, self._rng)

    def _contact(self, finger: SimulatedFinger) -> Contact:
        """Contact as the parts lie now; a way was free as far as nothing was noticed on it."""
        approach = finger.approach
        if finger.touched:
            shapes = [lies.region_within(approach.finger.span_mm) for lies in self._put]
            parts = zip(shapes, self._parts.displacements, strict=True)
            contact = finger.error.contact(approach, parts, finger.travel_mm)
            if contact is not None:
                return contact
        trace = finger.meter.trace()
        far = finger.travel_mm if trace is None else min(finger.travel_mm, trace.unfelt_mm)
        far -= 2 * self._rig.closing.back_off_mm if finger.touched else 0.0
        return finger.error.miss(approach, max(far, 0.0))


class _Grip:
    """A grip under way: all its fingers in one time."""

    def __init__(self, rig: RigFile, fingers: Sequence[SimulatedFinger], tips: DrivenTips) -> None:
        self._closing, self._fingers, self._tips = rig.closing, fingers, tips
        self._period_s = 1 / rig.closing.sample_rate_hz
        self._now = self._next_frame_s = 0.0

    @property
    def seconds(self) -> float:
        """Rig time since the grip began."""
        return self._now

    def touch(self) -> None:
        """Search, back off, touch slowly, rest and be measured."""
        closing, fingers = self._closing, self._fingers
        stage = search_stage(closing, [finger.approach for finger in fingers])
        for finger in fingers:
            finger.begin_search(stage, self._now)
            finger.go(finger.approach.fast_mm, closing.approach_speed_mm_s, sensing=True)
        self._search(may_stay=stage is TouchStage.SLOW)
        self._pass(SETTLE_S)
        if not any(finger.touched for finger in fingers):
            return
        again = [finger for finger in fingers if finger.is_back]
        for finger in again:
            met = finger.travel_mm + closing.back_off_mm
            speed = touch_speed_mm_s(finger.approach, closing.touch_speed_mm_s)
            finger.begin(TouchStage.SLOW, self._now, met - RETOUCH_MARGIN_MM, RETOUCH_MARGIN_MM, speed)
            finger.touched = False
            finger.go(finger.approach.travel_mm, speed, sensing=True)
        if again:
            self._move()
            self._pass(SETTLE_S)
        self._pass(MEASURE_FRAMES * self._period_s)
        for finger in fingers:
            finger.meter.measured(self._now)

    def retract(self) -> None:
        """Let all go back to where they wait."""
        self._pass(_TURN_S)
        for finger in self._fingers:
            finger.go(0.0, self._closing.retract_mm_s, sensing=False)
        self._move()

    def _search(self, *, may_stay: bool) -> None:
        """Fast, slower where the part may be, and back from a contact; the last to touch may stay there."""
        closing = self._closing
        while any(finger.is_moving or finger.searching or finger.turns for finger in self._fingers):
            for finger in self._fingers:
                if finger.searching and not finger.is_moving:
                    self._slow_down(finger)
            for finger in self._advance(self._step_s()):
                others = any(other.searching for other in self._fingers)
                finger.turns = others or not may_stay
            for finger in self._fingers:
                finger.stop_if_due(self._now, closing.back_off_mm, closing.approach_speed_mm_s)

    def _slow_down(self, finger: SimulatedFinger) -> None:
        """Slow down at the end of free space, and at the end of the way."""
        if finger.travel_mm < finger.approach.travel_mm:
            speed = touch_speed_mm_s(finger.approach, self._closing.search_mm_s)
            finger.go(finger.approach.travel_mm, speed, sensing=True)
        else:
            finger.searching = finger.sensing = False

    def _move(self) -> None:
        """Let time pass until all stand."""
        while any(finger.is_moving for finger in self._fingers):
            self._advance(self._step_s())
            for finger in self._fingers:
                finger.stop_if_due(self._now, 0.0, 0.0)

    def _pass(self, seconds: float) -> None:
        """Let time pass."""
        end = self._now + seconds
        while self._now < end - _TIME_TOLERANCE_S:
            self._advance(min(self._step_s(), end - self._now))

    def _step_s(self) -> float:
        """Time in which nothing happens but what is under way: tips move freely, or by little."""
        fingers = self._fingers
        step = min(_MAX_STEP_S, *(finger.until_event_s(self._now) for finger in fingers))
        for finger in fingers:
            if not finger.is_moving:
                continue
            gap = 0.0 if finger.tip.loads else finger.tip.gap_mm(self._tips.parts.displacements)
            way = _STEP_MM if finger.tip.loads else max(gap, 0.0)
            step = min(step, max(way / finger.speed_mm_s, _STEP_S))
        return step if self._tips.is_at_rest else min(step, self._period_s)

    def _advance(self, dt_s: float) -> list[SimulatedFinger]:
        """Let time pass; the fingers that notice a contact."""
        for finger in self._fingers:
            finger.move(dt_s)
        self._now += dt_s
        self._tips.step([finger.centre_mm for finger in self._fingers], dt_s)
        found = []
        while self._next_frame_s <= self._now + _TIME_TOLERANCE_S:
            found += [finger for finger in self._fingers if finger.sample(self._next_frame_s, self._now)]
            self._next_frame_s += self._period_s
        return found
