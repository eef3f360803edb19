"""The servo models that are emulated: what the e-Manual says of motor and supply, and what is guessed.

Stall torque, stall current and no-load speed are those of section "Specifications" of each model's page
(XM430-W350, XL330-M288-T, XC330-M288-T) at the recommended supply. Units of current are those of the control
tables there. Inertia, friction and heating stand nowhere; the guesses are said where they stand.
"""

import math
from dataclasses import dataclass, field

from palpate.drivers.dynamixel.manual import MODEL_NAMES

__all__ = ["SERVO_MODELS", "MotorConstants", "ServoModel", "servo_model"]

_RPM = 2 * math.pi / 60  # rad/s


@dataclass(frozen=True, slots=True)
class MotorConstants:
    """A servo as seen at its output shaft. Defaults: XM430-W350 at 12 V."""

    stall_torque_nm: float = 4.1  # e-Manual
    stall_current_a: float = 2.3  # e-Manual
    no_load_rad_s: float = 46 * 2 * math.pi / 60  # e-Manual
    inertia_kg_m2: float = 0.01  # guess: a 80 g·mm² rotor behind 353.5 : 1
    friction_nm: float = 0.05  # guess: gear friction, the same at rest and in motion


@dataclass(frozen=True, slots=True)
class ServoModel:
    """What an emulated servo is built as.

    `number`: Model Number (0). `firmware`: what it has unless asked otherwise. `nominal_v`: recommended
    supply. `brown_out_v`: below it the controller is off; a guess, the manual gives operating ranges only.
    `protocol_types`: values of Protocol Type that it works with.
    """

    number: int
    firmware: int
    nominal_v: float
    brown_out_v: float
    current_unit_a: float
    protocol_types: tuple[int, ...]
    motor: MotorConstants = field(default_factory=MotorConstants)

    @property
    def name(self) -> str:
        """Name as in the rig file."""
        return MODEL_NAMES[self.number]


# the rotors' inertia is guessed so that all motors gather speed in the XM430's 12 ms
_XL330_MOTOR = MotorConstants(0.52, 1.47, 103 * _RPM, 6e-4, 0.01)
_XC330_MOTOR = MotorConstants(0.93, 1.80, 81 * _RPM, 1.2e-3, 0.012)

# on an X330 the other types are radio control, which falls back to Protocol 2.0 where it hears none at boot;
# an XM430 with type 1 would speak Protocol 1.0, which is not emulated
_RADIO_CONTROL = (2, 20, 21, 22)

SERVO_MODELS: tuple[ServoModel, ...] = (
    ServoModel(1020, 44, 12.0, 6.0, 2.69e-3, (2,)),
    ServoModel(1200, 52, 5.0, 2.5, 1.0e-3, _RADIO_CONTROL, _XL330_MOTOR),
    ServoModel(1240, 52, 5.0, 2.5, 1.0e-3, _RADIO_CONTROL, _XC330_MOTOR),
)


def servo_model(name: str) -> ServoModel:
    """Find a model by name; ValueError if it is not emulated."""
    for model in SERVO_MODELS:
        if model.name == name:
            return model
    raise ValueError(f"servo model {name!r} is not emulated")
