"""Work for a process that says that it has begun, and then takes long."""

import os
import signal
import sys
import time
from pathlib import Path

__all__ = ["killed", "wait"]


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
