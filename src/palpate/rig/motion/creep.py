"""Creep after a contact: two ways for `carry_out_grip` to measure it while moving instead of at rest.

A quasi-static touch is for calibration. A slide that is stopped comes to rest in the same part of an encoder
step again and again, and in which part depends on how obliquely it touches: so the rounding of resting
positions does not average out over touches. While a slide creeps over whole steps, it does. An arm moves
both its joints, whose steps are larger: it creeps over a stretch of its way, and both are averaged.

A slip push goes on until the part slides, or a largest force is reached. The tip is a spring: while the part
stands, the force grows with the tip's travel by the skin's stiffness; once the part slides, the tip goes on
and the force does not. The creep ends there, so that the part is moved by little more than is needed to see
it.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from palpate.base.geometry import Floats, Ints
from palpate.drivers.dynamixel import MoveEnd, ServoState
from palpate.drivers.kinematics import TICK_RAD, Servos
from palpate.drivers.tactile import ContactPatch, TactileFrame
from palpate.rig.conversion import softest_n_per_mm
from palpate.rig.fingers import HostFinger
from palpate.rig.motion.finger_movers import TipMover
from palpate.rig.motion.guarded_approach import measure_at_rest
from palpate.rig.motion.hand import Hand
from palpate.rig.motion.touch import ApproachState

_CREEP_MM_S = 1.0
_MAX_CREEP_MM = 1.5  # no creep goes further; the servo lags behind its goal
_RUN_IN_STEPS = 2  # steps until it moves evenly
_AVERAGED_STEPS = 8
_ARM_STEP_MM = 0.05  # of an arm's way, in place of an encoder's
_CREEP_TIMEOUT_S = 2.0


def measure_quasi_statically(
    hand: Hand, runs: Sequence[ApproachState]
) -> list[tuple[ApproachState, ContactPatch | None]]:
    """Creep on from contacts, and take the mean of servos and arrays over whole encoder steps.

    The runs' servos are then where the slides were in the mean. A slide that does not move on, as one that is
    held or has no force left, is measured where it rests. Raises SafetyStop above the rig file's max_force_n.
    """
    creeping = [_CreepMover(hand, run, runs) for run in runs if run.touched]
    ends = hand.guarded(creeping, period_s=1 / hand.rig.closing.sample_rate_hz)
    moved = [mover for mover, end in ends.items() if end is MoveEnd.ENOUGH and mover.counted.size]
    found = {mover.run: mover.mean(hand.clock.now()) for mover in moved}
    resting = dict(measure_at_rest(hand, [run for run in runs if run not in found]))
    return [(run, found[run] if run in found else resting[run]) for run in runs]


class _CreepMover(TipMover):
    """A finger that creeps on: how many steps its slide has gone from where it rested, and what was felt."""

    def __init__(self, hand: Hand, run: ApproachState, others: Sequence[ApproachState]) -> None:
        super().__init__(hand, run, run.travel_mm + _MAX_CREEP_MM, _CREEP_MM_S, math.inf, others)
        self._rested = run.servos
        self._rested_mm = run.travel_mm
        self._ticks: list[int] = []
        self._seen: list[Servos] = []
        self._frames: list[Sequence[TactileFrame]] = []

    def look(self, states: Mapping[int, ServoState], now: float) -> None:
        """Sample servos and array at one instant."""
        super().look(states, now)
        reading = self.hand.take_reading(self.finger)
        if reading.frames:
            self._ticks.append(self._gone())
            self._seen.append(self.run.servos)
            self._frames.append(reading.frames)

    def until(self, now: float) -> MoveEnd | None:
        """Enough once the steps that count are behind it; a slide that does not get there has a deadline."""
        if self._ticks and self._ticks[-1] > _RUN_IN_STEPS + _AVERAGED_STEPS:
            return MoveEnd.ENOUGH
        if now - self.started_s > _CREEP_TIMEOUT_S:
            return MoveEnd.DEADLINE
        return super().until(now)

    def held(self, _now: float) -> MoveEnd:
        """Measure it where it rests."""
        return MoveEnd.STALL

    def mean(self, now: float) -> ContactPatch | None:
        """The patch in the mean of the steps that count; the run's servos are where they were in the mean."""
        counted = self.counted.tolist()
        frames = [frame for k in counted for frame in self._frames[k]]
        if self.streams:
            near, far = np.mean([self._seen[k] for k in counted], axis=0).tolist()
            self.run.seen((near, far), now)
            return self.finger.extractor.extract(frames)
        near, far = self._rested
        gone = float(np.mean([self._ticks[k] for k in counted]))
        self.run.seen((near, far + self._way * gone * TICK_RAD), now)
        return self.finger.extractor.extract(frames)

    def _gone(self) -> int:
        """Steps since it rested: of the slide's encoder, or of an arm's way."""
        if self.streams:
            return round((self.run.travel_mm - self._rested_mm) / _ARM_STEP_MM)
        return round(abs(self.run.servos[1] - self._rested[1]) / TICK_RAD)

    @property
    def counted(self) -> Ints:
        """Looks that count; none if the slide went on unseen, as while the computer was paused."""
        ticks = np.array(self._ticks)
        return np.flatnonzero((ticks > _RUN_IN_STEPS) & (ticks <= _RUN_IN_STEPS + _AVERAGED_STEPS))

    @property
    def _way(self) -> float:
        """+1 if growing angles of the slide's servo push the tip out, else -1."""
        first, last = (self.finger.kinematics.servos_rad(self.run.line, mm)[1] for mm in (0.0, 1.0))
        return 1.0 if last > first else -1.0


