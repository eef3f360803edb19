"""Slide mechanism: an aim servo turns a slide about a fixed base, a slide servo moves the tip along it.

It has one goal for a whole path, with the servo's own speed profile. It waits with the slide back, and turns
to its aim there; its paths go straight out from the base.
"""

import math
from collections.abc import Mapping, Sequence

import numpy as np

from palpate.base.errors import InputError
from palpate.base.geometry import Floats
from palpate.config import RigFile, SlideFingerConfig
from palpate.drivers.dynamixel import OperatingMode, Servo, ServoGoals
from palpate.drivers.kinematics import Line, Servos
from palpate.drivers.slide_kinematics import SlideKinematics
from palpate.rig.conversion import calibrated_direction_rad, encoder_of
from palpate.rig.mechanisms.mechanism import (
    ACCELERATION_RAD_S2,
    AIM_CURRENT_A,
    AIM_SPEED_RAD_S,
    ApproachPath,
    HardStops,
    Mechanism,
    ServoLimits,
    StandbyPoses,
    TestMove,
    crossing_mm,
)
from palpate.rig.mechanisms.swept_volume import BodyCapsules, capsules_of

_STEP_RAD = math.radians(1.0)  # between two aims at which a waiting slide is looked at
_SETTLING_RAD = math.radians(0.6)  # servos settle beside their goals
_WAY_STEP_MM = 1.0  # of the tip, between two postures of a way
_END_MARGIN_MM = 1.0
_AIM_END_MARGIN_RAD = 1e-7
_START_MM = 1.0  # from the retracted end, as people leave it
_OFF_STOP_MM = 0.5
_TEST_AIM_RAD = 0.35  # of the aim's servo, as calibration swings it
_TEST_SLIDE_MM = 8.0


def slide_kinematics(finger: SlideFingerConfig) -> SlideKinematics:
    """Kinematics of aim and slide. The file counts servo angles from Goal Position 0, drivers from 2048."""
    mm_per_rad = finger.slide.mm_per_rad
    return SlideKinematics(
        base_mm=finger.base_mm,
        heading_rad=math.radians(finger.heading_deg),
        gear_ratio=finger.aim.gear_ratio,
        aim_zero_rad=math.radians(finger.aim.zero_deg) - math.pi,
        mm_per_rad=mm_per_rad,
        zero_mm=finger.slide.zero_mm + mm_per_rad * math.pi,
        base_bound_mm=finger.bounds.base_mm,
        heading_bound_rad=math.radians(finger.bounds.heading_deg),
        aim_play_rad=math.radians(finger.aim.backlash_deg),
        slide_play_mm=finger.slide.backlash_mm,
        zero_bound_mm=finger.slide.zero_bound_mm,
        travel_spread=finger.slide.mm_per_turn_spread,
        found_position_mm=finger.bounds.position_mm,
        found_direction_rad=calibrated_direction_rad(finger),
        aim_encoder=encoder_of(finger, finger.aim),
        slide_encoder=encoder_of(finger, finger.slide),
    )


