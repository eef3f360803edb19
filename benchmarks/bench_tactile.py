"""Frames per second through the tactile code on one core: run with `python benchmarks/bench_tactile.py`.

One row for each way a recorded stream of 8 x 8 taxels of 16 bit goes; each is run several times, and the
least processor time counts. The plain loop does what cannot be left out, with the same libraries: cut at the
delimiter, COBS, CRC, header, array. A decoder that also says what was wrong with each stretch takes longer:
the last column.
"""

import argparse
import json
import struct
import sys
import time
import zlib
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from cobs import cobs

from palpate.drivers.tactile.messages import Frame, Message
from palpate.drivers.tactile.protocol import Decoder, encode

ROWS, COLS = 8, 8
HEADER = struct.Struct("<BBHIQH")
PLAIN = "plain loop"


@dataclass(frozen=True)
class Case:
    """One way: `run` takes the whole stream and returns how many frames came out; `target` is in frames/s."""

    name: str
    run: Callable[[bytes], int]
    target: float | None = None


def recorded(frames: int) -> bytes:
    """A stream of frames whose counts are random."""
    rng = np.random.default_rng(8)
    taxels = rng.integers(0, 65536, (frames, ROWS * COLS), dtype="<u2")
    return b"".join(
        encode(Message(n, 5000 * n, Frame(ROWS, COLS, counts.tobytes()))) for n, counts in enumerate(taxels)
    )


def plain_loop(stream: bytes) -> int:
    """Frames that a loop without any report of faults finds."""
    found = 0
    for piece in stream.split(b"\0"):
        if not piece:
            continue
        plain = cobs.decode(piece)
        if int.from_bytes(plain[-4:], "little") == zlib.crc32(plain[:-4]):
            HEADER.unpack_from(plain)
            found += np.frombuffer(plain, "<u2", ROWS * COLS, 20).reshape(ROWS, COLS).shape[0] == ROWS
    return found


def decoded(chunk: int) -> Callable[[bytes], int]:
    """Feed the stream in pieces, as reads from a port are; every frame becomes an array."""

    def run(stream: bytes) -> int:
        decoder, found = Decoder(), 0
        for at in range(0, len(stream), chunk):
            for item in decoder.feed(stream[at : at + chunk]):
                if isinstance(item, Message) and isinstance(item.body, Frame):
                    found += item.body.counts.shape[0] == ROWS
        return found

    return run


CASES = (
    Case(PLAIN, plain_loop),
    Case("decode, 64 kB at a time", decoded(65536), 100_000),
    Case("decode, 512 bytes at a time", decoded(512), 100_000),
)


def best_s(case: Case, stream: bytes, frames: int, repeats: int) -> float:
    """Shortest processor time of a run, in s: what else runs on the computer counts less."""
    times = []
    for _ in range(repeats):
        begin = time.process_time()
        found = case.run(stream)
        times.append(time.process_time() - begin)
        if found != frames:
            raise SystemExit(f"{case.name} found {found} frames of {frames}")
    return min(times)


def main() -> int:
    """Print the table; exit code 1 if a target is missed."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--frames", type=int, default=50_000)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--json", action="store_true", help="one JSON object instead of the table")
    options = parser.parse_args()
    stream = recorded(options.frames)
    seconds = {case.name: best_s(case, stream, options.frames, options.repeats) for case in CASES}
    rows = [
        {
            "case": case.name,
            "frames_per_s": options.frames / seconds[case.name],
            "target_per_s": case.target,
            "times_plain": seconds[case.name] / seconds[PLAIN],
        }
        for case in CASES
    ]
    if options.json:
        print(json.dumps({"format": "palpate/bench-tactile@1", "rows": rows}, indent=1))
    else:
        print(f"{'':30} {'frames/s':>10} {'target':>10} {'times plain':>12}")
        for row in rows:
            target = "–" if row["target_per_s"] is None else f"{row['target_per_s']:.0f}"
            print(f"{row['case']:30} {row['frames_per_s']:10.0f} {target:>10} {row['times_plain']:12.2f}")
    return int(any(c.target and options.frames / seconds[c.name] < c.target for c in CASES))


if __name__ == "__main__":
    sys.exit(main())
