"""Dynamixel servos over Protocol 2.0: the host side, and the packet codec that the emulators share."""

from palpate.drivers.dynamixel.bus import Bus, Ping
from palpate.drivers.dynamixel.control_table import HardwareError, OperatingMode
from palpate.drivers.dynamixel.failures import (
    DamagedAnswer,
    HardwareAlert,
    NotAnswering,
    PortFailed,
    StatusError,
)
from palpate.drivers.dynamixel.servo import Servo, ServoState, read_states, torque_off_all, write_goals

__all__ = [
    "Bus",
    "DamagedAnswer",
    "HardwareAlert",
    "HardwareError",
    "NotAnswering",
    "OperatingMode",
    "Ping",
    "PortFailed",
    "Servo",
    "ServoState",
    "StatusError",
    "read_states",
    "torque_off_all",
    "write_goals",
]
