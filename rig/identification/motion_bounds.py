"""Motion bounds of a grip: how far its touches can have moved the part, from the loads that were measured.

See docs/recogniser.md, "A part that moves". Friction at the table takes at least F for every mm of slide
(`support`), so the slide is at most the work done on the part over F; and nothing slides while no force is
large enough.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from palpate.config import ClosingConfig, FingerConfig, RigFile
from palpate.geometry import Floats, Ints
from palpate.recognizer import Catalogue, Motion
from palpate.rig.conversion import measured_force_share
from palpate.rig.identification.support import Support, supports_of
from palpate.rig.motion.contact_from_touch import Touch
from palpate.rig.motion.contact_load import ContactLoad, TouchStage

__all__ = ["GripMotion", "MotionBounds"]

_OBLIQUE = math.hypot(1.0, 0.7)
"""Arrays measure what presses, not what shears: with friction up to 0.7 a force is larger by this factor."""


@dataclass(frozen=True, eq=False)
class GripMotion:
    """What a grip may have moved: `before` its contacts were measured, `after`, as fingers left, and `whole`.

    Infinite where there is no bound. One work bounds both parts, so `whole` is less than their sum.
    """

    before: Motion
    after: Motion
    whole: Motion

    def within(self, states: Ints) -> tuple[float, float] | None:
        """How far (mm, rad) a part in one of `states` (indices) was moved at most; None: any distance."""
        shift = float(self.whole.shift_mm[states].max())
        turn = float(self.whole.turn_rad[states].max())
        return (shift, turn) if math.isfinite(shift + turn) else None


@dataclass(frozen=True)
class _Pushes:
    """Of all `fingers` of a grip: the sum of their largest forces, the work that they may have done, and the
    elastic energy in their tips when the contacts were measured."""

    fingers: int
    forces_n: float
    work_mj: float
    stored_mj: float


@dataclass(frozen=True, eq=False)
class MotionBounds:
    """Bounds motions of parts of a catalogue on a rig."""

    rig: RigFile
    catalogue: Catalogue

    @cached_property
    def supports(self) -> tuple[Support, ...]:
        """Of every state of the catalogue."""
        return supports_of(self.catalogue, self.rig.search)

    @cached_property
    def unnoticed_n(self) -> float:
        """The largest force with which a finger may press on the part without a load being listed."""
        return max(_unnoticed_n(finger, self.rig.closing) for finger in self.rig.fingers)

    def holds_n(self, states: Ints) -> float | None:
        """What a part in one of `states` (indices) bears; None if that is not said of all of them."""
        least = min(self.supports[state].holds_n for state in states.tolist())
        undeclared = any(math.isinf(self.supports[state].holds_n) for state in states.tolist())
        return None if undeclared else least

    def of_grip(self, touches: Sequence[Touch]) -> GripMotion:
        """Bounds on what a grip moved."""
        pushes = self._pushes(touches)
        count = len(self.catalogue.states)
        slides = np.array([self._slides_mm(support, pushes) for support in self.supports]).reshape(count, 3)
        shift = np.array([support.shift for support in self.supports])
        turn = np.array([support.turn_rad_per_mm for support in self.supports])
        before, after, whole = (Motion(_times(slide, shift), _times(slide, turn)) for slide in slides.T)
        return GripMotion(before, after, whole)

    def _slides_mm(self, support: Support, pushes: _Pushes) -> tuple[float, float, float]:
        """Largest slide before the measurement, after it, and in all."""
        if math.isinf(support.holds_n):
            return 0.0, 0.0, 0.0
        unnoticed_n = self.unnoticed_n * support.leverage
        if unnoticed_n >= support.holds_n:
            return math.inf, math.inf, math.inf
        # A finger that presses unnoticed cannot move the part by itself, but it may help one that does.
        left_n = support.holds_n - unnoticed_n * (pushes.fingers > 1)
        if pushes.forces_n * support.leverage <= left_n:
            return 0.0, 0.0, 0.0
        before = pushes.work_mj / left_n
        return before, min(pushes.stored_mj / left_n, before), before

    def _pushes(self, touches: Sequence[Touch]) -> _Pushes:
        forces, work, stored = 0.0, 0.0, 0.0
        for touch in touches:
            finger = self.rig.fingers[touch.finger_index]
            if touch.contact.touched and not touch.loads:
                return _Pushes(
                    len(touches), math.inf, math.inf, math.inf
                )  # touched, and nothing is known of how hard
            peaks = [(load, self._peak_n(finger, load)) for load in touch.loads]
            soft = _stiffness(finger)[0]
            forces += max((peak for _, peak in peaks), default=0.0)
            work += sum(self._work_mj(finger, load, peak) for load, peak in peaks)
            slow = [peak for load, peak in peaks if load.stage is TouchStage.SLOW]
            stored += max(slow, default=0.0) ** 2 / (2 * soft)
        return _Pushes(len(touches), forces, work, stored)

    def _speed(self, load: ContactLoad) -> float:
        closing = self.rig.closing
        return closing.search_mm_s if load.stage is TouchStage.QUICK else closing.touch_speed_mm_s

    def _peak_n(self, finger: FingerConfig, load: ContactLoad) -> float:
        """Largest force there can have been: gains, and what came between two frames."""
        between = _stiffness(finger)[1] * self._speed(load) / self.rig.closing.sample_rate_hz
        return _OBLIQUE * (load.peak_force_n / (1 - measured_force_share(finger)) + between)

    def _work_mj(self, finger: FingerConfig, load: ContactLoad, peak_n: float) -> float:
        """Most work that there can have been: gains, a frame's travel, and what was done below the noise."""
        step_mm = self._speed(load) / self.rig.closing.sample_rate_hz
        dented = self.unnoticed_n**2 / (2 * _stiffness(finger)[0])
        work = _OBLIQUE * load.work_mj / (1 - measured_force_share(finger))
        return work + peak_n * step_mm + dented


def _unnoticed_n(finger: FingerConfig, closing: ClosingConfig) -> float:
    # Half of the threshold is listed; as much again may be hidden below single taxels' noise.
    return _OBLIQUE * closing.contact_force_n / (1 - finger.array.gain_spread)


def _stiffness(finger: FingerConfig) -> tuple[float, float]:
    """The least and the greatest that a tip may have, N/mm."""
    tip = finger.tip
    return (
        tip.stiffness_n_per_mm * (1 - tip.stiffness_spread),
        tip.stiffness_n_per_mm * (1 + tip.stiffness_spread),
    )


def _times(slide: Floats, per_mm: Floats) -> Floats:
    """Products; nothing for states that do not slide (a state that lies still has no factor)."""
    result: Floats = np.zeros_like(slide)
    np.multiply(slide, per_mm, out=result, where=slide > 0)
    return result
