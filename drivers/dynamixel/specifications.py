"""Specifications of servo models: motor and supply from the e-Manual, and what is guessed for emulated ones.

Stall torque, stall current and no-load speed are those of section "Specifications" of each model's page
(XM430-W350, XL330-M288-T, XC330-M288-T) at the recommended supply. Units of current are those of the control
tables there. Inertia, friction and heating stand nowhere; the guesses are said where they stand.
"""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from types import MappingProxyType
from typing import Any

from palpate.drivers.dynamixel.emanual_tables import EXTENDED_FIRMWARE, MODEL_NAMES, TableItem, table_of
from palpate.extensions import SERVO_MODELS, broken, load

__all__ = ["SPECIFICATIONS", "MotorConstants", "ServoSpecification", "specification", "supply_warnings"]

_RPM = 2 * math.pi / 60  # rad/s


@dataclass(frozen=True, slots=True)
class MotorConstants:
    """A servo as seen at its output shaft. Defaults: XM430-W350 at 12 V."""

    stall_torque_nm: float = 4.1  # e-Manual
    stall_current_a: float = 2.3  # e-Manual
    no_load_rad_s: float = 46 * 2 * math.pi / 60  # e-Manual
    inertia_kg_m2: float = 0.01  # guess: a 80 g·mm² rotor behind 353.5 : 1
    friction_nm: float = 0.05  # guess: gear friction, the same at rest and in motion


@dataclass(frozen=True)
class ServoSpecification:
    """A servo model of the X series, for host and emulator; entry points of `palpate.servo_models` name one.

    `name`: as in rig files. `number`: Model Number (0). `items`: the e-Manual's control table of a firmware.
    `firmware`: what an emulated one has unless asked otherwise. `extended_firmware`: first one with fast
    reads, Control Table Backup and Startup Configuration. `nominal_v`: recommended supply. `brown_out_v`:
    below it the controller is off; a guess, the manual gives operating ranges only. `current_unit_a`: of
    Goal and Present Current. `protocol_types`: values of Protocol Type that it works with.

    Its positions have 4096 steps a turn, 2048 at 0 rad, and its velocities units of 0.229 rpm.
    """

    name: str
    number: int
    items: Callable[[int], Sequence[TableItem]]
    firmware: int
    extended_firmware: int
    nominal_v: float
    brown_out_v: float
    current_unit_a: float
    motor: MotorConstants
    protocol_types: tuple[int, ...] = (2,)


# guessed so that all motors gather speed in the XM430's 12 ms and lose its part of their torque to friction
_XL330_MOTOR = MotorConstants(0.52, 1.47, 103 * _RPM, 6e-4, 0.006)
_XC330_MOTOR = MotorConstants(0.93, 1.80, 81 * _RPM, 1.2e-3, 0.011)

# on an X330 the other types are radio control, which falls back to Protocol 2.0 where it hears none at boot;
# an XM430 with type 1 would speak Protocol 1.0, which is not emulated
_RADIO_CONTROL = (2, 20, 21, 22)


def _built_in(
    number: int, firmware: int, supply_v: tuple[float, float], current_unit_a: float, *more: Any
) -> ServoSpecification:
    return ServoSpecification(
        MODEL_NAMES[number],
        number,
        partial(table_of, number),
        firmware,
        EXTENDED_FIRMWARE[number],
        *supply_v,
        current_unit_a,
        *more,
    )


SPECIFICATIONS: Mapping[str, ServoSpecification] = MappingProxyType(
    {
        found.name: found
        for found in (
            _built_in(1020, 44, (12.0, 6.0), 2.69e-3, MotorConstants()),
            _built_in(1200, 52, (5.0, 2.5), 1.0e-3, _XL330_MOTOR, _RADIO_CONTROL),
            _built_in(1240, 52, (5.0, 2.5), 1.0e-3, _XC330_MOTOR, _RADIO_CONTROL),
        )
    }
)
"""Built-in models by name."""


def specification(name: str) -> ServoSpecification:
    """Find a model by name, built in or from a plug-in. Raises InputError if there is none."""
    if name in SPECIFICATIONS:
        return SPECIFICATIONS[name]
    found = load(SERVO_MODELS, name, SPECIFICATIONS)
    if not isinstance(found, ServoSpecification):
        raise broken(SERVO_MODELS, name, f"it is a {type(found).__name__}, not a ServoSpecification")
    return found


def supply_warnings(models: Iterable[str]) -> list[str]:
    """What is wrong with the supply of servos on one bus, whose cables pass it on; none if all need the same.

    Models that are not known here are left out.
    """
    by_volts: dict[float, set[str]] = {}
    for name in set(models) & SPECIFICATIONS.keys():
        by_volts.setdefault(SPECIFICATIONS[name].nominal_v, set()).add(name)
    if len(by_volts) < 2:
        return []
    listed = ", ".join(
        f"{volts:g} V for {' and '.join(sorted(by_volts[volts]))}" for volts in sorted(by_volts)
    )
    return [
        f"servos on one bus need different supplies ({listed}), and cables pass the supply on: the highest "
        "destroys the others; use servos of one voltage, or feed them apart, with only ground and data joined"
    ]
