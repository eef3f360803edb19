"""The control table of an emulated XM430-W350, as data and as memory.

`XM430_W350` lists address, size, access, default, range and area of every item, from the e-Manual page of the
XM430-W350. `ControlTable` is the servo's memory: it checks what comes in and keeps EEPROM through a reboot.

Left out, and answered like undefined addresses: Indirect Address/Data, Backup Ready. Refused with Data Range
Error because the emulator does not act on them: Drive Mode other than 0 (normal, velocity-based profile),
Baud Rate other than the wire's, Secondary ID, Protocol Version other than 2.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum

from palpate.drivers.dynamixel.packet import StatusErrorCode

__all__ = ["XM430_W350", "Access", "Area", "ControlTable", "Refused", "TableItem"]


class Access(Enum):
    """What a controller may do with an item."""

    R = "read only"
    RW = "read and write"


class Area(Enum):
    """Where an item lives: EEPROM survives a reboot and is locked while torque is on."""

    EEPROM = "EEPROM"
    RAM = "RAM"


class Refused(Exception):
    """An instruction that the servo answers with an error number instead of carrying it out."""

    def __init__(self, code: StatusErrorCode) -> None:
        super().__init__(code.name)
        self.code = code


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

XM430_W350: tuple[TableItem, ...] = (
    _eeprom("Model Number", 0, 2, 1020, 0, 0xFFFF, _R),
    _eeprom("Model Information", 2, 4, 0, 0, 0xFFFF_FFFF, _R),
    _eeprom("Firmware Version", 6, 1, 44, 0, 255, _R),
    _eeprom("ID", 7, 1, 1, 0, 252),
    _eeprom("Baud Rate", 8, 1, 1, 0, 7),
    _eeprom("Return Delay Time", 9, 1, 250, 0, 254),
    _eeprom("Drive Mode", 10, 1, 0, 0, 0),
    _eeprom("Operating Mode", 11, 1, 3, 3, 5),
    _eeprom("Secondary(Shadow) ID", 12, 1, 255, 253, 255),
    _eeprom("Protocol Version", 13, 1, 2, 2, 2),
    _eeprom("Homing Offset", 20, 4, 0, -1_044_479, 1_044_479),
    _eeprom("Moving Threshold", 24, 4, 10, 0, 1023),
    _eeprom("Temperature Limit", 31, 1, 80, 0, 100),
    _eeprom("Max Voltage Limit", 32, 2, 160, 95, 160),
    _eeprom("Min Voltage Limit", 34, 2, 95, 95, 160),
    _eeprom("PWM Limit", 36, 2, 885, 0, 885),
    _eeprom("Current Limit", 38, 2, 1193, 0, 1193),
    _eeprom("Acceleration Limit", 40, 4, 32767, 0, 32767),
    _eeprom("Velocity Limit", 44, 4, 350, 0, 1023),
    _eeprom("Max Position Limit", 48, 4, 4095, 0, 4095),
    _eeprom("Min Position Limit", 52, 4, 0, 0, 4095),
    _eeprom("Shutdown", 63, 1, 52, 0, 255),
    _ram("Torque Enable", 64, 1, 0, 0, 1),
    _ram("LED", 65, 1, 0, 0, 1),
    _ram("Status Return Level", 68, 1, 2, 0, 2),
    _ram("Registered Instruction", 69, 1, 0, 0, 1, _R),
    _ram("Hardware Error Status", 70, 1, 0, 0, 255, _R),
    _ram("Velocity I Gain", 76, 2, 1920, 0, 16383),
    _ram("Velocity P Gain", 78, 2, 100, 0, 16383),
    _ram("Position D Gain", 80, 2, 0, 0, 16383),
    _ram("Position I Gain", 82, 2, 0, 0, 16383),
    _ram("Position P Gain", 84, 2, 800, 0, 16383),
    _ram("Feedforward 2nd Gain", 88, 2, 0, 0, 16383),
    _ram("Feedforward 1st Gain", 90, 2, 0, 0, 16383),
    _ram("Bus Watchdog", 98, 1, 0, -1, 127),
    _ram("Goal PWM", 100, 2, 885, -885, 885),
    _ram("Goal Current", 102, 2, 1193, -1193, 1193),
    _ram("Goal Velocity", 104, 4, 0, -1023, 1023),
    _ram("Profile Acceleration", 108, 4, 0, 0, 32767),
    _ram("Profile Velocity", 112, 4, 0, 0, 32767),
    _ram("Goal Position", 116, 4, 0, *_S32),
    _ram("Realtime Tick", 120, 2, 0, 0, 0xFFFF, _R),
    _ram("Moving", 122, 1, 0, 0, 1, _R),
    _ram("Moving Status", 123, 1, 0, 0, 255, _R),
    _ram("Present PWM", 124, 2, 0, *_S16, _R),
    _ram("Present Current", 126, 2, 0, *_S16, _R),
    _ram("Present Velocity", 128, 4, 0, *_S32, _R),
    _ram("Present Position", 132, 4, 0, *_S32, _R),
    _ram("Velocity Trajectory", 136, 4, 0, *_S32, _R),
    _ram("Position Trajectory", 140, 4, 0, *_S32, _R),
    _ram("Present Input Voltage", 144, 2, 120, 0, 0xFFFF, _R),
    _ram("Present Temperature", 146, 1, 30, 0, 255, _R),
)


class ControlTable:
    """A servo's memory, byte addressed and little endian, with the checks that its firmware makes."""

    def __init__(self, items: Sequence[TableItem]) -> None:
        self._items = {item.name: item for item in items}
        self._at = {item.address: item for item in items}
        self._end = max(item.address + item.size for item in items)
        self._defined = {
            address for item in items for address in range(item.address, item.address + item.size)
        }
        self._memory = bytearray(self._end)
        for item in items:
            self.set(item.name, item.default)

    def get(self, name: str) -> int:
        """Value of an item by its e-Manual name."""
        item = self._items[name]
        raw = self._memory[item.address : item.address + item.size]
        return int.from_bytes(raw, "little", signed=item.signed)

    def set(self, name: str, value: int) -> None:
        """Store a value as the firmware itself does: no access or range check, wrapped to the item's size."""
        item = self._items[name]
        wrapped = value & ((1 << 8 * item.size) - 1)
        self._memory[item.address : item.address + item.size] = wrapped.to_bytes(item.size, "little")

    def reset_ram(self) -> None:
        """Put RAM back to its defaults, as a reboot does."""
        for item in self._items.values():
            if item.area is Area.RAM:
                self.set(item.name, item.default)

    def read(self, address: int, length: int) -> bytes:
        """Bytes of `length` addresses.

        A range that begins or ends outside the table, or begins at an undefined address, is refused with
        Access Error. Undefined addresses within a range read as 0.
        """
        end = address + length
        if length == 0 or end > self._end or address not in self._defined:
            raise Refused(StatusErrorCode.ACCESS_ERROR)
        return bytes(self._memory[address:end])

    def parse_write(self, address: int, data: bytes) -> list[tuple[TableItem, int]]:
        """Split a write into items with their values and check access and range; changes nothing.

        Refused with Access Error at a read-only or undefined address, Data Length Error if the data end
        within an item, Data Range Error if a value is outside the item's own range.
        """
        writes: list[tuple[TableItem, int]] = []
        position = 0
        while position < len(data):
            item = self._at.get(address + position)
            if item is None or item.access is not Access.RW:
                raise Refused(StatusErrorCode.ACCESS_ERROR)
            raw = data[position : position + item.size]
            if len(raw) < item.size:
                raise Refused(StatusErrorCode.DATA_LENGTH_ERROR)
            value = int.from_bytes(raw, "little", signed=item.signed)
            if not item.low <= value <= item.high:
                raise Refused(StatusErrorCode.DATA_RANGE_ERROR)
            writes.append((item, value))
            position += item.size
        if not writes:
            raise Refused(StatusErrorCode.DATA_LENGTH_ERROR)
        return writes
