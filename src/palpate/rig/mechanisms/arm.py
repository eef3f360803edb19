"""Arm mechanism: a shoulder servo turns the first of two links about a fixed base, an elbow servo the second.

Its tip waits on a circle round the workspace, and goes straight in from there at several angles, as far as
its joints and the array's view allow.
"""

import math
from collections.abc import Iterator, Sequence
from itertools import pairwise

import numpy as np

from palpate.base.geometry import Floats
from palpate.config import ARM_MARGIN_MM, ArmFingerConfig, JointConfig, RigFile
from palpate.drivers.arm_kinematics import ArmJoint, ArmKinematics
from palpate.drivers.dynamixel import Servo
from palpate.drivers.kinematics import FingerBody, Line, Servos
from palpate.rig.conversion import array_bound_rad, calibrated_direction_rad, encoder_of
from palpate.rig.mechanisms.arm_drive import MIN_FORCE_TRANSMISSION, ArmDrive, Place, point_on_circle
from palpate.rig.mechanisms.mechanism import (
    CIRCLE_SPEED_MM_S,
    STREAM_TOLERANCE_RAD,
    ApproachPath,
    Mechanism,
    StandbyPoses,
    TestMove,
    crossing_mm,
)
from palpate.rig.mechanisms.swept_volume import BodyCapsules, capsules_of

_JOINT_END_MARGIN_RAD = math.radians(1.0)
_JOINT_SLACK_DEG = 0.1  # an encoder step of a joint that stands at its end
_START_MM = 15.0  # the tip may stand this far from where tips wait when it is switched on
_STEP_RAD = math.radians(2.0)  # between two places on the circle that are looked at
_MAX_STEPS = 90  # half a turn either way
_AIM_STRIDE = 5  # of these places one is a goal
_STANDBY_TOLERANCE_MM = 3.0  # beside the circle a tip still waits
_SETTLING_RAD = math.radians(0.6)  # servos settle beside their goals
_WAY_STEP_MM = 1.0  # of the tip, between two postures of a way
_PATH_STEP_MM = 8.0  # between two postures of a path
_MAX_OBLIQUITY_DEG = 42.0  # of a path, from straight inward
_TEST_RAD = 0.1


def arm_kinematics(finger: ArmFingerConfig) -> ArmKinematics:
    """Kinematics of a two-link arm."""
    return ArmKinematics(
        base_mm=finger.base_mm,
        heading_rad=math.radians(finger.heading_deg),
        upper_mm=finger.links.upper_mm,
        fore_mm=finger.links.fore_mm,
        shoulder=_joint(finger, finger.shoulder),
        elbow=_joint(finger, finger.elbow),
        link_width_mm=finger.links.width_mm,
        base_bound_mm=finger.bounds.base_mm,
        heading_bound_rad=math.radians(finger.bounds.heading_deg),
        length_bound_mm=finger.links.bound_mm,
        found_position_mm=finger.bounds.position_mm,
        found_direction_rad=calibrated_direction_rad(finger),
    )


def _joint(finger: ArmFingerConfig, servo: JointConfig) -> ArmJoint:
    lo, hi = (math.radians(value) for value in servo.range_deg)
    play, zero = math.radians(servo.backlash_deg), math.radians(servo.zero_deg) - math.pi
    off = math.radians(servo.zero_bound_deg)
    return ArmJoint(servo.gear_ratio, zero, play, lo, hi, off, encoder_of(finger, servo))


