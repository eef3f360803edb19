"""A program that knows rustypot only. Run with a port: tells what it did as JSON."""

import importlib.metadata
import json
import sys
import time
from typing import Any

import rustypot

PATIENCE_S = 1.0  # for any answer: the computer may be busy
IDS = [5, 6, 7]
NOBODY = 9
GOALS = [2600, 1500, 2300]


def opened(path: str) -> rustypot.Xl430PyController:
    """The controller whose definition covers the XM430-W350, model number 1020."""
    assert rustypot.find_model("XM430-W350") == (1020, rustypot.Xl430PyController.definition())
    return rustypot.Xl430PyController(path, 1_000_000, PATIENCE_S)


def basics(path: str) -> dict[str, Any]:
    servos = opened(path)
    told: dict[str, Any] = {}
    told["ping"] = [servos.ping(dxl_id) for dxl_id in IDS]
    servos.set_timeout(0.1)
    told["nobody"] = not servos.ping(NOBODY)
    servos.set_timeout(PATIENCE_S)
    told["everybody"] = servos.broadcast_scan([*IDS, NOBODY])
    told["read"] = servos.read_register_with_error(6, "present_position")
    told["write"] = servos.write_register_with_error(6, "profile_velocity", 150)
    told["read back"] = servos.read_register_with_error(6, "profile_velocity")
    told["read only"] = servos.write_register_with_error(6, "model_number", 7)
    servos.sync_write_profile_velocity(IDS, [200] * 3)
    told["sync write"] = servos.sync_read_profile_velocity(IDS)
    servos.sync_write_torque_enable(IDS, [1] * 3)
    told["torque"] = servos.sync_read_register_with_error(IDS, "torque_enable")
    servos.sync_write_goal_position(IDS, GOALS)
    told["moved"] = watched(servos, GOALS)
    servos.sync_write_register(IDS, "torque_enable", [0] * 3)
    told["torque after"] = [servos.read_torque_enable(dxl_id) for dxl_id in IDS]
    told["reboot"] = servos.reboot(5)
    servos.close()
    return told


def watched(servos: rustypot.Xl430PyController, goals: list[int]) -> list[list[int]]:
    """Positions seen until the goals are reached."""
    seen = []
    end = time.monotonic() + 600
    while time.monotonic() < end:
        seen.append(servos.sync_read_present_position(IDS))
        if all(abs(position - goal) <= 3 for position, goal in zip(seen[-1], goals, strict=True)):
            break
    return seen


def fast(path: str) -> dict[str, Any]:
    servos = opened(path)
    servos.set_fast_sync_read(True)
    told = {"sync": dict(zip(IDS, servos.sync_read_present_position(IDS), strict=True))}
    servos.close()
    return told


def model(path: str) -> dict[str, Any]:
    servos = opened(path)
    found = servos.read_register(IDS[0], "model_number")
    servos.close()
    return {"model": found}


if __name__ == "__main__":
    told = {"basics": basics, "fast": fast, "model": model}[sys.argv[2]](sys.argv[1])
    json.dump(told | {"version": importlib.metadata.version("rustypot")}, sys.stdout)
