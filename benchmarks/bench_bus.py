"""What one cycle of a control loop costs, read all and write all: run with `python benchmarks/bench_bus.py`.

One row for each number of servos, model and firmware, and baud rate. In virtual time, on a mock port: time on
the bus beside the formula for the wire, and the host's processor time. The latter is taken with the port's
and the clock's answers from a list, so that neither wire nor servos are emulated meanwhile; pyserial and the
kernel are not in it. Then in real time, over a pseudo-terminal whose servos live in another process: cycles
per second, and processor time with pyserial and kernel. Beside each the vendor's plain SDK, with
GroupSyncRead or its fast one, and GroupSyncWrite.

A pseudo-terminal charges no wire time for what the host sends, so cycles there may be quicker than the wire.
The SDK waits for answers without sleeping: its processor time is that of a core that is never idle.
"""

import argparse
import json
import multiprocessing
import statistics
import sys
import threading
import time
from collections.abc import Callable
from multiprocessing.connection import Connection
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from bus_tape import PlayingClock, PlayingPort, SdkLoop, TapingClock, TapingPort

from palpate.drivers.emulators.device_server import serve_pty
from palpate.drivers.transport.clock import Clock, MonotonicClock, VirtualClock
from palpate.drivers.transport.mock import MockHub
from palpate.drivers.transport.ports import open_port
from support.oracles.bus_loop import CASES, BusLoop, LoopCase

MAX_RATIO = 1.3
MAX_HOST_US = 1000.0
PTY_LATENCY_S = 0.1
BATCHES = 7

Make = Callable[[object, Clock], BusLoop | SdkLoop]
Row = dict[str, object]


def loops(case: LoopCase, setup: BusLoop) -> dict[str, Make]:
    """How to make both loops on a port and a clock."""
    place = setup.servos[0].model.indirect
    assert place is not None
    fast = setup.reader.is_fast
    return {
        "palpate": lambda port, clock: BusLoop(case, port, clock),
        "sdk": lambda port, clock: SdkLoop(case, place.data, fast, port, clock),
    }


def host_us(make: Make, port: str, tape: list[object], cycles: int) -> list[float]:
    """Processor time of a cycle (µs) with all answers from a tape, in batches."""
    answers = iter(tape)
    loop = make(PlayingPort(port, answers), PlayingClock(answers))
    size = cycles // BATCHES
    found = []
    for batch in range(BATCHES):
        begin = time.process_time()
        for number in range(batch * size, (batch + 1) * size):
            loop.cycle(number)
        found.append((time.process_time() - begin) / size * 1e6)
    if cycles % BATCHES == 0:
        assert next(answers, None) is None, "every answer is used, so this is all of the host's time"
    return found


def virtual(case: LoopCase, cycles: int) -> Row:
    """Time on the bus and host's time of both loops, on a mock port."""
    clock = VirtualClock()
    hub = MockHub(clock, "bench")
    url = hub.attach("bus", case.chain(), case.baudrate)
    setup = BusLoop(case, open_port(url, case.baudrate), clock)
    row: Row = {"formula_us": setup.wire_s * 1e6, "fast": setup.reader.is_fast}
    for name, make in loops(case, setup).items():
        tape: list[object] = []
        loop = make(TapingPort(open_port(url, case.baudrate), tape), TapingClock(clock, tape))
        begin = clock.now()
        for number in range(cycles):
            loop.cycle(number)
        row[f"{name}_bus_us"] = (clock.now() - begin) / cycles * 1e6
        times = host_us(make, url, tape, cycles)
        row[f"{name}_host_us"] = statistics.median(times)
        row[f"{name}_host_us_range"] = (min(times), max(times))
    return row


def serve(case: LoopCase, told: Connection) -> None:
    """Serve the servos in this process until told to end."""
    with serve_pty({"bus": (case.chain(), case.baudrate)}, MonotonicClock(), threading.Event()) as service:
        told.send(service.paths["bus"])
        told.recv()


