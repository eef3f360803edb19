"""Simulated finger in a grip: where its tip is on its way, what its array reads, and when it stops."""

import math
from collections import deque

import numpy as np

from palpate.base.geometry import Floats
from palpate.base.geometry.plane import wrap_angle
from palpate.config import FingerConfig, RigFile
from palpate.recognizer import FREE_MARGIN_MM, FingerApproach
from palpate.rig.contact_peak import deceleration_mm_s2, travel_step_mm
from palpate.rig.emulated.array_noise import ArrayNoise
from palpate.rig.emulated.driven_tips import DrivenTip
from palpate.rig.motion.contact_load import (
    TouchStage,
    drag_shares,
    friction_factor,
    friction_of,
)
from palpate.rig.motion.load_meter import LoadMeter
from palpate.rig.motion.quiet_mean import STEADY_FRAMES
from palpate.rig.study.mismeasurement import Mismeasurement

__all__ = ["TURN_S", "SimulatedFinger"]

_STOP_S = 2e-3  # from the frame that shows a contact to the servo's braking: wire, host, bus, and its loop
TURN_S = 0.09
"""From standing still to going back (s): new profiles, speeding up, play."""

_SEEN_EVERY = 5  # samples between looks at the servos
_PITCH_RAD = 0.2  # of an array's columns
# Standard deviations of a window's noise: what is noticed; what the loudest window at the tip's back may
# hide, and what columns at its sides may, times what they would drag with, as on the shipped bench.
_LEAST_SIGMAS, _BACK_SIGMAS, _BESIDE_SIGMAS = 6.0, 5.5, 2.3
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
        self._friction, self._off_rad = friction_of(spec.tip), math.pi
        self.meter = self._metered(rig, spec)

    def _metered(self, rig: RigFile, spec: FingerConfig) -> LoadMeter:
        return LoadMeter(
            self._contact_n,
            self._period_s,
            self._noise.least_n,
            self.slowed_to(rig.closing.search_mm_s),
            travel_step_mm(spec),
            self._noise.share,
            friction=self._friction,
        )

    @property
    def centre_mm(self) -> Floats:
        """True place (2,) of the tip; the same array as long as it stands still."""
        return self._centre

    @property
    def is_moving(self) -> bool:
        """Whether it has not arrived."""
        return self.travel_mm != self.goal_mm

    def _dragging_n(self, force_n: float, steady_n: float) -> float:
        """What it may drag the part with as it goes back, and what noise may hide beside that."""
        if self.tip.press is not None:
            x, y = -self.tip.press.load.force_n
            self._off_rad = abs(wrap_angle(math.atan2(y, x) - self.approach.direction_rad)) + _PITCH_RAD
        sigma_n, sheared = self._noise.least_n / _LEAST_SIGMAS, friction_factor(self._friction)
        if force_n <= 0.0:  # columns are not looked at one by one then
            is_ahead = not drag_shares(np.array(self._off_rad + _PITCH_RAD), self._friction)
            hidden_n = _BACK_SIGMAS * sigma_n * self._noise.share(max(len(self._quiet), 1))
            return sheared * (hidden_n + (0.0 if is_ahead else steady_n))
        share = float(drag_shares(np.array(self._off_rad), self._friction))
        hidden_n = _BACK_SIGMAS * sigma_n * self._noise.share(STEADY_FRAMES)
        return share * force_n + _BESIDE_SIGMAS * sigma_n + sheared * hidden_n

    def until_event_s(self, now: float) -> float:
        """How long it goes on as it does, if it meets nothing."""
        arrival = abs(self.goal_mm - self.travel_mm) / self.speed_mm_s if self.is_moving else math.inf
        return min(arrival, max(self._stop_s - now, 0.0) or math.inf)

    def slowed_to(self, speed_mm_s: float) -> float:
        """A speed at which to meet the part, no higher than the approach allows."""
        return min(speed_mm_s, self.approach.touch_mm_s or math.inf)

    def begin(self, stage: TouchStage, now: float, free_mm: float, free_within_mm: float) -> None:
        """Begin a stage of the grip, as the meter has it."""
        self.meter.begin(stage, now, free_mm, free_within_mm)
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
        if self._frames % _SEEN_EVERY == 0:
            back = math.copysign(self.speed_mm_s * ago_s, self.goal_mm - self.travel_mm)
            self.meter.see(self.travel_mm - back, at_s)
        self._frames += 1
        if self.tip.press is None and not self._lately_n:
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
        """What a frame shows, and what the mean of the newest quiet ones does."""
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
            self.is_back, self._stop_s, self.goal_mm = True, now + TURN_S, self.travel_mm
            return
        self.go(self.travel_mm, self.speed_mm_s, sensing=False)
        if self.turns:
            self.turns = False
            self.go(max(0.0, self.travel_mm - back_off_mm), back_mm_s, sensing=False)
