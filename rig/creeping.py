"""Measuring contacts on the move, for calibration: fingers creep on a little and readings are averaged.

Between a slow touch and its conclusion. A slide that is stopped comes to rest in the same part of an encoder
step again and again, and in which part depends on how obliquely it touches: so the rounding of resting
positions does not average out over touches. While a slide creeps over whole steps, it does.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from palpate.drivers.dynamixel.servo import stop_at
from palpate.drivers.finger import TICK_RAD
from palpate.drivers.tactile.contact import ContactPatch
from palpate.drivers.tactile.frames import TactileFrame
from palpate.rig.closing import begin, measure_at_rest
from palpate.rig.hand import Hand
from palpate.rig.pressing import counts_as_contact
from palpate.rig.run import Run

__all__ = ["measure_creeping"]

_SPEED_MM_S = 1.0
_FAR_MM = 1.5  # no creep goes further; the servo lags behind its goal
_BEFORE = 2  # steps until it moves evenly
_STEPS = 8
_LONGEST_S = 2.0


def measure_creeping(hand: Hand, runs: Sequence[Run]) -> list[tuple[Run, ContactPatch | None]]:
    """Creep on from contacts, and take the mean of servos and arrays over whole encoder steps.

    The runs' servos are then where the slides were in the mean. A slide that does not move on, as one that is
    held or has no force left, is measured where it rests. Raises SafetyStop above the rig file's max_force_n.
    """
    creeps = [_Creep(run) for run in runs if run.touched]
    now = hand.clock.now()
    for run in (item.run for item in creeps):
        goal = run.travel_mm + _FAR_MM
        begin(hand, run.finger.drive.go(run.line, run.travel_mm, goal, _SPEED_MM_S, now), [run.finger])
    while (active := [item for item in creeps if not item.done]) and hand.clock.now() < now + _LONGEST_S:
        hand.clock.sleep(1 / hand.rig.closing.sample_rate_hz)
        _sample(hand, active)
        _hold(hand, [item for item in active if item.done])
    _hold(hand, [item for item in creeps if not item.done])
    found = {item.run: item.mean(hand.clock.now()) for item in creeps if item.done}
    resting = dict(measure_at_rest(hand, [run for run in runs if run not in found]))
    return [(run, found[run] if run in found else resting[run]) for run in runs]


@dataclass(eq=False)
class _Creep:
    """A finger that creeps on: how many steps its slide has gone from where it rested, and what was felt."""

    run: Run
    ticks: list[int] = field(default_factory=list)
    frames: list[list[TactileFrame]] = field(default_factory=list)

    def gone(self, slide_rad: float) -> int:
        """Steps from where the slide rested."""
        return round(abs(slide_rad - self.run.servos[1]) / TICK_RAD)

    @property
    def done(self) -> bool:
        """Whether the steps that count are behind it."""
        return bool(self.ticks) and self.ticks[-1] > _BEFORE + _STEPS

    def mean(self, now: float) -> ContactPatch | None:
        """The patch in the mean of the steps that count; the run's slide is then where it was in the mean."""
        ticks = np.array(self.ticks)
        counted = np.flatnonzero((ticks > _BEFORE) & (ticks <= _BEFORE + _STEPS))
        near, far = self.run.servos
        self.run.seen((near, far + self._way * float(ticks[counted].mean()) * TICK_RAD), now)
        return self.run.finger.extractor.extract([f for k in counted.tolist() for f in self.frames[k]])

    @property
    def _way(self) -> float:
        """+1 if growing angles of the slide's servo push the tip out, else -1."""
        first, last = (self.run.finger.kinematics.servos_rad(self.run.line, mm)[1] for mm in (0.0, 1.0))
        return 1.0 if last > first else -1.0


def _sample(hand: Hand, active: Sequence[_Creep]) -> None:
    """Look at servos and arrays at one instant."""
    states = hand.states([servo for item in active for servo in item.run.finger.drive.closing_servos])
    for item in active:
        finger = item.run.finger
        frames = finger.array.frames()
        if not frames:
            continue
        counts_as_contact(hand, finger, finger.extractor.force_n(frames[-1]))
        item.ticks.append(item.gone(states[finger.drive.closing_servos[0].dxl_id].position_rad))
        item.frames.append(list(frames))


def _hold(hand: Hand, creeps: Sequence[_Creep]) -> None:
    """Hold slides where they are now."""
    slides = [item.run.finger.drive.closing_servos[0] for item in creeps]
    if slides:
        states = hand.states(slides)
        stop_at(hand.bus, {slide: slide.nearest_rad(states[slide.dxl_id].position_rad) for slide in slides})
