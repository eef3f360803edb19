"""Load of a touch on the part: peak force, travel in contact and work, measured frame by frame.

A `LoadMeter` collects forces and travels of one finger, each at its instant, and makes loads and a trace of
them. A force that lasts is noticed in the mean of what the array reads while no frame by itself shows any.
"""

import math
from array import array
from bisect import bisect_right
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import cached_property
from typing import Self

import numpy as np

from palpate.base.geometry import Bools, Floats, Ints
from palpate.config import TipConfig
from palpate.drivers.tactile import ContactExtractor, TactileFrame, windows_within

TIP_FRICTION = 0.7
"""Friction of tips on parts that bounds on motion allow for, unless a rig file allows for more."""

HIDDEN_FACTOR = 1.5
"""So many times the noise's limit: three standard deviations more, and a force is noticed."""


class TouchStage(StrEnum):
    """Stage of a touch: the quick one finds the part, the slow one measures it."""

    QUICK = "quick"
    SLOW = "slow"


@dataclass(frozen=True)
class ContactLoad:
    """Load on the part by one stage of a touch, from the first contact until the finger has left it.

    `peak_force_n`: the largest force in a frame of the array. `travel_mm`: how far the tip went on in
    contact, forwards only, since the last frame without any force. `work_mj`: force times travel, likewise.
    `begun_s`, `ended_s`: from that frame to the first one without force again, on the rig's clock; loads of
    two fingers at different times do not add up. Infinite where that is not known.

    Measured, without bounds. Forces are off by the array's gain, and below its noise nothing is measured; so
    a load below half of contact_force_n is not listed. Between two frames the force may have been larger by
    stiffness × speed × sample period. Servos are read less often: where the tip was meanwhile is
    interpolated, also while it brakes, and how far it went on and came back between two reads is missing.
    """

    stage: TouchStage
    peak_force_n: float
    travel_mm: float
    work_mj: float
    begun_s: float = -math.inf
    ended_s: float = math.inf


@dataclass(frozen=True, eq=False)
class LoadTrace:
    """Load on the part by a finger over time, frame by frame: what motion bounds are computed from.

    `time_s` (n,) ascending, on the rig's clock, within `time_bound_s` of when the frames were sampled;
    `force_n` (n,): what was noticed, in the frame or in the mean
    of up to 64 quiet ones around it, 0 for nothing; `unnoticed_n` (n,): what the noise may hide of
    a steady push; `zero_doubt_n` (n,): what the doubt of the zero may hide of any force beside, and
    `any_zero_doubt_n` (n,) if no way was free; `free_within_mm` (n,): the way there is free of a part that
    the grip has moved by no more than this, 0 where that was not known; `travel_mm` (n,): where the tip was
    on its way; `advance_mm` (n,): how far it can have gone forward since the frame before, or sideways;
    `touch_mm_s` (n,): how fast at most since the frame before, where it might meet the part; `measured_s`:
    when the grip's contacts were measured, nan if never; `unfelt_mm`: so far the tip had come at least before
    anything was noticed, infinite if nothing was; `retreat_mm` (n,): how far it can have gone back since the
    frame before;
    `dragging_n` (n,): what the force that was noticed may drag the part with then, as much as all of it where
    the tip's back may hook the part, 0 where none was; `quiet` (n,): nothing was noticed in the frame by
    itself.
    """

    time_s: Floats
    time_bound_s: float
    force_n: Floats
    travel_mm: Floats
    advance_mm: Floats
    unnoticed_n: Floats
    zero_doubt_n: Floats
    any_zero_doubt_n: Floats
    free_within_mm: Floats
    touch_mm_s: Floats
    measured_s: float
    unfelt_mm: float
    retreat_mm: Floats
    dragging_n: Floats
    quiet: Bools

    def of_nothing_felt(self, free_mm: float) -> Self:
        """The same way for a part that it passes at `free_mm`: what the finger pressed was another part."""
        nothing = np.zeros_like(self.force_n)
        within = np.maximum(self.free_within_mm, free_mm)
        return replace(self, force_n=nothing, dragging_n=nothing, free_within_mm=within)

    @property
    def felt(self) -> bool:
        """True if anything was noticed."""
        return bool(self.force_n.any())


def tip_friction(tip: TipConfig) -> float:
    """Largest friction of a tip on parts that bounds on motion allow for."""
    return max(TIP_FRICTION, tip.max_friction)


