"""Worker processes of tests."""

import json
import os
import random
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import psutil

from support.commands.command import PATIENCE_S, until

# ----------------------------------------------------------------------------------------------------
# A dask scheduler with workers as processes of their own, which can be killed one by one.


@dataclass(frozen=True)
class Cluster:
    """`address` of the scheduler; `nannies` start a worker again when it has died."""

    address: str
    scheduler: psutil.Process
    nannies: tuple[psutil.Process, ...]

    def workers(self) -> list[psutil.Process]:
        """Those that run now."""
        children = [child for nanny in self.nannies for child in nanny.children()]
        return [child for child in children if "spawn_main" in " ".join(_words(child))]

    def kill_one(self, rng: random.Random) -> bool:
        """SIGKILL to any of them; whether there was one."""
        workers = self.workers()
        if workers:
            rng.choice(workers).kill()
        return bool(workers)


def _words(process: psutil.Process) -> list[str]:
    try:
        return list(process.cmdline())
    except psutil.Error:  # it has just ended
        return []


@contextmanager
def cluster(folder: Path, workers: int) -> Iterator[Cluster]:
    """Start a scheduler on any free port of this computer, and workers of one thread each."""
    file = folder / "scheduler.json"
    quiet = ("--no-dashboard", "--dashboard-address", "127.0.0.1:0")
    words = {
        "scheduler": ("--host", "127.0.0.1", "--port", "0", *quiet),
        "worker": ("--nthreads", "1", "--memory-limit", "0", *quiet),
    }
    with (folder / "cluster.log").open("w") as log:

        def start(what: str) -> psutil.Popen:
            return psutil.Popen(
                [sys.executable, "-m", "dask", what, *words[what], "--scheduler-file", str(file)],
                cwd=folder,
                stdout=log,
                stderr=subprocess.STDOUT,
                env=os.environ | {"OPENBLAS_NUM_THREADS": "1"},
            )

        started = [start("scheduler"), *(start("worker") for _ in range(workers))]
        try:
            yield Cluster(_address(file), started[0], tuple(started[1:]))
        finally:
            _end(started)


def _address(file: Path) -> str:
    until(lambda: file.exists() and file.stat().st_size, "the scheduler did not start")
    return str(json.loads(file.read_text(encoding="utf-8"))["address"])


def _end(started: list[psutil.Popen]) -> None:
    """Nannies first: each would start its worker again."""
    family = [
        child for process in started if process.is_running() for child in process.children(recursive=True)
    ]
    for process in (*reversed(started), *family):
        if process.is_running():
            process.kill()
    for process in started:
        process.wait(timeout=PATIENCE_S)


# ----------------------------------------------------------------------------------------------------
# Work for a process that says that it has begun, and then takes long.


def wait(folder: str, seconds: float) -> None:
    """Leave a file of the process's number and this work in a folder, and take so long."""
    Path(folder, f"{os.getpid()} {seconds}").touch()
    time.sleep(seconds)


def killed() -> None:
    """End this process as the system does where memory is out."""
    os.kill(os.getpid(), signal.SIGKILL)


if __name__ == "__main__":
    from palpate.rig.workers import in_processes

    place = sys.argv[1]
    list(in_processes(wait, [(place, 600.0), (place, 0.0), (place, 600.0)], workers=3))