class SlideMechanism(Mechanism):
    """Aim and slide; aims count from the finger's heading."""

    spec: SlideFingerConfig
    kinematics: SlideKinematics

    def __init__(self, spec: SlideFingerConfig) -> None:
        super().__init__(spec, slide_kinematics(spec))
        self.aim, self.push = spec.aim, spec.slide
        if spec.slide.stops_mm is None:
            self.restart_advice = "push its finger back by hand until it is retracted, then start again"
        else:
            self.homing = HardStops(spec.aim, spec.slide, self.kinematics, *spec.slide.stops_mm)
            self.restart_advice = "then start again: the next run, or palpate home, homes it"

    @property
    def ranges_rad(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """Aim and slide."""
        lo, hi = (self.kinematics.aim_servo_rad(math.radians(value)) for value in self.spec.aim.range_deg)
        near, far = (self.kinematics.slide_servo_rad(value) for value in self.spec.slide.range_mm)
        return (lo, hi), (near, far)

    @property
    def levers(self) -> Sequence[tuple[str, float]]:
        """Slide alone: the aim holds."""
        return [(self.spec.slide.model, self.spec.slide.mm_per_rad)]

    @property
    def reach(self) -> tuple[float, float, float, float]:
        """Range of the aim, by that of the slide."""
        return *self.spec.aim.range_deg, *self.spec.slide.range_mm

    def drive(self, servos: tuple[Servo, Servo], rig: RigFile) -> "SlideDrive":
        """Drive with one goal at a time."""
        return SlideDrive(servos, self, rig)

    def wait_mm(self, radius_mm: float) -> float:
        """Furthest distance from the base, from the retracted end on, with the tip clear of the workspace."""
        kinematics = self.kinematics
        lo, hi = self.spec.slide.range_mm
        clear = radius_mm + self.spec.tip.half_width_mm
        distances = np.append(lo + _END_MARGIN_MM, np.arange(lo + _END_MARGIN_MM, hi, 1.0))
        angles = kinematics.heading_rad + np.radians(np.linspace(*self.spec.aim.range_deg, 15))
        x = kinematics.base_mm[0] + distances[:, None] * np.cos(angles)
        y = kinematics.base_mm[1] + distances[:, None] * np.sin(angles)
        outside = np.all(np.hypot(x, y) >= clear, axis=1)
        outside[0] = True
        first_inside = len(outside) if outside.all() else int(np.argmin(outside))
        return float(distances[first_inside - 1])

    def start_problem(
        self, radius_mm: float, dxl_ids: tuple[int, int], angles_rad: Servos, *, is_homed: bool
    ) -> str | None:
        """Slide must be retracted, because its servo knows its angle within one turn only, or be homed."""
        del radius_mm  # it waits retracted, wherever the workspace ends
        if is_homed and self.homing is not None:
            return None
        distance = self.kinematics.distance_mm(angles_rad[1])
        lo, hi = self.spec.slide.range_mm
        slack = self.spec.slide.backlash_mm + self.kinematics.slide_encoder_mm
        if lo - slack <= distance <= hi + slack:
            return None
        return (
            f"its slide (servo {dxl_ids[1]}) stands at {distance:.1f} mm, outside its range "
            f"{lo:g} … {hi:g} mm; with torque off, push the finger back by hand until it is retracted within "
            "the servo's first turn, then start again"
        )

    def start_rad(self, radius_mm: float) -> Servos:
        """Retracted, at aim 0."""
        del radius_mm
        slide_mm = self.spec.slide.range_mm[0] + _START_MM
        return self.kinematics.aim_servo_rad(0.0), self.kinematics.slide_servo_rad(slide_mm)

    def draw_posture(self, rng: np.random.Generator) -> Servos:
        """Random aim and distance, the latter between the stops if they are known."""
        slide = self.spec.slide
        lo, hi = slide.range_mm
        if self.homing is not None:
            lo, hi = self.homing.back_mm + _OFF_STOP_MM, self.homing.front_mm - _OFF_STOP_MM
        off = max(slide.off_mm(lo), slide.off_mm(hi))
        lo, hi = lo + off, hi - off
        aim = math.radians(rng.uniform(*self.spec.aim.range_deg))
        return self.kinematics.aim_servo_rad(aim), self.kinematics.slide_servo_rad(rng.uniform(lo, hi))

    def home(self, radius_mm: float) -> Line:
        """Path at the aim that is nearest to 0."""
        lo, hi = (math.radians(value) for value in self.spec.aim.range_deg)
        return self.kinematics.line(min(max(0.0, lo), hi), self.wait_mm(radius_mm))

    def standby(self, radius_mm: float) -> StandbyPoses:
        """Retracted, at all aims of its range."""
        lo, hi = (math.radians(value) for value in self.spec.aim.range_deg)
        home = min(max(0.0, lo), hi)
        before = np.linspace(lo, home, math.ceil((home - lo) / _STEP_RAD) + 1)
        after = np.linspace(home, hi, math.ceil((hi - home) / _STEP_RAD) + 1)
        aims = np.concatenate([before[:-1], after])
        wait = self.wait_mm(radius_mm)
        lines = [self.kinematics.line(float(aim), wait) for aim in aims]
        bodies = [self.body(self.kinematics.servos_rad(line, 0.0)) for line in lines]
        return StandbyPoses(aims, capsules_of(bodies, between=True), len(before) - 1)

    def is_waiting(self, servos_rad: Servos, aims_rad: tuple[float, float], radius_mm: float) -> bool:
        """Tell whether it is aimed between two aims: retracted it is anyway."""
        del radius_mm
        aim = self.kinematics.facing_rad(servos_rad) - math.radians(self.spec.heading_deg)
        return bool(aims_rad[0] - _SETTLING_RAD <= aim <= aims_rad[1] + _SETTLING_RAD)

    def ways_to_standby(self, start: Servos, aims_rad: Floats, radius_mm: float) -> list[Floats]:
        """Way of the aim alone, to the nearest of the aims."""
        wait = self.wait_mm(radius_mm)
        at = self.kinematics.facing_rad(start) - math.radians(self.spec.heading_deg)
        aim = float(np.clip(at, aims_rad[0], aims_rad[-1]))
        turned = self.kinematics.aim_servo_rad(aim)
        count = max(math.ceil(abs(aim - at) * wait / _WAY_STEP_MM), 1) + 1
        return [np.column_stack([np.linspace(start[0], turned, count), np.full(count, start[1])])]

    def paths(
        self, finger_index: int, aims_rad: tuple[float, float], count: int, radius_mm: float
    ) -> list[ApproachPath]:
        """One path from each of `count` aims."""
        lo, hi = aims_rad
        # An aim at the very end of its servo's range may be beyond it once it has been a line in between.
        inner = min(_AIM_END_MARGIN_RAD, (hi - lo) / 2)
        aims = np.unique(np.linspace(lo + inner, hi - inner, count)).tolist()
        wait = self.wait_mm(radius_mm)
        return [self._path(finger_index, aim, wait, radius_mm) for aim in aims]

    def _path(self, finger_index: int, aim_rad: float, wait_mm: float, radius_mm: float) -> ApproachPath:
        """Path until the tip has left the workspace on the far side, or the slide ends."""
        kinematics = self.kinematics
        line = kinematics.line(aim_rad, wait_mm)
        room = self.spec.slide.range_mm[1] - _END_MARGIN_MM - wait_mm
        travel = min(crossing_mm(line, radius_mm), room)
        # What bounds the tip's place is largest at one of the ends.
        far = self.body(kinematics.servos_rad(line, max(travel, 0.0)))
        here = self.body(kinematics.servos_rad(line, 0.0))
        width = np.maximum(here.half_width, far.half_width)
        return ApproachPath(
            finger_index,
            line,
            travel,
            abs(kinematics.gear_ratio * aim_rad) / AIM_SPEED_RAD_S,
            BodyCapsules(here.start, here.end, width, np.zeros(1, np.int64)),
            np.zeros(1) - 1.0,
            np.ones(1, bool),
        )

    def test_moves(self, at: Servos) -> tuple[TestMove, TestMove]:
        """Aim to the left, slide out."""
        kinematics = self.kinematics
        ratio = kinematics.aim_servo_rad(1.0) - kinematics.aim_servo_rad(0.0)
        aim = at[0] + (_TEST_AIM_RAD if ratio > 0 else -_TEST_AIM_RAD)
        slide = kinematics.slide_servo_rad(kinematics.distance_mm(at[1]) + _TEST_SLIDE_MM)
        return TestMove("aim.gear_ratio", aim, outward=False), TestMove(
            "slide.mm_per_turn", slide, outward=True
        )


class SlideDrive:
    """Aim in position mode, slide in current-based position mode, each with one goal at a time."""

    streams = False

    def __init__(self, servos: tuple[Servo, Servo], mechanism: "SlideMechanism", rig: RigFile) -> None:
        closing = rig.closing
        self._aim, self._slide = servos
        self._kinematics = mechanism.kinematics
        self._wait_mm = mechanism.wait_mm(rig.clear_radius_mm)
        self._speed_mm_s, self._touch_mm_s = closing.approach_speed_mm_s, closing.touch_speed_mm_s
        self._force_n = closing.max_force_n
        self._friction_a = mechanism.spec.slide.friction_a
        self._targets: ServoGoals = {}

    @property
    def servos(self) -> tuple[Servo, Servo]:
        """Aim and slide."""
        return self._aim, self._slide

    @property
    def closing_servos(self) -> tuple[Servo, ...]:
        """The slide alone."""
        return (self._slide,)

    def limits(self) -> Mapping[Servo, ServoLimits]:
        """The slide's current allows the largest force at the tip."""
        return {
            self._aim: ServoLimits(OperatingMode.POSITION, AIM_CURRENT_A),
            self._slide: ServoLimits(
                OperatingMode.CURRENT_BASED_POSITION, self._current_a(), self._speed_problem()
            ),
        }

    def prepare(self) -> None:
        """Write modes and limits, and speeds."""
        for servo, limits in self.limits().items():
            limits.write(servo)
        self._slide.set_goal_current_a(self._current_a())
        self._aim.set_profile(AIM_SPEED_RAD_S, ACCELERATION_RAD_S2)
        self._set_speed(self._speed_mm_s)

    def retract(self) -> ServoGoals:
        """Slide back; the aim stays."""
        self._set_speed(self._speed_mm_s)
        self._targets = {self._slide: self._kinematics.slide_servo_rad(self._wait_mm)}
        return self._targets

    def aim(self, line: Line, _present: Servos, _now: float) -> ServoGoals:
        """Turn; the slide stays where it waits."""
        self._targets = {self._aim: self._kinematics.servos_rad(line, 0.0)[0]}
        return self._targets

    def go(self, line: Line, _from_mm: float, to_mm: float, speed_mm_s: float, _now: float) -> ServoGoals:
        """Slide at a speed, from the next goal on."""
        self._set_speed(speed_mm_s)
        self._targets = {self._slide: self._kinematics.servos_rad(line, to_mm)[1]}
        return self._targets

    def follow(self, postures_rad: Floats, _travel_mm: Floats, _speed_mm_s: float, _now: float) -> ServoGoals:
        """Turn to the last posture: outside of the workspace only the aim moves."""
        self._targets = {self._aim: float(postures_rad[-1, 0])}
        return self._targets

    def slow_down(self, speed_mm_s: float, _now: float) -> ServoGoals:
        """The same goal again: the servo's profile changes its speed when a goal is written."""
        self._set_speed(speed_mm_s)
        return self._targets

    def slowing_mm(self, from_mm_s: float, to_mm_s: float) -> float:
        """Travel at the profile's acceleration."""
        rate = ACCELERATION_RAD_S2 * abs(self._kinematics.mm_per_rad)
        return max(from_mm_s**2 - to_mm_s**2, 0.0) / 2 / rate

    def goals(self, _now: float) -> ServoGoals:
        """No goals: one is enough."""
        return {}

    def under_way(self, _now: float) -> bool:
        """Never: one goal is enough."""
        return False

    def targets(self) -> ServoGoals:
        """The last goal."""
        return self._targets

    def tolerance_rad(self, _servo: Servo, gap_mm: float) -> float:
        """Only the slide's is asked for: the aim has a tolerance of its own."""
        return gap_mm / abs(self._kinematics.mm_per_rad)

    def _speed_problem(self) -> str | None:
        """What is wrong with the slowest speed of the rig file."""
        if self._touch_mm_s >= self._least_mm_s:
            return None
        return (
            f"touch_speed_mm_s ({self._touch_mm_s:g}) is slower than its profile can be: at least "
            f"{math.ceil(1000 * self._least_mm_s) / 1000:g} mm/s (servo {self._slide.dxl_id}); raise it "
            "in the rig file, or take a smaller pinion"
        )

    def _current_a(self) -> float:
        lever_m = abs(self._kinematics.mm_per_rad) / 1000
        return self._friction_a + self._force_n * lever_m / self._slide.model.known_torque.nm_per_a

    def _set_speed(self, speed_mm_s: float) -> None:
        if speed_mm_s < self._least_mm_s:
            raise InputError(
                f"servo {self._slide.dxl_id} cannot move its slide as slowly as {speed_mm_s:g} mm/s, but at "
                f"{self._least_mm_s:.3g} mm/s at least; what was asked needs a smaller pinion"
            )
        self._slide.set_profile(speed_mm_s / abs(self._kinematics.mm_per_rad), ACCELERATION_RAD_S2)

    @property
    def _least_mm_s(self) -> float:
        """Slowest speed: Profile Velocity counts from 1."""
        return self._slide.model.velocity_unit_rad_s * abs(self._kinematics.mm_per_rad)
