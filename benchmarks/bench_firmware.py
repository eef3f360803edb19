"""A million frames from the C firmware to the Python driver: run with `python benchmarks/bench_firmware.py`.

The firmware's host program is built with the computer's C compiler and serves an array of 8 x 8 taxels of
16 bit on a pseudo-terminal, as fast as the line takes the frames. Every frame is compared with what the array
must have sampled. One row each: through the decoder, undamaged; through the decoder, with one bit flipped in
1 of 10,000 bytes each way; and undamaged through `TactileArray`, the driver that the rest uses.

Columns: `sent`, frames by the firmware's own count; `received`; `lost`, messages that the decoder counted as
missing; `answers`, how many of those were no frames; `hit`, messages with a flipped byte, and `delimiters`,
how many of those had their delimiter hit, which costs the next message, too; `wrong`, frames received that
are not what was sampled. sent = received + lost - answers, or the program ends with 1. The rate is that of
everything in this process, comparing included.
"""

import argparse
import json
import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
import numpy as np

from palpate.drivers.tactile import TactileArray
from palpate.drivers.transport.clock import MonotonicClock
from palpate.drivers.transport.ports import open_port
from support.devices.firmware import Sips, array_host, build_firmware, exchange, expected_counts

ROWS, COLUMNS = 8, 8
SIP = 65536  # bytes
Row = dict[str, object]


def by_decoder(program: Path, frames: int, flip: float, seed: int) -> Row:
    """Frames through `Decoder`, with a share of all bytes damaged."""
    options = ("--fast", "--frames", frames, "--flip", flip, "--flip-in", flip, "--seed", seed)
    with array_host(program, *options) as host:
        begin = time.perf_counter()
        taken, lost = exchange(host, ROWS, COLUMNS, frames)
        spent = time.perf_counter() - begin
    told = host.told
    answers = told["answers"] - taken.first - 1 - taken.answers
    return {
        "run": f"decoder, {flip:g} of the bytes flipped" if flip else "decoder",
        "sent": told["frames"],
        "received": taken.frames,
        "lost": lost,
        "answers": answers,
        "hit": told["flipped_messages"],
        "delimiters": told["flipped_delimiters"],
        "wrong": taken.wrong,
        "frames_per_s": taken.frames / spent,
        "adds_up": told["frames"] == frames == taken.frames + lost - answers and taken.wrong == 0,
    }


def by_driver(program: Path, frames: int) -> Row:
    """Frames through `TactileArray`."""
    received = wrong = 0
    with array_host(program, "--fast", "--frames", frames) as host:
        port = open_port(host.path, 1_000_000)
        sips = Sips(port, SIP)
        array = TactileArray(sips, MonotonicClock(), "bench")
        array.connect()
        begin = time.perf_counter()
        array.start(1000)
        while received < frames:
            sips.refill()
            batch = array.frames() or [array.wait_frame(5.0)]
            numbers = np.array([frame.sequence for frame in batch], np.uint32)
            counts = np.array([frame.counts for frame in batch])
            right = (counts == expected_counts(numbers, ROWS, COLUMNS)).all(axis=(1, 2))
            received += len(batch)
            wrong += int(np.count_nonzero(~right))
        spent = time.perf_counter() - begin
        array.stop()
        port.close()
    found = array.counters
    return {
        "run": "driver",
        "sent": host.told["frames"],
        "received": received,
        "lost": found.lost,
        "answers": 0,
        "hit": 0,
        "delimiters": 0,
        "wrong": wrong,
        "frames_per_s": received / spent,
        "adds_up": host.told["frames"] == received
        and not (found.lost or found.faults or found.dropped or wrong),
    }


def table(rows: list[Row]) -> str:
    heads = [name for name in rows[0] if name != "adds_up"]
    lines = [" | ".join(heads), " | ".join("---" for _ in heads)]
    for row in rows:
        cells = [row[name] for name in heads]
        lines.append(" | ".join(f"{cell:.0f}" if isinstance(cell, float) else str(cell) for cell in cells))
    return "\n".join(f"| {line} |" for line in lines)


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--frames", type=int, default=1_000_000)
    parser.add_argument("--flip", type=float, default=1e-4)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    program = build_firmware("host") / "palpate-array-host"
    rows = [
        by_decoder(program, args.frames, 0.0, args.seed),
        by_decoder(program, args.frames, args.flip, args.seed),
        by_driver(program, args.frames),
    ]
    print(json.dumps(rows) if args.json else table(rows))
    return 0 if all(row["adds_up"] for row in rows) else 1


if __name__ == "__main__":
    sys.exit(main())