def friction_factor(friction: float) -> float:
    """Arrays measure what presses, not what shears: with friction a force is larger by this at most."""
    return math.hypot(1.0, friction)


def drag_shares(ahead_rad: Floats, friction: float = TIP_FRICTION) -> Floats:
    """Largest force with which a tip that goes back drags a part, as a share of what presses on it.

    `ahead_rad` (n,): how far from straight ahead that is at most. What presses from ahead only gets lighter;
    from atan(1/friction) on, 55° with 0.7, friction may drag the part by more than that. Infinite behind
    the tip.
    """
    shares = friction * np.sin(ahead_rad) - np.cos(ahead_rad)
    result: Floats = np.where(ahead_rad > math.pi / 2, math.inf, np.maximum(shares, 0.0))
    return result


STEADY_FRAMES = 64
"""A force that lasts for so many frames is noticed in their mean, where the noise is less."""


class QuietMean:
    """Mean readings of the newest frames, up to `STEADY_FRAMES` of them."""

    def __init__(self) -> None:
        self._newest: deque[Floats] = deque(maxlen=STEADY_FRAMES)
        self._sum = np.zeros(0)

    @property
    def count(self) -> int:
        """Number of frames."""
        return len(self._newest)

    def add(self, readings: Floats) -> tuple[Floats, int]:
        """Take readings (n,) of one more frame; the mean (n,), and of how many."""
        newest = self._newest
        if not newest:
            self._sum = readings.copy()
        else:
            self._sum += readings
            if len(newest) == STEADY_FRAMES:
                self._sum -= newest[0]
        newest.append(readings)
        return self._sum / float(len(newest)), len(newest)


LIGHT_FORCE_FACTOR = 8
"""So many times contact_force_n is a light force: up to there it counts where it is felt round the tip."""

_CATCH_UP_SPEED_FACTOR = 1.1  # than its profile may a servo be that catches up
_MAX_LEAD_MM = 1.0  # of where it was seen last may a tip be
_NUMBERS_PER_FRAME = 6  # numbers
_BRAKING_FRAMES = 2  # frames after the order to stop until a tip stands


