"""Specifications of servo models: motor and supply from the e-Manual, and what is guessed for emulated ones.

Stall torque, stall current and no-load speed are those of section "Specifications" of each model's page, at
the recommended supply. Units of current are those of the control tables there (`x_series`). Inertia, friction
and heating stand nowhere; the guesses are said where they stand.
"""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from types import MappingProxyType

from palpate.base.extensions import SERVO_MODELS, broken, load
from palpate.drivers.dynamixel.emanual_tables import TableItem
from palpate.drivers.dynamixel.x_series import X_SERIES, XModel, table_of

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
    Goal and Present Current. `protocol_types`: values of Protocol Type that it works with. `supply_v`: least
    and highest supply; None: `nominal_v` alone.

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
    supply_v: tuple[float, float] | None = None


_XM430 = MotorConstants()
_ALSO_RADIO_CONTROL = (2, 20, 21, 22)


def _motor(model: XModel) -> MotorConstants:
    """A model's motor. Guessed: it gathers speed in an XM430-W350's 12 ms and loses its share to friction."""
    strength = model.stall_torque_nm / _XM430.stall_torque_nm
    no_load_rad_s = model.no_load_rpm * _RPM
    return MotorConstants(
        model.stall_torque_nm,
        model.stall_current_a,
        no_load_rad_s,
        inertia_kg_m2=_XM430.inertia_kg_m2 * strength * _XM430.no_load_rad_s / no_load_rad_s,
        friction_nm=_XM430.friction_nm * strength,
    )


def _built_in(model: XModel) -> ServoSpecification:
    family = model.family
    low, nominal, high = family.supply_v
    # on an X330 the other types are radio control, which falls back to Protocol 2.0 where it hears none at
    # boot; others with type 1 would speak Protocol 1.0, which is not emulated
    small = "Protocol Type" not in family.ranges
    return ServoSpecification(
        model.name,
        model.number,
        partial(table_of, model.number),
        max(family.extended_firmware, *family.indirect),
        family.extended_firmware,
        nominal,
        nominal / 2,
        family.current_unit_a,
        _motor(model),
        _ALSO_RADIO_CONTROL if small else (2,),
        (low, high),
    )


SPECIFICATIONS: Mapping[str, ServoSpecification] = MappingProxyType(
    {model.name: _built_in(model) for model in X_SERIES.values()}
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

    Models that are not built in are left out.
    """
    by_volts: dict[float, set[str]] = {}
    for name in set(models) & SPECIFICATIONS.keys():
        by_volts.setdefault(SPECIFICATIONS[name].nominal_v, set()).add(name)
    if len(by_volts) < 2:
        return []
    listed = ", ".join(
        f"{volts:g} V for {' and '.join(sorted(by_volts[volts]))}" for volts in sorted(by_volts)
    )
    ranges = [_supply_range(SPECIFICATIONS[name]) for names in by_volts.values() for name in names]
    low, high = max(low for low, _ in ranges), min(high for _, high in ranges)
    if low <= high:
        return [
            f"servos on one bus are made for different supplies ({listed}), and cables pass the supply on: "
            f"all take {low:g} to {high:g} V; set the supply within that, and measure it first"
        ]
    return [
        f"servos on one bus need different supplies ({listed}), and cables pass the supply on: the highest "
        "destroys the others; use servos of one voltage, or feed them apart, with only ground and data joined"
    ]


def _supply_range(found: ServoSpecification) -> tuple[float, float]:
    return (found.nominal_v, found.nominal_v) if found.supply_v is None else found.supply_v
