"""The e-Manual's control tables as data: name, address, size, access, area, default and range of every item.

Read by the emulated servos, which live by it, and by the host. Sources: ROBOTIS e-Manual, pages XM430-W350,
XL330-M288-T and XC330-M288-T with the pages of single items; where Indirect Data lies before firmware 52 is
from the tables that the vendor ships with its easy SDK. Values and ranges are in the items' own units.

Where the manual gives no default ("-"), `default` is 0 for what is measured, and a value that a servo cannot
be hurt by for what may be written. Where it gives no range, the range is that of the item's size.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from enum import Enum
from types import MappingProxyType

__all__ = [
    "BAUD_RATES",
    "BROADCAST_RESET_FIRMWARE",
    "COMMON_ITEMS",
    "EXTENDED_FIRMWARE",
    "MODEL_NAMES",
    "Access",
    "Area",
    "TableItem",
    "table_of",
]


class Access(Enum):
    """What a controller may do with an item."""

    R = "read only"
    RW = "read and write"


class Area(Enum):
    """Where an item lives: EEPROM survives a reboot and is locked while torque is on."""

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


_XM430, _XL330, _XC330 = 1020, 1200, 1240

MODEL_NAMES: Mapping[int, str] = MappingProxyType(
    {_XM430: "XM430-W350", _XL330: "XL330-M288", _XC330: "XC330-M288"}
)
"""Names of the models by Model Number (0)."""

BAUD_RATES: tuple[int, ...] = (9600, 57_600, 115_200, 1_000_000, 2_000_000, 3_000_000, 4_000_000, 4_500_000)
"""Bits per second by value of Baud Rate (8)."""

EXTENDED_FIRMWARE: Mapping[int, int] = MappingProxyType({_XM430: 45, _XL330: 46, _XC330: 46})
"""By model, the first firmware with the fast reads, Control Table Backup, Startup Configuration and Torque On
by Goal Update (pages Protocol 2.0, Startup Configuration, Drive Mode)."""

BROADCAST_RESET_FIRMWARE = 42
"""First firmware that ignores a Factory Reset of everything sent to all (page Protocol 2.0)."""

_LATE_LAYOUT = 52  # first firmware of the X330s with Indirect Data right behind Indirect Address


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
"""Items of every model, as most models and firmwares have them, in order of address."""

_Change = tuple[int, int, int]  # default, low, high

# What each model has differently from COMMON_ITEMS.
_OF_XL330: dict[str, _Change] = {
    "Model Number": (_XL330, 0, 0xFFFF),
    "Current Limit": (1750, 0, 1750),
    "Velocity Limit": (445, 0, 2047),
    "Shutdown": (53, 0, 255),
    "Velocity P Gain": (180, 0, 16383),
    "Position P Gain": (400, 0, 16383),
    "Goal Current": (1750, -1750, 1750),
}
_OF_XC330: dict[str, _Change] = {
    "Model Number": (_XC330, 0, 0xFFFF),
    "Current Limit": (2352, 0, 2352),
    "Velocity P Gain": (50, 0, 16383),
    "Position D Gain": (500, 0, 16383),
    "Position P Gain": (1100, 0, 16383),
    "Goal Current": (2352, -2352, 2352),
}
_OF_XM430: dict[str, _Change] = {
    "Model Number": (_XM430, 0, 0xFFFF),
    "Baud Rate": (1, 0, 7),
    "Protocol Type": (2, 1, 2),
    "Temperature Limit": (80, 0, 100),
    "Max Voltage Limit": (160, 95, 160),
    "Min Voltage Limit": (95, 95, 160),
    "Current Limit": (1193, 0, 1193),
    "Velocity Limit": (200, 0, 1023),
    "Velocity I Gain": (1920, 0, 16383),
    "Goal Current": (1193, -1193, 1193),
    "Goal Velocity": (0, -1023, 1023),
}
_CHANGES = {_XM430: _OF_XM430, _XL330: _OF_XL330, _XC330: _OF_XC330}

_OLDER_XM430 = 42  # Velocity Limit defaults to 350 before it; the time-based profile came with it
_DRIVE_MODE_XM430 = 38  # Drive Mode and Bus Watchdog came with it

_TORQUE_ON_BY_GOAL = 0x08
_TIME_BASED = 0x04


def table_of(model_number: int, firmware: int) -> tuple[TableItem, ...]:
    """Every item of a built-in model with that firmware, in order of address."""
    changes = dict(_CHANGES[model_number])
    absent: set[str] = set()
    extended = firmware >= EXTENDED_FIRMWARE[model_number]
    drive_mode = _TIME_BASED | 1 | (_TORQUE_ON_BY_GOAL if extended else 0)
    if not extended:
        absent |= {"Startup Configuration", "Backup Ready"}
    if model_number == _XM430:
        absent.add("PWM Slope")
        if firmware < _OLDER_XM430:
            changes["Velocity Limit"] = (350, 0, 1023)
            drive_mode &= ~_TIME_BASED
        if firmware < _DRIVE_MODE_XM430:
            absent |= {"Drive Mode", "Bus Watchdog"}
    changes["Drive Mode"] = (0, 0, drive_mode)
    changes["Firmware Version"] = (firmware, 0, 255)
    items = [_changed(item, changes.get(item.name)) for item in COMMON_ITEMS if item.name not in absent]
    items += _indirect_items(model_number, firmware)
    return tuple(sorted(items, key=lambda item: item.address))


def _changed(item: TableItem, change: _Change | None) -> TableItem:
    if change is None:
        return item
    default, low, high = change
    return replace(item, default=default, low=low, high=high)


def _indirect_items(model_number: int, firmware: int) -> list[TableItem]:
    if model_number == _XM430:
        return _indirect(1, 28, 168, 224, 661) + _indirect(29, 28, 578, 634, 661)
    data = 208 if firmware >= _LATE_LAYOUT else 224
    return _indirect(1, 20, 168, data, data + 19)


def _indirect(first: int, count: int, address: int, data: int, highest: int) -> list[TableItem]:
    """Indirect Address and Data `first` … with their addresses; an address may point to 64 … `highest`."""
    items = []
    for k in range(count):
        number = first + k
        items.append(_ram(f"Indirect Address {number}", address + 2 * k, 2, data + k, 64, highest))
        items.append(_ram(f"Indirect Data {number}", data + k, 1, 0, 0, 255))
    return items
