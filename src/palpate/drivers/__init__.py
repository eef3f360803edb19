"""Drivers: servo bus, tactile arrays, ports and clocks, and kinematics of the fingers that carry them.

Usable without a rig: `examples/drive_servos.py` drives servos with what is exported here; more is in the
packages `dynamixel`, `tactile` and `transport`. `emulators` stands in for the devices. Nothing here knows
objects, recognition or configuration files.
"""

from palpate.drivers.dynamixel import (
    Bus,
    OperatingMode,
    Servo,
    ServoState,
    StateReader,
    disable_torque,
    guarded_move,
    model_by_number,
    scan,
)
from palpate.drivers.transport import Clock, MonotonicClock, VirtualClock, open_port

__all__ = [
    "Bus",
    "Clock",
    "MonotonicClock",
    "OperatingMode",
    "Servo",
    "ServoState",
    "StateReader",
    "VirtualClock",
    "disable_torque",
    "guarded_move",
    "model_by_number",
    "open_port",
    "scan",
]
