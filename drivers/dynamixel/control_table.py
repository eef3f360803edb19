"""The control table as the host uses it: items, units, modes and error bits that the whole X series shares.

Names are the e-Manual's. Only items that the stack uses are here; `models` knows where other series have
them. Source: ROBOTIS e-Manual, control tables of XM430-W350, XL330-M288 and XC330-M288 (these addresses
agree).
"""

import math
from dataclasses import dataclass
from enum import IntEnum, IntFlag

__all__ = [
    "ACCELERATION_UNIT_RAD_S2",
    "ANSWERS_ALL",
    "FULL_PWM",
    "ITEMS",
    "RAD_PER_TICK",
    "RETURN_DELAY_UNIT_S",
    "VELOCITY_UNIT_RAD_S",
    "WATCHDOG_UNIT_S",
    "ZERO_TICK",
    "HardwareError",
    "Item",
    "OperatingMode",
]

RAD_PER_TICK = 2 * math.pi / 4096
ZERO_TICK = 2048
FULL_PWM = 885
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


MODEL_NUMBER = Item("Model Number", 0, 2, eeprom=True)
FIRMWARE_VERSION = Item("Firmware Version", 6, 1, eeprom=True)
ID = Item("ID", 7, 1, eeprom=True)
BAUD_RATE = Item("Baud Rate", 8, 1, eeprom=True)
RETURN_DELAY_TIME = Item("Return Delay Time", 9, 1, eeprom=True)
DRIVE_MODE = Item("Drive Mode", 10, 1, eeprom=True)
OPERATING_MODE = Item("Operating Mode", 11, 1, eeprom=True)
HOMING_OFFSET = Item("Homing Offset", 20, 4, signed=True, eeprom=True)
MOVING_THRESHOLD = Item("Moving Threshold", 24, 4, eeprom=True)
TEMPERATURE_LIMIT = Item("Temperature Limit", 31, 1, eeprom=True)
MAX_VOLTAGE_LIMIT = Item("Max Voltage Limit", 32, 2, eeprom=True)
MIN_VOLTAGE_LIMIT = Item("Min Voltage Limit", 34, 2, eeprom=True)
PWM_LIMIT = Item("PWM Limit", 36, 2, eeprom=True)
CURRENT_LIMIT = Item("Current Limit", 38, 2, eeprom=True)
VELOCITY_LIMIT = Item("Velocity Limit", 44, 4, eeprom=True)
MAX_POSITION_LIMIT = Item("Max Position Limit", 48, 4, eeprom=True)
MIN_POSITION_LIMIT = Item("Min Position Limit", 52, 4, eeprom=True)
SHUTDOWN = Item("Shutdown", 63, 1, eeprom=True)
TORQUE_ENABLE = Item("Torque Enable", 64, 1)
LED = Item("LED", 65, 1)
STATUS_RETURN_LEVEL = Item("Status Return Level", 68, 1)
HARDWARE_ERROR_STATUS = Item("Hardware Error Status", 70, 1)
POSITION_D_GAIN = Item("Position D Gain", 80, 2)
POSITION_I_GAIN = Item("Position I Gain", 82, 2)
POSITION_P_GAIN = Item("Position P Gain", 84, 2)
BUS_WATCHDOG = Item("Bus Watchdog", 98, 1, signed=True)
GOAL_PWM = Item("Goal PWM", 100, 2, signed=True)
GOAL_CURRENT = Item("Goal Current", 102, 2, signed=True)
GOAL_VELOCITY = Item("Goal Velocity", 104, 4, signed=True)
PROFILE_ACCELERATION = Item("Profile Acceleration", 108, 4)
PROFILE_VELOCITY = Item("Profile Velocity", 112, 4)
GOAL_POSITION = Item("Goal Position", 116, 4, signed=True)
REALTIME_TICK = Item("Realtime Tick", 120, 2)
MOVING = Item("Moving", 122, 1)
MOVING_STATUS = Item("Moving Status", 123, 1)
PRESENT_PWM = Item("Present PWM", 124, 2, signed=True)
PRESENT_CURRENT = Item("Present Current", 126, 2, signed=True)
PRESENT_VELOCITY = Item("Present Velocity", 128, 4, signed=True)
PRESENT_POSITION = Item("Present Position", 132, 4, signed=True)
VELOCITY_TRAJECTORY = Item("Velocity Trajectory", 136, 4, signed=True)
POSITION_TRAJECTORY = Item("Position Trajectory", 140, 4, signed=True)
PRESENT_INPUT_VOLTAGE = Item("Present Input Voltage", 144, 2)
PRESENT_TEMPERATURE = Item("Present Temperature", 146, 1)

ITEMS: tuple[Item, ...] = tuple(value for value in list(globals().values()) if isinstance(value, Item))
"""Every item above, in order of address."""


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