class LoadMeter:
    """Collects forces and travels of one finger, each at its instant, and sums them up to loads."""

    def __init__(  # noqa: PLR0913  # what is known of the finger, all but two optional
        self,
        contact_force_n: float,
        period_s: float,
        unnoticed_n: float = 0.0,
        touch_mm_s: float = math.inf,
        step_mm: float = 0.0,
        noise_share: Callable[[int], float] = lambda frames: 1 / math.sqrt(frames),
        drags: Floats | None = None,
        friction: float = TIP_FRICTION,
    ) -> None:
        """`contact_force_n`: half of it counts as contact; `period_s`: time between two frames;
        `unnoticed_n`: the largest force that a single frame may not show; `touch_mm_s`: of the quick stage;
        `step_mm`: how finely servos tell where the tip is; `noise_share`: of the mean of so many frames;
        `drags` (cols,): see `ApproachState.drags`; None: all of any force may drag the part along;
        `friction`: of the tip on parts, at most.
        """
        self._sheared = friction_factor(friction)
        self._drags, self._behind, self._beside = drags, np.zeros(0, dtype=bool), np.zeros(0, dtype=bool)
        if drags is not None:  # windows at the tip's back are looked at by themselves
            self._behind, columns = windows_within(np.isinf(drags))
            self._beside = ~windows_within(drags == 0)[0]
            self._drags = np.where(columns, 0.0, np.minimum(drags, self._sheared))
        self._touch_mm_s, self._step_mm, self._noise_share = touch_mm_s, step_mm, noise_share
        self._stopped: list[float] = []
        self._late_s = 2 * period_s
        self._least_n, self._period_s = contact_force_n / 2, period_s
        self._unnoticed_n = unnoticed_n
        # Plain numbers one after another: a grip has tens of thousands of frames.
        self._forces = array("d")  # by frames: latest_s, force_n, steady_n, doubts_n and dragging_n
        self._seen_s, self._seen_mm, self._aside_mm = array("d"), array("d"), array("d")
        self._begun: list[tuple[float, TouchStage, float, float, float]] = []
        self._quiet, self._quiet_behind = QuietMean(), QuietMean()
        self._measured_s = math.nan

    def begin(
        self,
        stage: TouchStage,
        now: float,
        free_mm: float = 0.0,
        free_within_mm: float = 0.0,
        touch_mm_s: float | None = None,
    ) -> None:
        """Begin a stage; one that is begun again is a touch of its own.

        `free_mm`: so much of the way is free of a part that the grip has moved by `free_within_mm` at most.
        `touch_mm_s`: its speed, if it is not that of the quick stage.
        """
        speed = self._touch_mm_s if touch_mm_s is None else touch_mm_s
        self._begun.append((now, stage, free_mm, free_within_mm, speed))

    def resume(self, now: float) -> None:
        """Go on with a stage after the finger was stopped on its way."""
        self._begun.append((now, *self._begun[-1][1:]))

    def quiet_mean(self, readings: Floats, force_n: float) -> tuple[Floats, int] | None:
        """Mean readings (n,) of the newest frames without a force, and how many; None at a frame with one.

        What is below the noise of three columns counts as none: single taxels exceed theirs now and then.
        """
        if force_n > self._unnoticed_n:
            if self._quiet.count:
                self._quiet_behind, self._quiet = self._quiet, QuietMean()
            return None
        return self._quiet.add(readings)

    def dragging_n(self, extractor: ContactExtractor, frame: TactileFrame, readings: Floats) -> float:
        """Largest drag (N) of a noticed force on the part as the tip goes back; infinite: all of it.

        By the columns on which it is felt, and by what noise may hide at the tip's back.
        """
        if self._drags is None:
            return math.inf
        beside_n = extractor.weighted_n(frame, self._drags)
        if not self._behind.any():
            return beside_n
        if extractor.windows_n(readings, self._behind) > self._unnoticed_n:
            self._quiet_behind = QuietMean()
            return math.inf
        mean, count = self._quiet_behind.add(readings)
        return beside_n + self._sheared * extractor.windows_most_n(mean, self._behind, count)

    def steady_dragging_n(self, extractor: ContactExtractor, mean: Floats, frames: int) -> float:
        """Largest dragging force of what is noticed in the mean readings (n,) of so many frames only."""
        if self._drags is None:
            return math.inf
        if not self._beside.any():
            return 0.0
        return self._sheared * extractor.windows_most_n(mean, self._beside, frames)

    def may_touch(self, since_s: float) -> bool:
        """True if the tip may have been at the part since an instant (s).

        Unless the way is known to be free wherever it has been seen since then.
        """
        if not self._begun or not self._seen_s:
            return True
        begun = [at for at, *_ in self._begun]
        free_mm = min(free for _, _, free, *_ in self._begun[_last_before(begun, since_s) :])
        seen_mm = max(self._seen_mm[_last_before(self._seen_s, since_s) :])
        return seen_mm + _MAX_LEAD_MM > free_mm

    def feel(
        self,
        force_n: float,
        latest_s: float,
        steady_n: float = 0.0,
        doubts_n: tuple[float, float] = (0.0, 0.0),
        dragging_n: float = math.inf,
    ) -> None:
        """Note the force of a frame, sampled at `latest_s` or before, and what is steady in the newest ones.

        `doubts_n`: what a zero that drifts may hide, and what it may hide if no way was free; `dragging_n` as
        the methods have it. All of a force that is not light may drag.
        """
        is_light = force_n <= 2 * LIGHT_FORCE_FACTOR * self._least_n
        dragging_n = min(dragging_n if is_light else math.inf, self._sheared * max(force_n, steady_n))
        self._forces.extend((latest_s, force_n, steady_n, *doubts_n, dragging_n))

    def late_by(self, late_s: float) -> None:
        """Note how much earlier than `latest_s` frames may have been sampled, at most; two periods anyway."""
        self._late_s = max(self._late_s, late_s)

    def stopped(self, now: float) -> None:
        """Note that the finger was told to stop: from now on it stands or goes back, until a stage begins."""
        self._stopped.append(now)

    def measured(self, now: float) -> None:
        """Note that the contacts of the grip have been measured."""
        self._measured_s = now

    def see(self, travel_mm: float, now: float, aside_mm: float = 0.0) -> None:
        """Note how far along its line the tip is, and how far beside it."""
        self._seen_s.append(now)
        self._seen_mm.append(travel_mm)
        self._aside_mm.append(aside_mm)

    def loads(self) -> tuple[ContactLoad, ...]:
        """A load for each stage in which something was felt, in order of time."""
        if not self._forces or not self._seen_s:
            return ()
        latest, forces, *_ = self._by_frames()
        times = self._times_s(latest)
        travels = np.interp(times, self._seen_s, self._seen_mm)
        ends = [*(begun for begun, *_ in self._begun[1:]), math.inf]
        found = []
        for (begun, stage, *_), end in zip(self._begun, ends, strict=True):
            during = (times >= begun) & (times < end)
            if (forces[during] > self._least_n).any():
                found.append(self._load(stage, times[during], forces[during], travels[during]))
        return tuple(found)

    def trace(self) -> LoadTrace | None:
        """All that was noted, frame by frame; None if nothing was."""
        if not self._forces or not self._seen_s:
            return None
        latest, forces, steady, doubt, any_doubt, dragging = self._by_frames()
        times = self._times_s(latest)
        travels = np.interp(times, self._seen_s, self._seen_mm)
        quiet = forces <= self._unnoticed_n
        noticed = np.where(quiet, _window_maximum(steady), forces)
        lasting = np.where(steady > 0, np.minimum(dragging, self._sheared * steady), 0.0)
        return LoadTrace(
            times,
            self._late_s / 2,
            noticed,
            travels,
            self._advances(times, travels) + self._sideways(times),
            self._unnoticed_n * self._shares[_quiet_run_lengths(quiet)],
            _window_maximum(doubt),
            _window_maximum(any_doubt),
            self._free_within(times),
            self._touch_speeds_mm_s(times),
            self._measured_s,
            self._unfelt_mm(times, noticed),
            self._retreats(times, travels),
            np.where(quiet, _window_maximum(lasting), dragging),
            quiet,
        )

    def _by_frames(self) -> Floats:
        """Notes of the n frames, (6, n): as in `_forces`."""
        return np.array(self._forces).reshape(-1, _NUMBERS_PER_FRAME).T

    def _times_s(self, latest_s: Floats) -> Floats:
        """Instants (n,) of the frames, each within half of what it may be late."""
        latest: Floats = np.maximum.accumulate(latest_s)
        return latest - self._late_s / 2

    def _unfelt_mm(self, times: Floats, noticed: Floats) -> float:
        """Least travel of the tip when the last frame was sampled before anything was noticed."""
        if not noticed.any():
            return math.inf
        before_s = times[max(int(np.argmax(noticed > 0)) - 1, 0)] - self._late_s / 2
        reads, travels = np.array(self._seen_s), np.array(self._seen_mm)
        last = int(np.searchsorted(reads, before_s, side="right")) - 1
        return float(travels[last]) if last >= 0 else 0.0  # it may have stood since, so nothing in between

    def _free_within(self, times: Floats) -> Floats:
        """Motion of the part within which the way is free wherever the tip may have been at a frame (n,).

        A read of the servos may be as old as the read before it, so that the second one after an instant
        is the first that is certainly younger.
        """
        begun, _, free, within, _ = (np.array(column) for column in zip(*self._begun, strict=True))
        reads, travels = np.array(self._seen_s), np.array(self._seen_mm)
        begin_s, end_s = times - self._late_s / 2, times + self._late_s / 2
        last = np.minimum(np.searchsorted(reads, end_s, side="right") + 1, len(reads) - 1)
        seen_mm = _largest_between(travels, np.searchsorted(reads, begin_s, side="right") - 1, last)
        first, last = (np.searchsorted(begun, at, side="right") - 1 for at in (begin_s, end_s))
        is_free = seen_mm <= -_largest_between(-free, first, last)
        result: Floats = np.where(is_free, -_largest_between(-within, first, last), 0.0)
        return result

    @cached_property
    def _shares(self) -> Floats:
        return np.array([1.0] + [self._noise_share(frames) for frames in range(1, STEADY_FRAMES + 1)])

    def _touch_speeds_mm_s(self, times: Floats) -> Floats:
        """Speed of the stage that each frame (n,) was sampled in, of the quickest since the frame before."""
        begun, speed = (np.array([stage[column] for stage in self._begun]) for column in (0, -1))
        since = np.append(times[:1], times[:-1]) - self._late_s / 2
        first, last = (
            np.searchsorted(begun, at, side="right") - 1 for at in (since, times + self._late_s / 2)
        )
        return _largest_between(speed, first, last)

    def _advances(self, times: Floats, travels: Floats) -> Floats:
        """Largest advance of the tip before each frame (n,).

        By its profile's speed, or faster if servos say so; nothing while it is stopped, unless they do.
        """
        passed, fastest = (
            np.diff(times, prepend=times[0]),
            _CATCH_UP_SPEED_FACTOR * self._touch_speeds_mm_s(times),
        )
        result: Floats = fastest * passed
        result += _excess_travel(np.diff(travels, prepend=travels[0]) - result, self._step_mm)
        for stopped in self._stopped:
            begun = [at for at, *_ in self._begun if at > stopped]
            rows = np.flatnonzero(
                (times > stopped + _BRAKING_FRAMES * self._period_s) & (times < min(begun, default=math.inf))
            )
            if len(rows):
                reached = np.maximum.accumulate([travels[rows[0]] + self._step_mm, *travels[rows]])
                result[rows] = np.diff(reached)
                if rows[0] > 0:  # of that gap the beginning was before the finger stood
                    moving_s = max(stopped + _BRAKING_FRAMES * self._period_s - times[rows[0] - 1], 0.0)
                    result[rows[0]] += fastest[rows[0]] * moving_s
        return result

    def _sideways(self, times: Floats) -> Floats:
        """Distance that the tip was seen to go sideways before each frame (n,), either way."""
        aside = np.interp(times, self._seen_s, self._aside_mm)
        result: Floats = np.abs(np.diff(aside, prepend=aside[0]))
        return result

    def _retreats(self, times: Floats, travels: Floats) -> Floats:
        """Largest retreat of the tip before each frame (n,).

        After the order to stop it goes on and turns where it is seen furthest; of one that stands, reads may
        jump.
        """
        result = np.maximum(-np.diff(travels, prepend=travels[0]), 0.0)
        for stopped in self._stopped:
            begun = [at for at, *_ in self._begun if at > stopped]
            rows = np.flatnonzero((times > stopped) & (times < min(begun, default=math.inf)))
            if len(rows):
                rows = rows[int(np.argmax(travels[rows])) :]
                back = np.diff(np.maximum.accumulate(-travels[rows]))
                if back.any():  # so much less is seen of it than it has gone
                    back[np.argmax(back > 0)] += self._step_mm
                result[rows[1:]] = back
        return result

    def _load(self, stage: TouchStage, times: Floats, forces: Floats, travels: Floats) -> ContactLoad:
        felt = np.flatnonzero(forces > self._least_n)
        free = np.flatnonzero(forces <= 0)
        first = max(free[free < felt[0]], default=0)
        last = min(free[free > felt[-1]], default=len(forces) - 1)
        force, travel = forces[first : last + 1], travels[first : last + 1]
        steps = np.maximum(np.diff(travel), 0.0)
        work = float(((force[1:] + force[:-1]) / 2 * steps).sum())
        begun_s, ended_s = float(times[first]), float(times[last])
        if forces[last] > 0:
            ended_s = math.inf  # it has not left the part yet
        return ContactLoad(stage, float(force.max()), float(steps.sum()), work, begun_s, ended_s)


