"""The emulated bench: fingers, a table and what stands on it, in one time.

Joins the emulated servos and arrays. Every device calls `Bench.advance` before it answers; the bench then
lets the mechanics catch up in steps of one millisecond and hands every streaming array its samples. A finger
is an aim servo that turns a slide about a fixed base, and a slide servo that moves the tip along it; both act
through play. The object does not move, and tips yield along their radius only.

What the host is not told (`FingerTruth`) is drawn by whoever builds the bench and never leaves it.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from palpate.drivers.emulators.array import EmulatedArray
from palpate.drivers.emulators.servo import EmulatedServo
from palpate.drivers.emulators.tip import Outline, Press, press, separation_mm

__all__ = ["Bench", "EmulatedFinger", "FingerTruth"]

Floats = NDArray[np.float64]

_STEP_S = 1e-3
_MM_PER_M = 1000.0


@dataclass(frozen=True)
class FingerTruth:
    """How an emulated finger really is built, in W; mm, rad, N.

    aim = heading + (servo − aim_zero_rad) / gear_ratio and distance = zero_mm + mm_per_rad · servo, with
    servo angles as the shaft has them and `aim_play_rad` and `slide_play_mm` either way between the two.
    `array_heading_rad`: where the array's middle looks, from the direction of travel.
    """

    base_mm: tuple[float, float]
    heading_rad: float
    height_mm: float
    gear_ratio: float
    aim_zero_rad: float
    aim_play_rad: float
    mm_per_rad: float
    zero_mm: float
    slide_play_mm: float
    tip_radius_mm: float
    stiffness_n_per_mm: float
    array_heading_rad: float


class _Play:
    """A coupling with play: the driven side follows once the play is used up."""

    def __init__(self, half: float, at: float) -> None:
        self._half = half
        self.at = at

    def follow(self, driving: float) -> float:
        if driving - self.at > self._half:
            self.at = driving - self._half
        elif driving - self.at < -self._half:
            self.at = driving + self._half
        return self.at


class EmulatedFinger:
    """One finger: two servos, the mechanics between them and the tip, and the array on it.

    `outline` is what stands on the table at the finger's height, None for nothing. `press` is what touches
    the tip now, `hardest_n` the largest force so far.
    """

    def __init__(
        self,
        truth: FingerTruth,
        aim: EmulatedServo,
        slide: EmulatedServo,
        array: EmulatedArray,
        outline: Outline | None,
    ) -> None:
        self.truth = truth
        self.outline = outline
        self.aim = aim
        self.slide = slide
        self.array = array
        self.press: Press | None = None
        self.hardest_n = 0.0
        self._aim_play = _Play(truth.aim_play_rad, self._aim_drive())
        self._slide_play = _Play(truth.slide_play_mm, self._slide_drive())
        self._free_centre = np.full(2, np.inf)
        self._free_mm = 0.0
        self._pressed_centre = np.full(2, np.inf)

    def put(self, outline: Outline | None) -> None:
        """Let something else, or the same elsewhere, stand on the table; nothing may touch the tip now."""
        self.outline = outline
        self._free_centre = np.full(2, np.inf)

    @property
    def direction_rad(self) -> float:
        """True direction of the slide in W."""
        return self._aim_play.at

    @property
    def centre_mm(self) -> Floats:
        """True position (2,) of the tip's axis in W."""
        angle, distance = self._aim_play.at, self._slide_play.at
        x, y = self.truth.base_mm
        return np.array([x + distance * math.cos(angle), y + distance * math.sin(angle)])

    def step(self, dt_s: float) -> None:
        """Let servos, couplings and skin move on by `dt_s`."""
        push = 0.0
        if self.press is not None:
            along = np.array([math.cos(self.direction_rad), math.sin(self.direction_rad)])
            push = float(self.press.force_n @ along)
        lever = self.truth.mm_per_rad / _MM_PER_M
        self.slide.step(dt_s, push * lever)
        self.aim.step(dt_s, 0.0)
        self._aim_play.follow(self._aim_drive())
        self._slide_play.follow(self._slide_drive())
        self.press = None if self.outline is None else self._touch(self.outline)
        if self.press is not None:
            self.hardest_n = max(self.hardest_n, float(np.hypot(*self.press.force_n)))

    def sample(self, now: float) -> None:
        """Hand the array the forces on its taxels at `now`."""
        if self.press is None or self.outline is None:
            self.array.sample(now, np.zeros((self.array.description.rows, self.array.description.cols)))
        else:
            self.array.sample(now, self._taxels(self.press, self.outline))

    def _aim_drive(self) -> float:
        truth = self.truth
        return truth.heading_rad + (self.aim.shaft_rad - truth.aim_zero_rad) / truth.gear_ratio

    def _slide_drive(self) -> float:
        return self.truth.zero_mm + self.truth.mm_per_rad * self.slide.shaft_rad

    def _touch(self, outline: Outline) -> Press | None:
        # An outline that was further away than the tip has moved since cannot have been reached.
        centre, radius = self.centre_mm, self.truth.tip_radius_mm
        if math.dist(centre, self._free_centre) < self._free_mm:
            return None
        if self.press is not None and np.array_equal(centre, self._pressed_centre):
            return self.press
        self._pressed_centre = self._free_centre = centre
        self._free_mm = separation_mm(outline, centre) - radius
        if self._free_mm > 0:
            return None
        return press(outline, centre, radius, self.truth.stiffness_n_per_mm)

    def _taxels(self, touch: Press, outline: Outline) -> Floats:
        """Force (rows, cols) N on each taxel: rays sorted into columns, shared by the rows below the top."""
        d = self.array.description
        columns = np.asarray(d.columns)
        pitch = columns[1] - columns[0]
        middle = self.direction_rad + self.truth.array_heading_rad
        seen = (touch.angle - middle + math.pi) % (2 * math.pi) - math.pi
        slot = np.floor((seen - columns[0]) / pitch + 0.5).astype(np.int64)
        on_array = (slot >= 0) & (slot < d.cols)
        by_column = np.bincount(slot[on_array], touch.by_ray_n[on_array], minlength=d.cols)
        heights = np.asarray(d.row_heights_mm)
        lower_end = self.truth.height_mm - float(heights.mean())
        below = (heights + lower_end) <= outline.top_mm
        rows = below / max(int(below.sum()), 1)
        result: Floats = rows[:, None] * by_column
        return result


class Bench:
    """All fingers round one table, in one time."""

    def __init__(self, fingers: Sequence[EmulatedFinger]) -> None:
        self.fingers = tuple(fingers)
        self._steps = 0

    def advance(self, now: float) -> None:
        """Let the mechanics catch up with `now` (s), which never runs backwards.

        Mechanics move in whole steps; arrays sample at their own instants what the last step left.
        """
        steps = int(now / _STEP_S + 1e-6)
        while self._steps < steps:
            self._sample_until((self._steps + 1) * _STEP_S)
            self._steps += 1
            for finger in self.fingers:
                finger.step(_STEP_S)
        self._sample_until(now)

    def _sample_until(self, now: float) -> None:
        for finger in self.fingers:
            while (due := finger.array.next_sample_s()) is not None and due <= now:
                finger.sample(due)
