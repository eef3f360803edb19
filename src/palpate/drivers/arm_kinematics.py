"""Kinematics of a two-link arm: a shoulder turns the first link about a fixed base, an elbow the second link.

One of the kinds of `kinematics`. The tip hangs down from the end of the second link. The elbow bends one way,
so every place has one posture. The bounds add up base, heading, lengths, play and encoder steps, each with
the lever that it has on the tip.
"""

import math
from dataclasses import dataclass

import numpy as np

from palpate.drivers.kinematics import NO_ENCODER_ERROR, TICK_RAD, Encoder, FingerBody, Line, Servos


@dataclass(frozen=True)
class ArmJoint:
    """Servo angle = `zero_rad` + `gear_ratio` · joint angle; the joint stays within lo and hi.

    Servo angles count from Goal Position 2048. `play_rad`: how far off the joint may be through play,
    `zero_bound_rad`: through its zero.
    """

    gear_ratio: float
    zero_rad: float
    play_rad: float
    lo_rad: float
    hi_rad: float
    zero_bound_rad: float = 0.0
    encoder: Encoder = NO_ENCODER_ERROR

    @property
    def bound_rad(self) -> float:
        """Bound of the joint's error beside what the servo says, from zero, play and encoder."""
        return self.zero_bound_rad + self.play_rad + TICK_RAD / 2 / abs(self.gear_ratio) + self.encoder_rad

    @property
    def encoder_rad(self) -> float:
        """Share of the encoder's error in that, its steps apart."""
        return self.encoder.bound_rad / abs(self.gear_ratio)

    def servo_rad(self, angle_rad: float) -> float:
        """Servo angle for a joint angle; nan outside of the joint's range."""
        if not self.lo_rad <= angle_rad <= self.hi_rad:
            return math.nan
        return self.encoder.read_rad(self.zero_rad + self.gear_ratio * angle_rad)

    def angle_rad(self, servo_rad: float) -> float:
        """Joint angle for a servo angle."""
        return (self.encoder.angle_rad(servo_rad) - self.zero_rad) / self.gear_ratio

    def within_range(self, servo_rad: float) -> float:
        """The nearest servo angle at which the joint is in its range."""
        return self.servo_rad(min(max(self.angle_rad(servo_rad), self.lo_rad), self.hi_rad))


