"""The backup area of an emulated servo: what Control Table Backup keeps, from page "DYNAMIXEL Protocol 2.0".

It survives power and, though the manual does not say so, Factory Reset.
"""

from palpate.drivers.dynamixel.emanual_tables import Access, Area
from palpate.drivers.emulators.servo_table import ControlTable

__all__ = ["Backup"]

_RAM_ITEMS = (
    "Velocity I Gain",
    "Velocity P Gain",
    "Position D Gain",
    "Position I Gain",
    "Position P Gain",
    "Feedforward 2nd Gain",
    "Feedforward 1st Gain",
    "Profile Acceleration",
    "Profile Velocity",
)


class Backup:
    """Values by item; nothing before the first `store`."""

    def __init__(self) -> None:
        self._eeprom: dict[str, int] = {}
        self._ram: dict[str, int] = {}

    @property
    def ready(self) -> bool:
        """True once something is stored: item Backup Ready."""
        return bool(self._eeprom)

    def store(self, table: ControlTable) -> None:
        """Keep all of EEPROM that can be written, and the RAM items that the manual lists."""
        self._eeprom = {
            item.name: table.get(item.name)
            for item in table
            if item.area is Area.EEPROM and item.access is Access.RW
        }
        self._ram = {
            item.name: table.get(item.name)
            for item in table
            if item.name in _RAM_ITEMS or item.name.startswith("Indirect Address")
        }

    def restore_eeprom(self, table: ControlTable) -> None:
        """Put EEPROM back as it was stored."""
        for name, value in self._eeprom.items():
            table.set(name, value)

    def restore_ram(self, table: ControlTable) -> None:
        """Put the RAM items back as they were stored."""
        for name, value in self._ram.items():
            table.set(name, value)
