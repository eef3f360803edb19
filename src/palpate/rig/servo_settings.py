"""Every servo of a rig with what it should be: name, model, id, and what its EEPROM must hold before a run.

One place for runs, `setup-motors` and `check`: the numbers are those of the drives, which write them.
"""

from dataclasses import dataclass

from palpate.base.errors import InputError
from palpate.config import FingerConfig, RigFile
from palpate.drivers.dynamixel.bus import Bus
from palpate.drivers.dynamixel.servo import Servo
from palpate.rig.drives import Limits
from palpate.rig.turning_stage import HostStage
from palpate.rig.wiring import drive_of

__all__ = ["FingerSettings", "ServoSettings", "finger_settings", "servo_settings", "stage_settings"]


@dataclass(frozen=True, eq=False)
class ServoSettings:
    """A servo on the bus, what people call it, and its limits."""

    owner: str
    servo: Servo
    limits: Limits

    def eeprom(self) -> dict[str, int]:
        """Items and values. Raises InputError for limits that the model cannot keep."""
        try:
            return self.limits.eeprom(self.servo)
        except ValueError as error:
            raise InputError(
                f"{self.owner}: {error}; lower max_force_n in the rig file, or take a stronger model"
            ) from error


@dataclass(frozen=True, eq=False)
class FingerSettings:
    """A finger's part of the rig file and its servos, the one next to the base first."""

    spec: FingerConfig
    servos: tuple[ServoSettings, ServoSettings]


def finger_settings(rig: RigFile, bus: Bus) -> list[FingerSettings]:
    """Every finger. Nothing is sent."""
    found = []
    for spec in rig.fingers:
        limits = drive_of(spec, rig, bus).limits()
        near, far = (
            ServoSettings(f"{spec.name} {joint}", servo, limits[servo])
            for joint, servo in zip(spec.servos, limits, strict=True)
        )
        found.append(FingerSettings(spec, (near, far)))
    return found


def stage_settings(rig: RigFile, bus: Bus) -> ServoSettings | None:
    """The stage's servo, None if there is none. Nothing is sent."""
    stage = HostStage.of(rig, bus)
    return None if stage is None else ServoSettings("stage", stage.servo, stage.limits())


def servo_settings(rig: RigFile, bus: Bus) -> list[ServoSettings]:
    """All of them, the stage's first. Nothing is sent."""
    stage = stage_settings(rig, bus)
    fingers = [servo for finger in finger_settings(rig, bus) for servo in finger.servos]
    return fingers if stage is None else [stage, *fingers]