@dataclass(frozen=True)
class ArmKinematics:
    """Two-link arm; mm, rad. The shoulder's angle counts from `heading_rad`, the elbow's from the first link.

    The sign of the elbow's range says to which side it bends. `length_bound_mm`: how far either length may
    be off; `link_width_mm`: of both links. `found_position_mm` and `found_direction_rad`, if given, are the
    bounds on centre and direction that a calibration found, and all others but encoders' are left aside.
    """

    base_mm: tuple[float, float]
    heading_rad: float
    upper_mm: float
    fore_mm: float
    shoulder: ArmJoint
    elbow: ArmJoint
    link_width_mm: float
    base_bound_mm: float
    heading_bound_rad: float
    length_bound_mm: float
    found_position_mm: float | None = None
    found_direction_rad: float | None = None

    @property
    def direction_bound_rad(self) -> float:
        """Bound of the error of the last link's direction."""
        if self.found_direction_rad is not None:
            return self.found_direction_rad + self.shoulder.encoder_rad + self.elbow.encoder_rad
        return self.heading_bound_rad + self.shoulder.bound_rad + self.elbow.bound_rad

    def servos_rad(self, line: Line, travel_mm: float) -> Servos:
        """Shoulder and elbow; nan where a joint would leave its range or the arm is too short."""
        return self.servos_at(line.point_mm(travel_mm))

    def servos_at(self, point_mm: tuple[float, float]) -> Servos:
        """Shoulder and elbow for a place of the tip's centre (law of cosines)."""
        x, y = point_mm[0] - self.base_mm[0], point_mm[1] - self.base_mm[1]
        bend = (x * x + y * y - self.upper_mm**2 - self.fore_mm**2) / (2 * self.upper_mm * self.fore_mm)
        if abs(bend) > 1:
            return math.nan, math.nan
        elbow = math.copysign(math.acos(bend), self.elbow.lo_rad)
        across = math.atan2(self.fore_mm * math.sin(elbow), self.upper_mm + self.fore_mm * math.cos(elbow))
        shoulder = math.remainder(math.atan2(y, x) - across - self.heading_rad, 2 * math.pi)
        return self.shoulder.servo_rad(shoulder), self.elbow.servo_rad(elbow)

    def within_ranges(self, servos_rad: Servos) -> Servos:
        """The nearest servo angles at which both joints are in their ranges."""
        return self.shoulder.within_range(servos_rad[0]), self.elbow.within_range(servos_rad[1])

    def centre_mm(self, servos_rad: Servos) -> tuple[float, float]:
        """Tip's centre."""
        x, y = self.elbow_mm(servos_rad)
        angle = self.facing_rad(servos_rad)
        return x + self.fore_mm * math.cos(angle), y + self.fore_mm * math.sin(angle)

    def elbow_mm(self, servos_rad: Servos) -> tuple[float, float]:
        """The elbow's axis."""
        angle = self.heading_rad + self.shoulder.angle_rad(servos_rad[0])
        x, y = self.base_mm
        return x + self.upper_mm * math.cos(angle), y + self.upper_mm * math.sin(angle)

    def facing_rad(self, servos_rad: Servos) -> float:
        """Direction of the last link, which carries the array."""
        shoulder = self.shoulder.angle_rad(servos_rad[0])
        return self.heading_rad + shoulder + self.elbow.angle_rad(servos_rad[1])

    def levers_mm(self, servos_rad: Servos) -> tuple[float, float]:
        """Round the base, and round the elbow."""
        lever = math.dist(self.base_mm, self.centre_mm(servos_rad))
        return lever / abs(self.shoulder.gear_ratio), self.fore_mm / abs(self.elbow.gear_ratio)

    def position_bound_mm(self, servos_rad: Servos) -> float:
        """Bound of the true centre's distance from `centre_mm`."""
        lever = math.dist(self.base_mm, self.centre_mm(servos_rad))
        if self.found_position_mm is not None:
            encoders = lever * self.shoulder.encoder_rad + self.fore_mm * self.elbow.encoder_rad
            return self.found_position_mm + encoders
        turned = (
            lever * (self.heading_bound_rad + self.shoulder.bound_rad) + self.fore_mm * self.elbow.bound_rad
        )
        return self.base_bound_mm + 2 * self.length_bound_mm + turned

    def cross_track_bound_mm(self, servos_rad: Servos, off_rad: float) -> float:
        """Both servos keep the tip on its line: the errors of both, by their levers."""
        return sum(self.levers_mm(servos_rad)) * off_rad

    def body(self, servos_rad: Servos, tip_radius_mm: float) -> FingerBody:
        """Both links, and the tip."""
        elbow, tip = self.elbow_mm(servos_rad), self.centre_mm(servos_rad)
        half = self.link_width_mm / 2
        return FingerBody(
            np.array([self.base_mm, elbow, tip]),
            np.array([elbow, tip, tip]),
            np.array([half, half, tip_radius_mm]),
        )

    def force_transmission(self, servos_rad: Servos) -> float:
        """Force transmission: sine of half the transmission angle, between tip-to-base and tip-to-elbow.

        Times √2 the smaller singular value of the Jacobian with unit rows; 0 where the arm is stretched.
        Torques that would each alone push the tip with a force F push it together with F divided by this at
        most.
        """
        elbow, tip = self.elbow_mm(servos_rad), self.centre_mm(servos_rad)
        to_base = math.atan2(self.base_mm[1] - tip[1], self.base_mm[0] - tip[0])
        to_elbow = math.atan2(elbow[1] - tip[1], elbow[0] - tip[0])
        between = abs(math.remainder(to_base - to_elbow, 2 * math.pi))
        # Beyond a right angle the worst torques have the other sign.
        return math.sin(min(between, math.pi - between) / 2)

    def largest_torques_nm(
        self, servos_rad: Servos, force_n: float, least_transmission: float = 0.0
    ) -> tuple[float, float]:
        """Torques of shoulder and elbow joint that cannot push the tip harder than a force, in this posture.

        A torque τ at an axis at distance d is balanced by a force with component τ / d across the way to the
        axis. Two components of f each across directions γ apart come from a force of f / sin(γ/2) at most
        (f / cos(γ/2) for the other signs), so each may be force · sin(γ/2). A transmission below
        `least_transmission` counts as that: along its links a stretched arm may press harder then.
        """
        share = force_n * max(self.force_transmission(servos_rad), least_transmission) / 1000
        return share * math.dist(self.base_mm, self.centre_mm(servos_rad)), share * self.fore_mm
