"""Dynamixel servos over Protocol 2.0: the host side, and the packet codec that the emulators share."""

from palpate.drivers.dynamixel.bus import Bus, GroupRead, Ping
from palpate.drivers.dynamixel.bus_scan import FoundServo, Scan, scan
from palpate.drivers.dynamixel.control_table import ITEMS, HardwareError, Item, OperatingMode
from palpate.drivers.dynamixel.counts import BusCounts
from palpate.drivers.dynamixel.errors import (
    AnsweringLate,
    DamagedAnswer,
    HardwareAlert,
    NotAnswering,
    NotConfirmed,
    PortFailed,
    Restarted,
    ServoError,
    StatusError,
    WrongLength,
)
from palpate.drivers.dynamixel.guarded import End, Guard, guarded_move
from palpate.drivers.dynamixel.models import Model, model_named, model_numbered, models_known
from palpate.drivers.dynamixel.servo import Servo, stop_at, write_goals
from palpate.drivers.dynamixel.state import ServoState, StateReader
from palpate.drivers.dynamixel.torque import disable_torque

__all__ = [
    "ITEMS",
    "AnsweringLate",
    "Bus",
    "BusCounts",
    "DamagedAnswer",
    "End",
    "FoundServo",
    "GroupRead",
    "Guard",
    "HardwareAlert",
    "HardwareError",
    "Item",
    "Model",
    "NotAnswering",
    "NotConfirmed",
    "OperatingMode",
    "Ping",
    "PortFailed",
    "Restarted",
    "Scan",
    "Servo",
    "ServoError",
    "ServoState",
    "StateReader",
    "StatusError",
    "WrongLength",
    "disable_torque",
    "guarded_move",
    "model_named",
    "model_numbered",
    "models_known",
    "scan",
    "stop_at",
    "write_goals",
]
