"""A run's timing beside its live view: with none, with one page, with a hundred that do not read.

    python benchmarks/bench_view.py --runs 3        # six minutes

Each run is `palpate identify` on an emulated bench that another process serves on pseudo-terminals in real
time. Judged by the run's log: the time between two packets to the servos, from the first stage to the end.

On two cores, 3 runs each:

| pages | served | packets | between two, ms: median | 99 % | most |
|---|---|---|---|---|---|
| no view | 0 | 4746 | 22.62 | 87.72 | 178.64 |
| one page | 1 | 4757 | 22.45 | 88.39 | 176.29 |
| 100 pages that do not read | 32 | 4730 | 22.58 | 87.57 | 176.97 |
"""

import argparse
import json
import signal
import socket
import statistics
import subprocess
import sys
import tempfile
import time
from contextlib import ExitStack, closing, suppress
from itertools import pairwise
from pathlib import Path

import zstandard

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from support.benches.rigs import quick_bench

PALPATE = Path(sys.executable).with_name("palpate")
_CASES = {"no view": None, "one page": 1, "100 pages that do not read": 100}


def intervals_s(log: Path) -> list[float]:
    """Times between two packets to the servos, once fingers move."""
    with zstandard.ZstdDecompressor().stream_reader(log.read_bytes()) as stream:
        lines = b"".join(iter(lambda: stream.read(1 << 20), b"")).splitlines()
    events = [json.loads(line) for line in lines]
    begin = next(item["t_s"] for item in events if item["event"] == "stage")
    bus = next(item["port"] for item in events if item["event"] == "opened")
    sent = [
        item["t_s"]
        for item in events
        if item["event"] == "bytes" and item["direction"] == "sent" and item["port"] == bus
    ]
    return [after - before for before, after in pairwise(t_s for t_s in sent if t_s > begin)]


def run(folder: Path, pages: int | None, port: int) -> tuple[list[float], int]:
    """Intervals (s) of a run with so many pages, and how many of them were served."""
    rig, parts = quick_bench(folder, fingers=2)
    words = [PALPATE, "emulate", "--rig", rig, "--objects", parts, "--seed", "7", "--rig-out", "real.toml"]
    server = subprocess.Popen(words, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    assert server.stdout is not None
    server.stdout.readline()
    words = [PALPATE, "identify", "--rig", "real.toml", "--objects", parts]
    view = [] if pages is None else ["--view", "--view-port", str(port)]
    try:
        with ExitStack() as stack:
            process = subprocess.Popen(
                [*words, *view], cwd=folder, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
            )
            served = sum(asks(stack, process, port) for _ in range(pages or 0))
            process.wait()
    finally:
        server.send_signal(signal.SIGINT)
        with suppress(subprocess.TimeoutExpired):
            server.wait(10)
        server.kill()
        server.wait()
    (log,) = folder.glob("palpate-sessions/*/session.jsonl.zst")
    return intervals_s(log), served


def asks(stack: ExitStack, process: subprocess.Popen[bytes], port: int) -> bool:
    """Ask for the frames and read no more than the answer's first line; whether it is 200."""
    while process.poll() is None:
        try:
            client = stack.enter_context(closing(socket.create_connection(("127.0.0.1", port), timeout=10)))
            client.sendall(f"GET /stream HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\n\r\n".encode())
            return client.recv(12).endswith(b"200")
        except ConnectionRefusedError:
            time.sleep(0.02)
    return False


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--port", type=int, default=8766)
    given = parser.parse_args()
    print("| pages | served | packets | between two, ms: median | 99 % | most |")
    print("|---|---|---|---|---|---|")
    for name, pages in _CASES.items():
        found, served = [], 0
        for _ in range(given.runs):
            with tempfile.TemporaryDirectory(prefix="palpate-bench-view-") as folder:
                more, served = run(Path(folder), pages, given.port)
                found += more
        percentiles = statistics.quantiles(found, n=100)
        times = " | ".join(
            f"{1e3 * item:.2f}" for item in (statistics.median(found), percentiles[98], max(found))
        )
        print(f"| {name} | {served} | {len(found)} | {times} |", flush=True)


if __name__ == "__main__":
    main()
