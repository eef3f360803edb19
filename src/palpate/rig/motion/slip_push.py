"""Slip push: one finger creeps on into a contact until the part slides, or a largest force is reached.

The tip is a spring. While the part stands, the force grows with the tip's travel by the skin's stiffness;
once the part slides, the tip goes on and the force does not. The creep ends there, so that the part is moved
by little more than is needed to see it.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from palpate.base.geometry import Floats
from palpate.drivers.dynamixel.guarded import End
from palpate.drivers.dynamixel.state import ServoState
from palpate.drivers.tactile.contact import ContactPatch
from palpate.drivers.tactile.frames import TactileFrame
from palpate.rig.conversion import softest_n_per_mm
from palpate.rig.host_finger import HostFinger
from palpate.rig.motion.approach_state import ApproachState
from palpate.rig.motion.finger_movers import TipMover
from palpate.rig.motion.guarded_approach import measure_at_rest
from palpate.rig.motion.hand import Hand

__all__ = ["FURTHEST_MM", "SlipPush", "SlipPusher", "is_sliding"]

FURTHEST_MM = 2.0
"""No creep takes the tip further than this from where it touched, so the part neither."""

_SPEED_MM_S = 1.0
_WINDOW_MM = 0.4  # of travel, over which the force must rise: more than a drive's play
_FLAT_SHARE = 0.25  # of the softest skin's stiffness: less is no rise
_NEAR_END_MM = 0.05
_AT_REST_FRAMES = 8
_LONGEST_S = 6.0
_OBLIQUE_RAD = math.radians(70.0)  # met so far from head-on, a part that stands lets the tip glide along


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
        super().__init__(hand, run, run.travel_mm + FURTHEST_MM, _SPEED_MM_S, math.inf, others)
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

    def until(self, now: float) -> End | None:
        """Enough once the part slides, or the force or the travel is the largest that is allowed."""
        travel, force = np.array(self._travel_mm), np.array(self._force_n)
        self._is_flat = is_sliding(travel, force, self._soft_n_per_mm)
        if self._is_flat or (force.size and force[-1] > self._largest_n):
            return End.ENOUGH
        if self.run.travel_mm > self.limit_mm - _NEAR_END_MM:
            return End.REACHED
        return End.DEADLINE if now - self.started_s > _LONGEST_S else None

    def held(self, _now: float) -> End:
        """The part stands against all that the finger has."""
        return End.STALL

    def push(self) -> SlipPush:
        """What came of it."""
        frames = [frame for group in self._frames[self._first() :] for frame in group]
        patch = self.finger.extractor.extract(frames)
        slid = self._is_flat and patch is not None and self._incidence_rad(patch) < _OBLIQUE_RAD
        return SlipPush(self.finger, slid, patch)

    def _incidence_rad(self, patch: ContactPatch) -> float:
        """How far from head-on the tip has met the part."""
        spec, kinematics = self.finger.spec, self.finger.kinematics
        heading = kinematics.facing_rad(self.run.servos) + math.radians(spec.array.heading_deg)
        return abs(math.remainder(heading + patch.angle_rad - self.run.line.direction_rad, 2 * math.pi))

    def _first(self) -> int:
        """The look from which frames count: where sliding began to show, or the last few."""
        if not self._is_flat:
            return max(len(self._frames) - _AT_REST_FRAMES, 0)
        travel = np.array(self._travel_mm)
        return int(np.argmax(travel > travel[-1] - _WINDOW_MM))


def is_sliding(travel_mm: Floats, force_n: Floats, soft_n_per_mm: float) -> bool:
    """Whether forces (n,) no longer rise with travels (n,) as against a part that stands.

    `soft_n_per_mm`: the least stiffness that the skin may have.
    """
    if not travel_mm.size:
        return False
    recent = travel_mm >= travel_mm[-1] - _WINDOW_MM
    if recent.all() or np.ptp(travel_mm[recent]) < _WINDOW_MM / 2:
        return False
    along = travel_mm[recent] - travel_mm[recent].mean()
    slope = float(along @ force_n[recent] / (along @ along))
    return slope < _FLAT_SHARE * soft_n_per_mm
