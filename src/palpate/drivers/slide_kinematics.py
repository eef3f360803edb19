"""Kinematics of an aim and slide finger: an aim turns a slide about a fixed base, the slide moves the tip.

One of the kinds of `kinematics`. The bounds add up everything that is known only to within a tolerance: base,
heading, the slide's zero and travel per turn, play and encoder steps; or they are what a calibration found.
"""

import math
from dataclasses import dataclass

import numpy as np

from palpate.base.geometry.plane import wrap_angle
from palpate.drivers.kinematics import NO_ENCODER_ERROR, TICK_RAD, Encoder, FingerBody, Line, Servos


@dataclass(frozen=True)
class SlideKinematics:
    """Aim + slide finger; mm, rad. Servo angles count from Goal Position 2048 (e-Manual).

    aim = (servo − aim_zero_rad) / gear_ratio, measured from `heading_rad`; distance of the tip's centre from
    the base = zero_mm + mm_per_rad · servo. The `…_bound_…` fields are how far each may be off, either way:
    `travel_spread` is the share by which `mm_per_rad` may be, counted from Goal Position 0, where
    `zero_bound_mm` holds. `found_position_mm` and `found_direction_rad`, if given, are the bounds on centre
    and direction that a calibration found, and all others but encoders' are left aside.
    """

    base_mm: tuple[float, float]
    heading_rad: float
    gear_ratio: float
    aim_zero_rad: float
    mm_per_rad: float
    zero_mm: float
    base_bound_mm: float
    heading_bound_rad: float
    aim_play_rad: float
    slide_play_mm: float
    zero_bound_mm: float = 0.0
    travel_spread: float = 0.0
    found_position_mm: float | None = None
    found_direction_rad: float | None = None
    aim_encoder: Encoder = NO_ENCODER_ERROR
    slide_encoder: Encoder = NO_ENCODER_ERROR

    @property
    def direction_bound_rad(self) -> float:
        """Bound of the error of the direction of travel."""
        if self.found_direction_rad is not None:
            return self.found_direction_rad + self._aim_encoder_rad
        return self._aimed_bound_rad

    @property
    def _aim_encoder_rad(self) -> float:
        return self.aim_encoder.bound_rad / abs(self.gear_ratio)

    @property
    def _aimed_bound_rad(self) -> float:
        step = TICK_RAD / 2 / abs(self.gear_ratio)
        return self.heading_bound_rad + self.aim_play_rad + step + self._aim_encoder_rad

    @property
    def slide_encoder_mm(self) -> float:
        """Bound of the distance's error from the slide's encoder, its steps apart."""
        return abs(self.mm_per_rad) * self.slide_encoder.bound_rad

    def _scale_bound_mm(self, servo_rad: float) -> float:
        """Bound of the distance's error from zero, travel per turn and the encoder's step."""
        turned = abs(servo_rad + math.pi) + TICK_RAD / 2
        return self.zero_bound_mm + self.travel_spread * abs(self.mm_per_rad) * turned

    def aim_servo_rad(self, aim_rad: float) -> float:
        """Servo angle for an aim."""
        return self.aim_encoder.read_rad(self.aim_zero_rad + self.gear_ratio * aim_rad)

    def slide_servo_rad(self, distance_mm: float) -> float:
        """Servo angle for a distance of the tip's centre from the base."""
        return self.slide_encoder.read_rad((distance_mm - self.zero_mm) / self.mm_per_rad)

    def distance_mm(self, servo_rad: float) -> float:
        """Distance of the tip's centre from the base for a servo angle."""
        return self.zero_mm + self.mm_per_rad * self.slide_encoder.angle_rad(servo_rad)

    def line(self, aim_rad: float, distance_mm: float) -> Line:
        """The way along the slide at an aim, from a distance on."""
        angle = self.heading_rad + aim_rad
        x, y = self.base_mm
        return Line((x + distance_mm * math.cos(angle), y + distance_mm * math.sin(angle)), angle)

    def servos_rad(self, line: Line, travel_mm: float) -> Servos:
        """Aim and slide; the line must pass through the base, as all of a slide's do."""
        aim = wrap_angle(line.direction_rad - self.heading_rad)
        distance = Line(self.base_mm, line.direction_rad).travel_mm(line.point_mm(travel_mm))
        return self.aim_servo_rad(aim), self.slide_servo_rad(distance)

    def centre_mm(self, servos_rad: Servos) -> tuple[float, float]:
        """Tip's centre."""
        return self._along(servos_rad[0]).point_mm(self.distance_mm(servos_rad[1]))

    def facing_rad(self, servos_rad: Servos) -> float:
        """Direction of travel: the slide's."""
        return self._along(servos_rad[0]).direction_rad

    def levers_mm(self, servos_rad: Servos) -> tuple[float, float]:
        """Across the slide, and along it."""
        return abs(self.distance_mm(servos_rad[1]) / self.gear_ratio), abs(self.mm_per_rad)

    def position_bound_mm(self, servos_rad: Servos) -> float:
        """Bound of the true centre's distance from `centre_mm`, along the slide and across it."""
        if self.found_position_mm is not None:
            aim_mm = (self.distance_mm(servos_rad[1]) + self.slide_encoder_mm) * self._aim_encoder_rad
            return self.found_position_mm + math.hypot(self.slide_encoder_mm, aim_mm)
        scale = self._scale_bound_mm(servos_rad[1]) + self.slide_encoder_mm
        along = self.slide_play_mm + abs(self.mm_per_rad) * TICK_RAD / 2 + scale
        across = (self.distance_mm(servos_rad[1]) + scale) * self._aimed_bound_rad
        return self.base_bound_mm + math.hypot(along, across)

    def cross_track_bound_mm(self, servos_rad: Servos, off_rad: float) -> float:
        """The aim keeps the tip on its line: its error by the distance."""
        return abs(self.distance_mm(servos_rad[1])) * off_rad / abs(self.gear_ratio)

    def body(self, servos_rad: Servos, tip_radius_mm: float) -> FingerBody:
        """Capsule from base to tip, as wide as the tip."""
        tip = self.centre_mm(servos_rad)
        return FingerBody(np.array([self.base_mm]), np.array([tip]), np.array([tip_radius_mm]))

    def _along(self, aim_servo_rad: float) -> Line:
        aim = (self.aim_encoder.angle_rad(aim_servo_rad) - self.aim_zero_rad) / self.gear_ratio
        return Line(self.base_mm, self.heading_rad + aim)