class ArmMechanism(Mechanism):
    """Shoulder and elbow; aims are directions of places on the circle from W's origin."""

    spec: ArmFingerConfig
    kinematics: ArmKinematics
    settling_rad = STREAM_TOLERANCE_RAD

    def __init__(self, spec: ArmFingerConfig) -> None:
        super().__init__(spec, arm_kinematics(spec))
        self.lowest_link_mm, self.swing_mm = spec.links.links_height_mm, spec.links.upper_mm

    @property
    def ranges_rad(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """Shoulder and elbow."""
        shoulder, elbow = (
            (joint.servo_rad(joint.lo_rad), joint.servo_rad(joint.hi_rad))
            for joint in (self.kinematics.shoulder, self.kinematics.elbow)
        )
        return shoulder, elbow

    @property
    def levers(self) -> Sequence[tuple[str, float]]:
        """Both, with the arm stretched."""
        shoulder, elbow, links = self.spec.shoulder, self.spec.elbow, self.spec.links
        return [
            (shoulder.model, (links.upper_mm + links.fore_mm) / shoulder.gear_ratio),
            (elbow.model, links.fore_mm / elbow.gear_ratio),
        ]

    @property
    def reach(self) -> tuple[float, float, float, float]:
        """Full circle, as far as the arm is long."""
        return 0.0, 360.0, 0.0, self.spec.links.upper_mm + self.spec.links.fore_mm

    def drive(self, servos: tuple[Servo, Servo], rig: RigFile) -> ArmDrive:
        """Drive with streamed goals."""
        wait_mm = self.wait_radius_mm(rig.clear_radius_mm)
        return ArmDrive(servos, self.kinematics, wait_mm, rig.closing.max_force_n)

    def wait_radius_mm(self, radius_mm: float) -> float:
        """Distance from W's origin at which the tip waits."""
        return radius_mm + self.spec.tip.half_width_mm + ARM_MARGIN_MM

    @property
    def home_rad(self) -> float:
        """Aim next to the base."""
        return math.atan2(self.spec.base_mm[1], self.spec.base_mm[0])

    def is_steady(self, point_mm: Place) -> bool:
        """Tell whether it can hold its tip there: off its joints' ends, neither stretched nor folded."""
        servos = self.kinematics.servos_at(point_mm)
        if math.isnan(servos[0]) or math.isnan(servos[1]):
            return False
        joints = self.kinematics.shoulder, self.kinematics.elbow
        margin = _JOINT_END_MARGIN_RAD
        off_ends = all(
            joint.lo_rad + margin <= joint.angle_rad(servo) <= joint.hi_rad - margin
            for joint, servo in zip(joints, servos, strict=True)
        )
        return off_ends and self.kinematics.force_transmission(servos) >= MIN_FORCE_TRANSMISSION

    def start_problem(
        self, radius_mm: float, dxl_ids: tuple[int, int], angles_rad: Servos, *, is_homed: bool
    ) -> str | None:
        """Joints must be in their ranges, or the tip near its home if it does not come to standby first."""
        if is_homed:
            return self._joint_problem(dxl_ids, angles_rad)
        x, y = self.kinematics.centre_mm(angles_rad)
        radius = self.wait_radius_mm(radius_mm)
        home = point_on_circle(radius, self.home_rad)
        beside = point_on_circle(radius, math.atan2(y, x))
        if math.dist(beside, (x, y)) <= _START_MM and self.is_steady(beside):
            return None
        return (
            f"its tip (servos {dxl_ids[0]} and {dxl_ids[1]}) stands at ({x:.1f}, {y:.1f}) mm; "
            f"with torque off, push it by hand to within {_START_MM:g} mm of ({home[0]:.1f}, {home[1]:.1f}), "
            "then start again"
        )

    def _joint_problem(self, dxl_ids: tuple[int, int], angles_rad: Servos) -> str | None:
        """Reason why it cannot be moved: servos' turns are only known with joints in their ranges."""
        joints = self.kinematics.shoulder, self.kinematics.elbow
        for (key, config), joint, dxl_id, angle in zip(
            self.spec.servos.items(), joints, dxl_ids, angles_rad, strict=True
        ):
            at = math.degrees(joint.angle_rad(angle))
            lo, hi = config.range_deg
            slack = config.backlash_deg + math.degrees(joint.encoder_rad) + _JOINT_SLACK_DEG
            if not lo - slack <= at <= hi + slack:
                return (
                    f"its {key} (servo {dxl_id}) stands at {at:.1f}°, outside its range {lo:g} … {hi:g}°; "
                    "with torque off, turn it back by hand, then start again"
                )
        return None

    def start_rad(self, radius_mm: float) -> Servos:
        """Servo angles where it waits, next to its base."""
        return self.kinematics.servos_at(point_on_circle(self.wait_radius_mm(radius_mm), self.home_rad))

    def draw_posture(self, rng: np.random.Generator) -> Servos:
        """Random angles of both joints."""
        shoulder, elbow = (
            math.radians(joint.zero_deg + joint.gear_ratio * rng.uniform(*joint.range_deg)) - math.pi
            for joint in (self.spec.shoulder, self.spec.elbow)
        )
        return shoulder, elbow

    def home(self, radius_mm: float) -> Line:
        """Path straight inward, past the base."""
        start = point_on_circle(self.wait_radius_mm(radius_mm), self.home_rad)
        return Line(start, self.home_rad + math.pi)

    def standby(self, radius_mm: float) -> StandbyPoses:
        """Part of the circle that it can follow from its home."""
        home, radius = self.home_rad, self.wait_radius_mm(radius_mm)

        def reached(step: int) -> list[float]:
            found: list[float] = []
            while len(found) < _MAX_STEPS:
                aim = home + (len(found) + 1) * step * _STEP_RAD
                if not self.is_steady(point_on_circle(radius, aim)):
                    break
                found.append(aim)
            return found

        before = reached(-1)[::-1]
        aims = np.array([*before, home, *reached(1)])
        postures = [self.kinematics.servos_at(point_on_circle(radius, aim)) for aim in aims.tolist()]
        bodies = [self.body(servos) for servos in postures]
        return StandbyPoses(aims, capsules_of(bodies, between=True), len(before))

    def is_waiting(self, servos_rad: Servos, aims_rad: tuple[float, float], radius_mm: float) -> bool:
        """Tell whether the tip is on the circle, between two aims."""
        x, y = self.kinematics.centre_mm(servos_rad)
        first, last = aims_rad
        off = math.remainder(math.atan2(y, x) - (first + last) / 2, 2 * math.pi)
        beside = abs(math.hypot(x, y) - self.wait_radius_mm(radius_mm))
        return bool(beside <= _STANDBY_TOLERANCE_MM and abs(off) <= (last - first) / 2 + _SETTLING_RAD)

    def ways_to_standby(self, start: Servos, aims_rad: Floats, radius_mm: float) -> list[Floats]:
        """Straight ways of the tip and of the joints, both at once or one after the other, to each place."""
        radius = self.wait_radius_mm(radius_mm)
        start = self.kinematics.within_ranges(start)  # play may show it a little outside
        here = self.kinematics.centre_mm(start)
        found = []
        for aim in aims_rad[::_AIM_STRIDE].tolist():
            there = point_on_circle(radius, aim)
            goal = self.kinematics.servos_at(there)
            turns = ([start, goal], [start, (start[0], goal[1]), goal], [start, (goal[0], start[1]), goal])
            found += [self._turn_joints(corners) for corners in turns]
            found += self._go_straight(here, there)
        return found

    def _turn_joints(self, corners: Sequence[Servos]) -> Floats:
        """Postures (m, 2) from corner to corner, all joints even, `_WAY_STEP_MM` of the tip or less apart."""
        kinematics = self.kinematics
        levers = np.array([kinematics.upper_mm + kinematics.fore_mm, kinematics.fore_mm])
        levers /= np.abs([kinematics.shoulder.gear_ratio, kinematics.elbow.gear_ratio])
        legs = [np.array([corners[0]])]
        for one, other in pairwise(corners):
            length = float(np.abs(np.subtract(other, one)) @ levers)
            shares = np.linspace(0.0, 1.0, math.ceil(length / _WAY_STEP_MM) + 1)[1:, None]
            legs.append((1 - shares) * np.array(one) + shares * np.array(other))
        return np.concatenate(legs)

    def _go_straight(self, here: Place, there: Place) -> Iterator[Floats]:
        """Postures (m, 2) on the straight line of the tip; none where the arm is not steady all along."""
        shares = np.linspace(0.0, 1.0, max(math.ceil(math.dist(here, there) / _WAY_STEP_MM), 1) + 1)[:, None]
        places = ((1 - shares) * np.array(here) + shares * np.array(there)).tolist()
        if all(self.is_steady((x, y)) for x, y in places):
            yield np.array([self.kinematics.servos_at((x, y)) for x, y in places])

    def paths(
        self, finger_index: int, aims_rad: tuple[float, float], count: int, radius_mm: float
    ) -> list[ApproachPath]:
        """Paths from fewer aims, each at several turns from straight inward: about five times `count`."""
        lo, hi = aims_rad
        aims = np.linspace(lo, hi, count // 3 + 1) if hi > lo else np.array([lo])
        turns = np.radians(np.linspace(-_MAX_OBLIQUITY_DEG, _MAX_OBLIQUITY_DEG, 2 * (count // 6) + 1))
        found = (self._path(finger_index, aim, turn, radius_mm) for aim in aims for turn in turns)
        return [path for path in found if path is not None]

    def _path(
        self, finger_index: int, aim_rad: float, turn_rad: float, radius_mm: float
    ) -> ApproachPath | None:
        """Path from a place on the circle, at a turn from straight inward, as far as joints and array allow.

        None where not even the start is within reach. All of the path the arm is off its singular postures,
        and the array sees everything that the tip may touch: a quarter turn either way of the direction of
        travel.
        """
        start = point_on_circle(self.wait_radius_mm(radius_mm), aim_rad)
        line = Line(start, aim_rad + math.pi + turn_rad)
        most = crossing_mm(line, radius_mm)
        travels = np.append(np.arange(0.0, most, _PATH_STEP_MM), most)
        usable = [self._sees(line, float(travel)) for travel in travels]
        if not all(usable):
            travels = travels[: usable.index(False)]
        if len(travels) < 2:
            return None
        bodies = [self.body(self.kinematics.servos_rad(line, float(travel))) for travel in travels]
        links = [FingerBody(body.start[:2], body.end[:2], body.half_width[:2]) for body in bodies]
        swept = capsules_of(links, between=True)
        tip = max(float(body.half_width[2]) for body in bodies)
        since = np.concatenate([[-1.0], travels[:-1]])
        return ApproachPath(
            finger_index,
            line,
            float(travels[-1]),
            abs(math.remainder(aim_rad - self.home_rad, 2 * math.pi))
            * math.hypot(*start)
            / CIRCLE_SPEED_MM_S,
            BodyCapsules(
                np.vstack([swept.start, [start]]),
                np.vstack([swept.end, [start]]),
                np.append(swept.half_width, tip),
                np.zeros(len(swept.owner) + 1, np.int64),
            ),
            np.append(np.repeat(since, 2), -1.0),
            np.append(np.zeros(len(swept.owner), bool), True),
        )

    def _sees(self, line: Line, travel_mm: float) -> bool:
        """Tell whether the arm is steady there, and its array looks along the line."""
        if not self.is_steady(line.point_mm(travel_mm)):
            return False
        view = math.radians(self.spec.array.coverage_deg / 2) - math.pi / 2 - array_bound_rad(self.spec)
        seen = self.kinematics.facing_rad(self.kinematics.servos_rad(line, travel_mm))
        seen += math.radians(self.spec.array.heading_deg)
        return bool(abs(math.remainder(line.direction_rad - seen, 2 * math.pi)) <= view)

    def test_moves(self, at: Servos) -> tuple[TestMove, TestMove]:
        """Shoulder to the left; elbow straighter, which is away from the base."""
        shoulder, elbow = self.kinematics.shoulder, self.kinematics.elbow
        turned = min(shoulder.angle_rad(at[0]) + _TEST_RAD, shoulder.hi_rad)
        bent = elbow.angle_rad(at[1])
        straighter = min(max(bent - math.copysign(_TEST_RAD, bent), elbow.lo_rad), elbow.hi_rad)
        return (
            TestMove("shoulder.gear_ratio", shoulder.servo_rad(turned), outward=False),
            TestMove("elbow.gear_ratio", elbow.servo_rad(straighter), outward=True),
        )
