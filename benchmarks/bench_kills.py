"""Runs killed at random moments on pseudo-terminals: what their sessions are good for afterwards.

    python benchmarks/bench_kills.py --kills 200        # an hour; needs strace

Each run is `palpate identify` on an emulated bench that another process serves in real time, ended by SIGKILL
after a random time. Then its session must be listed as killed, described, exported (CSV, MCAP), reported and
replayed to its last whole line.

What was lost is judged by the system: strace notes every write of the run to a port. The first byte written
to a port that is not in the log marks where the log ends; from there to the kill is the time lost (0 where
the log has every byte). Ends with exit code 1 if a session was not good for all of that.

On two cores, with one to three other processes at full load beside it:

| kills | too early or late | sessions | wrong | lost, s: median | most | more than 0.1 s |
|---|---|---|---|---|---|---|
| 200 | 22 | 178 | 0 | 0.023 | 0.114 | 1 |
"""

import argparse
import json
import os
import random
import re
import shutil
import signal
import statistics
import subprocess
import sys
import tempfile
from collections import Counter, defaultdict
from contextlib import suppress
from itertools import accumulate
from pathlib import Path

import zstandard

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from support.benches.rigs import quick_bench

PALPATE = Path(sys.executable).with_name("palpate")
_LONGEST_S = 14.0  # of a run until it is killed
_LOST_S = 0.1
_WRITE = re.compile(r"^\d+ +([\d.]+) write\(\d+<(/dev/pts/\d+)>.* = (\d+)$")
_RESUMED = re.compile(
    r"^(\d+) +([\d.]+) (?:write\(\d+<(/dev/pts/\d+)>.*unfinished|<\.\.\. write resumed>.* = (\d+)$)"
)


def asked(*words: object, cwd: Path) -> subprocess.CompletedProcess[str]:
    """A command of palpate."""
    return subprocess.run(
        [PALPATE, *map(str, words)], cwd=cwd, capture_output=True, text=True, timeout=300, check=False
    )


def killed_run(folder: Path, after_s: float) -> bool:
    """Run and kill; whether it was still running. strace's record is `writes.txt` in the folder."""
    rig, parts = quick_bench(folder, fingers=2)
    words = [PALPATE, "emulate", "--rig", rig, "--objects", parts, "--seed", "7", "--rig-out", "real.toml"]
    server = subprocess.Popen(words, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    assert server.stdout is not None
    server.stdout.readline()
    traced = [
        "strace",
        "-D",
        "-f",
        "-y",
        "-ttt",
        "--seccomp-bpf",
        "-s",
        "0",
        "-e",
        "trace=write",
        "-o",
        "writes.txt",
    ]
    run = subprocess.Popen(
        [*traced, PALPATE, "identify", "--rig", "real.toml", "--objects", "small-parts.json"],
        cwd=folder,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    try:
        with suppress(subprocess.TimeoutExpired):
            run.wait(after_s)
            return False
        return True
    finally:
        run.kill()
        run.wait()
        server.send_signal(signal.SIGINT)
        with suppress(subprocess.TimeoutExpired):
            server.wait(10)
        server.kill()
        server.wait()


def lost_s(folder: Path, log: Path) -> float:
    """Time (s) from the first byte to a port that is not in the log to the kill.

    A byte is logged before it is written, so the log may have more than the system saw. AssertionError if
    the log's ports are not those that were written to.
    """
    trace = (folder / "writes.txt").read_text()
    killed = float(re.findall(r"^\d+ +([\d.]+) \+\+\+ killed by SIGKILL", trace, re.MULTILINE)[-1])
    writes = defaultdict(list)
    for instant, path, size in _writes(trace):
        writes[path].append((instant, size))
    urls, logged = {}, Counter[str]()
    for line in logged_lines(log):
        if line["event"] == "opened":
            urls[line["port"]] = os.path.realpath(line["url"])
        elif line["event"] == "bytes" and line["direction"] == "sent":
            logged[urls[line["port"]]] += len(line["base64"]) // 4 * 3 - line["base64"].count("=")
    assert logged.keys() <= set(urls.values())
    assert writes or not logged
    ends = [killed]
    for path, calls in writes.items():
        sums = accumulate(size for _, size in calls)
        ends += [instant for (instant, _), end in zip(calls, sums, strict=True) if end > logged[path]][:1]
    return killed - min(ends)


def _writes(trace: str) -> list[tuple[float, str, int]]:
    """Writes to terminals: instant (s), path, bytes."""
    found, open_calls = [], {}
    for line in trace.splitlines():
        if whole := _WRITE.match(line):
            found.append((float(whole[1]), whole[2], int(whole[3])))
        elif part := _RESUMED.match(line):
            thread, instant, path, size = part.groups()
            if path:
                open_calls[thread] = (float(instant), path)
            elif thread in open_calls:
                found.append((*open_calls.pop(thread), int(size)))
    return sorted(found)


def logged_lines(log: Path) -> list[dict]:
    """The whole lines of a log, unpacked by zstandard itself."""
    with zstandard.ZstdDecompressor().stream_reader(log.read_bytes()) as stream:
        data = b"".join(iter(lambda: stream.read(1 << 20), b""))
    return [json.loads(line) for line in data[: data.rfind(b"\n") + 1].splitlines()]


def faults(folder: Path) -> list[str]:
    """What the killed session is not good for."""
    (session,) = (folder / "palpate-sessions").iterdir()
    found = []
    listed = json.loads(asked("sessions", "--json", cwd=folder).stdout)
    if listed["unreadable"] or [item["ended"] for item in listed["sessions"]] != [None]:
        found.append(f"sessions: {listed}")
    commands = {
        "info": ("info", session),
        "csv": ("export", session, "--csv", "tables"),
        "mcap": ("export", session, "--mcap", "run.mcap"),
        "report": ("report", session),
        "replay": ("replay", session),
    }
    for name, words in commands.items():
        done = asked(*words, cwd=folder)
        if done.returncode:
            found.append(f"{name}: {done.returncode} {done.stdout[-200:]}{done.stderr[-400:]}")
    return found


def main() -> int:
    """Kill runs, and print what came of it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--kills", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    moments = random.Random(given.seed)
    lost, wrong, early = [], 0, 0
    for number in range(given.kills):
        folder = Path(tempfile.mkdtemp(prefix="palpate-kills-"))
        try:
            ran = killed_run(folder, moments.uniform(0.3, _LONGEST_S))
            logs = list(folder.glob("palpate-sessions/*/session.jsonl.zst"))
            if not ran or not logs or not logs[0].stat().st_size:
                early += 1
                continue
            lost.append(lost_s(folder, logs[0]))
            problems = faults(folder)
            wrong += bool(problems)
            for problem in [*problems, *([f"{lost[-1]:.3f} s lost"] if lost[-1] > _LOST_S else [])]:
                print(f"kill {number}: {problem}", flush=True)
        finally:
            shutil.rmtree(folder)
        if (number + 1) % 10 == 0:
            print(f"{number + 1} kills, {wrong} wrong", file=sys.stderr, flush=True)
    middle, most = statistics.median(lost or [0.0]), max(lost, default=0.0)
    more = sum(item > _LOST_S for item in lost)
    print("| kills | too early or late | sessions | wrong | lost, s: median | most | more than 0.1 s |")
    print("|---|---|---|---|---|---|---|")
    print(f"| {given.kills} | {early} | {len(lost)} | {wrong} | {middle:.3f} | {most:.3f} | {more} |")
    return 1 if wrong else 0


if __name__ == "__main__":
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    sys.exit(main())
