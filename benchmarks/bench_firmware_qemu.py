"""Frames from the C firmware on emulated processors: run with `python benchmarks/bench_firmware_qemu.py`.

The firmware is built by arm-none-eabi-gcc and runs on two boards of QEMU, a Cortex-M3 and a Cortex-M0, whose
time follows their instructions: 16 million a second. An array of 8 x 20 taxels of 12 bit streams through the
board's UART, its interrupts and rings, and through `TactileArray`; every frame is compared with what the
board must have sampled. The second run of each board, a tenth as long, has one bit flipped in 1 of 10,000
bytes to the host.

Columns: `sent`, frames by the firmware's own count when the last one had come; `received`; `lost`, messages
missing by their numbers; `given_up`, frames that the board itself left out; `flipped`, bytes; `wrong`,
frames received that are not what was sampled; `frames/s`, of this computer's time; `instructions` for a
frame: all that the board carries out while it streams; `idle`, share of its time that it sleeps; `stack`,
deepest, in bytes. Ends with 1 if a frame is wrong or not accounted for. `--profile` says which functions the
instructions are in.

`--parts N` identifies N parts in real time on the emulated bench, whose three arrays are such boards.
"""

import argparse
import json
import math
import subprocess
import sys
import tempfile
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
import numpy as np
from bench_firmware import Row, table
from qemu_profile import instructions_by_function

from palpate.base.errors import DeviceError
from palpate.config import load_objects, load_rig
from palpate.drivers.tactile import TactileArray
from palpate.drivers.transport.clock import MonotonicClock
from palpate.rig.bench import choose_placements
from support.devices.firmware import expected_counts
from support.devices.ports import NoisyPort, PipePort
from support.devices.qemu import (
    COLUMNS,
    DEPTH,
    MICROBIT,
    MPS2,
    ROWS,
    Machine,
    board_bench,
    missing_tools,
    qemu_board,
    slow_bench,
    write_real_rig,
)

ICOUNT = 6  # 2^6 ns an instruction
_WORTH_A_ROW = 100  # instructions
_ASKED = 10  # a busy computer may keep an emulator from answering in time


def frames_row(machine: Machine, frames: int, rate_hz: float, share: float) -> Row:
    """So many frames of one board, with a share of the bytes to the host damaged."""
    received = wrong = missing = 0
    last = -1
    with (
        tempfile.TemporaryDirectory() as folder,
        qemu_board(machine, Path(folder), icount=ICOUNT, is_piped=True) as board,
    ):
        pipes = PipePort(board.path)
        port = NoisyPort(pipes, share, seed=1)
        array = TactileArray(port, MonotonicClock(), machine.name)
        array.connect()
        started(array, rate_hz)
        before = board.account()
        begin = time.perf_counter()
        while received < frames:
            batch = array.frames() or [array.wait_frame(30.0)]
            numbers = np.array([frame.sequence for frame in batch], np.uint32)
            counts = np.array([frame.counts for frame in batch])
            right = (counts == expected_counts(numbers, ROWS, COLUMNS, DEPTH)).all(axis=(1, 2))
            wrong += int(np.count_nonzero(~right))
            received += len(batch)
            if last >= 0:
                missing += int(numbers[-1]) - last - len(batch)
            else:
                missing += int(numbers[-1] - numbers[0]) + 1 - len(batch)
            last = int(numbers[-1])
        spent = time.perf_counter() - begin
        account = board.account()
        pipes.close()
    time_us, asleep_us = account.clock_us - before.clock_us, account.asleep_us - before.asleep_us
    return {
        "run": f"{machine.core}, {rate_hz:g}/s" + (f", {share:g} of the bytes flipped" if share else ""),
        "sent": account.frames,
        "received": received,
        "lost": missing,
        "given_up": account.given_up,
        "flipped": port.flipped,
        "wrong": wrong,
        "frames/s": received / spent,
        "instructions": (time_us - asleep_us) * 1000 / 2**ICOUNT / (account.frames - before.frames),
        "idle": f"{100 * asleep_us / time_us:.0f} %",
        "stack": account.stack_bytes,
        "adds_up": wrong == 0 and account.frames >= received + missing and missing <= 2 * port.flipped,
    }


