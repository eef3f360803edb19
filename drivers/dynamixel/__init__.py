"""Dynamixel servos over Protocol 2.0: the host side, and the packet codec that the emulators share."""

from palpate.drivers.dynamixel.bus import Bus, GroupRead, Ping
from palpate.drivers.dynamixel.control_table import HardwareError, OperatingMode
from palpate.drivers.dynamixel.counts import BusCounts
from palpate.drivers.dynamixel.errors import (
    DamagedAnswer,
    HardwareAlert,
    NotAnswering,
    NotConfirmed,
    PortFailed,
    Restarted,
    StatusError,
)
from palpate.drivers.dynamixel.models import Model, model_named, model_numbered, models_known
from palpate.drivers.dynamixel.servo import Servo, stop_at, write_goals
from palpate.drivers.dynamixel.state import ServoState, StateReader
from palpate.drivers.dynamixel.torque import disable_torque

__all__ = [
    "Bus",
    "BusCounts",
    "DamagedAnswer",
    "GroupRead",
    "HardwareAlert",
    "HardwareError",
    "Model",
    "NotAnswering",
    "NotConfirmed",
    "OperatingMode",
    "Ping",
    "PortFailed",
    "Restarted",
    "Servo",
    "ServoState",
    "StateReader",
    "StatusError",
    "disable_torque",
    "model_named",
    "model_numbered",
    "models_known",
    "stop_at",
    "write_goals",
]
