"""Drives one servo without a rig: finds the servos on a port, prints their states, moves one, torque off.

    python examples/drive_servos.py /dev/ttyUSB0 --id 1 --by 0.2

`palpate emulate` prints ports of emulated servos, such as /dev/pts/3, for a try without hardware.
"""

import argparse
import signal
import sys

from palpate.base.errors import InputError, PalpateError
from palpate.drivers import (
    Bus,
    MonotonicClock,
    OperatingMode,
    Servo,
    StateReader,
    disable_torque,
    guarded_move,
    model_by_number,
    open_port,
)

LATENCY_S = 0.034  # an adapter whose latency timer is 16 ms, as it comes
WIDEST_RAD = 0.5  # to either side of where the servo stands: further goals are refused


def find_servos(bus: Bus) -> list[Servo]:
    """The servos that answer a broadcast ping, each of the model that it says it is."""
    pings = bus.broadcast_ping()
    return [Servo(bus, dxl_id, model_by_number(ping.model_number).name) for dxl_id, ping in pings.items()]


def move(servo: Servo, reader: StateReader, clock: MonotonicClock, by_rad: float) -> None:
    """Move one servo by an angle from where it stands, slowly, at a tenth of its current."""
    here = reader.read([servo]).all()[servo.dxl_id].position_rad
    servo = servo.with_range((here - WIDEST_RAD, here + WIDEST_RAD))
    servo.prepare(OperatingMode.EXTENDED_POSITION, current_limit_a=0.1 * servo.model.largest_current_a)
    servo.set_profile(velocity_rad_s=0.5, acceleration_rad_s2=5.0)
    servo.enable_torque()
    servo.disarm_watchdog()  # one that tripped in an earlier run refuses goals
    servo.arm_watchdog(0.5)  # the servo stops by itself if this program dies
    ends = guarded_move(reader, clock, {servo: here + by_rad})
    there = reader.read([servo]).all()[servo.dxl_id].position_rad
    print(f"servo {servo.dxl_id}: {ends[servo].value} at {there:.2f} rad, from {here:.2f} rad")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("port", help="such as /dev/ttyUSB0")
    parser.add_argument("--baud", type=int, default=1_000_000)
    parser.add_argument("--id", type=int, help="which servo moves; none without it")
    parser.add_argument("--by", type=float, default=0.2, help="by how many rad")
    options = parser.parse_args()
    for number in (signal.SIGTERM, signal.SIGHUP):  # end as Ctrl-C does, through every `finally`
        signal.signal(number, lambda number, _frame: sys.exit(128 + number))
    clock = MonotonicClock()
    problems: list[PalpateError] = []
    try:
        with open_port(options.port, options.baud) as port:
            bus = Bus(port, clock, options.baud, latency_s=LATENCY_S)
            servos = {servo.dxl_id: servo for servo in find_servos(bus)}
            try:
                reader = StateReader(bus, servos.values())
                reader.arrange()
                for dxl_id, state in reader.read(list(servos.values())).all().items():
                    print(f"servo {dxl_id}, {servos[dxl_id].model.name}: {state.position_rad:.2f} rad")
                if options.id is not None:
                    if options.id not in servos:
                        raise InputError(f"no servo {options.id} answers; check --id and --baud")
                    move(servos[options.id], reader, clock, options.by)
            finally:
                problems += disable_torque(bus, servos.values())
    except PalpateError as error:
        problems.append(error)
    for problem in problems:
        print(problem, file=sys.stderr)
    return int(bool(problems))


if __name__ == "__main__":
    sys.exit(main())
