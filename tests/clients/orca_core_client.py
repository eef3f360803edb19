"""A program that knows orca_core's client of Dynamixel servos only. Run with a port: says what it did (JSON).

What its hands do: connect, switch modes and torque, read positions and currents together, write goals, set
gains and profiles, read errors and temperatures, reboot, disconnect.
"""

import importlib.metadata
import json
import math
import sys
import time
from typing import Any

import numpy as np
from orca_core.hardware.dynamixel_client import DynamixelClient

IDS = [5, 6, 7]
GOALS = [2600, 1500, 2300]
CURRENT_POSITION = 5
TICK_RAD = 2 * math.pi / 4096


def basics(path: str) -> dict[str, Any]:
    told: dict[str, Any] = {}
    client = DynamixelClient(IDS, port=path, baudrate=1_000_000)
    client.connect()
    told["responding"] = client.responding_motor_ids()
    client.set_operating_mode(IDS, CURRENT_POSITION)
    told["mode"] = [client.read_config_register(dxl_id, "operating_mode") for dxl_id in IDS]
    client.set_torque_enabled(IDS, True)
    client.write_desired_current(IDS, np.full(3, 300.0))
    client.write_desired_pos(IDS, np.array(GOALS) * TICK_RAD)
    told["moved"] = watched(client)
    told["ok"] = client.last_read_ok
    told["temperature"] = client.read_temperature().tolist()
    told["errors"] = list(client.read_hardware_errors(IDS).values())
    client.set_torque_enabled(IDS, False)
    client.reboot_motor(5)
    told["after reboot"] = client.responding_motor_ids()
    client.disconnect()
    return told


def watched(client: DynamixelClient) -> list[list[int]]:
    """Positions seen until the goals are reached."""
    seen: list[list[int]] = []
    end = time.monotonic() + 600
    while time.monotonic() < end:
        state = client.read_position_velocity_current()
        seen.append([round(value / TICK_RAD) for value in np.asarray(state[0]).tolist()])
        if all(abs(position - goal) <= 3 for position, goal in zip(seen[-1], GOALS, strict=True)):
            break
    return seen


if __name__ == "__main__":
    told = {"basics": basics}[sys.argv[2]](sys.argv[1])
    json.dump(told | {"version": importlib.metadata.version("orca-core")}, sys.stdout)