def _last_before(times: Sequence[float], at_s: float) -> int:
    """Index of the last of some instants, in order, that is not later; of the first if all are."""
    return max(bisect_right(times, at_s) - 1, 0)


def _largest_between(values: Floats, first: Ints, last: Ints) -> Floats:
    """Largest of `values` from one index (n,) to another, both included; before the first is the first."""
    first, last = np.maximum(first, 0), np.maximum(last, 0)
    steps = np.arange(int((last - first).max(initial=0)) + 1)
    result: Floats = values[np.minimum(first[:, None] + steps, last[:, None])].max(axis=1)
    return result


def _excess_travel(excess_mm: Floats, step_mm: float) -> Floats:
    """Travel beyond the usual (n,) of a tip that is seen by steps: what is in excess of one."""
    result, pending = np.zeros(len(excess_mm)), 0.0
    for row, excess in enumerate(excess_mm.tolist()):
        pending = max(pending + excess, 0.0)
        if pending > step_mm:
            result[row], pending = pending - step_mm, step_mm
    return result


def _window_maximum(values: Floats) -> Floats:
    """Maximum (n,) of the windows that a frame is in: a mean of frames holds at each of them."""
    padded = np.concatenate([values, np.zeros(STEADY_FRAMES - 1)])
    result: Floats = np.lib.stride_tricks.sliding_window_view(padded, STEADY_FRAMES).max(axis=1)
    return result


def _quiet_run_lengths(quiet: Bools) -> Ints:
    """Number of quiet frames together at each frame (n,), STEADY_FRAMES at most; 1 if it is not quiet."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], quiet, [False]]).astype(np.int8)))
    result = np.ones(len(quiet), dtype=np.int64)
    for first, last in zip(edges[::2], edges[1::2], strict=True):
        result[first:last] = min(last - first, STEADY_FRAMES)
    return result