def real(case: LoopCase, seconds: float) -> Row:
    """Cycles per second of both loops over a pseudo-terminal, and their processor time."""
    context = multiprocessing.get_context("spawn")
    here, there = context.Pipe()
    process = context.Process(target=serve, args=(case, there), daemon=True)
    process.start()
    try:
        path = here.recv()
        clock = MonotonicClock()
        with open_port(path, case.baudrate) as port:
            ours = BusLoop(case, port, clock, PTY_LATENCY_S)
            row = timed("palpate", ours, seconds)
            counts = ours.bus.counts
            row["palpate_pty_lost"] = counts.silent + counts.damaged
        place = ours.servos[0].model.indirect
        assert place is not None
        with open_port(path, case.baudrate) as port:
            plain = SdkLoop(case, place.data, ours.reader.is_fast, port)
            row |= timed("sdk", plain, seconds)
            row["sdk_pty_lost"] = plain.lost
        here.send(None)
        process.join(5)
    finally:
        process.kill()
    return row


def timed(name: str, loop: BusLoop | SdkLoop, seconds: float) -> Row:
    """Run a loop for a while on the wall clock."""
    begin, busy, cycles = time.monotonic(), time.process_time(), 0
    while time.monotonic() - begin < seconds:
        loop.cycle(cycles)
        cycles += 1
    elapsed, spent = time.monotonic() - begin, time.process_time() - busy
    return {f"{name}_pty_hz": cycles / elapsed, f"{name}_pty_cpu_us": spent / cycles * 1e6}


COLUMNS = {
    "servos": "n",
    "model": "model",
    "firmware": "fw",
    "mbps": "Mbps",
    "formula_us": "wire µs",
    "palpate_bus_us": "bus µs",
    "bus_ratio": "ratio",
    "sdk_bus_us": "SDK's",
    "palpate_host_us": "host µs",
    "sdk_host_us": "SDK's",
    "host_ratio": "ratio",
    "palpate_pty_hz": "pty Hz",
    "sdk_pty_hz": "SDK's",
    "palpate_pty_cpu_us": "CPU µs",
    "sdk_pty_cpu_us": "SDK's",
}


def line(row: Row) -> str:
    """A row of the table."""
    cells = []
    for key, title in COLUMNS.items():
        value = row.get(key, title if row is COLUMNS else "–")
        if isinstance(value, float):
            value = f"{value:.2f}" if key.endswith("ratio") else f"{value:.0f}"
        cells.append(f"{value!s:>{max(6, len(title)) if key != 'model' else 10}}")
    return " ".join(cells)


def main() -> int:
    """Print the table; exit code 1 if a target is missed."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cycles", type=int, default=2100, help="cycles of each loop in virtual time")
    parser.add_argument("--seconds", type=float, default=2.0, help="of each loop in real time; 0 for none")
    parser.add_argument("--json", action="store_true", help="one JSON object instead of the table")
    options = parser.parse_args()
    rows: list[Row] = []
    if not options.json:
        print(line(dict(COLUMNS)))
    for case in CASES:
        row: Row = {
            "servos": case.servos,
            "model": case.model,
            "firmware": case.firmware,
            "mbps": case.baudrate // 1_000_000,
        }
        row |= virtual(case, options.cycles)
        row["bus_ratio"] = row["palpate_bus_us"] / row["formula_us"]
        row["host_ratio"] = row["palpate_host_us"] / row["sdk_host_us"]
        if options.seconds > 0:
            row |= real(case, options.seconds)
        rows.append(row)
        if not options.json:
            print(line(row), flush=True)
    worst = max(row["bus_ratio"] for row in rows)
    slowest = max(row["palpate_host_us"] for row in rows)
    if options.json:
        print(json.dumps({"format": "palpate/bench-bus@1", "rows": rows}, indent=1))
    else:
        print(f"bus time over wire time at most {worst:.3f} (target {MAX_RATIO})")
        print(f"host's time of a cycle at most {slowest:.0f} µs (target {MAX_HOST_US:.0f} µs)")
    return int(worst > MAX_RATIO or slowest > MAX_HOST_US)


if __name__ == "__main__":
    sys.exit(main())
