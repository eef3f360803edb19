"""A program that knows lerobot's bus of Dynamixel servos only. Run with a port: says what it did (JSON).

lerobot imports learning libraries beside its motors, 7 GB that no servo needs: empty modules stand in their
places. Its motors are as they were published.
"""

import importlib.metadata
import json
import sys
import time
from types import ModuleType
from typing import Any

NOT_NEEDED = {
    "torch": ("device", "dtype", "Tensor"),
    "accelerate": ("Accelerator",),
    "datasets": (),
    "datasets.utils": (),
    "datasets.utils.logging": ("disable_progress_bar", "enable_progress_bar"),
}
for module_name, names in NOT_NEEDED.items():
    module = ModuleType(module_name)
    for attribute in names:
        setattr(module, attribute, object)
    sys.modules[module_name] = module

from lerobot.motors import Motor, MotorNormMode  # noqa: E402  # after what it does not need
from lerobot.motors.dynamixel import DynamixelMotorsBus, OperatingMode  # noqa: E402

NAMES = {"pan": 5, "lift": 6, "grip": 7}
GOALS = {"pan": 2600, "lift": 1500, "grip": 2300}


def opened(path: str) -> DynamixelMotorsBus:
    motors = {
        name: Motor(dxl_id, "xm430-w350", MotorNormMode.RANGE_M100_100) for name, dxl_id in NAMES.items()
    }
    bus = DynamixelMotorsBus(path, motors)
    bus.connect()  # pings all, and compares their models
    return bus


def basics(path: str) -> dict[str, Any]:
    bus = opened(path)
    told: dict[str, Any] = {"everybody": bus.broadcast_ping(num_retry=5)}
    bus.disable_torque(num_retry=5)
    bus.configure_motors()
    for name in NAMES:
        bus.write("Operating_Mode", name, OperatingMode.EXTENDED_POSITION.value, num_retry=5)
    told["mode"] = [bus.read("Operating_Mode", name, num_retry=5) for name in NAMES]
    told["return delay"] = [bus.read("Return_Delay_Time", name, num_retry=5) for name in NAMES]
    told["calibration"] = {name: found.id for name, found in bus.read_calibration().items()}
    bus.enable_torque(num_retry=5)
    told["before"] = positions(bus)
    bus.sync_write("Goal_Position", GOALS, normalize=False, num_retry=5)
    told["moved"] = watched(bus)
    told["current"] = bus.sync_read("Present_Current", normalize=False, num_retry=5)
    bus.disconnect()
    return told


def positions(bus: DynamixelMotorsBus) -> dict[str, int]:
    found: dict[str, int] = bus.sync_read("Present_Position", normalize=False, num_retry=5)
    return found


def watched(bus: DynamixelMotorsBus) -> list[dict[str, int]]:
    """Positions seen until the goals are reached."""
    seen = []
    end = time.monotonic() + 600
    while time.monotonic() < end:
        seen.append(positions(bus))
        if all(abs(seen[-1][name] - goal) <= 3 for name, goal in GOALS.items()):
            break
    return seen


if __name__ == "__main__":
    told = {"basics": basics}[sys.argv[2]](sys.argv[1])
    json.dump(told | {"version": importlib.metadata.version("lerobot")}, sys.stdout)
