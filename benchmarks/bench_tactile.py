"""Frames per second through the tactile code on one core: run with `python benchmarks/bench_tactile.py`.

One row for each way a recorded stream of 8 x 8 taxels of 16 bit goes; each is run several times, and the
least processor time counts. The plain loop does what cannot be left out, with the same libraries: cut at the
delimiter, COBS, CRC, header, array. A decoder that also says what was wrong with each stretch takes longer:
the last column. Below, the contact extractor's `process` over recordings of emulated contacts
(tests/support/oracles/array_contacts.py), in which nine tenths of the frames are untouched or none is; its
plain loop
takes the zero off, sums the columns and takes the centroid.
"""

import argparse
import json
import os
import struct
import sys
import time
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # one core is what is measured
import numpy as np
from cobs import cobs

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from palpate.drivers.tactile.array import TactileArray
from palpate.drivers.tactile.codec import Decoder, encode
from palpate.drivers.tactile.description import Description, Shape
from palpate.drivers.tactile.messages import Ack, Describe, Frame, Hello, Message, Start
from palpate.drivers.transport.clock import MonotonicClock
from support.oracles.array_contacts import RATE_HZ, TARE_FRAMES, Session, cylinder_session, pad_session, tared

ROWS, COLS = 8, 8
HEADER = struct.Struct("<BBHIQH")
PLAIN = "plain loop"
DESCRIPTION = Description(
    unique_id=b"benchmark's own.",
    firmware="bench",
    emulated=True,
    shape=Shape.FLAT,
    rows=ROWS,
    cols=COLS,
    bit_depth=16,
    max_rate_hz=1000.0,
    full_scale_n=10.0,
    counts_per_n=6553.5,
    tip_radius_mm=0.0,
    columns=tuple(range(COLS)),
    row_heights_mm=tuple(range(ROWS)),
)


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
        encode(Message(n, 1000 * n, Frame(ROWS, COLS, counts.tobytes())))
        for n, counts in enumerate(taxels, 1)
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


class RecordedPort:
    """A port that has the whole stream to give; it answers HELLO and START in front of it."""

    def __init__(self, stream: bytes) -> None:
        self.port: str | None = "recorded"
        self.timeout: float | None = 0.0
        self._stream = stream
        self._answers: list[bytes] = []
        self._at = 0

    @property
    def in_waiting(self) -> int:
        return len(self._answers[0]) if self._answers else min(len(self._stream) - self._at, 1 << 16)

    def read(self, size: int = 1, /) -> bytes:
        if self._answers:
            return self._answers.pop(0)
        data = self._stream[self._at : self._at + size]
        self._at += len(data)
        return data

    def write(self, data: bytes, /) -> int | None:
        for item in Decoder().feed(data):
            body = item.body if isinstance(item, Message) else None
            if isinstance(body, Hello):
                self._answers.append(encode(Message(0, 0, Describe(body.request_id, DESCRIPTION))))
            elif isinstance(body, Start):
                self._answers.append(encode(Message(0, 0, Ack(body.request_id))))
        return len(data)


def driven(stream: bytes) -> int:
    """The stream through `TactileArray.frames`, called as often as it takes."""
    port, found = RecordedPort(stream), 0
    array = TactileArray(port, MonotonicClock(), "bench")
    array.connect()
    array.start(1000.0)
    while frames := array.frames():
        found += len(frames)
    return found


CASES = (
    Case(PLAIN, plain_loop),
    Case("decode, 64 kB at a time", decoded(65536), 100_000),
    Case("decode, 512 bytes at a time", decoded(512), 100_000),
    Case("driver", driven),
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


@dataclass(frozen=True)
class Speed:
    """How fast one recording goes through the extractor, and its processor time beside the plain loop's."""

    name: str
    frames_per_s: float
    times_plain: float


RECORDINGS: tuple[tuple[str, Callable[[], Session]], ...] = (
    ("cylinder 8 x 8", lambda: cylinder_session(8, 200, rows=8, cols=8, radius_mm=5.0, coverage_deg=180)),
    ("cylinder 8 x 20", lambda: cylinder_session(20, 200, rows=8, cols=20, radius_mm=5.0, coverage_deg=270)),
    ("pad 8 x 8", lambda: pad_session(8, 200, rows=8, cols=8)),
    ("pad 8 x 20", lambda: pad_session(20, 200, rows=8, cols=20)),
)
EXTRACTION_TARGET = 20_000


def plain_centroids(session: Session, counts: np.ndarray) -> np.ndarray:
    """Zero, gain, sum along the rows, centroid: what no extractor can leave out."""
    zero = session.counts[:TARE_FRAMES].mean(axis=0)
    columns = ((counts - zero) * session.calibration.gain).sum(axis=1)
    centroid: np.ndarray = columns @ np.array(session.description.columns) / columns.sum(axis=1)
    return centroid


def least_s(run: Callable[[], object], repeats: int) -> float:
    """Shortest processor time of a run, s."""
    times = []
    for _ in range(repeats):
        begin = time.process_time()
        run()
        times.append(time.process_time() - begin)
    return min(times)


def extraction_speeds(repeats: int) -> list[Speed]:
    """Each recording whole, and its touched frames over and over; templates are made beforehand."""
    speeds = []
    for name, make in RECORDINGS:
        session = make()
        extractor = tared(session)
        whole = session.counts[TARE_FRAMES:]
        touched = np.tile(session.counts[session.touched], (40, 1, 1))
        for part, counts in (("whole", whole), ("all touched", touched)):
            time_s = session.time_s[TARE_FRAMES] + np.arange(len(counts)) / RATE_HZ
            if part == "all touched":  # zeros drift on meanwhile; here they shall not
                time_s[:] = session.time_s[TARE_FRAMES]
            extractor.process(counts, time_s)
            taken = least_s(lambda e=extractor, c=counts, t=time_s: e.process(c, t), repeats)
            plain = least_s(lambda s=session, c=counts: plain_centroids(s, c), repeats)
            speeds.append(Speed(f"{name}, {part}", len(counts) / taken, taken / plain))
    return speeds


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
    rows += [
        {
            "case": f"extract, {speed.name}",
            "frames_per_s": speed.frames_per_s,
            "target_per_s": EXTRACTION_TARGET if "8 x 8" in speed.name else None,
            "times_plain": speed.times_plain,
        }
        for speed in extraction_speeds(options.repeats)
    ]
    if options.json:
        print(json.dumps({"format": "palpate/bench-tactile@1", "rows": rows}, indent=1))
    else:
        print(f"{'':36} {'frames/s':>10} {'target':>10} {'times plain':>12}")
        for row in rows:
            target = "–" if row["target_per_s"] is None else f"{row['target_per_s']:.0f}"
            print(f"{row['case']:36} {row['frames_per_s']:10.0f} {target:>10} {row['times_plain']:12.2f}")
    return int(any(row["target_per_s"] and row["frames_per_s"] < row["target_per_s"] for row in rows))


if __name__ == "__main__":
    sys.exit(main())