def profile_rows() -> list[Row]:
    """Instructions for a frame by function, of both boards, as far as they are more than a few."""
    found = []
    for machine in (MPS2, MICROBIT):
        with tempfile.TemporaryDirectory() as folder:
            found.append(instructions_by_function(machine, 250.0, Path(folder)))
    totals = [sum(counts.values()) for counts in found]
    rows: list[Row] = [{"function": "all", MPS2.core: totals[0], MICROBIT.core: totals[1]}]
    for name in dict.fromkeys(name for counts in found for name in counts):
        each = [counts.get(name, 0.0) for counts in found]
        if max(each) > _WORTH_A_ROW:
            rows.append({"function": name, MPS2.core: each[0], MICROBIT.core: each[1]})
    return rows


def started(array: TactileArray, rate_hz: float) -> None:
    """A stream that runs."""
    for attempt in range(_ASKED):
        try:
            array.start(rate_hz)
        except DeviceError:
            if attempt == _ASKED - 1:
                raise
        else:
            return


def part_row(seed: int) -> Row:
    """A part that `identify` is given, with boards on all fingers."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        rig, parts = slow_bench(folder)
        (truth,) = choose_placements(load_rig(rig), load_objects(parts), None, seed)
        with board_bench(load_rig(rig), [truth], seed, folder) as bench:
            real = write_real_rig(rig, bench.paths, folder / "real.toml")
            done = subprocess.run(
                [sys.executable, "-m", "palpate", "identify", "--rig", real, "--objects", parts, "--json"],
                cwd=folder,
                capture_output=True,
                text=True,
                check=False,
            )
            accounts = [board.account() for board in bench.boards.values()]
    answer = json.loads(done.stdout) if done.stdout else {"verdict": f"exit code {done.returncode}"}
    said = f"{answer['verdict']} {answer.get('object') or ''}"
    is_within = False
    if answer.get("object") == truth.model.name:
        turns = round((answer["configuration"]["theta"] - truth.theta_rad) / (2 * math.pi))
        pose = {"x": truth.x_mm, "y": truth.y_mm, "theta": truth.theta_rad + 2 * math.pi * turns}
        is_within = all(lo <= pose[key] <= hi for key, (lo, hi) in answer["bounds"].items())
    print(done.stderr.strip().splitlines()[-1:], file=sys.stderr)
    return {
        "seed": seed,
        "part": truth.model.name,
        "answer": said,
        "within bounds": "yes" if is_within else "no",
        "grips": answer.get("grips", 0),
        "frames": sum(account.frames for account in accounts),
        "given_up": sum(account.given_up for account in accounts),
        "adds_up": not answer.get("object") or is_within,
    }


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--frames", type=int, default=1_000_000, help="of each undamaged run")
    parser.add_argument("--flip", type=float, default=1e-4)
    parser.add_argument("--parts", type=int, default=0)
    parser.add_argument("--profile", action="store_true")
    args = parser.parse_args()
    missing = missing_tools()
    if missing:
        print(f"needs the Debian packages {missing}", file=sys.stderr)
        return 2
    if args.profile:
        print(table(profile_rows()))
        return 0
    rows = []
    if args.frames:
        for machine, rate_hz in ((MPS2, 250.0), (MICROBIT, 250.0)):
            rows.append(frames_row(machine, args.frames, rate_hz, 0.0))
            rows.append(frames_row(machine, args.frames // 10, rate_hz, args.flip))
        print(table(rows))
    parts = []
    for seed in range(args.parts):
        parts.append(part_row(seed))
        print(table(parts[-1:]).splitlines()[-1], file=sys.stderr)
    if parts:
        print(table(parts))
    return 0 if all(row["adds_up"] for row in [*rows, *parts]) else 1


if __name__ == "__main__":
    sys.exit(main())
