"""Kinematics of a finger: from servo angles to where its tip is in the support plane, and how surely.

Stands between the servos and the contacts, and between the plan and the servos. A finger is an aim that
turns a slide about a fixed base, and a slide that moves the tip along the line. The bounds add up everything
that is known only to within a tolerance: base, heading, play and encoder steps.
"""

import math
from dataclasses import dataclass

__all__ = ["FingerKinematics"]

_TICK_RAD = 2 * math.pi / 4096


@dataclass(frozen=True)
class FingerKinematics:
    """Aim + slide finger in W; mm, rad. Servo angles count from Goal Position 2048 (e-Manual).

    aim = (servo − aim_zero_rad) / gear_ratio, measured from `heading_rad`; distance of the tip's centre from
    the base = zero_mm + mm_per_rad · servo. The `…_bound_…` fields are how far each may be off, either way.
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

    def aim_servo_rad(self, aim_rad: float) -> float:
        """Servo angle for an aim."""
        return self.aim_zero_rad + self.gear_ratio * aim_rad

    def slide_servo_rad(self, distance_mm: float) -> float:
        """Servo angle for a distance of the tip's centre from the base."""
        return (distance_mm - self.zero_mm) / self.mm_per_rad

    def aim_rad(self, servo_rad: float) -> float:
        """Aim for a servo angle."""
        return (servo_rad - self.aim_zero_rad) / self.gear_ratio

    def distance_mm(self, servo_rad: float) -> float:
        """Distance of the tip's centre from the base for a servo angle."""
        return self.zero_mm + self.mm_per_rad * servo_rad

    def direction_rad(self, aim_rad: float) -> float:
        """Direction of travel in W at an aim."""
        return self.heading_rad + aim_rad

    def centre_mm(self, aim_rad: float, distance_mm: float) -> tuple[float, float]:
        """Tip's centre in W."""
        angle = self.direction_rad(aim_rad)
        return (
            self.base_mm[0] + distance_mm * math.cos(angle),
            self.base_mm[1] + distance_mm * math.sin(angle),
        )

    @property
    def direction_bound_rad(self) -> float:
        """How far the true direction of travel may be from the computed one."""
        return self.heading_bound_rad + self.aim_play_rad + _TICK_RAD / 2 / abs(self.gear_ratio)

    @property
    def distance_bound_mm(self) -> float:
        """How far the true distance from the base may be from the computed one."""
        return self.slide_play_mm + abs(self.mm_per_rad) * _TICK_RAD / 2

    def position_bound_mm(self, distance_mm: float, along_mm: float = 0.0, across_mm: float = 0.0) -> float:
        """How far the true centre may be from `centre_mm`.

        `along_mm` and `across_mm` are further errors along and across the direction of travel.
        """
        along = self.distance_bound_mm + along_mm
        across = distance_mm * self.direction_bound_rad + across_mm
        return self.base_bound_mm + math.hypot(along, across)
