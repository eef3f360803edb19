"""Hostile files against the installed command: does each end in a few lines, exit code 2, soon and small?

    python benchmarks/bench_hostile_files.py
    python benchmarks/bench_hostile_files.py svg "ZIP bomb"      # those whose title has one of these in it

Each file of tests/support/campaign/hostile_files.py is given to the command that reads it, in a folder
of its own.
Measured are the time on the clock, the processor time, and the memory of the command with all processes that
it starts: the sum of their peaks, sampled, or the largest peak of one. A file passes if its command ends
within 10 s of processor time (on an idle computer: of the clock) and 1 GB, with exit code 2, at most eleven
lines of at most 600 characters on stderr, nothing on stdout and no new file; some may also be accepted, with
exit code 0. Ends with exit code 1 if any does not pass.
"""

import os
import subprocess
import sys
import tempfile
import time
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from support.campaign.hostile_files import CASES, Case

PALPATE = Path(sys.executable).with_name("palpate")
MOST_LINES = 11
MOST_S, MOST_MB, GIVE_UP_S = 10.0, 1000.0, 60.0
"""Of processor time, and of the clock before a command is ended."""


@dataclass(frozen=True)
class Seen:
    """What a command did with a file; `wrong`: why that is not allowed, or nothing."""

    code: int
    seconds: float
    processor_s: float
    mb: float
    line: str
    wrong: str


def peaks_mb(process: int) -> float:
    """Sum of the peaks of a process and all that it started and that are there."""
    try:
        status = Path(f"/proc/{process}/status").read_text(encoding="utf-8")
        children = Path(f"/proc/{process}/task/{process}/children").read_text(encoding="utf-8").split()
    except OSError:
        return 0.0
    own = next((int(line.split()[1]) for line in status.splitlines() if line.startswith("VmHWM")), 0)
    return own * 1024 / 1e6 + sum(peaks_mb(int(child)) for child in children)


def run(case: Case) -> Seen:
    """Give the file to its command."""
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        if not (maker := os.fork()):  # what making a large file takes is not to be seen in this process
            case.write(folder / case.name)
            os._exit(0)
        os.waitpid(maker, 0)
        command = [str(PALPATE), *(case.name if part == "FILE" else part for part in case.command)]
        with (folder / "out").open("w+") as out, (folder / "err").open("w+") as err:
            there = set(folder.iterdir())
            begin, peak = time.monotonic(), 0.0
            process = subprocess.Popen(command, cwd=folder, stdout=out, stderr=err, stdin=subprocess.DEVNULL)
            while not (ended := os.wait4(process.pid, os.WNOHANG))[0]:
                peak = max(peak, peaks_mb(process.pid))
                if time.monotonic() - begin > GIVE_UP_S:
                    process.kill()
                time.sleep(0.01)
            seconds = time.monotonic() - begin
            out.seek(0), err.seek(0)
            said, line = out.read(), err.read()
        code, usage = os.waitstatus_to_exitcode(ended[1]), ended[2]
        busy = usage.ru_utime + usage.ru_stime
        peak = max(peak, usage.ru_maxrss * 1024 / 1e6)
        new = sorted(path.name for path in set(folder.iterdir()) - there)
    return Seen(code, seconds, busy, peak, line.strip(), problem(case, code, busy, peak, said, line, new))


def problem(case: Case, code: int, seconds: float, mb: float, said: str, line: str, new: list[str]) -> str:
    """The first thing that is not as it has to be."""
    lines = line.splitlines()
    checks = [
        (seconds < MOST_S, "too long"),
        (mb < MOST_MB, "too much memory"),
        ("Traceback" not in line, "traceback"),
        (code == 2 or (case.accepted and code == 0), f"exit code {code}"),
        (code == 0 or (1 <= len(lines) <= MOST_LINES and line.startswith("error: ")), f"{len(lines)} lines"),
        (code == 0 or max(map(len, lines), default=0) <= 600, "a long line"),
        (code == 0 or not said, "something on stdout"),
        (code == 0 or not new, f"wrote {', '.join(new)}"),
    ]
    return next((words for good, words in checks if not good), "")


def main(wanted: list[str]) -> int:
    cases = [case for case in CASES if not wanted or any(part in case.title for part in wanted)]
    print(f"{'file':55} {'code':>4} {'s':>6} {'cpu':>5} {'MB':>5}  what was said")
    wrong: Counter[str] = Counter()
    worst = [0.0, 0.0]
    for case in cases:
        seen = run(case)
        worst = [max(worst[0], seen.processor_s), max(worst[1], seen.mb)]
        said = seen.line.removeprefix(f"error: {case.name}: ").replace("\n", " ⏎ ")
        told = f"WRONG, {seen.wrong}: {said[-90:]}" if seen.wrong else said[:90]
        cost = f"{seen.seconds:6.1f} {seen.processor_s:5.1f} {seen.mb:5.0f}"
        print(f"{case.title[:55]:55} {seen.code:4} {cost}  {told}", flush=True)
        wrong[seen.wrong] += 1
    good = wrong.pop("", 0)
    print(f"\n{good} of {len(cases)} as they have to be")
    print(f"at most {worst[0]:.1f} s of processor time and {worst[1]:.0f} MB")
    for words, count in wrong.most_common():
        print(f"{count} × {words}")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
