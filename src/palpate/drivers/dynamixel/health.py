"""How a servo is, beside what it should be: supply, temperature, errors, settings. Above `servo`.

Only reads; what is judged wrong is for those who ask. Reading works while a servo reports a hardware error.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from palpate.drivers.dynamixel.bus import Bus
from palpate.drivers.dynamixel.control_table import HardwareError
from palpate.drivers.dynamixel.servo import Servo

__all__ = ["Health", "read_health", "read_items"]

_VOLTAGE_UNIT_V = 0.1


@dataclass(frozen=True, slots=True)
class Health:
    """What a servo says of itself. `settings`: the values of the items that were asked for."""

    voltage_v: float
    voltage_limits_v: tuple[float, float]
    temperature_c: int
    temperature_limit_c: int
    hardware_error: HardwareError
    torque_on: bool
    settings: Mapping[str, int]


def read_health(bus: Bus, servo: Servo, items: Iterable[str] = ()) -> Health:
    """Ask a servo whose firmware is known already (`Servo.check`). Raises what the bus raises."""

    def read(name: str) -> int:
        return bus.read(servo.dxl_id, servo.item(name), alert=False)

    low, high = read("Min Voltage Limit"), read("Max Voltage Limit")
    return Health(
        voltage_v=read("Present Input Voltage") * _VOLTAGE_UNIT_V,
        voltage_limits_v=(low * _VOLTAGE_UNIT_V, high * _VOLTAGE_UNIT_V),
        temperature_c=read("Present Temperature"),
        temperature_limit_c=read("Temperature Limit"),
        hardware_error=bus.hardware_error(servo.dxl_id),
        torque_on=bool(read("Torque Enable")),
        settings=read_items(bus, servo, items),
    )


def read_items(bus: Bus, servo: Servo, items: Iterable[str]) -> dict[str, int]:
    """The values of some items, also of a servo that reports a hardware error."""
    return {name: bus.read(servo.dxl_id, servo.item(name), alert=False) for name in items}
