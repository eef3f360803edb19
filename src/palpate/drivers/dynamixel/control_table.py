"""The control table as the host uses it: items, units, modes and error bits that the whole X series shares.

Names are the e-Manual's. `emanual_tables` has items with access and range, `models` those of other series.
Source: ROBOTIS e-Manual, control tables of the X series with current (their addresses agree).
"""

import math
from dataclasses import dataclass
from enum import IntEnum, IntFlag

from palpate.drivers.dynamixel.emanual_tables import COMMON_ITEMS, Area

__all__ = [
    "ACCELERATION_UNIT_RAD_S2",
    "ANSWERS_ALL",
    "BAUD_RATE",
    "HARDWARE_ERROR_STATUS",
    "ID",
    "ITEMS",
    "RAD_PER_TICK",
    "RETURN_DELAY_TIME",
    "RETURN_DELAY_UNIT_S",
    "TORQUE_ENABLE",
    "VELOCITY_UNIT_RAD_S",
    "WATCHDOG_UNIT_S",
    "ZERO_TICK",
    "HardwareError",
    "Item",
    "OperatingMode",
]

RAD_PER_TICK = 2 * math.pi / 4096
ZERO_TICK = 2048
ANSWERS_ALL = 2
"""Status Return Level at which a servo answers every instruction."""
VELOCITY_UNIT_RAD_S = 0.229 * 2 * math.pi / 60
ACCELERATION_UNIT_RAD_S2 = 214.577 * 2 * math.pi / 3600
WATCHDOG_UNIT_S = 0.020
RETURN_DELAY_UNIT_S = 2e-6


@dataclass(frozen=True, slots=True)
class Item:
    """One item of the control table."""

    name: str
    address: int
    size: int
    signed: bool = False
    eeprom: bool = False

    def decode(self, raw: bytes) -> int:
        """Value of the item's bytes as they come from the wire."""
        return int.from_bytes(raw, "little", signed=self.signed)

    def encode(self, value: int) -> bytes:
        """Bytes of a value; one that does not fit raises ValueError naming the item."""
        try:
            return value.to_bytes(self.size, "little", signed=self.signed)
        except OverflowError:
            raise ValueError(f"{value} does not fit into {self.name} ({self.size} bytes)") from None


ITEMS: dict[str, Item] = {
    item.name: Item(item.name, item.address, item.size, item.signed, item.area is Area.EEPROM)
    for item in COMMON_ITEMS
}
"""Items of the X series by name, in order of address; some models lack PWM Slope or LED."""

ID = ITEMS["ID"]
BAUD_RATE = ITEMS["Baud Rate"]
RETURN_DELAY_TIME = ITEMS["Return Delay Time"]
TORQUE_ENABLE = ITEMS["Torque Enable"]
HARDWARE_ERROR_STATUS = ITEMS["Hardware Error Status"]


class OperatingMode(IntEnum):
    """Operating Mode (11)."""

    CURRENT = 0
    VELOCITY = 1
    POSITION = 3
    EXTENDED_POSITION = 4
    CURRENT_BASED_POSITION = 5
    PWM = 16


class HardwareError(IntFlag):
    """Hardware Error Status (70)."""

    INPUT_VOLTAGE = 0x01
    OVERHEATING = 0x04
    MOTOR_ENCODER = 0x08
    ELECTRICAL_SHOCK = 0x10
    OVERLOAD = 0x20
