"""Control table of the X series: items with address, size, access, default and range; units, modes, errors.

Names are the e-Manual's. `COMMON_ITEMS` are the table's items as data; `ITEMS` are the same as the host
addresses them. What a single model has and has differently stands in `x_series`, what other series have in
`models`. Source: ROBOTIS e-Manual, pages of the X series' models and of single items. Values and ranges are
in the items' own units. Where the manual gives no default ("-"), `default` is 0 for what is measured, and a
value that a servo would come with for what can be written.
"""

import math
from dataclasses import dataclass
from enum import Enum, IntEnum, IntFlag


class Access(Enum):
    """Access that a controller has to an item."""

    R = "read only"
    RW = "read and write"


class Area(Enum):
    """Memory of an item: EEPROM survives a reboot and is locked while torque is on."""

    EEPROM = "EEPROM"
    RAM = "RAM"


@dataclass(frozen=True, slots=True)
class TableItem:
    """One item; values are signed if the range begins below zero."""

    name: str
    address: int
    size: int
    access: Access
    area: Area
    default: int
    low: int
    high: int

    @property
    def signed(self) -> bool:
        """True if negative values are in range, or the item reports signed quantities."""
        return self.low < 0


BAUD_RATES: tuple[int, ...] = (9600, 57_600, 115_200, 1_000_000, 2_000_000, 3_000_000, 4_000_000, 4_500_000)
"""Bits per second by value of Baud Rate (8)."""

BROADCAST_RESET_FIRMWARE = 42
"""First firmware that ignores a Factory Reset of everything sent to all (page Protocol 2.0)."""


def _eeprom(
    name: str, address: int, size: int, default: int, low: int, high: int, access: Access = Access.RW
) -> TableItem:
    return TableItem(name, address, size, access, Area.EEPROM, default, low, high)


def _ram(
    name: str, address: int, size: int, default: int, low: int, high: int, access: Access = Access.RW
) -> TableItem:
    return TableItem(name, address, size, access, Area.RAM, default, low, high)


_R = Access.R
_S16 = (-0x8000, 0x7FFF)
_S32 = (-0x8000_0000, 0x7FFF_FFFF)

COMMON_ITEMS: tuple[TableItem, ...] = (
    _eeprom("Model Number", 0, 2, 0, 0, 0xFFFF, _R),
    _eeprom("Model Information", 2, 4, 0, 0, 0xFFFF_FFFF, _R),
    _eeprom("Firmware Version", 6, 1, 0, 0, 255, _R),
    _eeprom("ID", 7, 1, 1, 0, 252),
    _eeprom("Baud Rate", 8, 1, 1, 0, 6),
    _eeprom("Return Delay Time", 9, 1, 250, 0, 254),
    _eeprom("Drive Mode", 10, 1, 0, 0, 5),
    _eeprom("Operating Mode", 11, 1, 3, 0, 16),
    _eeprom("Secondary(Shadow) ID", 12, 1, 255, 0, 255),
    _eeprom("Protocol Type", 13, 1, 2, 2, 22),
    _eeprom("Homing Offset", 20, 4, 0, -1_044_479, 1_044_479),
    _eeprom("Moving Threshold", 24, 4, 10, 0, 1023),
    _eeprom("Temperature Limit", 31, 1, 70, 0, 100),
    _eeprom("Max Voltage Limit", 32, 2, 70, 31, 70),
    _eeprom("Min Voltage Limit", 34, 2, 35, 31, 70),
    _eeprom("PWM Limit", 36, 2, 885, 0, 885),
    _eeprom("Current Limit", 38, 2, 0, 0, 0),
    _eeprom("Velocity Limit", 44, 4, 350, 0, 2047),
    _eeprom("Max Position Limit", 48, 4, 4095, 0, 4095),
    _eeprom("Min Position Limit", 52, 4, 0, 0, 4095),
    _eeprom("Startup Configuration", 60, 1, 0, 0, 3),
    _eeprom("PWM Slope", 62, 1, 140, 1, 255),
    _eeprom("Shutdown", 63, 1, 52, 0, 255),
    _ram("Torque Enable", 64, 1, 0, 0, 1),
    _ram("LED", 65, 1, 0, 0, 1),
    _ram("Status Return Level", 68, 1, 2, 0, 2),
    _ram("Registered Instruction", 69, 1, 0, 0, 1, _R),
    _ram("Hardware Error Status", 70, 1, 0, 0, 255, _R),
    _ram("Velocity I Gain", 76, 2, 1600, 0, 16383),
    _ram("Velocity P Gain", 78, 2, 100, 0, 16383),
    _ram("Position D Gain", 80, 2, 0, 0, 16383),
    _ram("Position I Gain", 82, 2, 0, 0, 16383),
    _ram("Position P Gain", 84, 2, 800, 0, 16383),
    _ram("Feedforward 2nd Gain", 88, 2, 0, 0, 16383),
    _ram("Feedforward 1st Gain", 90, 2, 0, 0, 16383),
    _ram("Bus Watchdog", 98, 1, 0, -1, 127),
    _ram("Goal PWM", 100, 2, 885, -885, 885),
    _ram("Goal Current", 102, 2, 0, *_S16),
    _ram("Goal Velocity", 104, 4, 0, -2047, 2047),
    _ram("Profile Acceleration", 108, 4, 0, 0, 32767),
    _ram("Profile Velocity", 112, 4, 0, 0, 32767),
    _ram("Goal Position", 116, 4, 0, *_S32),
    _ram("Realtime Tick", 120, 2, 0, 0, 0x7FFF, _R),
    _ram("Moving", 122, 1, 0, 0, 1, _R),
    _ram("Moving Status", 123, 1, 0, 0, 255, _R),
    _ram("Present PWM", 124, 2, 0, *_S16, _R),
    _ram("Present Current", 126, 2, 0, *_S16, _R),
    _ram("Present Velocity", 128, 4, 0, *_S32, _R),
    _ram("Present Position", 132, 4, 0, *_S32, _R),
    _ram("Velocity Trajectory", 136, 4, 0, *_S32, _R),
    _ram("Position Trajectory", 140, 4, 0, *_S32, _R),
    _ram("Present Input Voltage", 144, 2, 0, 0, 0xFFFF, _R),
    _ram("Present Temperature", 146, 1, 0, 0, 255, _R),
    _ram("Backup Ready", 147, 1, 0, 0, 1, _R),
)
"""Items of the X series, as most models and firmwares have them, in order of address."""

EXTERNAL_PORTS: tuple[TableItem, ...] = (
    *(_eeprom(f"External Port Mode {k}", 55 + k, 1, 3, 0, 3) for k in (1, 2, 3)),
    *(_ram(f"External Port Data {k}", 150 + 2 * k, 2, 0, 0, 4095) for k in (1, 2, 3)),
)
"""Items of the X540s' ports for other devices."""


def indirect_items(first: int, count: int, address: int, data: int, highest: int) -> list[TableItem]:
    """Indirect Address and Data `first` … with their addresses; an address may point to 64 … `highest`."""
    items = []
    for k in range(count):
        number = first + k
        items.append(_ram(f"Indirect Address {number}", address + 2 * k, 2, data + k, 64, highest))
        items.append(_ram(f"Indirect Data {number}", data + k, 1, 0, 0, 255))
    return items


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

GAINS = (
    *("Velocity I Gain", "Velocity P Gain", "Position D Gain", "Position I Gain", "Position P Gain"),
    *("Feedforward 2nd Gain", "Feedforward 1st Gain"),
)
"""Gains, which a change of Operating Mode resets."""

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
