"""Runs killed at random moments on pseudo-terminals: what their sessions are good for afterwards.

    python benchmarks/bench_kills.py --kills 200        # half an hour

Each run is `palpate identify` on an emulated bench that another process serves in real time, ended by SIGKILL
after a random time. Then its session must be listed as killed, described, exported (CSV, MCAP), reported and
replayed to its last whole line. The log's age at the kill, by its file's date, is what was lost at most:
lines wait 0.05 s, and while a run computes there are none. Ends with exit code 1 if a session was not good
for all of that.

| kills | too early or late | sessions | wrong | age of the log, s: median | most | above 0.1 s |
|---|---|---|---|---|---|---|
| 14 | 2 | 12 | 0 | 0.036 | 0.340 | 2 |
"""

import argparse
import json
import os
import random
import shutil
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from contextlib import suppress
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "support"))
from quick_rig import quick_bench

PALPATE = Path(sys.executable).with_name("palpate")
_LONGEST_S = 14.0  # of a run until it is killed
_LOST_S = 0.1


def asked(*words: object, cwd: Path) -> subprocess.CompletedProcess[str]:
    """A command of palpate."""
    return subprocess.run(
        [PALPATE, *map(str, words)], cwd=cwd, capture_output=True, text=True, timeout=300, check=False
    )


def killed_run(folder: Path, after_s: float) -> float | None:
    """Age of the log (s) when its run was killed; None if there was none yet, or the run had ended."""
    rig, parts = quick_bench(folder, fingers=2)
    words = [PALPATE, "emulate", "--rig", rig, "--objects", parts, "--seed", "7", "--rig-out", "real.toml"]
    server = subprocess.Popen(words, cwd=folder, stdout=subprocess.PIPE, text=True)
    assert server.stdout is not None
    server.stdout.readline()
    run = subprocess.Popen(
        [PALPATE, "identify", "--rig", "real.toml", "--objects", "small-parts.json"],
        cwd=folder,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    try:
        with suppress(subprocess.TimeoutExpired):
            run.wait(after_s)
            return None
        logs = list(folder.glob("palpate-sessions/*/session.jsonl.zst"))
        age = time.time() - logs[0].stat().st_mtime if logs else None
        run.kill()
        return age
    finally:
        run.kill()
        run.wait()
        server.send_signal(signal.SIGINT)
        with suppress(subprocess.TimeoutExpired):
            server.wait(10)
        server.kill()
        server.wait()


def faults(folder: Path) -> list[str]:
    """What the killed session is not good for."""
    (session,) = (folder / "palpate-sessions").iterdir()
    found = []
    listed = json.loads(asked("sessions", "--json", cwd=folder).stdout)
    if listed["unreadable"] or [item["end"] for item in listed["sessions"]] != [None]:
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
    ages, wrong, early = [], 0, 0
    for number in range(given.kills):
        folder = Path(tempfile.mkdtemp(prefix="palpate-kills-"))
        try:
            age = killed_run(folder, moments.uniform(0.3, _LONGEST_S))
            logs = list(folder.glob("palpate-sessions/*/session.jsonl.zst"))
            if age is None or not logs or not logs[0].stat().st_size:
                early += 1
                continue
            ages.append(age)
            problems = faults(folder)
            wrong += bool(problems)
            for problem in problems:
                print(f"kill {number}: {problem}", flush=True)
        finally:
            shutil.rmtree(folder)
        if (number + 1) % 10 == 0:
            print(f"{number + 1} kills, {wrong} wrong", file=sys.stderr, flush=True)
    middle, most = statistics.median(ages or [0.0]), max(ages, default=0.0)
    older = sum(age > _LOST_S for age in ages)
    print("| kills | too early or late | sessions | wrong | age of the log, s: median | most | above 0.1 s |")
    print("|---|---|---|---|---|---|---|")
    print(f"| {given.kills} | {early} | {len(ages)} | {wrong} | {middle:.3f} | {most:.3f} | {older} |")
    return 1 if wrong else 0


if __name__ == "__main__":
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    sys.exit(main())
