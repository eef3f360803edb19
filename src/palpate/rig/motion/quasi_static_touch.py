"""Quasi-static touch, for calibration: fingers creep on into a contact, and readings are averaged.

A slide that is stopped comes to rest in the same part of an encoder
step again and again, and in which part depends on how obliquely it touches: so the rounding of resting
positions does not average out over touches. While a slide creeps over whole steps, it does.
An arm moves both its joints, whose steps are larger: it creeps over a stretch of its way, and both are
averaged.
"""

import math
from collections.abc import Mapping, Sequence

import numpy as np

from palpate.base.geometry import Ints
from palpate.drivers.dynamixel.guarded import End
from palpate.drivers.dynamixel.state import ServoState
from palpate.drivers.finger import TICK_RAD, Servos
from palpate.drivers.tactile.contact import ContactPatch
from palpate.drivers.tactile.frames import TactileFrame
from palpate.rig.motion.approach_state import ApproachState
from palpate.rig.motion.finger_movers import TipMover
from palpate.rig.motion.guarded_approach import measure_at_rest
from palpate.rig.motion.hand import Hand

__all__ = ["measure_quasi_statically"]

_SPEED_MM_S = 1.0
_FAR_MM = 1.5  # no creep goes further; the servo lags behind its goal
_BEFORE = 2  # steps until it moves evenly
_STEPS = 8
_ARM_STEP_MM = 0.05  # of an arm's way, in place of an encoder's
_LONGEST_S = 2.0


def measure_quasi_statically(
    hand: Hand, runs: Sequence[ApproachState]
) -> list[tuple[ApproachState, ContactPatch | None]]:
    """Creep on from contacts, and take the mean of servos and arrays over whole encoder steps.

    The runs' servos are then where the slides were in the mean. A slide that does not move on, as one that is
    held or has no force left, is measured where it rests. Raises SafetyStop above the rig file's max_force_n.
    """
    creeping = [_CreepMover(hand, run, runs) for run in runs if run.touched]
    ends = hand.guarded(creeping, period_s=1 / hand.rig.closing.sample_rate_hz)
    moved = [mover for mover, end in ends.items() if end is End.ENOUGH and mover.counted.size]
    found = {mover.run: mover.mean(hand.clock.now()) for mover in moved}
    resting = dict(measure_at_rest(hand, [run for run in runs if run not in found]))
    return [(run, found[run] if run in found else resting[run]) for run in runs]


class _CreepMover(TipMover):
    """A finger that creeps on: how many steps its slide has gone from where it rested, and what was felt."""

    def __init__(self, hand: Hand, run: ApproachState, others: Sequence[ApproachState]) -> None:
        super().__init__(hand, run, run.travel_mm + _FAR_MM, _SPEED_MM_S, math.inf, others)
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

    def until(self, now: float) -> End | None:
        """Enough once the steps that count are behind it; a slide that does not get there has a deadline."""
        if self._ticks and self._ticks[-1] > _BEFORE + _STEPS:
            return End.ENOUGH
        if now - self.started_s > _LONGEST_S:
            return End.DEADLINE
        return super().until(now)

    def held(self, _now: float) -> End:
        """It is measured where it rests."""
        return End.STALL

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
        """Which looks count; none if the slide went on unseen, as while the computer was paused."""
        ticks = np.array(self._ticks)
        return np.flatnonzero((ticks > _BEFORE) & (ticks <= _BEFORE + _STEPS))

    @property
    def _way(self) -> float:
        """+1 if growing angles of the slide's servo push the tip out, else -1."""
        first, last = (self.finger.kinematics.servos_rad(self.run.line, mm)[1] for mm in (0.0, 1.0))
        return 1.0 if last > first else -1.0