_MAX_PUSH_MM = 2.0
"""No creep takes the tip further than this from where it touched, so the part neither."""

_PUSH_MM_S = 1.0
_SLOPE_WINDOW_MM = 0.4  # of travel, over which the force must rise: more than a drive's play
_SLIP_SLOPE_SHARE = 0.25  # of the softest skin's stiffness: less is no rise
_NEAR_END_MM = 0.05
_AT_REST_FRAMES = 8
_PUSH_TIMEOUT_S = 6.0
_MAX_INCIDENCE_RAD = math.radians(
    70.0
)  # met so far from head-on, a part that stands lets the tip glide along


@dataclass(frozen=True, eq=False)
class SlipPush:
    """One push. `slid`: the part gave way; else it stood until the push ended, or that cannot be told.

    It cannot be told where the tip met the part so obliquely that it may have glided along.
    `patch`: the contact while the part slid, or at the end; None if nothing was touched any more.
    """

    finger: HostFinger
    slid: bool
    patch: ContactPatch | None


class SlipPusher:
    """Pushes, as a way to measure contacts in `carry_out_grip`, and keeps what came of it in `pushes`."""

    def __init__(self, largest_n: float) -> None:
        """`largest_n`: no push goes on above this force (N)."""
        self._largest_n = largest_n
        self.pushes: list[SlipPush] = []

    def push_until_slip(
        self, hand: Hand, runs: Sequence[ApproachState]
    ) -> list[tuple[ApproachState, ContactPatch | None]]:
        """Creep on with each finger that touches, one after the other.

        Raises SafetyStop above the rig file's max_force_n.
        """
        found: dict[ApproachState, ContactPatch | None] = {}
        for run in runs:
            if not run.touched:
                continue
            mover = _SlipMover(hand, run, runs, self._largest_n)
            hand.guarded([mover], period_s=1 / hand.rig.closing.sample_rate_hz)
            push = mover.push()
            self.pushes.append(push)
            found[run] = push.patch
        resting = dict(measure_at_rest(hand, [run for run in runs if run not in found]))
        return [(run, found[run] if run in found else resting[run]) for run in runs]


class _SlipMover(TipMover):
    """A finger that creeps on; travel, force and frames of every look."""

    def __init__(
        self, hand: Hand, run: ApproachState, others: Sequence[ApproachState], largest_n: float
    ) -> None:
        super().__init__(hand, run, run.travel_mm + _MAX_PUSH_MM, _PUSH_MM_S, math.inf, others)
        tip = run.finger.spec.tip
        self._soft_n_per_mm = softest_n_per_mm(tip)
        self._largest_n = largest_n
        self._travel_mm: list[float] = []
        self._force_n: list[float] = []
        self._frames: list[Sequence[TactileFrame]] = []
        self._is_flat = False

    def look(self, states: Mapping[int, ServoState], now: float) -> None:
        """Sample servos and array at one instant."""
        super().look(states, now)
        reading = self.hand.take_reading(self.finger)
        if reading.frames:
            self._travel_mm.append(self.run.travel_mm)
            self._force_n.append(reading.force_n)
            self._frames.append(reading.frames)

    def until(self, now: float) -> MoveEnd | None:
        """Enough once the part slides, or the force or the travel is the largest that is allowed."""
        travel, force = np.array(self._travel_mm), np.array(self._force_n)
        self._is_flat = is_sliding(travel, force, self._soft_n_per_mm)
        if self._is_flat or (force.size and force[-1] > self._largest_n):
            return MoveEnd.ENOUGH
        if self.run.travel_mm > self.limit_mm - _NEAR_END_MM:
            return MoveEnd.REACHED
        return MoveEnd.DEADLINE if now - self.started_s > _PUSH_TIMEOUT_S else None

    def held(self, _now: float) -> MoveEnd:
        """The part stands against all that the finger has."""
        return MoveEnd.STALL

    def push(self) -> SlipPush:
        """Result of it."""
        frames = [frame for group in self._frames[self._first() :] for frame in group]
        patch = self.finger.extractor.extract(frames)
        slid = self._is_flat and patch is not None and self._incidence_rad(patch) < _MAX_INCIDENCE_RAD
        return SlipPush(self.finger, slid, patch)

    def _incidence_rad(self, patch: ContactPatch) -> float:
        """Angle from head-on at which the tip has met the part."""
        spec, kinematics = self.finger.spec, self.finger.kinematics
        heading = kinematics.facing_rad(self.run.servos) + math.radians(spec.array.heading_deg)
        return abs(math.remainder(heading + patch.angle_rad - self.run.line.direction_rad, 2 * math.pi))

    def _first(self) -> int:
        """The look from which frames count: where sliding began to show, or the last few."""
        if not self._is_flat:
            return max(len(self._frames) - _AT_REST_FRAMES, 0)
        travel = np.array(self._travel_mm)
        return int(np.argmax(travel > travel[-1] - _SLOPE_WINDOW_MM))


def is_sliding(travel_mm: Floats, force_n: Floats, soft_n_per_mm: float) -> bool:
    """True if forces (n,) no longer rise with travels (n,) as against a part that stands.

    `soft_n_per_mm`: the least stiffness that the skin may have.
    """
    if not travel_mm.size:
        return False
    recent = travel_mm >= travel_mm[-1] - _SLOPE_WINDOW_MM
    if recent.all() or np.ptp(travel_mm[recent]) < _SLOPE_WINDOW_MM / 2:
        return False
    along = travel_mm[recent] - travel_mm[recent].mean()
    slope = float(along @ force_n[recent] / (along @ along))
    return slope < _SLIP_SLOPE_SHARE * soft_n_per_mm
