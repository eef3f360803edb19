"""Paths to standby: how a finger gets from wherever it stands to its standby pose.

Nothing is known of where the part is. Aims of slides turn outside of the workspace. An arm's tip may stand
in the middle of it: then its ways are tried that keep clear of whatever else is known, those first on which
the array leads the tip and which are short.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from palpate.base.geometry import Bools, Floats
from palpate.config import RigFile
from palpate.drivers.kinematics import Servos, Turn
from palpate.rig.mechanisms.mechanism import Mechanism
from palpate.rig.mechanisms.swept_volume import BodyCapsules, capsules_of, gap_mm, polygon_gap_mm
from palpate.rig.reach.approaches import WaitingFingers

_APPROACH_ALLOWANCE_MM = 0.2  # what a way may come nearer to what was met than it begins
_GAP_ALLOWANCE_MM = 0.5  # of a gap that is below the clearance at the start
_INSIDE_COST, _OUTSIDE_COST = (
    0.3,
    0.05,
)  # of a mm, beside one on which the array sees nothing of what may come


@dataclass(frozen=True, eq=False)
class StandbyWay:
    """A finger's way: servo angles (m, 2), the tip's places (m, 2) in the ring's frame, travel (m,) mm.

    `is_inside` (m - 1,): steps on which the tip may meet the part. `blind` (m - 1,): of the half of the tip
    that leads on each, the share that has no taxels.
    """

    servos_rad: Floats
    places_mm: Floats
    travel_mm: Floats
    is_inside: Bools
    blind: Floats

    @property
    def cost(self) -> float:
        """Length, above all of what has to be gone without feeling what comes."""
        each = np.where(self.is_inside, self.blind + _INSIDE_COST, _OUTSIDE_COST)
        return float((np.diff(self.travel_mm) * each).sum())

    def keeps_off(self, point_mm: Floats, by_mm: float) -> bool:
        """True if its places all keep so far from a point (2,), or as far as the first of them is."""
        away = np.hypot(*(self.places_mm - point_mm).T)
        return bool((away >= min(by_mm, float(away[0]) - _APPROACH_ALLOWANCE_MM)).all())

    def up_to(self, travel_mm: float) -> "StandbyWay":
        """The same way, up to the posture that is nearest to a travel."""
        count = int(np.abs(self.travel_mm - travel_mm).argmin()) + 1
        return StandbyWay(
            self.servos_rad[:count],
            self.places_mm[:count],
            self.travel_mm[:count],
            self.is_inside[: count - 1],
            self.blind[: count - 1],
        )

    def reversed(self) -> "StandbyWay":
        """The way back; it has just been gone, so that nothing is met on it."""
        return StandbyWay(
            self.servos_rad[::-1],
            self.places_mm[::-1],
            self.travel_mm[-1] - self.travel_mm[::-1],
            self.is_inside[::-1],
            np.zeros_like(self.blind),
        )


@dataclass(frozen=True, eq=False)
class Standby:
    """Ranges in which the fingers of a rig may wait, with the stage at an angle.

    `ranges`: of each finger the first and last aim of its range, by index into its poses; None where it has
    no room. `obstacles` as they look from the ring, each within `unsure_mm`.
    """

    waiting: WaitingFingers
    ranges: tuple[tuple[int, int] | None, ...]
    obstacles: tuple[Floats, ...]
    unsure_mm: float

    @classmethod
    def of(cls, rig: RigFile, turn: Turn) -> "Standby":
        """Ranges in which fingers may wait with the stage at `turn`."""
        waiting = WaitingFingers.of(rig)
        unsure_mm = turn.angle_bound_rad * waiting.reach_radius_mm + turn.centre_bound_mm
        obstacles = waiting.obstacles(turn.angle_rad)
        return cls(waiting, tuple(waiting.free_ranges(obstacles, unsure_mm)), tuple(obstacles), unsure_mm)

    def is_there(self, index: int, servos_rad: Servos) -> bool:
        """True if a finger waits, or a slide is aimed, within its range."""
        found = self.ranges[index]
        if found is None:
            return False
        first, last = self.waiting.poses[index].aims_rad[list(found)].tolist()
        radius = self.waiting.rig.clear_radius_mm
        return self.waiting.mechanisms[index].is_waiting(servos_rad, (first, last), radius)

    def ways(self, index: int, servos_rad: Sequence[Servos]) -> Iterator[StandbyWay]:
        """Ways of a finger into its range, clear of obstacles and of where all others stand, best first.

        `servos_rad`: where all fingers stand. A gap that is smaller than `clearance_mm` at the beginning must
        not become smaller.
        """
        found, mechanism = self.ranges[index], self.waiting.mechanisms[index]
        if found is None or not self._stands_alone(index, servos_rad):
            return
        others = [
            capsules_of([other.body(servos)])
            for other, servos in zip(self.waiting.mechanisms, servos_rad, strict=True)
            if other is not mechanism
        ]
        aims = self.waiting.poses[index].aims_rad[found[0] : found[1] + 1]
        radius = self.waiting.rig.clear_radius_mm
        postures = mechanism.ways_to_standby(servos_rad[index], aims, radius)
        for way in sorted((_way(mechanism, item, radius) for item in postures), key=lambda way: way.cost):
            if self._is_free(mechanism, way, others):
                yield way

    def _stands_alone(self, index: int, servos_rad: Sequence[Servos]) -> bool:
        """True if a finger stands in nothing by the drawing: else there is no telling which way is out."""
        bodies = [
            capsules_of([item.kinematics.body(servos, item.spec.tip.half_width_mm)])
            for item, servos in zip(self.waiting.mechanisms, servos_rad, strict=True)
        ]
        own = bodies.pop(index)
        gaps = [gap_mm(own, other) for other in bodies]
        gaps += [polygon_gap_mm(own, corners) for corners in self.obstacles]
        return all(float(gap.min()) > 0 for gap in gaps)

    def _is_free(self, mechanism: Mechanism, way: StandbyWay, others: Sequence[BodyCapsules]) -> bool:
        bodies = [mechanism.body((near, far)) for near, far in way.servos_rad.tolist()]
        own = capsules_of(bodies, between=True)
        clearance = self.waiting.rig.closing.clearance_mm
        gaps = [(gap_mm(own, other), clearance) for other in others]
        gaps += [(polygon_gap_mm(own, corners), clearance + self.unsure_mm) for corners in self.obstacles]
        at_first = own.owner == 0
        return all(
            bool((gap >= min(least, float(gap[at_first].min()) - _GAP_ALLOWANCE_MM)).all())
            for gap, least in gaps
        )


def _way(mechanism: Mechanism, postures: Floats, workspace_mm: float) -> StandbyWay:
    spec, kinematics = mechanism.spec, mechanism.kinematics
    servos = [(near, far) for near, far in postures.tolist()]
    places = np.array([kinematics.centre_mm(item) for item in servos])
    steps = np.diff(places, axis=0)
    length = np.hypot(*steps.T)
    inside = np.hypot(*places[1:].T) < workspace_mm + spec.tip.half_width_mm
    middle = np.array([kinematics.facing_rad(item) for item in servos[1:]]) + math.radians(
        spec.array.heading_deg
    )
    off = np.abs(np.angle(np.exp(1j * (np.arctan2(steps[:, 1], steps[:, 0]) - middle))))
    half = math.radians(spec.array.coverage_deg) / 2
    blind = np.clip(off + math.pi / 2 - half, 0.0, math.pi) / math.pi
    travel = np.concatenate([[0.0], np.cumsum(length)])
    return StandbyWay(postures, places, travel, inside, blind)
