"""Ways to standby: how a finger gets from wherever it stands to where tips wait between approaches.

Nothing is known of where the part is. Aims of slides turn outside of the workspace. An arm's tip may stand
in the middle of it: then its ways are tried that keep clear of whatever else is known, those first on which
the array leads the tip and which are short.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from palpate.base.geometry import Bools, Floats
from palpate.config import ArmFingerConfig, FingerConfig, RigFile
from palpate.drivers.arm_kinematics import ArmKinematics
from palpate.drivers.kinematics import FingerKinematics, Servos, Turn
from palpate.rig.conversion import kinematics_of
from palpate.rig.drives import is_steady, point_on_circle, wait_distance_mm, wait_radius_mm
from palpate.rig.reach.approaches import reach_radius_mm
from palpate.rig.reach.standby_poses import (
    StandbyPoses,
    body_of,
    clear_aims,
    free_ranges,
    standby_poses_of,
)
from palpate.rig.reach.swept_volume import BodyCapsules, capsules_of, gap_mm, polygon_gap_mm

_STEP_MM = 1.0  # of the tip, between two postures of a way
_AIM_STRIDE = 5  # of the sampled places on an arm's waiting circle one is a goal
_STANDBY_TOLERANCE_MM = 3.0  # beside the waiting circle a tip still waits
_SETTLING_RAD = math.radians(0.6)  # servos settle beside their goals
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
        """Whether its places all keep so far from a point (2,), or as far as the first of them is."""
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
    """Where the fingers of a rig may wait, with the stage at an angle.

    `ranges`: of each finger the first and last aim of its range, by index into its poses; None where it has
    no room. `obstacles` as they look from the ring.
    """

    rig: RigFile
    kinematics: tuple[FingerKinematics, ...]
    poses: tuple[StandbyPoses, ...]
    ranges: tuple[tuple[int, int] | None, ...]
    obstacles: tuple[Floats, ...]
    unsure_mm: float

    def is_there(self, index: int, servos_rad: Servos) -> bool:
        """Whether a finger waits, or a slide is aimed, within its range."""
        found = self.ranges[index]
        if found is None:
            return False
        spec, kinematics = self.rig.fingers[index], self.kinematics[index]
        first, last = self.poses[index].aims_rad[list(found)].tolist()
        if not isinstance(spec, ArmFingerConfig):
            aim = kinematics.facing_rad(servos_rad) - math.radians(spec.heading_deg)
            return bool(first - _SETTLING_RAD <= aim <= last + _SETTLING_RAD)
        x, y = kinematics.centre_mm(servos_rad)
        middle = (first + last) / 2
        off = math.remainder(math.atan2(y, x) - middle, 2 * math.pi)
        beside = abs(math.hypot(x, y) - wait_radius_mm(spec, self.rig.clear_radius_mm))
        return bool(beside <= _STANDBY_TOLERANCE_MM and abs(off) <= (last - first) / 2 + _SETTLING_RAD)

    def ways(self, index: int, servos_rad: Sequence[Servos]) -> Iterator[StandbyWay]:
        """Ways of a finger into its range, clear of obstacles and of where all others stand, best first.

        `servos_rad`: where all fingers stand. A gap that is smaller than `clearance_mm` at the beginning must
        not become smaller.
        """
        if self.ranges[index] is None:
            return
        others = [self._body(k, servos) for k, servos in enumerate(servos_rad) if k != index]
        if not self._stands_alone(index, servos_rad):
            return
        for way in sorted(self._candidates(index, servos_rad[index]), key=lambda way: way.cost):
            if self._is_free(index, way, others):
                yield way

    def _body(self, index: int, servos_rad: Servos) -> BodyCapsules:
        """The room that a finger takes up, with its bounds."""
        return capsules_of([body_of(self.kinematics[index], servos_rad, self.rig.fingers[index])])

    def _stands_alone(self, index: int, servos_rad: Sequence[Servos]) -> bool:
        """Whether a finger stands in nothing by the drawing: else there is no telling which way is out."""
        bodies = [
            capsules_of([kinematics.body(servos, spec.tip.radius_mm)])
            for kinematics, servos, spec in zip(self.kinematics, servos_rad, self.rig.fingers, strict=True)
        ]
        own = bodies.pop(index)
        gaps = [gap_mm(own, other) for other in bodies]
        gaps += [polygon_gap_mm(own, corners) for corners in self.obstacles]
        return all(float(gap.min()) > 0 for gap in gaps)

    def _candidates(self, index: int, start: Servos) -> list[StandbyWay]:
        spec, kinematics, found = self.rig.fingers[index], self.kinematics[index], self.ranges[index]
        assert found is not None
        aims = self.poses[index].aims_rad[found[0] : found[1] + 1]
        if isinstance(spec, ArmFingerConfig):
            assert isinstance(kinematics, ArmKinematics)
            return _ways_of_arm(spec, kinematics, start, aims[::_AIM_STRIDE], self.rig.clear_radius_mm)
        wait = wait_distance_mm(spec, self.rig.clear_radius_mm)
        at = kinematics.facing_rad(start) - math.radians(spec.heading_deg)
        aim = float(np.clip(at, aims[0], aims[-1]))
        turned = math.radians(spec.aim.zero_deg) - math.pi + spec.aim.gear_ratio * aim
        count = max(math.ceil(abs(aim - at) * wait / _STEP_MM), 1) + 1
        postures = np.column_stack([np.linspace(start[0], turned, count), np.full(count, start[1])])
        return [_way(spec, kinematics, postures, self.rig.clear_radius_mm)]

    def _is_free(self, index: int, way: StandbyWay, others: Sequence[BodyCapsules]) -> bool:
        spec, kinematics = self.rig.fingers[index], self.kinematics[index]
        bodies = [body_of(kinematics, (near, far), spec) for near, far in way.servos_rad.tolist()]
        own = capsules_of(bodies, between=True)
        clearance = self.rig.closing.clearance_mm
        gaps = [(gap_mm(own, other), clearance) for other in others]
        gaps += [(polygon_gap_mm(own, corners), clearance + self.unsure_mm) for corners in self.obstacles]
        at_first = own.owner == 0
        return all(
            bool((gap >= min(least, float(gap[at_first].min()) - _GAP_ALLOWANCE_MM)).all())
            for gap, least in gaps
        )


def standby_of(rig: RigFile, turn: Turn) -> Standby:
    """Where fingers may wait with the stage at `turn`."""
    unsure_mm = turn.angle_bound_rad * reach_radius_mm(rig) + turn.centre_bound_mm
    back = Turn(turn.centre_mm, -turn.angle_rad)
    obstacles = [
        np.array([back.point_mm((float(x), float(y))) for x, y in item.outline_mm]) for item in rig.obstacles
    ]
    poses = [standby_poses_of(spec, rig.clear_radius_mm) for spec in rig.fingers]
    clearance = rig.closing.clearance_mm
    clear = [clear_aims(item, obstacles, clearance + unsure_mm) for item in poses]
    return Standby(
        rig,
        tuple(kinematics_of(spec) for spec in rig.fingers),
        tuple(poses),
        tuple(free_ranges(poses, clear, clearance)),
        tuple(obstacles),
        unsure_mm,
    )


def _ways_of_arm(
    spec: ArmFingerConfig, kinematics: ArmKinematics, start: Servos, aims: Floats, workspace_mm: float
) -> list[StandbyWay]:
    """Straight ways of the tip and of the joints, both at once or one after the other, to each place."""
    radius = wait_radius_mm(spec, workspace_mm)
    start = kinematics.within_ranges(start)  # play may show it a little outside
    here = kinematics.centre_mm(start)
    found = []
    for aim in aims.tolist():
        goal = kinematics.servos_at(point_on_circle(radius, aim))
        turns = ([start, goal], [start, (start[0], goal[1]), goal], [start, (goal[0], start[1]), goal])
        postures = [_joints_through(kinematics, corners) for corners in turns]
        straight = _straight(kinematics, here, point_on_circle(radius, aim))
        postures += [] if straight is None else [straight]
        found += [_way(spec, kinematics, item, workspace_mm) for item in postures]
    return found


def _joints_through(kinematics: ArmKinematics, corners: Sequence[Servos]) -> Floats:
    """Postures (m, 2) from corner to corner, all joints even, `_STEP_MM` of the tip or less apart."""
    levers = np.array([kinematics.upper_mm + kinematics.fore_mm, kinematics.fore_mm])
    levers /= np.abs([kinematics.shoulder.gear_ratio, kinematics.elbow.gear_ratio])
    legs = [np.array([corners[0]])]
    for one, other in pairwise(corners):
        length = float(np.abs(np.subtract(other, one)) @ levers)
        shares = np.linspace(0.0, 1.0, math.ceil(length / _STEP_MM) + 1)[1:, None]
        legs.append((1 - shares) * np.array(one) + shares * np.array(other))
    return np.concatenate(legs)


def _straight(
    kinematics: ArmKinematics, here: tuple[float, float], there: tuple[float, float]
) -> Floats | None:
    """Postures (m, 2) on the straight line of the tip; None where the arm is not steady all along."""
    shares = np.linspace(0.0, 1.0, max(math.ceil(math.dist(here, there) / _STEP_MM), 1) + 1)[:, None]
    places = ((1 - shares) * np.array(here) + shares * np.array(there)).tolist()
    if not all(is_steady(kinematics, (x, y)) for x, y in places):
        return None
    return np.array([kinematics.servos_at((x, y)) for x, y in places])


def _way(
    spec: FingerConfig, kinematics: FingerKinematics, postures: Floats, workspace_mm: float
) -> StandbyWay:
    servos = [(near, far) for near, far in postures.tolist()]
    places = np.array([kinematics.centre_mm(item) for item in servos])
    steps = np.diff(places, axis=0)
    length = np.hypot(*steps.T)
    inside = np.hypot(*places[1:].T) < workspace_mm + spec.tip.radius_mm
    middle = np.array([kinematics.facing_rad(item) for item in servos[1:]]) + math.radians(
        spec.array.heading_deg
    )
    off = np.abs(np.angle(np.exp(1j * (np.arctan2(steps[:, 1], steps[:, 0]) - middle))))
    half = math.radians(spec.array.coverage_deg) / 2
    blind = np.clip(off + math.pi / 2 - half, 0.0, math.pi) / math.pi
    travel = np.concatenate([[0.0], np.cumsum(length)])
    return StandbyWay(postures, places, travel, inside, blind)
