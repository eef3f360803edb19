"""The turning stage as the host sees it: one servo, and from its angle to where the ring stands.

The stage turns all fingers about a fixed centre; what it carries is
computed in the ring's frame, and `Turn` leads from there to W.
"""

import math
from dataclasses import dataclass
from typing import Self

from palpate.config import RigFile, StageConfig
from palpate.drivers.dynamixel.bus import Bus
from palpate.drivers.dynamixel.control_table import OperatingMode
from palpate.drivers.dynamixel.servo import Servo
from palpate.drivers.finger import TICK_RAD, Turn
from palpate.rig.drives import AIM_TOLERANCE_RAD, Limits

__all__ = ["STAGE_SPEED_RAD_S", "HostStage", "planned_turn"]

STAGE_SPEED_RAD_S = 2.0
"""Speed of the stage's servo."""

_ACCELERATION_RAD_S2 = 3.0
_CURRENT_A = 1.2  # the ring carries all fingers


def planned_turn(spec: StageConfig | None, angle_rad: float) -> Turn:
    """The stage at an angle that it has been sent to: its bound holds wherever it settles."""
    if spec is None:
        return Turn()
    settled = AIM_TOLERANCE_RAD / abs(spec.gear_ratio)
    return Turn(spec.centre_mm, angle_rad, _bound_rad(spec) + settled, spec.centre_bound_mm)


@dataclass(frozen=True, eq=False)
class HostStage:
    """The stage's part of the rig file and its servo."""

    spec: StageConfig
    servo: Servo

    @classmethod
    def of(cls, rig: RigFile, bus: Bus) -> Self | None:
        """The rig's stage, None if it has none."""
        if rig.stage is None:
            return None
        ends = [_servo_rad(rig.stage, math.radians(angle)) for angle in rig.stage.range_deg]
        servo = Servo(bus, rig.stage.dxl_id, rig.stage.model, range_rad=(min(ends), max(ends)))
        return cls(rig.stage, servo)

    def limits(self) -> Limits:
        """What the stage's servo may do."""
        return Limits(OperatingMode.POSITION, min(_CURRENT_A, self.servo.model.largest_current_a))

    def prepare(self) -> None:
        """Write mode and limits; torque is off."""
        self.limits().write(self.servo)
        self.servo.set_profile(STAGE_SPEED_RAD_S, _ACCELERATION_RAD_S2)

    def goal_rad(self, angle_rad: float) -> float:
        """Servo angle for a stage angle."""
        return _servo_rad(self.spec, angle_rad)

    def turn(self, servo_rad: float) -> Turn:
        """Where the ring stands for a servo angle."""
        angle = (servo_rad - _servo_rad(self.spec, 0.0)) / self.spec.gear_ratio
        return Turn(self.spec.centre_mm, angle, _bound_rad(self.spec), self.spec.centre_bound_mm)

    def start_problem(self, servo_rad: float) -> str | None:
        """Why the stage must not start from where it stands; None if it may."""
        angle = math.degrees(self.turn(servo_rad).angle_rad)
        lo, hi = self.spec.range_deg
        play = self.spec.backlash_deg + self.spec.bound_deg
        if lo - play <= angle <= hi + play:
            return None
        return (
            f"the stage (servo {self.servo.dxl_id}) stands at {angle:.1f}°, outside {lo:g} … {hi:g}°; "
            "with torque off, turn it by hand to about 0, then start again"
        )


def _servo_rad(spec: StageConfig, angle_rad: float) -> float:
    return math.radians(spec.zero_deg) - math.pi + spec.gear_ratio * angle_rad


def _bound_rad(spec: StageConfig) -> float:
    return math.radians(spec.backlash_deg + spec.bound_deg) + TICK_RAD / 2 / abs(spec.gear_ratio)
