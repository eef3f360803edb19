"""Pushing touches: simulated grips on a part that slides when fingers push it.

Fingers move as in `guarded_approach`, at the rig's speeds, with its threshold, frame rate and latency, but
without servos, bytes and frames: a finger is where its speed takes it. The emulated bench's engines say what
it presses with and where the part goes; the load meter hears what arrays would read of it.
"""

import math
from collections.abc import Callable, Sequence

import numpy as np

from palpate.config import RigFile
from palpate.drivers.emulators.part import Part
from palpate.drivers.emulators.skin import Skin
from palpate.recognizer import Contact, FingerApproach, Resolution
from palpate.rig.conversion import resolution_of, undetected_dent_mm
from palpate.rig.emulated.array_noise import ArrayNoise
from palpate.rig.emulated.driven_tips import DrivenTip, DrivenTips
from palpate.rig.emulated.scene import Placement, moved, outline_at
from palpate.rig.motion.contact_load import TouchStage
from palpate.rig.motion.guarded_approach import MEASURE_FRAMES, GripPhase, Touch
from palpate.rig.study.mismeasurement import FingerErrors
from palpate.rig.study.simulated_finger import TURN_S, SimulatedFinger
from palpate.rig.study.simulated_touches import PlacedShapes

__all__ = ["PushingTouches"]

_STEP_S = 1e-3
_STEP_MM = 4e-3  # in contact, a tip goes on by so much at once, if that takes no less than _STEP_S
_SETTLE_S = 0.08
_NEAR_MM = 0.5
_LONGEST_S = 0.25
_ROUNDING_S = 1e-9


class PushingTouches:
    """Carries out grips on a part that they may move, as `search` has them carried out."""

    def __init__(
        self,
        rig: RigFile,
        placement: Placement,
        part: Part,
        tip_friction: float,
        noise: Sequence[ArrayNoise],
        rng: np.random.Generator,
        resolution: Resolution | None = None,
    ) -> None:
        """`part`: as placed; `noise`: of each finger's array. Tips and gains are drawn in their bounds."""
        self.seconds = 0.0  # rig time in grips; turning to the next aims is not in it
        self._rig, self._put, self._part, self._noise, self._rng = rig, placement, part, noise, rng
        self._shapes = PlacedShapes(placement)
        self._errors = FingerErrors(resolution or resolution_of(rig), rng)
        spans = {
            item.span_mm: (
                item.height_mm,
                item.tip.half_length_mm,
                item.tip.radius_mm if item.tip.is_ball else None,
            )
            for item in rig.fingers
        }
        self._outlines = {span: outline_at(placement, *at) for span, at in spans.items()}
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
    def placement(self) -> Placement:
        """Where the part lies now."""
        return moved(self._put, self._part.displacement)

    def __call__(
        self, grip: Sequence[FingerApproach], tell: Callable[[GripPhase], None] | None = None
    ) -> list[Touch]:
        """What the fingers of a grip feel, and what loads they put on the part."""
        del tell
        fingers = [self._finger(approach) for approach in grip]
        tips = DrivenTips(self._part, [finger.tip for finger in fingers])
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
        """As the part lies now; a way was free as far as nothing was noticed on it."""
        approach = finger.approach
        if finger.touched:
            shape = self._shapes.within(approach.finger.span_mm)
            contact = finger.error.contact(approach, shape, self._part.displacement, finger.travel_mm)
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
        slow = closing.touch_speed_mm_s
        is_slow = all(finger.slowed_to(closing.search_mm_s) <= slow for finger in fingers)
        for finger in fingers:
            finger.begin_search(TouchStage.SLOW if is_slow else TouchStage.QUICK, self._now)
            finger.go(finger.approach.fast_mm, closing.approach_speed_mm_s, sensing=True)
        self._search(may_stay=is_slow)
        self._pass(_SETTLE_S)
        if not any(finger.touched for finger in fingers):
            return
        again = [finger for finger in fingers if finger.is_back]
        for finger in again:
            met = finger.travel_mm + closing.back_off_mm
            finger.begin(TouchStage.SLOW, self._now, met - _NEAR_MM, _NEAR_MM)
            finger.touched = False
            finger.go(finger.approach.travel_mm, finger.slowed_to(slow), sensing=True)
        if again:
            self._move()
            self._pass(_SETTLE_S)
        self._pass(MEASURE_FRAMES * self._period_s)
        for finger in fingers:
            finger.meter.measured(self._now)

    def retract(self) -> None:
        """Let all go back to where they wait."""
        self._pass(TURN_S)
        for finger in self._fingers:
            finger.go(0.0, self._closing.approach_speed_mm_s, sensing=False)
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
        """At the end of free space, and at the end of its way."""
        if finger.travel_mm < finger.approach.travel_mm:
            speed = finger.slowed_to(self._closing.search_mm_s)
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
        while self._now < end - _ROUNDING_S:
            self._advance(min(self._step_s(), end - self._now))

    def _step_s(self) -> float:
        """How long nothing happens but what is under way: until then tips move freely, or by little."""
        fingers = self._fingers
        step = min(_LONGEST_S, *(finger.until_event_s(self._now) for finger in fingers))
        for finger in fingers:
            if not finger.is_moving:
                continue
            pressed = finger.tip.press is not None
            way = _STEP_MM if pressed else max(finger.tip.gap_mm(self._tips.displacement), 0.0)
            step = min(step, max(way / finger.speed_mm_s, _STEP_S))
        return step if self._tips.is_at_rest else min(step, self._period_s)

    def _advance(self, dt_s: float) -> list[SimulatedFinger]:
        """Let time pass; the fingers that notice a contact."""
        for finger in self._fingers:
            finger.move(dt_s)
        self._now += dt_s
        self._tips.step([finger.centre_mm for finger in self._fingers], dt_s)
        found = []
        while self._next_frame_s <= self._now + _ROUNDING_S:
            found += [finger for finger in self._fingers if finger.sample(self._next_frame_s, self._now)]
            self._next_frame_s += self._period_s
        return found
