"""A control loop by another library: `python servo_loop.py LIBRARY PORT SERVOS SECONDS`, prints JSON.

Each cycle reads the state of all servos (seven items, a group read each: neither library reads several items
at once) or their positions alone, then writes all goals. The servos have ids from 1 on.
"""

import importlib
import importlib.metadata
import json
import sys
import time
from collections.abc import Callable
from typing import Any

GOALS = (1850, 2113, 2178, 1983)
STATE = (
    "Present_Position", "Present_Velocity", "Present_Current", "Present_Input_Voltage",
    "Present_Temperature", "Hardware_Error_Status", "Moving",
)  # fmt: skip

Read, Write = Callable[[str], Any], Callable[[int], Any]


def with_lerobot(port: str, ids: list[int]) -> tuple[Read, Write]:
    motors = importlib.import_module("lerobot.motors")
    names = [str(dxl_id) for dxl_id in ids]
    raw = motors.MotorNormMode.DEGREES
    bus = importlib.import_module("lerobot.motors.dynamixel").DynamixelMotorsBus(
        port, {name: motors.Motor(int(name), "xm430-w350", raw) for name in names}
    )
    bus.connect(handshake=False)
    return (
        lambda item: bus.sync_read(item, normalize=False),
        lambda goal: bus.sync_write("Goal_Position", dict.fromkeys(names, goal), normalize=False),
    )


def with_rustypot(port: str, ids: list[int]) -> tuple[Read, Write]:
    servos = importlib.import_module("rustypot").Xl430PyController(port, 1_000_000, 0.1)
    return (
        lambda item: servos.sync_read_register(ids, item.lower()),
        lambda goal: servos.sync_write_goal_position(ids, [goal] * len(ids)),
    )


def timed(cycle: Callable[[int], None], seconds: float) -> dict[str, float]:
    """Cycles per second, and processor time of one (µs)."""
    begin, busy, cycles = time.monotonic(), time.process_time(), 0
    while time.monotonic() - begin < seconds:
        cycle(cycles)
        cycles += 1
    elapsed, spent = time.monotonic() - begin, time.process_time() - busy
    return {"hz": cycles / elapsed, "cpu_us": spent / cycles * 1e6}


def main() -> None:
    """Run both loops."""
    library, port, servos, seconds = sys.argv[1:]
    ids = list(range(1, int(servos) + 1))
    try:
        read, write = {"lerobot": with_lerobot, "rustypot": with_rustypot}[library](port, ids)
    except ModuleNotFoundError as error:
        json.dump({"missing": error.name}, sys.stdout)
        return

    def positions(number: int) -> None:
        read("Present_Position")
        write(GOALS[number % len(GOALS)])

    def state(number: int) -> None:
        for item in STATE:
            read(item)
        write(GOALS[number % len(GOALS)])

    told = {
        name: timed(cycle, float(seconds)) for name, cycle in (("positions", positions), ("state", state))
    }
    json.dump(told | {"version": importlib.metadata.version(library)}, sys.stdout)


if __name__ == "__main__":
    main()
